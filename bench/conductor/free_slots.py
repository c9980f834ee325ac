"""Free ECU slots, for ECUs started by hand, and how the conductor detects these ECUs.

An ECU running alone sends its status with State Wait until its first BenchSync (see dbc/vehicle.dbc). That, or any
other frame that only it sends, shows its presence; before the first cycle all other nodes ignore such frames, and the
log has none of them.
"""

import time
from collections.abc import Collection, Iterable, Mapping, Sequence

from bench.bus.codec import Codec, DecodeError
from bench.bus.frame import CanFrame
from bench.bus.link.address import Address
from bench.bus.network import ROLES, EcuSlot
from bench.bus.states import EcuState
from bench.conductor.crew import Crew
from bench.conductor.cycle import frames_due
from bench.errors import BadInput, RunFailed
from bench.faults.base import Fault
from bench.names import vehicle_bus


def free_slots(without: Collection[str], vehicles: int, address: Address) -> list[EcuSlot]:
    """Return the slots of the ECUs named in `without`.

    Raises:
        BadInput: there is no such ECU among `vehicles` vehicles, or it cannot know the address of its buses.
    """
    slots = [EcuSlot(role, vehicle) for role in ROLES for vehicle in range(1, vehicles + 1)]
    names = [slot.name for slot in slots]
    unknown = [name for name in without if name not in names]
    if unknown:
        raise BadInput(f"--without {', '.join(unknown)}: the scenario has {', '.join(names)}")
    if without and address.hub is not None:
        raise BadInput(
            "--without: --can direct runs everything in one process; allowed: --can udp:PORT, vcan, IFACE:CHANNEL"
        )
    free = [slot for slot in slots if slot.name in without]
    for slot in free:
        for bus in slot.buses:
            if not address.is_known(bus):
                raise BadInput(
                    f"--without {slot.name}: the ECU must know the address of {bus}; give the port: --can udp:45000 or "
                    f"--can {bus}=udp:45000"
                )
    return free


def described(slot: EcuSlot, address: Address) -> str:
    """Return the expected ECU and its buses at `address`, e.g. `veh2.tracker on vcan2`."""
    places = map(address.place_of, slot.buses)
    where = (place.channel if place.interface == "socketcan" else str(place) for place in places)
    return f"{slot.name} on {' and '.join(where)}"


def refuse_outages(faults: Iterable[Fault], without: Collection[str]) -> None:
    """Check the faults.

    Raises:
        BadInput: a fault crashes or stops an ECU that the bench does not start.
    """
    for fault in faults:
        if fault.outage and fault.outage.ecu in without:
            raise BadInput(
                f"--without {fault.outage.ecu}: the scenario has a fault {fault.name()} for it, but only an ECU that "
                "the bench starts can be crashed or stopped; leave one of the two out"
            )


class FreeSlots:
    """Watches the buses for the ECUs whose slots were left free."""

    def __init__(self, free: Sequence[EcuSlot], codecs: Mapping[str, Codec], vehicles: int) -> None:
        """Watch for the ECUs of `free`."""
        self._waiting = {slot.name: slot for slot in free}
        self._free = frozenset(self._waiting)
        self._due = frames_due(codecs, vehicles)
        self._codecs = codecs
        self._status = {
            (bus, codecs[bus].can_id(slot.message("Status"))) for slot in free for bus in [vehicle_bus(slot.vehicle)]
        }

    @property
    def waiting(self) -> list[EcuSlot]:
        """The slots whose ECU has not been detected."""
        return list(self._waiting.values())

    def wait(self, crew: Crew, limit_s: float) -> None:
        """Wait for the ECUs started by hand.

        Args:
            crew: the other processes, whose listener receives the frames.
            limit_s: longest wall-clock time in s.

        Raises:
            RunFailed: not all were detected, or a process ended.
            Interrupted: a signal has come.
        """
        deadline = time.monotonic() + limit_s
        while self._waiting:
            left = deadline - time.monotonic()
            if left <= 0:
                raise RunFailed(
                    f"{', '.join(self._waiting)} not detected within {limit_s:g} s: none of its frames was received. "
                    "An ECU running alone sends its status with State Wait until the run begins"
                )
            crew.attend(left)

    def note(self, bus: str, frames: Sequence[CanFrame]) -> bool:
        """Note the ECUs that sent these whole frames; return whether one of them was waited for."""
        waiting = len(self._waiting)
        for can_id, _ in frames:
            due = self._due[bus].get(can_id)
            if due is not None:
                self._waiting.pop(due.sender, None)
        return len(self._waiting) < waiting

    def is_free(self, bus: str, can_id: int) -> bool:
        """Return whether only an ECU started by hand sends this identifier."""
        due = self._due[bus].get(can_id)
        return due is not None and due.sender in self._free

    def without_signs(self, bus: str, frames: Sequence[CanFrame]) -> Sequence[CanFrame]:
        """Drop frames that an ECU sent before it received the beginning of the run."""
        return [frame for frame in frames if not self.is_sign(bus, frame)] if self._status else frames

    def is_sign(self, bus: str, frame: CanFrame) -> bool:
        """Return whether an ECU sent this frame before it received the beginning of the run."""
        can_id, data = frame
        if (bus, can_id) not in self._status:
            return False
        try:
            return self._codecs[bus].decode(can_id, data)[1]["State"] == EcuState.WAIT
        except DecodeError:
            return False
