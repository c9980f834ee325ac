"""Whatever ends a run, its log is closed and says why."""

from collections.abc import Callable
from pathlib import Path

import pytest

from bench.bus.link.address import Address
from bench.conductor.interrupts import Interrupted
from bench.conductor.options import RunOptions
from bench.conductor.run import run
from bench.errors import RunFailed
from bench.events import ProcessOutput, RunEnded
from bench.record.reader import Run
from bench.scenario import load

ECUS = Path(__file__).parents[1] / "ecus"
SIMPLE = {"planner": f"{ECUS}/simple.py:CruisePlanner", "tracker": f"{ECUS}/simple.py:SpeedTracker"}


def start(out: Path, on_progress: Callable[[float], None], *, realtime: bool = False) -> None:
    """Run, and let the caller's function, which the conductor calls, do what it wants."""
    run(
        RunOptions(
            load("formation", ["duration_s=1.0"]),
            address=Address.parse("udp" if realtime else "direct"),
            out=out,
            command_line=["test"],
            ecus=SIMPLE,
            on_progress=on_progress,
            realtime=realtime,
        )
    )


@pytest.mark.parametrize(
    ("error", "realtime"),
    [
        (ZeroDivisionError("nobody thought of this"), False),
        (ZeroDivisionError("nobody thought of this"), True),
        (MemoryError(), False),
        (OSError(24, "too many open files"), False),
    ],
)
def test_an_error_that_nobody_foresaw_is_the_reason(tmp_path: Path, error: Exception, realtime: bool) -> None:
    def fail(time_s: float) -> None:
        if time_s >= 0.3:
            raise error

    out = tmp_path / "run.mcap"
    with pytest.raises(RunFailed) as caught:
        start(out, fail, realtime=realtime)
    said = f"an error in the bench itself, test_run_ending.py line {fail.__code__.co_firstlineno + 2}: "
    assert said in str(caught.value)
    assert type(error).__name__ in str(caught.value)
    assert str(out) in str(caught.value)
    assert "Traceback" not in str(caught.value)
    log = Run(out)
    assert log.result["status"] == "failed"
    assert log.result["reason"].startswith(said)
    (ended,) = [event for event in log.events if event.kind == RunEnded.kind]
    assert ended.fields == {"status": "failed", "reason": log.result["reason"]}
    (output,) = [event for event in log.events if event.kind == ProcessOutput.kind and event.source == "conductor"]
    assert output.text.startswith("Traceback")
    assert len(log.signal("veh1", "VehicleMotion", "VelocityX")[0]) >= 25


def test_an_interrupt_in_an_odd_place_is_one(tmp_path: Path) -> None:
    def interrupt(time_s: float) -> None:
        if time_s >= 0.3:
            raise KeyboardInterrupt

    out = tmp_path / "run.mcap"
    with pytest.raises(Interrupted, match="interrupted by SIGINT"):
        start(out, interrupt)
    assert Run(out).result["status"] == "interrupted"


def test_a_conductor_that_is_told_to_exit_still_closes_the_log(tmp_path: Path) -> None:
    def leave(_: float) -> None:
        raise SystemExit(3)

    out = tmp_path / "run.mcap"
    with pytest.raises(SystemExit):
        start(out, leave)
    log = Run(out)
    assert (log.result["status"], log.result["reason"]) == ("failed", "the conductor was ended: SystemExit: 3")
