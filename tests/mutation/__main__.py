"""Changes what keeps people safe in one place at a time and has its tests find each change: `make mutation`.

mutmut makes the mutants, of the files that pyproject.toml has under [tool.coverage.run], and runs the tests given here.
A mutant that survives fails this, unless `survivors.txt` says why it may.
"""

import json
import os
import re
import shutil
import subprocess
import sys
import tomllib
from collections import Counter
from collections.abc import Iterator, Sequence
from pathlib import Path

ROOT = Path(__file__).parents[2]
PLACE = ROOT / "build" / "mutation"
SURVIVORS = Path(__file__).with_name("survivors.txt")
COPIED = ("bench", "platoon_fmu", "dbc", "tests")
FOUND = {"killed", "timeout", "segfault", "caught by type check"}


def prepare(files: Sequence[str], tests: Sequence[str]) -> None:
    """Copy the project to where mutmut may change it.

    mutmut leaves decorated functions alone, so the decorators of the compiler are taken away.
    """
    shutil.rmtree(PLACE, ignore_errors=True)
    for name in COPIED:
        shutil.copytree(ROOT / name, PLACE / name, ignore=shutil.ignore_patterns("__pycache__"))
    for file in files:
        code = PLACE / file
        code.write_text(re.sub(r"^@cython\..*\n", "", code.read_text(), flags=re.MULTILINE))
    settings = {
        "source_paths": ["bench", "platoon_fmu"],
        "also_copy": ["dbc"],
        "only_mutate": list(files),
        "pytest_add_cli_args_test_selection": list(tests),
        # A timeout counts as found: on a busy machine, mutmut's default of 1 s (times 15) ends good runs.
        "timeout_constant": 5.0,
    }
    lines = [f"{key} = {json.dumps(value)}" for key, value in settings.items()]
    (PLACE / "pyproject.toml").write_text(
        "\n".join([(ROOT / "pyproject.toml").read_text(), "[tool.mutmut]", *lines, ""])
    )


def mutmut(*arguments: str, quiet: bool = True) -> str:
    """Run mutmut there; its output, where that is not shown."""
    environment = os.environ | {"PLATOON_INTERPRETED": "1", "OPENBLAS_NUM_THREADS": "1"}
    command = [sys.executable, "-m", "mutmut", *arguments]
    done = subprocess.run(command, cwd=PLACE, env=environment, stdout=subprocess.PIPE if quiet else None, text=True)
    return done.stdout or ""


def results() -> dict[str, str]:
    """The fate of each mutant by its name."""
    lines = (line.strip().rpartition(": ") for line in mutmut("results", "--all", "true").splitlines())
    return {name: fate for name, _, fate in lines if name}


def change(mutant: str) -> str:
    """What a mutant changes, in one line that stays the same when other lines change."""
    lines = [line for line in mutmut("show", mutant).splitlines() if not line.startswith(("---", "+++"))]
    before, after = (" ".join(line[1:].strip() for line in lines if line.startswith(sign)) for sign in "-+")
    function = mutant.rpartition("__mutmut_")[0].replace(".xǁ", ".").replace("ǁ", ".").replace(".x_", ".")
    return f"{function}: {before} -> {after}"


def permitted(lines: Iterator[str]) -> set[str]:
    """The changes that may survive; comments say why."""
    return {line.strip() for line in lines if line.strip() and not line.startswith("#")}


def main(tests: Sequence[str]) -> int:
    """Make the mutants and have them found; the exit code."""
    files = tomllib.loads((ROOT / "pyproject.toml").read_text())["tool"]["coverage"]["run"]["include"]
    prepare(files, tests)
    mutmut("run", quiet=False)
    fates = results()
    survivors = {change(mutant) for mutant, fate in fates.items() if fate not in FOUND}
    with SURVIVORS.open(encoding="utf-8") as lines:
        known = permitted(lines)
    counts = Counter(fates.values())
    found = sum(counts[fate] for fate in FOUND)
    sys.stdout.write(f"{found} of {len(fates)} mutants found ({dict(counts)}), {len(known)} may survive\n")
    for each in sorted(survivors - known):
        sys.stdout.write(f"survived: {each}\n")
    for each in sorted(known - survivors):
        sys.stdout.write(f"no survivor any more, take it from {SURVIVORS.name}: {each}\n")
    return 0 if fates and survivors == known else 1


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))
