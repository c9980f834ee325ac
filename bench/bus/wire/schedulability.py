"""Worst-case response times on CAN, and the check that a bus can carry its messages.

R. I. Davis, A. Burns, R. J. Bril, J. J. Lukkien, "Controller Area Network (CAN) schedulability analysis: Refuted,
revisited and revised", Real-Time Systems 35 (2007). The analysis of 1994 considers only the first frame of a busy
period; a later one may wait longer, because the frame before it delayed higher priorities, which then go first.

Symbols are the paper's: C longest transmission, T period, J release jitter, B blocking, w queuing delay, q the number
of the frame in its busy period, R response time.
"""

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from functools import partial

import numpy as np

from bench.bus.absence import BENCH_ABSENT
from bench.bus.codec import Codec
from bench.bus.link.base import EXTENDED
from bench.bus.network import transmissions
from bench.bus.wire.frame_length import longest_bits, priority
from bench.cycle import CYCLE_NS
from bench.errors import BadInput
from bench.events import ResponseBeyondPeriod
from bench.names import V2V

_NS = 1_000_000_000

HORIZON_NS = 10 * _NS
"""The analysis stops at busy periods of this length: a longer response time is treated as unbounded."""


@dataclass(frozen=True)
class Stream:
    """A message as input of the analysis.

    Attributes:
        name: as in the DBC.
        can_id: its identifier; one of 29 bits has the bit `EXTENDED` set.
        length: bytes of data.
        period_ns: T, also its deadline.
        jitter_ns: J, maximum deviation of its release from an exact period.
    """

    name: str
    can_id: int
    length: int
    period_ns: int
    jitter_ns: int = 0

    @property
    def bits(self) -> int:
        """The bits of its longest frame, including the interframe space."""
        return longest_bits(self.length, extended=bool(self.can_id & EXTENDED))


@dataclass(frozen=True)
class WorstCase:
    """A worst-case response time, up to the end of the interframe space after the frame.

    Attributes:
        response_ns: R, from the nominal release: compared with the deadline.
        from_release_ns: from the actual release: can be measured. R - J, unless a frame can be released while the one
            before it is still waiting.
    """

    response_ns: int
    from_release_ns: int


def streams(bus: str, codec: Codec, vehicles: int) -> list[Stream]:
    """Return the periodic messages of a bus with `vehicles` vehicles, highest priority first.

    BenchAbsent is excluded: it serves the clock of virtual time and is never on the wire.
    """
    found = []
    for each in transmissions(bus, codec, vehicles):
        if each.period and each.message != BENCH_ABSENT:
            message = codec.described(each.message)
            can_id = each.can_id | (EXTENDED if message.is_extended else 0)
            found.append(Stream(each.message, can_id, message.length, each.period * CYCLE_NS))
    return _by_priority(found)


def load(messages: Sequence[Stream], bit_rate: int) -> float:
    """Return the maximum bus load of the messages, 1 is full."""
    return sum(message.bits * _NS / (message.period_ns * bit_rate) for message in messages)


def response_times(messages: Sequence[Stream], bit_rate: int) -> dict[int, WorstCase | None]:
    """Return each message's worst-case response time by identifier.

    None if there is no bound, because the message and those of higher priority load the bus fully, or keep it busy for
    longer than `HORIZON_NS`.

    Args:
        messages: all messages of a bus.
        bit_rate: in bit/s.
    """
    ordered = _by_priority(messages)
    return {message.can_id: _response(ordered, rank, bit_rate) for rank, message in enumerate(ordered)}


def _response(ordered: Sequence[Stream], m: int, bit_rate: int) -> WorstCase | None:
    own = ordered[m]
    if load(ordered[: m + 1], bit_rate) >= 1.0:
        return None
    tau_bit = -(-_NS // bit_rate)
    c_m = _transmission(own, bit_rate)
    blocking = max((_transmission(lower, bit_rate) for lower in ordered[m + 1 :]), default=0)
    higher = [(k.period_ns, k.jitter_ns, _transmission(k, bit_rate)) for k in ordered[:m]]

    def queued(time: int) -> int:
        """Longest transmission time of the frames with higher priority released within `time`."""
        return sum(-(-(time + jitter) // period) * c for period, jitter, c in higher)

    def frames_of_m(time: int) -> int:
        return -(-(time + own.jitter_ns) // own.period_ns)

    # The longest busy period at this priority, and the frames of m that fall into it.
    busy = _fixed_point(c_m, lambda t: blocking + queued(t) + frames_of_m(t) * c_m)
    if busy > HORIZON_NS:
        return None
    response, from_release, w = 0, 0, 0
    for q in range(frames_of_m(busy)):
        # Frames of higher priority released up to the last bit time before m could start go first.
        w = _fixed_point(max(w, blocking + q * c_m), partial(_delay, blocking + q * c_m, queued, tau_bit))
        # The busy period begins at most J after the nominal release of the first frame, and no frame in it was released
        # before it began.
        response = max(response, own.jitter_ns + w + c_m - q * own.period_ns)
        from_release = max(from_release, w + c_m - max(0, q * own.period_ns - own.jitter_ns))
    return WorstCase(response, from_release)


def _delay(base: int, queued: Callable[[int], int], tau_bit: int, w: int) -> int:
    return base + queued(w + tau_bit)


def check_load(codecs: Mapping[str, Codec], vehicles: int) -> list[ResponseBeyondPeriod]:
    """Return the messages of all buses that may be late in the worst case.

    Args:
        codecs: codec of every bus.
        vehicles: number of vehicles.

    Raises:
        BadInput: a bus cannot carry its messages.
    """
    warnings = []
    overloaded = {}
    for bus, codec in codecs.items():
        messages = streams(bus, codec, vehicles)
        if load(messages, codec.bit_rate) > 1.0:
            overloaded[bus] = messages
            continue
        worst = response_times(messages, codec.bit_rate)
        for message in messages:
            can_id, found = message.can_id, worst[message.can_id]
            if found is None or found.response_ns > message.period_ns:
                response_ms = None if found is None else found.response_ns / 1e6
                period_ms = message.period_ns / 1e6
                place = bus, message.name, can_id & ~EXTENDED
                warnings.append(ResponseBeyondPeriod(*place, response_ms, period_ms, codec.bit_rate))
    if overloaded:
        raise BadInput("\n".join(_overload(codecs, overloaded, vehicles)))
    return warnings


def _overload(codecs: Mapping[str, Codec], overloaded: Mapping[str, Sequence[Stream]], vehicles: int) -> list[str]:
    """Return a message for each DBC with an overloaded bus: its load and the remedy; all vehicles share one DBC."""
    lines = []
    for dbc in ("v2v", "vehicle"):
        buses = [bus for bus in overloaded if (bus == V2V) == (dbc == "v2v")]
        if not buses:
            continue
        rate, need = codecs[buses[0]].bit_rate, load(overloaded[buses[0]], codecs[buses[0]].bit_rate)
        name = buses[0] if len(buses) == 1 else f"{buses[0]} to {buses[-1]}"
        fewer = f", or fewer than {vehicles} vehicles" if dbc == "v2v" and vehicles > 1 else ""
        lines.append(
            f"bus {name}: overloaded: its messages need up to {100 * need:.0f} % of {rate / 1000:g} kbit/s; allowed "
            f"are 100 %. In dbc/{dbc}.dbc set Baudrate to {_enough(need * rate)} or GenMsgCycleTime to more ms{fewer}"
        )
    return lines


def _enough(needed: float) -> str:
    """The lowest usual bit rate that suffices."""
    rates = [rate for rate in (125_000, 250_000, 500_000, 1_000_000) if rate >= needed]
    return f"{rates[0]} bit/s" if rates else "more than 1000000 bit/s, which classical CAN does not have,"


def _fixed_point(start: int, step: Callable[[int], int]) -> int:
    """Return the least fixed point of the non-decreasing `step` from `start` on, or a value beyond the horizon."""
    value = start
    while value <= HORIZON_NS and (following := step(value)) > value:
        value = following
    return value


def _transmission(message: Stream, bit_rate: int) -> int:
    return -(-message.bits * _NS // bit_rate)


def _by_priority(messages: Sequence[Stream]) -> list[Stream]:
    ranks = priority(np.array([message.can_id for message in messages], np.uint32)).tolist()
    return [messages[index] for index in np.argsort(ranks, kind="stable").tolist()]
