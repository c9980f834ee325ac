"""Clean logs out of broken ones."""

import os
import resource
import signal
import subprocess
import sys
import warnings
from pathlib import Path

import pytest
from mcap.reader import make_reader
from typer.testing import CliRunner

from bench.cli.main import app
from bench.errors import BadInput
from bench.mcap.container import MAGIC
from bench.mcap.recover import recover
from bench.mcap.recovered import METADATA, Recovery
from bench.mcap.scan import ScannedFile
from bench.record import LogDamaged, Run
from bench.record.overview import overview

ROOT = Path(__file__).parents[2]


def read(path):
    """Return a log that must be whole, by its own summary and by mcap's reader."""
    with warnings.catch_warnings():
        warnings.simplefilter("error", LogDamaged)
        run = Run(path)
        frames = list(run.frames())
    assert ScannedFile(path).walked is None
    with path.open("rb") as stream:
        reader = make_reader(stream, validate_crcs=True)
        assert sum(1 for _ in reader.iter_messages()) == reader.get_summary().statistics.message_count
    return run, frames


def chunks_of(path):
    with path.open("rb") as stream:
        return make_reader(stream).get_summary().chunk_indexes


def command(*arguments):
    result = CliRunner().invoke(app, ["log", "recover", *map(str, arguments)])
    if isinstance(result.exception, BadInput):
        raise result.exception
    return result


def test_of_a_whole_log_nothing_is_lost(recorded, tmp_path):
    target = tmp_path / "clean.mcap"
    result = command(recorded.path, "-o", target)
    assert (result.exit_code, "lost" in result.output) == (0, False)
    run, frames = read(target)
    whole = Run(recorded.path)
    assert frames == list(whole.frames())
    assert (run.metadata, run.attachments, run.buses) == (whole.metadata, whole.attachments, whole.buses)
    assert {topic: run.log.count(topic) for topic in run.topics} == {t: whole.log.count(t) for t in whole.topics}
    for topic, channel in run.topics.items():
        assert channel.metadata == whole.topics[topic].metadata
        schemas = (log.log.contents.schemas[log.topics[topic].schema_id] for log in (run, whole))
        assert len({(schema.name, schema.data, schema.encoding) for schema in schemas}) == 1
    assert METADATA not in run.log.contents.metadata
    truth = run.truth(1)
    assert [truth[name].tolist() for name in truth] == [whole.truth(1)[name].tolist() for name in truth]
    assert run.events == whole.events


def test_of_a_log_that_was_cut_off_all_whole_chunks_are_there(recorded, tmp_path):
    chunks = chunks_of(recorded.path)
    broken = tmp_path / "broken.mcap"
    broken.write_bytes(recorded.path.read_bytes()[: chunks[-2].chunk_start_offset + 100])
    with pytest.warns(LogDamaged):
        wanted = list(Run(broken).frames())
    result = command(broken)
    assert result.exit_code == 3
    assert "lost: 100 bytes at its end are not a complete record" in result.output
    assert "lost: the log is truncated: it ends at" in result.output
    run, frames = read(tmp_path / "broken-recovered.mcap")
    assert frames == wanted
    assert "truncated" in run.log.contents.metadata[METADATA]["lost"]
    assert run.result == {}
    shown = overview(run)
    assert shown.status == "unfinished (cut off)"
    assert shown.recovered == Recovery("broken.mcap", [line[6:] for line in result.output.splitlines()[1:]])
    # A copy of it is no more complete.
    assert command(run.path, "-o", tmp_path / "copy.mcap").exit_code == 0
    assert overview(Run(tmp_path / "copy.mcap")).recovered == shown.recovered


def test_a_damaged_chunk_is_named_and_all_others_are_kept(recorded, tmp_path):
    chunk = chunks_of(recorded.path)[0]
    damaged = bytearray(recorded.path.read_bytes())
    damaged[chunk.chunk_start_offset + chunk.chunk_length // 2] ^= 1
    broken = tmp_path / "broken.mcap"
    broken.write_bytes(damaged)
    done = recover(broken, tmp_path / "clean.mcap")
    assert len(done.lost) == 1
    count = (
        sum(
            len(ScannedFile(recorded.path).entries(at, channel))
            for channel, at in sorted(chunk.message_index_offsets.items())
        )
        // 16
    )
    assert f"a chunk, {count} messages of /can/v2v, /can/veh1, /can/veh2, from 0.000 s" in done.lost[0]
    read(tmp_path / "clean.mcap")
    assert sum(done.messages.values()) == sum(Run(recorded.path).log.contents.counts.values()) - count


@pytest.mark.parametrize("with_summary", [True, False])
def test_after_a_hole_the_next_chunk_that_proves_itself_is_found(recorded, tmp_path, with_summary):
    whole = recorded.path.read_bytes()
    chunks = chunks_of(recorded.path)
    hole = chunks[1].chunk_start_offset - 20, chunks[1].chunk_start_offset + 300
    end = len(whole) if with_summary else len(whole) - 50
    broken = tmp_path / "broken.mcap"
    broken.write_bytes(whole[: hole[0]] + whole[hole[1] : end])
    done = recover(broken, tmp_path / "clean.mcap")
    _, frames = read(tmp_path / "clean.mcap")
    assert any("are not a complete record" in what for what in done.lost)
    assert set(frames) <= set(Run(recorded.path).frames())
    # Only what is of the one chunk, and of topics that are named there for the first time, is not there.
    assert sum(done.messages.values()) > 0.5 * sum(Run(recorded.path).log.contents.counts.values())
    with pytest.warns(LogDamaged, match="cannot be read and are skipped") as caught:
        assert list(Run(broken).frames()) == frames
    assert len(caught) == 1


def test_a_chunk_that_only_looks_like_one_is_not_taken(recorded, tmp_path):
    """In a hole, whole chunk records with a wrong or no checksum prove nothing."""
    whole = recorded.path.read_bytes()
    last = chunks_of(recorded.path)[-1]
    start, end = last.chunk_start_offset, last.chunk_start_offset + last.chunk_length
    without_crc = bytearray(whole[start:end])
    without_crc[33:37] = bytes(4)
    broken = tmp_path / "broken.mcap"
    broken.write_bytes(whole[:start] + b"\xff" * 30 + bytes(without_crc) + b"\xff" * 30)
    done = recover(broken, tmp_path / "clean.mcap")
    before = ScannedFile(broken)
    assert len(before.contents.chunks) == len(chunks_of(recorded.path)) - 1
    assert any(f"{len(without_crc) + 60} bytes at its end" in what for what in done.lost)


def test_a_log_that_was_cut_off_before_its_first_message_says_so(recorded, tmp_path):
    broken = tmp_path / "broken.mcap"
    broken.write_bytes(recorded.path.read_bytes()[: chunks_of(recorded.path)[0].chunk_start_offset + 100])
    assert (
        recover(broken, tmp_path / "clean.mcap")
        .lost[-1]
        .startswith("the log is truncated: it ends before the first message; ")
    )


def test_a_record_that_ends_before_its_end_is_named_by_its_kind(recorded, tmp_path):
    whole = recorded.path.read_bytes()
    at = whole.index(MAGIC) + len(MAGIC)
    header = at, at + 9 + int.from_bytes(whole[at + 1 : at + 9], "little")
    # A channel record with room for no more than its id.
    channel = b"\x04" + (2).to_bytes(8, "little") + bytes(2)
    broken = tmp_path / "broken.mcap"
    broken.write_bytes(whole[: header[1]] + channel + whole[header[1] : -50])
    assert "a channel cannot be read (EndOfFile)" in recover(broken, tmp_path / "clean.mcap").lost


def test_a_damaged_attachment_is_left_out_and_named(recorded, tmp_path):
    damaged = recorded.path.read_bytes().replace(b"lane_y_m = 7.0", b"lane_y_m = 9.0")
    broken = tmp_path / "broken.mcap"
    broken.write_bytes(damaged)
    done = recover(broken, tmp_path / "clean.mcap")
    assert done.lost == ["an attachment cannot be read (the attachment scenario.toml is damaged)"]
    run, frames = read(tmp_path / "clean.mcap")
    assert list(run.attachments) == ["v2v.dbc", "vehicle.dbc"]
    assert frames == list(Run(recorded.path).frames())


@pytest.mark.parametrize(
    ("content", "words"), [(MAGIC, "has nothing intact"), (b"hello", "is not an MCAP file"), (b"", "is empty")]
)
def test_what_has_nothing_whole_is_refused_and_nothing_written(tmp_path, content, words):
    broken = tmp_path / "broken.mcap"
    broken.write_bytes(content)
    with pytest.raises(BadInput, match=words):
        command(broken)
    assert list(tmp_path.iterdir()) == [broken]


def test_nothing_is_written_over(recorded, tmp_path):
    target = tmp_path / "precious.mcap"
    target.write_bytes(b"precious")
    with pytest.raises(BadInput, match=r"precious.mcap already exists"):
        command(recorded.path, "-o", target)
    assert target.read_bytes() == b"precious"


@pytest.mark.skipif(os.geteuid() == 0, reason="root may write everywhere")
def test_a_folder_that_is_read_only_is_refused(recorded, tmp_path):
    tmp_path.chmod(0o500)
    with pytest.raises(BadInput, match="not writable"):
        command(recorded.path, "-o", tmp_path / "clean.mcap")


def test_a_full_disk_leaves_nothing_half_written(recorded, tmp_path):
    def small_files():
        # A file that grows too large fails to be written, as on a full disk, where the signal is not the end.
        signal.signal(signal.SIGXFSZ, signal.SIG_IGN)
        resource.setrlimit(resource.RLIMIT_FSIZE, (50_000, 50_000))

    target = tmp_path / "clean.mcap"
    done = subprocess.run(
        [sys.executable, "-m", "bench.cli", "log", "recover", str(recorded.path), "-o", str(target)],
        cwd=ROOT,
        preexec_fn=small_files,
        capture_output=True,
        text=True,
        check=False,
    )
    assert done.returncode == 2
    assert done.stderr == f"platoon: cannot write {target}: File too large\n"
    assert list(tmp_path.iterdir()) == []
