"""Finding an ECU's class by name."""

from pathlib import Path

import pytest

from bench.bus.network import ROLES
from bench.ecu.loading import DEFAULT_ECUS, load_class
from bench.errors import BadInput

SIMPLE = Path(__file__).parents[1] / "ecus" / "simple.py"


def test_every_role_has_an_ecu_of_the_bench() -> None:
    assert tuple(DEFAULT_ECUS) == ROLES


def test_a_class_comes_from_a_module_or_a_file() -> None:
    assert load_class(DEFAULT_ECUS["planner"]).__name__ == "PlannerEcu"
    assert load_class(DEFAULT_ECUS["tracker"]).__name__ == "TrackerEcu"
    assert load_class(f"{SIMPLE}:SpeedTracker").__name__ == "SpeedTracker"
    assert load_class(f"{SIMPLE}:SpeedTracker") is load_class(f"{SIMPLE}:SpeedTracker")


@pytest.mark.parametrize(
    ("spec", "message"),
    [
        ("SpeedTracker", "write package.module:Class or path/to/file.py:Class"),
        ("bench.nothing:Here", "No module named 'bench.nothing'"),
        ("/no/such/file.py:Here", "no file /no/such/file.py"),
        (f"{SIMPLE}:Here", "has no class Here"),
        ("json:dumps", "json has no class dumps"),
        ("json:JSONEncoder", "the class JSONEncoder is not an ECU: it has no method step"),
    ],
)
def test_what_cannot_be_loaded_is_said(spec: str, message: str) -> None:
    with pytest.raises(BadInput, match=message):
        load_class(spec)


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("import no_such_thing", r"ModuleNotFoundError: No module named 'no_such_thing' \(.*ecu.py, line 1\)"),
        ("x = 1\ny = x / 0", r"ZeroDivisionError: division by zero \(.*ecu.py, line 2\)"),
        ("def broken(", "SyntaxError: .*ecu.py, line 1"),
        ("import sys\nsys.exit(3)", r"SystemExit: 3 \(.*ecu.py, line 2\)"),
    ],
)
def test_a_file_that_fails_is_said_with_its_line_each_time(text: str, message: str, tmp_path: Path) -> None:
    (tmp_path / "ecu.py").write_text(text)
    for _ in range(2):
        with pytest.raises(BadInput, match=message):
            load_class(f"{tmp_path}/ecu.py:Tracker")
