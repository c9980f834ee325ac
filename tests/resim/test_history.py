"""What a log tells of faults that were typed into the running bench."""

import threading
import time
from pathlib import Path
from typing import Any

from bench.bus.link.address import Address
from bench.conductor.fault_desk import ask
from bench.conductor.options import RunOptions
from bench.conductor.run import run
from bench.cycle import CYCLE_S
from bench.record.reader import Run
from bench.resim.history import read_history
from bench.resim.plan import make_plan
from bench.resim.rewrite import write
from bench.scenario import load
from tests.resim.conftest import rerun

FAULT = {"kind": "frame_loss", "bus": "veh1", "message": "Reference", "probability": 0.5, "for_s": 0.2}
CYCLES = 1000
"""Some tenths of a second on a quick machine, in which a person's program has typed in two faults."""

CRASH = {"kind": "ecu_crash", "ecu": "veh2.tracker", "for_s": 0.1}


def test_ecus_meet_the_faults_that_were_typed_in(tmp_path: Path) -> None:
    out = tmp_path / "typed-in.mcap"
    answers: list[dict[str, Any]] = []

    def type_in() -> None:
        for fault in (FAULT, CRASH):
            answers.append(ask("typed-in", fault))

    person = threading.Thread(target=type_in)

    def on_progress(_time_s: float) -> None:
        if not person.ident:
            person.start()
        # The run is quicker than a person, and would end before both are typed in.
        if len(answers) < 2:
            time.sleep(0.02)

    scenario = load(
        "formation",
        [f"duration_s={CYCLES * CYCLE_S}", "vehicles=[{x_m=8,y_m=0,speed_mps=20},{x_m=0,y_m=3.5,speed_mps=22}]"],
    )
    run(RunOptions(scenario, address=Address.parse("direct"), out=out, command_line=["test"], on_progress=on_progress))
    person.join()
    history = read_history(Run(out))
    assert [fault.model_dump(mode="json") for fault in history.faults] == [answer["fault"] for answer in answers]
    assert (history.untold, history.ended) == (0, {})
    outcomes = rerun(out, tolerances=())
    assert [outcome.name for outcome in outcomes if not outcome.same] == []
    steps = {outcome.name: outcome.steps for outcome in outcomes}
    # On a busy machine the crash may begin late, and be cut short by the end of the run.
    crash = round(answers[1]["at_s"] / CYCLE_S)
    assert steps.pop("veh2.tracker") == max(crash, CYCLES - 10) < CYCLES
    assert set(steps.values()) == {CYCLES}
    # A log made of this one tells the same of the run.
    write(make_plan(Run(out), (), every=True, tolerances=()), outcomes, tmp_path / "again.mcap", "test")
    assert Run(tmp_path / "again.mcap").events == Run(out).events != []
