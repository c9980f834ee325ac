"""A log is followed while it is written: nothing is told twice, nothing is left out, nothing half-written is read."""

import random
from pathlib import Path

import numpy as np
import pytest

from bench.errors import BadInput
from bench.live.cursor import Cursor
from bench.live.tail import Tail
from bench.record.reader import Run


def grow(whole: bytes, path: Path, cuts: list[int]):
    """Write `whole` to `path` bit by bit; give the number of bytes written after each."""
    with path.open("wb") as stream:
        for start, end in zip([0, *cuts], [*cuts, len(whole)], strict=True):
            stream.write(whole[start:end])
            stream.flush()
            yield end


def random_cuts(size: int, count: int, seed: int) -> list[int]:
    return sorted(random.Random(seed).sample(range(size), count))


def test_a_log_that_is_not_there_yet_is_waited_for(tmp_path: Path) -> None:
    tail = Tail(tmp_path / "none.mcap")
    tail.poll()
    assert tail.chunks == []
    assert tail.quiet
    (tmp_path / "none.mcap").write_bytes(b"\x89MCAP")
    tail.poll()
    assert tail.chunks == []


def test_what_is_no_log_is_refused(tmp_path: Path) -> None:
    path = tmp_path / "no.mcap"
    path.write_bytes(b"GIF89a and more")
    with pytest.raises(BadInput, match="is not an MCAP file"):
        Tail(path).poll()


@pytest.mark.parametrize("seed", [1, 2])
def test_however_it_is_cut_all_chunks_are_found_once(whole_log: Path, tmp_path: Path, seed: int) -> None:
    whole = whole_log.read_bytes()
    tail = Tail(tmp_path / "run.mcap")
    for _ in grow(whole, tail.path, random_cuts(len(whole), 200, seed)):
        tail.poll()
    assert tail.ended
    with tail.piece(tail.chunks) as path:
        piece = Run(path)
    run = Run(whole_log)
    assert piece.damage == ""
    assert piece.attachments == run.attachments
    assert piece.metadata == run.metadata
    assert piece.topics.keys() == run.topics.keys()
    for bus in run.buses:
        assert (piece.frame_table(bus) == run.frame_table(bus)).all()
    assert [chunk.size for chunk in tail.chunks] == [len(whole[c.at : c.at + c.size]) for c in tail.chunks]


@pytest.mark.parametrize("seed", [1, 2])
def test_spans_are_complete_and_follow_each_other(whole_log: Path, tmp_path: Path, seed: int) -> None:
    """Each signal of each span is that of the whole log, though a look comes in the midst of a write."""
    whole, run = whole_log.read_bytes(), Run(whole_log)
    tail, cursor = Tail(tmp_path / "run.mcap"), Cursor()
    found: dict[tuple[str, str], list[np.ndarray]] = {}
    spans = []
    for _ in grow(whole, tail.path, random_cuts(len(whole), 60, seed)):
        tail.poll()
        while (span := cursor.next(tail)) is not None:
            assert span.start_ns >= cursor.told_ns
            cursor.told_ns = span.end_ns
            spans.append(span)
            with tail.piece(span.chunks) as path:
                piece = Run(path)
            for bus in piece.buses:
                for name in piece.messages(bus):
                    t = piece.message(bus, name)["t"]
                    inside = np.rint(t * 1e9).astype(np.int64)
                    found.setdefault((bus, name), []).append(
                        t[(inside >= span.start_ns) & (inside < span.end_ns)],
                    )
    assert len(spans) > 7
    assert all(len(told) > 0 for told in found.values())
    for bus in run.buses:
        for name in run.messages(bus):
            assert np.array_equal(np.concatenate(found[bus, name]), run.message(bus, name)["t"]), (bus, name)


def test_a_length_that_cannot_be_is_never_reached(whole_log: Path, tmp_path: Path) -> None:
    """A record that says it is longer than the file is taken for one that is still being written."""
    whole = whole_log.read_bytes()
    tail = Tail(tmp_path / "run.mcap")
    tail.path.write_bytes(whole[:100_000] + b"\x06" + b"\xff" * 7 + b"\x00" + whole[100_000:])
    tail.poll()
    before = len(tail.chunks)
    tail.poll()
    assert tail.quiet
    assert not tail.ended
    assert len(tail.chunks) == before
