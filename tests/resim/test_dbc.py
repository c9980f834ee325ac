"""A log of which the DBC file is another than today's is run again with today's, and that is said."""

from bench.bus.codec import DBC_DIR
from bench.record.reader import Run
from bench.resim.plan import make_plan
from bench.resim.rewrite import write
from tests.reference.__main__ import FOLDER
from tests.reference.raw_log import write as write_raw


def test_a_dbc_file_that_has_changed_is_named_and_both_are_in_the_log_written_anew(tmp_path):
    before = Run(FOLDER / "five.mcap")
    head = {key: value for key, value in before.metadata.items() if key not in before.result}
    today = {name: (DBC_DIR / name).read_bytes() for name in ("v2v.dbc", "vehicle.dbc")}
    then = {**today, "vehicle.dbc": today["vehicle.dbc"].replace(b"m/s", b"km/h")}
    assert then != today
    log = tmp_path / "then.mcap"
    metadata = {"run": head, "result": before.result}
    write_raw(log, before.frames(), before.buses, before.scenario_text, metadata, then)
    plan = make_plan(Run(log), ["veh1.planner"])
    (note,) = [note for note in plan.notes if ".dbc" in note]
    assert note.startswith("vehicle.dbc has changed since this log was made")
    write(plan, [], tmp_path / "now.mcap", "test")
    now = Run(tmp_path / "now.mcap")
    assert {bus: now.dbc(bus) for bus in now.buses} == {
        bus: today["v2v.dbc" if bus == "v2v" else "vehicle.dbc"] for bus in now.buses
    }
    assert then["vehicle.dbc"] in now.attachments.values()
