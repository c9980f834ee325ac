"""The DBC file of each bus of a log: found by bus, whatever its name and encoding; left out where it is bad."""

import warnings

import pytest
from click.testing import CliRunner
from typer.main import get_command

from bench.analysis.bus_load import bus_loads
from bench.bus.codec import DBC_DIR, Codec
from bench.cli.main import app
from bench.record import LogDamaged, Run, RunWriter, diff
from bench.record.exchange import import_logs
from bench.replay.selection import Selection
from tests.reference import raw_log

from .damage import with_bad_dbc

DBC = """VERSION ""
BU_: ECU
BO_ 5 M: 8 ECU
 SG_ {signal} : 0|8@1+ (1,0) [0|255] "°C" ECU
"""


def logged(path, codecs, attachments=None):
    """A log of a frame with identifier 5 on each bus."""
    with RunWriter(
        path, codecs=codecs, truth_names=(), vehicles=0, metadata={}, attachments=attachments or {}
    ) as writer:
        for bus in codecs:
            writer.frame(bus, 0, 5, bytes([7] * 8), 0)
    return Run(path)


def signals_of(run, bus):
    return [signal.name for signal in run.codec(bus).message("M").signals]


@pytest.mark.parametrize("encoding", ["utf-8", "cp1252"])
def test_a_degree_sign_comes_back_from_the_file_the_log_and_the_attachment(tmp_path, encoding):
    dbc, frames = tmp_path / "vehicle.dbc", tmp_path / "a.log"
    dbc.write_bytes(DBC.format(signal="Temperature").encode(encoding))
    frames.write_text("(1.000000) can0 005#0700000000000000\n")
    import_logs([frames], tmp_path / "a.mcap", dbc=[str(dbc)])
    run = Run(tmp_path / "a.mcap")
    assert run.unit("can0.M.Temperature") == "°C"
    assert run.codec("can0").message("M").get_signal_by_name("Temperature").unit == "°C"
    assert run.dbc("can0") == dbc.read_bytes()


def test_two_files_of_one_name_are_both_there_each_for_its_bus(tmp_path):
    options = []
    for number in (0, 1):
        dbc = tmp_path / str(number) / "vehicle.dbc"
        dbc.parent.mkdir()
        dbc.write_text(DBC.format(signal=f"Of{number}"))
        options.append(f"can{number}={dbc}")
    frames = tmp_path / "a.log"
    frames.write_text("".join(f"(1.000000) can{number} 005#0700000000000000\n" for number in (0, 1, 2)))
    import_logs([frames], tmp_path / "a.mcap", dbc=options)
    run = Run(tmp_path / "a.mcap")
    assert list(run.attachments) == ["vehicle.dbc", "vehicle-can1.dbc"]
    assert [signals_of(run, f"can{number}") for number in (0, 1)] == [["Of0"], ["Of1"]]
    assert run.names() == ["can0.M.Of0", "can1.M.Of1"]
    # The bus without a DBC file does not get that of another.
    assert (run.codec("can2"), run.dbc("can2")) == (None, None)


def test_one_file_for_many_buses_is_attached_once_and_takes_no_other_ones_name(tmp_path):
    codec = Codec.from_bytes(DBC.format(signal="Mine").encode(), "notes.txt")
    other = {"notes.txt": b"hello", "notes-a.txt": b"hello, too"}
    run = logged(tmp_path / "a.mcap", {"a": codec, "b": codec}, other)
    assert run.attachments == {**other, "notes-a2.txt": codec.dbc}
    assert [signals_of(run, bus) for bus in ("a", "b")] == [["Mine"], ["Mine"]]


def test_a_log_that_does_not_tell_which_file_is_whose_has_them_by_their_names(tmp_path, recorded):
    whole = Run(recorded.path)
    attached = {name: (DBC_DIR / name).read_bytes() for name in ("v2v.dbc", "vehicle.dbc")}
    old = tmp_path / "old.mcap"
    raw_log.write(old, whole.frames(), whole.buses, "", {}, attached)
    for bus in whole.buses:
        assert Run(old).dbc(bus) == whole.dbc(bus) == attached["v2v.dbc" if bus == "v2v" else "vehicle.dbc"]
        assert Run(old).codec(bus).names == whole.codec(bus).names
    raw_log.write(old, whole.frames(), whole.buses, "", {}, {"vehicle.dbc": attached["vehicle.dbc"]})
    assert Run(old).codec("v2v") is None


def test_a_bad_file_is_told_once_by_log_name_and_reason(tmp_path, recorded):
    run = Run(with_bad_dbc(recorded.path, tmp_path / "bad.mcap"))
    with pytest.warns(LogDamaged, match=r"attached to .*bad\.mcap is ignored: vehicle\.dbc: .*line 1") as told:
        assert [run.codec("veh1"), run.codec("veh2"), run.codec("veh1")] == [None] * 3
    assert len(told) == 1


def test_what_needs_no_dbc_file_goes_on_without_a_bad_one(tmp_path, real_log):
    bad = with_bad_dbc(real_log, tmp_path / "bad.mcap")
    with warnings.catch_warnings():
        warnings.simplefilter("error", LogDamaged)
        assert diff(real_log, bad).same
    with pytest.warns(LogDamaged, match="is ignored"):
        assert bus_loads(Run(bad)) == []
    assert len(bus_loads(Run(real_log))) == 4
    with pytest.warns(LogDamaged, match="is ignored"):
        chosen = Selection.of(Run(bad), without=["veh1.tracker"])
    assert chosen == Selection.of(Run(real_log), without=["veh1.tracker"])
    for arguments in (["metrics", bad], ["report", bad, "-o", tmp_path / "bad.html"], ["log", "info", bad]):
        with warnings.catch_warnings():
            warnings.simplefilter("ignore", LogDamaged)
            result = CliRunner().invoke(get_command(app), [str(argument) for argument in arguments])
        assert result.exception is None
