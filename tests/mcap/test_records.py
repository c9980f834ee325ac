"""Many records and index entries at once are those that MCAP has for each message."""

import struct

import numpy as np
from hypothesis import given
from hypothesis import strategies as st

from bench.mcap.chunking import ChunkGroups
from bench.mcap.records import Templates, entries_by_channel

PAYLOADS = [b"", b"a", bytes(range(200))]
messages = st.lists(st.tuples(st.integers(0, 2), st.integers(1, 300), st.integers(0, 2**63 - 1)))


def columns(rows):
    return (np.array([row[column] for row in rows], np.int64) for column in range(3))


def written(rows, counts):
    """The record of each message, one by one."""
    found = []
    for number, channel, time in rows:
        payload = PAYLOADS[number]
        found.append(
            struct.pack("<BQHIQQ", 5, 22 + len(payload), channel, counts.get(channel, 0), time, time) + payload
        )
        counts[channel] = counts.get(channel, 0) + 1
    return found


@given(messages, messages)
def test_records_have_header_payload_and_the_next_number_of_their_channel(first, second):
    templates, sequence, counts = Templates(PAYLOADS), np.zeros(301, np.int64), {}
    for rows in (first, second):
        records, wanted = templates.records(*columns(rows), sequence), written(rows, counts)
        assert records.data.tobytes() == b"".join(wanted)
        assert records.offset.tolist() == [sum(map(len, wanted[:row])) for row in range(len(rows))]


@given(messages.filter(len))
def test_index_entries_keep_the_order_of_their_channel(rows):
    _, channel, time = columns(rows)
    counts, entries = entries_by_channel(channel, time, np.arange(len(rows)))
    ordered = sorted(range(len(rows)), key=lambda row: rows[row][1])
    assert counts == {number: channel.tolist().count(number) for number in sorted(set(channel.tolist()))}
    assert entries.tolist() == [(rows[row][2], row) for row in ordered]


@given(st.lists(messages, max_size=5), st.integers(1, 800))
def test_chunks_are_full_and_hold_all_records_in_their_order(batches, size):
    groups, templates, sequence = ChunkGroups(size), Templates(PAYLOADS), np.zeros(301, np.int64)
    wanted, counts = [], {}
    for rows in batches:
        groups.add(1, templates.records(*columns(rows), sequence))
        wanted += written(rows, counts)
    chunks = list(groups.take())
    assert b"".join(chunk.data.tobytes() for chunk in chunks) == b"".join(wanted)
    assert all(len(chunk.data) <= size or len(chunk.channel) == 1 for chunk in chunks)
    found = [chunk.data[start:end].tobytes() for chunk in chunks for start, end in spans(chunk)]
    assert found == wanted
    assert groups.bytes == 0


def spans(chunk):
    return zip(chunk.offset.tolist(), [*chunk.offset.tolist()[1:], len(chunk.data)], strict=True)
