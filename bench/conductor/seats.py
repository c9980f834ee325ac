"""Seats left free for ECUs that somebody starts by hand, and how the conductor knows that they are taken.

An ECU on its own sends its status with State Wait until its first BenchSync (see dbc/vehicle.dbc). That, or any other
frame that only it sends, says that it is there; before the first cycle nobody else takes notice of such frames, and
the log has none of them.
"""

import time
from collections.abc import Collection, Iterable, Mapping, Sequence
from dataclasses import dataclass

from bench.bus.codec import Codec, DecodeError
from bench.bus.link.address import Address
from bench.bus.states import EcuState
from bench.conductor.crew import Crew
from bench.conductor.cycle import Due, frames_due
from bench.ecu.main import DEFAULT_ECUS, buses_of, ecu_name
from bench.errors import BadInput, RunFailed
from bench.faults.base import Fault

Frames = Sequence[tuple[int, bytes]]


@dataclass(frozen=True, slots=True)
class Seat:
    """An ECU's seat.

    Attributes:
        role: planner or tracker.
        vehicle: number of its vehicle, from 1.
    """

    role: str
    vehicle: int

    @property
    def name(self) -> str:
        """Name of the ECU: `veh2.tracker`."""
        return ecu_name(self.role, self.vehicle)

    def described(self, address: Address) -> str:
        """Say who is expected where, with the buses at `address`: `veh2.tracker on vcan2`."""
        places = (address.place_of(bus) for bus in buses_of(self.role, self.vehicle))
        where = (place.channel if place.interface == "socketcan" else str(place) for place in places)
        return f"{self.name} on {' and '.join(where)}"


def free_seats(without: Collection[str], vehicles: int, address: Address) -> list[Seat]:
    """Return the seats of the ECUs named in `without`.

    Raises:
        BadInput: there is no such ECU among `vehicles` vehicles, or it could not know where its buses are.
    """
    seats = [Seat(role, vehicle) for role in DEFAULT_ECUS for vehicle in range(1, vehicles + 1)]
    names = [seat.name for seat in seats]
    unknown = [name for name in without if name not in names]
    if unknown:
        raise BadInput(f"--without {', '.join(unknown)}: the scenario has {', '.join(names)}")
    if without and address.hub is not None:
        raise BadInput(
            "--without: with --can direct all is in one process; allowed: --can udp:PORT, vcan, IFACE:CHANNEL"
        )
    free = [seat for seat in seats if seat.name in without]
    for seat in free:
        for bus in buses_of(seat.role, seat.vehicle):
            if not address.is_known(bus):
                raise BadInput(
                    f"--without {seat.name}: the ECU must know where {bus} is; give the port, as in --can udp:45000 or "
                    f"--can {bus}=udp:45000"
                )
    return free


def refuse_outages(faults: Iterable[Fault], without: Collection[str]) -> None:
    """Refuse faults that crash or stop an ECU which the bench does not start.

    Raises:
        BadInput: see there.
    """
    for fault in faults:
        if fault.outage and fault.outage.ecu in without:
            raise BadInput(
                f"--without {fault.outage.ecu}: the scenario has a fault {fault.name()} for it, but only an ECU that "
                "the bench starts can be crashed or stopped; leave one of the two out"
            )


class Seats:
    """Watches the buses for the ECUs in seats that were left free."""

    def __init__(self, free: Sequence[Seat], codecs: Mapping[str, Codec], vehicles: int) -> None:
        """Watch for the ECUs of `free`."""
        self._waiting = {seat.name: seat for seat in free}
        self._due = frames_due(codecs, vehicles)
        self._codecs = codecs
        self._status = {
            (f"veh{seat.vehicle}", codecs[f"veh{seat.vehicle}"].can_id(f"{seat.role.capitalize()}Status"))
            for seat in free
        }

    @property
    def waiting(self) -> list[Seat]:
        """The seats whose ECU has not come."""
        return list(self._waiting.values())

    def wait(self, crew: Crew, limit_s: float) -> None:
        """Wait for the ECUs that somebody starts by hand.

        Args:
            crew: the others, whose listener notes what comes.
            limit_s: longest wall-clock time in s.

        Raises:
            RunFailed: not all came, or a process ended.
            Interrupted: a signal has come.
        """
        deadline = time.monotonic() + limit_s
        while self._waiting:
            left = deadline - time.monotonic()
            if left <= 0:
                raise RunFailed(
                    f"{', '.join(self._waiting)} did not come within {limit_s:g} s: nothing that it sends was heard. "
                    "An ECU on its own sends its status with State Wait until the run begins"
                )
            crew.attend(left)

    def note(self, bus: str, frames: Frames) -> None:
        """Note whose frames these are."""
        for can_id, _ in frames:
            due: Due | None = self._due[bus].get(can_id)
            if due is not None:
                self._waiting.pop(due.sender, None)

    def without_signs(self, bus: str, frames: Frames) -> Frames:
        """Leave out what an ECU sent before it knew that the run has begun."""
        if not self._status:
            return frames
        return [frame for frame in frames if not self._is_sign(bus, *frame)]

    def _is_sign(self, bus: str, can_id: int, data: bytes) -> bool:
        if (bus, can_id) not in self._status:
            return False
        try:
            return self._codecs[bus].decode(can_id, data)[1]["State"] == EcuState.WAIT
        except DecodeError:
            return False
