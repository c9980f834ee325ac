"""Who may import whom, and what must not be imported at the start of a command."""

import subprocess
import sys
from pathlib import Path

import pytest

ROOT = Path(__file__).parents[1]


def modules_after(statement: str) -> set[str]:
    """Return the top-level modules that a fresh interpreter has loaded after a statement."""
    code = f"import sys; {statement}; print(*{{name.partition('.')[0] for name in sys.modules}})"
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True, cwd=ROOT)
    return set(done.stdout.split())


def test_layers_import_downwards_only():
    # import-linter has no module to run with -m; this is what its command does.
    code = "import sys; from importlinter.cli import lint_imports; sys.exit(lint_imports())"
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=False, cwd=ROOT)
    assert done.returncode == 0, done.stdout + done.stderr
    assert "0 broken" in done.stdout


@pytest.mark.parametrize("module", ["bench.ecu.planner", "bench.ecu.tracker", "bench.ecu.main"])
def test_an_ecu_starts_without_what_only_design_and_analysis_need(module):
    assert not modules_after(f"import {module}") & {"cvxpy", "casadi", "fmpy", "bokeh", "typer"}


def test_help_needs_nothing_of_the_bench():
    assert not modules_after("import bench.cli.main") & {"numpy", "can", "cantools", "mcap", "pydantic"}


def test_a_codec_and_the_buses_of_the_bench_need_neither_cantools_nor_python_can():
    warm = "from bench.bus.codec import load_codecs; load_codecs(3)"
    modules_after(warm)
    assert not modules_after(f"import bench.ecu.main, bench.bus.link.udp; {warm}") & {"can", "cantools", "asyncio"}
