"""`platoon log` as a user calls it, by its output and its exit code."""

import json
import os
import subprocess
import sys
import warnings
from pathlib import Path
from types import SimpleNamespace

import polars as pl
import pytest
from mcap.reader import make_reader

from bench.bus.codec import DBC_DIR
from bench.cli.log import ExportName, FormatName
from bench.cli.main import main
from bench.record import LogDamaged, Run
from bench.record.exchange import Format
from bench.record.exchange.events import EventFormat
from bench.record.exchange.tables import TableFormat

from .conftest import SCENARIO


@pytest.fixture
def platoon(tmp_path, monkeypatch, capsys):
    """Call the command in the test's folder."""
    monkeypatch.chdir(tmp_path)
    # The command sets it for its own process.
    monkeypatch.setattr(warnings, "formatwarning", warnings.formatwarning)

    def call(*arguments):
        monkeypatch.setattr(sys, "argv", ["platoon", *map(str, arguments)])
        with pytest.raises(SystemExit) as ended:
            main()
        shown = capsys.readouterr()
        return SimpleNamespace(returncode=ended.value.code or 0, stdout=shown.out, stderr=shown.err)

    return call


@pytest.fixture
def log(recorded, tmp_path):
    (tmp_path / "run.mcap").write_bytes(recorded.path.read_bytes())
    return tmp_path / "run.mcap"


def test_the_command_has_the_formats_there_are():
    assert [name.value for name in FormatName] == [kind.value for kind in Format]
    assert [name.value for name in ExportName] == [kind.value for kind in [*Format, *EventFormat]]
    assert set(TableFormat) < set(EventFormat)


def test_info_tells_what_a_log_is(platoon, log, recorded):
    shown = platoon("log", "info", log.name)
    assert (shown.returncode, shown.stderr) == (0, "")
    lines = dict(line.split(maxsplit=1) for line in shown.stdout.splitlines() if not line.startswith("bus"))
    assert lines["time"] == "0 s to 0.39 s"
    assert (lines["status"], lines["seed"], lines["events"]) == ("completed", "7", "4 warning")
    files = {"scenario.toml": SCENARIO, **{name: (DBC_DIR / name).read_bytes() for name in ("v2v.dbc", "vehicle.dbc")}}
    assert lines["attachments"] == ", ".join(f"{name} ({len(data)} bytes)" for name, data in files.items())
    assert lines["damage"] == "none found"
    for bus in ("v2v", "veh1", "veh2"):
        count = sum(frame[1] == bus for frame in recorded.frames)
        assert f"bus {bus}" in shown.stdout
        assert f"  {count} frames, {(count - 1) / 0.39:.6g} a second" in shown.stdout
    found = json.loads(platoon("log", "info", log.name, "--json").stdout)
    # Of the log's time, not of that from the first to the last event.
    assert {"name": "/events", "messages": 4, "per_s": round(3 / 0.39, 3)} in found["topics"]
    assert (found["start_s"], found["end_s"], found["damage"]) == (0.0, 0.39, "")
    assert found["signals"] == len(Run(log).names())
    assert sum(bus["messages"] for bus in found["buses"]) == len(recorded.frames)


def test_a_log_that_was_cut_off_is_shown_as_far_as_it_goes_after_one_warning(platoon, log):
    log.write_bytes(log.read_bytes()[: log.stat().st_size * 2 // 3])
    for arguments in (["info", "--json"], ["signals"], ["export", "--format", "csv"]):
        with pytest.warns(LogDamaged, match="ends before its summary") as caught:
            shown = platoon("log", arguments[0], log.name, *arguments[1:])
        assert (shown.returncode, len(caught)) == (0, 1)
        if arguments[0] == "info":
            assert "ends before its summary" in json.loads(shown.stdout)["damage"]


def destroy(log, *chunks):
    """Destroy these chunks of a log; return their times, as they are told."""
    data = bytearray(log.read_bytes())
    with log.open("rb") as stream:
        indexes = [make_reader(stream).get_summary().chunk_indexes[number] for number in chunks]
    for index in indexes:
        data[index.chunk_start_offset + index.chunk_length // 2] ^= 1
    log.write_bytes(data)
    return [f"from {index.message_start_time / 1e9:.3f} s to {index.message_end_time / 1e9:.3f} s" for index in indexes]


def test_of_a_chunk_that_is_damaged_the_warning_says_the_time_and_info_knows_all(platoon, log):
    times = destroy(log, 0, -1)
    warned = f"a chunk {times[0]} is damaged and left out; there may be more: platoon log recover lists all"
    for arguments in (["info", "--json"], ["export", "--format", "candump"]):
        with pytest.warns(LogDamaged) as caught:
            shown = platoon("log", arguments[0], log.name, *arguments[1:])
        assert [str(warning.message) for warning in caught] == [f"run.mcap: {warned}"]
        if arguments[0] == "info":
            told = "; ".join(f"a chunk {time} is damaged and left out" for time in times)
            assert json.loads(shown.stdout)["damage"] == told


def test_what_is_damaged_beside_what_was_seen_first_is_told_too(platoon, log):
    (time,) = destroy(log, 0)
    data = log.read_bytes().replace(b"lane_y_m = 7.0", b"lane_y_m = 9.0")
    log.write_bytes(data[:-50])
    with pytest.warns(LogDamaged, match=r"any chunk that is damaged is left out: platoon log recover lists") as caught:
        shown = platoon("log", "info", log.name, "--json")
    assert len(caught) == 1
    assert json.loads(shown.stdout)["damage"] == (
        "it ends before its summary; complete chunks are read up to there; "
        "an attachment cannot be read (the attachment scenario.toml is damaged); "
        f"a chunk {time} is damaged and left out"
    )


def test_damage_is_told_in_a_line_however_much_there_is(log):
    destroy(log, *range(5))
    run = Run(log)
    with pytest.warns(LogDamaged) as caught:
        run.log.check_chunks()
    assert len(caught) == 1
    # What is met once more is not told once more.
    run.log.check_chunks()
    assert run.damage.endswith("; 2 more chunks are damaged and left out")
    assert run.damage.count(";") == 3


def test_info_of_a_recovered_log_says_so(platoon, log):
    log.write_bytes(log.read_bytes()[: log.stat().st_size * 2 // 3])
    with pytest.warns(LogDamaged, match="ends before its summary"):
        assert "unfinished (cut off or still written)\n" in platoon("log", "info", log.name).stdout
    assert platoon("log", "recover", log.name).returncode == 3
    shown = platoon("log", "info", "run-recovered.mcap")
    rows = [line.split(maxsplit=1) for line in shown.stdout.splitlines()]
    assert ["status", "unfinished (cut off)"] in rows
    assert ["damage", "none found"] in rows
    assert ["recovered", "from run.mcap"] in rows
    assert any(row[0] == "lost" and "the log is truncated: it ends at" in row[1] for row in rows)


def test_signals_are_listed_with_units_counts_and_ranges(platoon, log):
    shown = platoon("log", "signals", log.name, "*.VehicleMotion.YawRate", "--ranges")
    assert (shown.returncode, shown.stderr) == (0, "")
    values = Run(log).signal("veh2.VehicleMotion.YawRate")[1]
    rows = [line.split() for line in shown.stdout.splitlines()]
    assert rows[0] == ["name", "unit", "values", "start_s", "end_s", "min", "max"]
    assert [row[0] for row in rows[1:]] == ["veh1.VehicleMotion.YawRate", "veh2.VehicleMotion.YawRate"]
    assert rows[2][1:] == ["rad/s", "40", "0", "0.39", f"{values.min():.9g}", f"{values.max():.9g}"]
    assert len(platoon("log", "signals", log.name).stdout.splitlines()) == 1 + len(Run(log).names())


@pytest.mark.parametrize("kind", TableFormat, ids=str)
def test_signals_go_out_as_a_table(platoon, log, tmp_path, kind):
    asked = ["truth.*.X", "veh1.VehicleMotion.YawRate", "veh1.TrackerStatus.GainSource"]
    options = [word for pattern in asked for word in ("--signal", pattern)]
    out = platoon("log", "export", log.name, "--format", kind, *options, "--from", 0.1, "--every", 0.005, "--labels")
    assert (out.returncode, out.stderr) == (0, "")
    wanted = Run(log).table(asked, start_s=0.1, every_s=0.005, labels=True).cast({pl.Enum: pl.String})
    assert out.stdout == f"run.{kind}: {len(wanted)} rows of 4 signals\n"
    if kind is TableFormat.CSV:
        found = pl.read_csv(tmp_path / "run.csv", schema_overrides={"veh1.TrackerStatus.GainSource": pl.String})
        titles = ["t [s]", "truth.veh1.X [m]", "truth.veh2.X [m]", "veh1.VehicleMotion.YawRate [rad/s]"]
        assert found.columns == [*titles, "veh1.TrackerStatus.GainSource"]
        found.columns = wanted.columns
    else:
        found = pl.read_parquet(tmp_path / "run.parquet")
        units = json.loads(pl.read_parquet_metadata(tmp_path / "run.parquet")["units"])
        assert (units["t"], units["truth.veh1.X"], units["veh1.TrackerStatus.GainSource"]) == ("s", "m", "")
    assert found.equals(wanted)


def test_a_long_log_goes_out_in_slices_that_join(platoon, make_log, tmp_path, monkeypatch):
    monkeypatch.setattr("bench.record.exchange.tables.SLICE_NS", 70_000_000)
    make_log("run.mcap")
    assert platoon("log", "export", "run.mcap", "-o", "all.parquet").returncode == 0
    assert pl.read_parquet(tmp_path / "all.parquet").equals(Run(tmp_path / "run.mcap").table("*"))
    done = platoon("log", "export", "run.mcap", "-o", "every.parquet", "--every", 0.003, "--to", 0.2)
    assert done.returncode == 0
    assert pl.read_parquet(tmp_path / "every.parquet").equals(
        Run(tmp_path / "run.mcap").table("*", every_s=0.003, end_s=0.2)
    )


def test_a_disk_that_is_full_leaves_no_half_of_a_table(log, tmp_path):
    # A limit on the file's size stands in for the disk's end.
    code = """
import resource, signal, sys
from pathlib import Path
from bench.errors import BadInput
from bench.record.exchange.tables import TableFormat, export_table
signal.signal(signal.SIGXFSZ, signal.SIG_IGN)
resource.setrlimit(resource.RLIMIT_FSIZE, (10_000, 10_000))
for kind in TableFormat:
    try:
        export_table(Path("run.mcap"), Path(f"out{kind.suffix}"), kind)
    except BadInput as error:
        print(error)
"""
    paths = {**os.environ, "PYTHONPATH": str(Path(__file__).parents[2])}
    done = subprocess.run([sys.executable, "-c", code], cwd=tmp_path, capture_output=True, text=True, env=paths)
    told = done.stdout.splitlines()
    assert [line.split(":")[0] for line in told] == ["cannot write out.csv", "cannot write out.parquet"], done
    assert all("File too large" in line for line in told)
    assert list(tmp_path.iterdir()) == [log]


@pytest.mark.parametrize("kind", Format, ids=str)
def test_a_log_goes_out_and_comes_back_the_same(platoon, log, kind):
    out = platoon("log", "export", log.name, "--format", kind)
    assert out.returncode == 0, out.stderr
    frames = out.stdout.split(": ")[1].split()[0]
    assert out.stdout.startswith(f"run{kind.suffix}: {frames} frames")
    assert out.stderr == (
        f"platoon: {kind} carries frames only; left out: decoded signals, truth, poses, plans, events, attachments, "
        "metadata, receive and wire times\n"
    )
    back = platoon("log", "import", f"run{kind.suffix}", "-o", "back.mcap")
    assert back.returncode == 0, back.stderr
    assert back.stderr == ""
    assert all(f"frames on {bus}" in back.stdout for bus in ("v2v", "veh1", "veh2"))
    same = platoon("diff", log.name, "back.mcap")
    assert same.returncode == 0
    assert same.stdout.startswith("same: ")


def test_the_name_tells_the_format_and_buses_can_be_chosen(platoon, log, tmp_path):
    out = platoon("log", "export", log.name, "-o", "some.asc", "--bus", "veh1", "--bus", "v2v")
    assert out.returncode == 0, out.stderr
    assert out.stdout.endswith("channels 1 = v2v, 2 = veh1\n")
    assert " 3  " not in (tmp_path / "some.asc").read_text()


def test_a_foreign_file_is_named_with_options(platoon, tmp_path):
    (tmp_path / "drive.dump").write_text("(1700000000.5) vcan0 123#00\n(1700000000.6) vcan0 123##100\n")
    arguments = ["drive.dump", "--format", "candump", "--bus", "vcan0=bench", "-o", "a.mcap"]
    done = platoon("log", "import", *arguments)
    assert done.returncode == 0, done.stderr
    assert done.stdout == "a.mcap: 1 frames on bench\n"
    shown = platoon("log", "signals", "a.mcap")
    assert shown.returncode == 2
    assert "a.mcap has no signal '*': it holds raw frames only; platoon log import" in shown.stderr
    assert done.stderr.splitlines() == [
        "platoon: left out: 1 CAN FD frames",
        "platoon: bench: no DBC, so frames only; give --dbc bench=FILE",
    ]


@pytest.mark.usefixtures("log")
def test_what_cannot_be_done_is_refused_in_one_line(platoon, tmp_path):
    (tmp_path / "bad.log").write_text("no frame\n")
    (tmp_path / "good.log").write_text("(1.0) vcan0 123#00\n")
    for arguments, says in (
        (["export", "run.mcap"], "--format"),
        (["export", "none.mcap", "--format", "asc"], "not there"),
        (["export", "good.log", "--format", "asc"], "good.log"),
        (["export", "run.mcap", "-o", "run.txt"], ".mf4 (mf4), .csv (csv), .parquet (parquet), or give --format"),
        (["export", "run.mcap", "--format", "blf", "-o", "run.asc"], ".blf"),
        (["export", "run.mcap", "-o", "good.log"], "already exists"),
        (["export", "run.mcap", "-o", "none/a.log"], "mkdir"),
        (["export", "run.mcap", "-o", "a.log", "--bus", "veh9"], "veh9"),
        (["export", "run.mcap", "-o", "a.log", "--every", "0.1"], "--every is for tables"),
        (["export", "run.mcap", "-o", "a.csv", "--bus", "veh1"], "--bus is for frames"),
        (["export", "run.mcap", "-o", "a.csv", "--signal", "truth.veh1.x"], "near are truth.veh1.X"),
        (["export", "run.mcap", "-o", "a.csv", "--every", "-1"], "give a step"),
        (
            ["export", "run.mcap", "-o", "a.csv", "--every", "1e-12"],
            "--every / every_s 1e-12: give a step in s, at least",
        ),
        (["export", "run.mcap", "-o", "a.csv", "--to", "nan"], "--to / end_s nan: give a time in s"),
        (["export", "run.mcap", "-o", "a.csv", "--from", "2"], "no values of these signals in that time"),
        (["export", "run.mcap", "-o", "a.csv", "--from", "0.2", "--to", "0.1"], "is an empty range"),
        (["export", "run.mcap", "--format", "csv", "-o", "a.parquet"], ".csv"),
        (["export", "run.mcap", "-o", "a.json"], "json is for --events"),
        (["export", "run.mcap", "--format", "json"], "json is for --events"),
        (["export", "run.mcap", "--events", "-o", "a.txt"], "txt is not one of csv, parquet, json"),
        (["export", "run.mcap", "--events", "-o", "a"], "a is not one of csv, parquet, json"),
        (["export", "run.mcap", "--events", "--format", "blf"], "blf is not one of csv, parquet, json"),
        (["export", "run.mcap", "--events", "--format", "json", "-o", "a.csv"], "ends in .json"),
        (["export", "run.mcap", "--events", "-o", "none/a.csv"], "mkdir"),
        (["export", "run.mcap", "--events", "--bus", "veh1"], "--bus is not for --events"),
        (["export", "run.mcap", "--events", "--signal", "*"], "--signal is not for --events"),
        (["export", "run.mcap", "--events", "--every", "1"], "--every is not for --events"),
        (["export", "run.mcap", "--events", "--labels"], "--labels is not for --events"),
        (["export", "run.mcap", "--events", "--from", "2", "--to", "1"], "is an empty range"),
        (["export", "bad.log", "--events"], "is not an MCAP file"),
        (["export", "bad.log", "-o", "a.csv"], "is not an MCAP file"),
        (["info", "bad.log"], "is not an MCAP file"),
        (["signals", "run.mcap", "veh1.VehicleMotoin.*"], "near are"),
        (["import", "bad.log", "-o", "a.mcap"], "line 1"),
        (["import", "none.log", "-o", "a.mcap"], "not there"),
        (["import", "good.log", "-o", "run.mcap"], "already exists"),
        (["import", "good.log", "-o", "a.log"], ".mcap"),
        (["import", "good.log", "-o", "a.mcap", "--bus", "veh1"], "CHANNEL=BUS"),
        (["import", "good.log", "-o", "a.mcap", "--bus", "1=veh1"], "vcan0"),
        (["import", "good.log", "-o", "a.mcap", "--dbc", "none.dbc"], "none.dbc"),
    ):
        before = sorted(tmp_path.rglob("*"))
        done = platoon("log", *arguments)
        assert done.returncode == 2
        assert done.stderr.startswith("platoon: ")
        assert done.stderr.count("\n") == 1
        assert says in done.stderr
        assert sorted(tmp_path.rglob("*")) == before
