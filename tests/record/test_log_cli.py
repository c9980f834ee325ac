"""`platoon log` as a user calls it, by its output and its exit code."""

import sys
import warnings
from types import SimpleNamespace

import pytest

from bench.cli import main
from bench.log_cli import FormatName
from bench.record.exchange import Format


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
        (["export", "run.mcap", "-o", "run.txt"], "--format"),
        (["export", "run.mcap", "--format", "blf", "-o", "run.asc"], ".blf"),
        (["export", "run.mcap", "-o", "good.log"], "is there already"),
        (["export", "run.mcap", "-o", "none/a.log"], "mkdir"),
        (["export", "run.mcap", "-o", "a.log", "--bus", "veh9"], "veh9"),
        (["import", "bad.log", "-o", "a.mcap"], "line 1"),
        (["import", "none.log", "-o", "a.mcap"], "not there"),
        (["import", "good.log", "-o", "run.mcap"], "is there already"),
        (["import", "good.log", "-o", "a.log"], ".mcap"),
        (["import", "good.log", "-o", "a.mcap", "--bus", "veh1"], "CHANNEL=BUS"),
        (["import", "good.log", "-o", "a.mcap", "--bus", "1=veh1"], "there are vcan0"),
        (["import", "good.log", "-o", "a.mcap", "--dbc", "none.dbc"], "none.dbc"),
    ):
        before = sorted(tmp_path.rglob("*"))
        done = platoon("log", *arguments)
        assert done.returncode == 2
        assert done.stderr.startswith("platoon: ")
        assert done.stderr.count("\n") == 1
        assert says in done.stderr
        assert sorted(tmp_path.rglob("*")) == before
