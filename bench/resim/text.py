"""The outcome of running an ECU again, as text."""

from collections.abc import Iterator, Mapping, Sequence

from bench.bus.codec import Codec, DecodeError
from bench.bus.e2e import COUNTER_SIGNAL, CRC_SIGNAL
from bench.counts import counted
from bench.cycle import time_of
from bench.names import V2V
from bench.record.meaning import value_text
from bench.resim.comparison import First
from bench.resim.job import Outcome

_MOST = 30
"""Lines of signals shown at most."""


def describe(outcome: Outcome, codecs: Mapping[str, Codec]) -> str:
    """Return the outcome in words: one line where all is the same, else what differs, first and in all."""
    return "\n".join(_lines(outcome, codecs))


def _lines(outcome: Outcome, codecs: Mapping[str, Codec]) -> Iterator[str]:
    there = f"{outcome.frames} frames in {outcome.cycles} cycles"
    if outcome.error and not outcome.cycles:
        yield f"{outcome.name}: FAILED: {_indented(outcome.error)}"
        return
    if not outcome.differing:
        yield f"{outcome.name}: {'as far as it went ' if outcome.error else ''}same: {there}, byte for byte"
    elif outcome.first is None:
        yield f"{outcome.name}: within the tolerance: {outcome.differing} of {there} differ"
    else:
        since = time_of(outcome.first.cycle)
        within = outcome.differing - outcome.beyond
        more = f", {within} more within the tolerance" if within else ""
        yield f"{outcome.name}: DIFFERENT from {since:.3f} s on: {outcome.beyond} of {there}{more}"
        yield from (f"  {line}" for line in _first(outcome.first, codecs))
    if outcome.waited:
        never = ", ".join(f"{topic.bus} {topic.message}" for topic in outcome.not_there)
        what = f"the log has no {never}" if never else "an input is neither there nor announced as absent"
        yield f"  in {outcome.waited} cycles it waits and does no step, as {what}"
    if outcome.not_numbers:
        times = "once" if outcome.not_numbers == 1 else f"{outcome.not_numbers} times"
        yield f"  {times} a value that it sent is not a number (NaN or infinite); the message is not sent"
    if outcome.alone:
        yield from (f"  {line}" for line in outcome.alone)
    if outcome.signals:
        yield f"  {len(outcome.signals)} signal{'s differ' if len(outcome.signals) > 1 else ' differs'}:"
        rows = [
            (
                f"{s.bus} {s.message}.{s.signal}",
                f"from {s.first_s:.3f} s",
                counted(s.count, "value"),
                s.at_most,
            )
            for s in outcome.signals
        ]
        yield from (f"    {line}" for line in _table(rows[:_MOST]))
        if len(rows) > _MOST:
            yield f"    and {len(rows) - _MOST} more"
    if outcome.error:
        yield f"  FAILED: {_indented(outcome.error)}"


def _indented(error: str) -> str:
    """Return an error with its further lines indented: they may be of an ECU's own, and look like an outcome."""
    return error.replace("\n", "\n    ")


def _first(first: First, codecs: Mapping[str, Codec]) -> Iterator[str]:
    pair = first.pair
    codec = codecs[pair.bus]
    name = codec.name_of(pair.can_id) or "no message of the DBC"
    nth = f", number {pair.rank + 1} of its identifier" if pair.rank else ""
    yield f"first in cycle {first.cycle}: 0x{pair.can_id:03X} {name} on {pair.bus}{nth}"
    frames = (pair.logged, pair.sent)
    decoded = [_decoded(codec, pair.can_id, data) for data in frames]
    for side, data, values, others in zip(("log", "now"), frames, decoded, decoded[::-1], strict=True):
        if data is None:
            yield f"  {side}  no frame"
            continue
        shown = [
            _signal(codec, name, s, v) for s, v in values.items() if (others and others[s] != v) or s not in _PROTECTION
        ]
        yield f"  {side}  [{data.hex(' ')}]  {', '.join(shown)}".rstrip()
    if first.inputs is None:
        yield "it did no step in this cycle"
        return
    yield "its inputs in this cycle:"
    for topic, signals in first.inputs.items():
        sent = " of the cycle before" if topic.bus == V2V else ""
        what = (
            "missing"
            if signals is None
            else ", ".join(
                _signal(codecs[topic.bus], topic.message, s, v) for s, v in signals.items() if s not in _PROTECTION
            )
        )
        yield f"  {topic.bus} {topic.message}{sent}: {what}"


_PROTECTION = (CRC_SIGNAL, COUNTER_SIGNAL)


def _decoded(codec: Codec, can_id: int, data: bytes | None) -> dict[str, float]:
    try:
        return {} if data is None else codec.decode(can_id, data)[1]
    except DecodeError:
        return {}


def _signal(codec: Codec, message: str, signal: str, value: float) -> str:
    known = codec.message(message).get_signal_by_name(signal)
    labels = {int(number): str(text) for number, text in (known.choices or {}).items()}
    return value_text(signal, value, known.unit or "", labels)


def _table(rows: Sequence[tuple[str, ...]]) -> Iterator[str]:
    widths = [max(map(len, column)) for column in zip(*rows, strict=True)]
    for row in rows:
        yield "  ".join(f"{cell:{width}}" for cell, width in zip(row, widths, strict=True)).rstrip()
