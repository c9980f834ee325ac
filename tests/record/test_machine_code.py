"""The recorder's machine code gives the same bytes as its plain text."""

import numpy as np
import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st

from bench.bus.codec import DBC_DIR, Codec
from bench.bus.wire.timing import FRAME
from tests.plain import bits, compiled, plain

WAYS = (compiled, plain)
times = st.integers(0, 2**63 - 1)


@settings(deadline=None, max_examples=40, suppress_health_check=[HealthCheck.too_slow])
@given(st.lists(st.tuples(times, st.integers(0, 2**32 - 1), times, times, st.binary(max_size=8)), min_size=1))
def test_can_frames(rows):
    table = np.zeros(len(rows), FRAME)
    for row, (receive, can_id, wire, response, data) in zip(table, rows, strict=True):
        row["receive"], row["can_id"], row["wire"], row["response"] = receive, can_id, wire, response
        row["length"], row["data"][: len(data)] = len(data), list(data)
    found = []
    for way in WAYS:
        module = way("bench.record.can_frame")
        templates = [module.template(len(data)) for *_, data in rows]
        at = np.cumsum([0, *map(len, templates)])[:-1]
        out = np.frombuffer(b"".join(templates), np.uint8).copy()
        module.fill(out, at, table)
        read = np.zeros(len(rows), FRAME)
        assert module.read(out, at, np.array([len(each) for each in templates]), read)
        found.append((out.tobytes(), read.tobytes()))
    assert found[0] == found[1]


@pytest.fixture(scope="module")
def tables() -> list:
    """The signals of the vehicle's bus: messages and table of each form."""
    codec = Codec(DBC_DIR / "vehicle.dbc")
    made = []
    for way in WAYS:
        module = way("bench.record.signals")
        messages = [module.signal_message("test", codec, name) for name in codec.names]
        made.append((messages, module.SignalTable(messages)))
    return made


@settings(deadline=None, max_examples=40, suppress_health_check=[HealthCheck.too_slow])
@given(data=st.data())
def test_signals(tables, data):
    count = len(tables[0][0])
    frames = data.draw(
        st.lists(st.tuples(st.integers(0, count - 1), st.binary(min_size=8, max_size=8)), min_size=1, max_size=30)
    )
    message = np.array([number for number, _ in frames], np.int64)
    raw = np.frombuffer(b"".join(content for _, content in frames), np.uint8).reshape(-1, 8)
    found = []
    for messages, table in tables:
        first, value = table.decode(raw, message)
        templates = [messages[number].layout.template for number in message]
        at = np.cumsum([0, *map(len, templates)])[:-1]
        out = np.frombuffer(b"".join(templates), np.uint8).copy()
        table.fill(out, at, message, value)
        found.append((bits((first, value)), out.tobytes()))
    assert found[0] == found[1]
