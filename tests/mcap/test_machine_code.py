"""The machine code that forms MCAP records gives the same bytes as its plain text."""

import numpy as np
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st

from tests.plain import bits, compiled, plain

PAYLOADS = [b"", b"a", bytes(range(200))]
messages = st.lists(st.tuples(st.integers(0, 2), st.integers(1, 300), st.integers(0, 2**63 - 1)), min_size=1)


@settings(deadline=None, max_examples=40, suppress_health_check=[HealthCheck.too_slow])
@given(messages, st.integers(0, 500))
def test_records_and_index(rows, size):
    template, channel, time = (np.array([row[column] for row in rows], np.int64) for column in range(3))
    found = []
    for way in (compiled, plain):
        module = way("bench.mcap.records")
        sequence = np.arange(301)
        records = module.Templates(PAYLOADS).records(template, channel, time, sequence)
        index = module.entries_by_channel(channel, time, records.offset)
        groups = list(records.by_group(np.arange(len(rows)) // 3))
        found.append(bits((records, index[0], index[1].tolist(), records.parted(size, 1), groups, sequence)))
    assert found[0] == found[1]
