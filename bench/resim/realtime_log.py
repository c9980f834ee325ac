"""A real-time log from an ECU's view: frames in order of reception, and the cycles of its own frames."""

from collections.abc import Mapping
from functools import cached_property

import numpy as np
import numpy.typing as npt

from bench.bus.codec import Codec
from bench.bus.e2e import COUNTER_MODULUS, check
from bench.bus.frame import BusFrame
from bench.conductor.realtime import SETTLE_CYCLES
from bench.cycle import CYCLE_NS
from bench.names import vehicle_bus
from bench.resim.recording import EcuLog, frames_of

_NEVER = 1 << 62
_STEP_TIME = "StepTime"
"""The signal of an ECU's timing message that says how long its step took, us."""


class Feed:
    """All frames of an ECU's buses in the order in which they were received.

    A step took its inputs when it began: its duration, from the ECU's timing message, before its first frame. If that
    message is not sent in every cycle, it has the longest of several durations; but no step begins before the wait for
    its inputs is over, unless all of them are there. If an ECU does not report durations, frames received while it was
    calculating count as its inputs too.
    """

    def __init__(self, log: EcuLog, input_wait_s: float) -> None:
        """Read the log of an ECU that waits for its inputs for so long after BenchSync (s)."""
        self._log = log
        self._wait_ns = round(input_wait_s * 1e9)
        parts = []
        for bus, recorded in log.buses.items():
            frames = frames_of(bus, recorded.table)
            columns = (recorded.table["receive"].tolist(), recorded.cycles.tolist(), log.own_rows(bus).tolist())
            parts += list(zip(*columns, frames, strict=True))
        self._own: dict[int, list[tuple[int, BusFrame]]] = {}
        for received, cycle, own, frame in parts:
            if own:
                self._own.setdefault(cycle, []).append((received, frame))
        others = [(received, frame) for received, _, own, frame in parts if not own]
        self._others = sorted(others, key=lambda item: item[0])
        self._received = np.array([received for received, _ in self._others], np.int64)
        self._at = 0
        self._timed = self._step_times()

    def _step_times(self) -> npt.NDArray[np.int64]:
        """When each timing message of the ECU was received, and the duration that it reports (2, n), ns."""
        bus, name = vehicle_bus(self._log.slot.vehicle), self._log.slot.message("Timing")
        codec, table = self._log.codecs[bus], self._log.buses[bus].table
        if name not in codec.names:
            return np.zeros((2, 0), np.int64)
        rows = table[(table["can_id"] == codec.can_id(name)) & (table["length"] == codec.layout(name).length)]
        times = [codec.decode(can_id, data)[1].get(_STEP_TIME, 0.0) for _, can_id, data in frames_of(bus, rows)]
        timed = np.array([rows["receive"], np.array(times) * 1000], np.int64)
        return timed[:, np.argsort(timed[0], kind="stable")]

    @cached_property
    def _times_every_step(self) -> bool:
        """Whether the timing messages are of one step each: in logs of older versions they came in every cycle."""
        return self._timed.shape[1] < 2 or float(np.median(np.diff(self._timed[0]))) < 1.5 * CYCLE_NS

    def step_began(self, cycle: int) -> int:
        """Return when the ECU's step of a cycle began (ns); never, if no frame of it was received."""
        found = self._own.get(cycle, ())
        # A frame that does not name its cycle may have been put in one beside it.
        named = [received for received, frame in found if _names(self._log.codecs, frame, cycle)]
        first = min(named or (received for received, _ in found), default=_NEVER)
        timing = int(np.searchsorted(self._timed[0], first))
        began = first - int(self._timed[1, timing]) if timing < self._timed.shape[1] else first
        if not self._times_every_step:
            began = max(began, min(first, self.begun(cycle) + self._wait_ns))
        return began if began > self._begun_everywhere(cycle) else first

    def own(self, cycle: int) -> list[BusFrame]:
        """Return what the ECU sent as frames of a cycle."""
        return [frame for _, frame in self._own.get(cycle, ())]

    def begun(self, cycle: int) -> int:
        """Return when a cycle began on the first of the ECU's buses (ns)."""
        starts = [int(log.begun[cycle]) for log in self._log.buses.values() if cycle < len(log.begun)]
        return min((start for start in starts if start), default=_NEVER)

    def _begun_everywhere(self, cycle: int) -> int:
        return max(int(log.begun[cycle]) for log in self._log.buses.values())

    def skip_to(self, cycle: int) -> None:
        """Skip frames received before a cycle began."""
        self._at = max(self._at, int(np.searchsorted(self._received, self.begun(cycle))))

    def until(self, time_ns: int) -> list[BusFrame]:
        """Return the frames that were received before a time and have not been returned yet."""
        start, self._at = self._at, max(self._at, int(np.searchsorted(self._received, time_ns)))
        return [frame for _, frame in self._others[start : self._at]]


class Naming:
    """Which cycle the log of a real-time run has a frame of an ECU in, see `bench.conductor.realtime`.

    The cycle that its alive counter names; where it has none, that of the newest frame on its bus that has one; where
    it is damaged, repeated, too late or not in the DBC, the one it is sent in.
    """

    def __init__(self, log: EcuLog) -> None:
        """Begin before the first frame."""
        self._codecs = log.codecs
        self._at: dict[str, int] = {}
        self._seen: set[tuple[str, int, int]] = set()

    def cycle_of(self, frame: BusFrame, now: int) -> int:
        """Return the cycle of a frame that is sent in the cycle `now`."""
        bus, can_id, data = frame
        codec = self._codecs[bus]
        if can_id not in codec.can_ids:
            return now
        if not codec.is_protected(can_id):
            return max(self._at.get(bus, now), now - SETTLE_CYCLES)
        cycle = now - (now - (data[1] & 0x0F)) % COUNTER_MODULUS if len(data) > 1 else -1
        place = (bus, can_id, cycle)
        if cycle < max(0, now - SETTLE_CYCLES) or place in self._seen or not _names(self._codecs, frame, cycle):
            return now
        self._seen.add(place)
        self._at[bus] = cycle
        return cycle


def _names(codecs: Mapping[str, Codec], frame: BusFrame, cycle: int) -> bool:
    """Return whether a frame is whole and its alive counter that of a cycle."""
    bus, can_id, data = frame
    codec = codecs[bus]
    if not codec.is_protected(can_id) or len(data) < 2 or data[1] & 0x0F != cycle % COUNTER_MODULUS:
        return False
    name = next(each for each in codec.names if codec.can_id(each) == can_id)
    return check(data, codec.data_id(name))
