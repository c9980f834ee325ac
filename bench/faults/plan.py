"""The faults of a run for a node: those active in a cycle, and their random numbers.

All processes of a bench have the same plan and make the same decisions, because random numbers follow from the
scenario's seed, the fault and the frame. Faults injected into a running bench reach all of them over a `FaultBoard`,
which also says which BenchSync are the bench's own.
"""

import json
import mmap
import struct
from collections.abc import Sequence
from functools import lru_cache, partial
from random import Random

from bench.cycle import CYCLE_S
from bench.faults.base import Fault, FrameContext, Window
from bench.faults.kinds import ONE_FAULT
from bench.memory_file import memory_file

Faults = tuple[tuple[int, Fault], ...]
"""The faults active in a cycle, each with its number in the plan."""

_HEAD = struct.Struct("<II")
_CYCLES, _REALTIME, _STOPPED = 2, 3, 4
"""Words of the board, after those of `_HEAD`: cycles opened so far, whether in real time, whether told to stop."""

_FAULTS_AT = 20
BOARD_BYTES = 256 * 1024


class FaultBoard:
    """A page of shared memory to which the conductor writes faults and which all processes of a bench read.

    The conductor writes a fault before it sends the BenchSync of the cycle in which it begins, so that no process
    misses it. Whoever sends BenchSync first notes it here: a bus does not say whose a frame is, and anybody could open
    a cycle or end the run.
    """

    def __init__(self, descriptor: int) -> None:
        """Map the file `descriptor`, of `BOARD_BYTES` bytes."""
        self._memory = mmap.mmap(descriptor, BOARD_BYTES)
        # Written and read as whole words: another process never sees half a number.
        self._words = memoryview(self._memory).cast("I")

    @staticmethod
    def create() -> int:
        """Return the file descriptor of a new, empty board; the last process that has it open frees it."""
        return memory_file(bytes(BOARD_BYTES))

    @property
    def count(self) -> int:
        """Number of faults on the board."""
        return self._words[0]

    def post(self, fault: Fault) -> None:
        """Add a fault to the board.

        Raises:
            ValueError: the board is full.
        """
        count, used = _HEAD.unpack_from(self._memory)
        line = json.dumps(fault.model_dump(mode="json")).encode() + b"\n"
        if _FAULTS_AT + used + len(line) > BOARD_BYTES:
            raise ValueError("no room for another fault in this run")
        start = _FAULTS_AT + used
        self._memory[start : start + len(line)] = line
        _HEAD.pack_into(self._memory, 0, count + 1, used + len(line))

    def read(self) -> list[Fault]:
        """Return all faults on the board, in the order they were posted."""
        count, used = _HEAD.unpack_from(self._memory)
        lines = bytes(self._memory[_FAULTS_AT : _FAULTS_AT + used]).splitlines()
        return [ONE_FAULT.validate_json(line) for line in lines[:count]]

    def open_cycle(self, cycle: int, *, realtime: bool) -> None:
        """Note that the BenchSync of a cycle follows."""
        self._words[_REALTIME] = realtime
        self._words[_CYCLES] = cycle + 1

    def stop(self) -> None:
        """Note that STOP follows."""
        self._words[_STOPPED] = 1

    def has_opened(self, cycle: int, *, realtime: bool) -> bool:
        """Whether the BenchSync of a cycle has been sent, or is about to be."""
        return cycle < self._words[_CYCLES] and realtime == bool(self._words[_REALTIME])

    @property
    def has_stopped(self) -> bool:
        """Whether STOP has been sent, or is about to be."""
        return bool(self._words[_STOPPED])


def _none_at(cycle: int) -> Faults:  # noqa: ARG001 - as `FaultPlan.at`
    return ()


class FaultPlan:
    """The faults of a run and their times.

    Attributes:
        faults: all faults, in the order they became known.
    """

    def __init__(self, faults: Sequence[Fault] = (), seed: int = 0, board: FaultBoard | None = None) -> None:
        """Plan the `faults` of a scenario with this `seed`, and those that will be posted on `board`."""
        self._planned = tuple(faults)
        self._seed = seed
        self._board = board
        self._posted = 0
        self._set(self._planned)

    def _set(self, faults: Sequence[Fault]) -> None:
        self.faults = tuple(faults)
        self._windows = [Window(fault, CYCLE_S) for fault in self.faults]
        self.at = lru_cache(maxsize=4)(self._at) if faults else _none_at

    def refresh(self) -> None:
        """Read new faults from the board."""
        if self._board is not None and self._board.count != self._posted:
            self._posted = self._board.count
            self._set((*self._planned, *self._board.read()))

    def open_cycle(self, cycle: int, *, realtime: bool) -> None:
        """See `FaultBoard`."""
        if self._board is not None:
            self._board.open_cycle(cycle, realtime=realtime)

    def stop(self) -> None:
        """See `FaultBoard`."""
        if self._board is not None:
            self._board.stop()

    def has_opened(self, cycle: int, *, realtime: bool) -> bool:
        """Whether a cycle's BenchSync can be the bench's own; without a board, as in an ECU run by hand, any can."""
        return self._board is None or self._board.has_opened(cycle, realtime=realtime)

    @property
    def has_stopped(self) -> bool:
        """Whether a STOP can be the bench's own."""
        return self._board is None or self._board.has_stopped

    def _at(self, cycle: int) -> Faults:
        return tuple(
            (index, fault)
            for index, (fault, window) in enumerate(zip(self.faults, self._windows, strict=True))
            if cycle in window
        )

    def window(self, index: int) -> Window:
        """Return the cycles in which a fault is active."""
        return self._windows[index]

    def chance(self, index: int, bus: str, can_id: int, cycle: int) -> Random:
        """Return the random generator of a fault for a frame; the same in all processes."""
        return Random(f"{self._seed}/{index}/{bus}/{can_id}/{cycle}")

    def context(self, index: int, bus: str, can_id: int, cycle: int) -> FrameContext:
        """Return the context of a frame for fault number `index`."""
        dice = partial(self.chance, index, bus, can_id, cycle)
        return FrameContext(bus, can_id, cycle, self._windows[index].first, dice)

    def extra(self, bus: str, message: str, can_id: int, cycle: int) -> int:
        """Return the number of frames of a message sent in a cycle in addition to the due one, after it."""
        return sum(
            fault.extra(self.context(index, bus, can_id, cycle))
            for index, fault in self.at(cycle)
            if fault.hits(bus, message)
        )


def is_off(node: str, bus: str, faults: Faults) -> bool:
    """Return whether a node is cut off from a bus, neither sending nor receiving."""
    return any(fault.cuts(node, bus) for _, fault in faults)
