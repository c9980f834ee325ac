"""The planner's control gives the same bits compiled and interpreted."""

import os
import subprocess

import bench.control.genetic
from bench.compiled.finder import INTERPRETED, ROOT, is_wanted
from platoon_fmu.interpreter import interpreter
from tests.control.planner_cases import answers


def test_machine_code_and_plain_text_give_the_same_bits() -> None:
    settings = os.environ | {INTERPRETED: "1", "PYTHONPATH": str(ROOT)}
    command = [*interpreter(), "-c", "from tests.control.planner_cases import main; main()"]
    plain = subprocess.run(command, env=settings, capture_output=True, text=True, check=True).stdout.splitlines()
    assert len(set(plain)) > 100
    assert answers(12) == plain
    if is_wanted():
        assert type(bench.control.genetic.search).__name__ == "cython_function_or_method"
