"""The reference logs, and logs made of them with something changed."""

from collections.abc import Callable, Iterable, Sequence
from pathlib import Path

import pytest

from bench.cli.resim import STEP_LIMIT_S
from bench.record.can_frame import Frame
from bench.record.reader import Run
from bench.resim.fleet import run_all
from bench.resim.job import Outcome
from bench.resim.plan import make_plan
from tests.reference.__main__ import FOLDER
from tests.reference.raw_log import write

CONTROLLERS = Path(__file__).with_name("controllers.py")

TOLERANCE = ("10", "TrackerStatus.Iterations=6", "TrackerStatus.Tau=0.01")
"""What another processor may make of it. OpenBLAS and libm have code of their own for each kind; with that for others
(OPENBLAS_CORETYPE, GLIBC_TUNABLES) commands were off by one step of their resolution, estimates by three, the solver's
iterations by 3 and tau by 0.0014; planners sent the same bytes."""

Change = Callable[[Frame], Iterable[Frame]]


@pytest.fixture
def reworked(tmp_path: Path) -> Callable[..., Path]:
    """`reworked(name, change, ran=...)`: a reference log, each frame replaced by what `change` makes of it."""

    def rework(name: str, change: Change = lambda frame: [frame], **ran: str) -> Path:
        before = Run(FOLDER / f"{name}.mcap")
        head = {key: value for key, value in before.metadata.items() if key not in before.result}
        head |= {f"ecu {role}": spec for role, spec in ran.items()}
        frames = [after for frame in before.frames() for after in change(frame)]
        frames.sort(key=lambda frame: frame.time_ns)
        out = tmp_path / "reworked.mcap"
        write(out, frames, before.buses, before.scenario_text, {"run": head, "result": before.result})
        return out

    return rework


def rerun(
    log: Path, *names: str, tolerances: Sequence[str] = TOLERANCE, step_limit_s: float = STEP_LIMIT_S, **options: object
) -> list[Outcome]:
    """Run ECUs of a log again, all of them where none is named."""
    plan = make_plan(Run(log), names, every=not names, tolerances=tolerances, **options)  # type: ignore[arg-type]
    return list(run_all(plan.jobs, step_limit_s))
