"""Closed or full streams and low limits: one message, an exit code, nothing half-written, never a traceback."""

import os
import resource
import subprocess
import sys
from pathlib import Path

import pytest

from bench.bus.link.address import Address
from bench.conductor.limits import FILES_OF_VEHICLE, LEAST_FILES
from bench.conductor.options import RunOptions
from bench.conductor.run import run
from bench.record.reader import Run
from bench.scenario import load

ROOT = Path(__file__).parents[2]
PLATOON = str(Path(sys.executable).with_name("platoon"))
SIMPLE = ROOT / "tests" / "ecus" / "simple.py"
OWN = ("--ecu", f"tracker={SIMPLE}:SpeedTracker", "--ecu", f"planner={SIMPLE}:CruisePlanner")
RUN = ("run", "formation", *OWN, "--can", "udp", "--set", "duration_s=0.1", "--out", "run.mcap")
GUARD_S = 120.0
KIB = 1024


@pytest.fixture(scope="module")
def log(tmp_path_factory: pytest.TempPathFactory) -> str:
    path = tmp_path_factory.mktemp("log") / "run.mcap"
    ecus = {"tracker": f"{SIMPLE}:SpeedTracker", "planner": f"{SIMPLE}:CruisePlanner"}
    scenario = load("formation", ["duration_s=0.5"])
    run(RunOptions(scenario, address=Address.parse("direct"), out=path, command_line=[], ecus=ecus))
    return str(path)


def called(*arguments: str, cwd: Path, limits: dict[int, int] | None = None, **streams: object):
    """Call the command with limits on its resources."""

    def limit() -> None:
        for which, most in (limits or {}).items():
            resource.setrlimit(which, (most, most))

    pipes = {"stdin": subprocess.DEVNULL, "stdout": subprocess.PIPE, "stderr": subprocess.PIPE} | streams
    command = [PLATOON, *arguments]
    environment = os.environ | {"COLUMNS": "200"}
    return subprocess.run(
        command, cwd=cwd, preexec_fn=limit, text=True, check=False, timeout=GUARD_S, env=environment, **pipes
    )


def in_shell(words: str, *arguments: str, cwd: Path, **environment: str) -> subprocess.CompletedProcess[str]:
    """Call the command with redirections of a shell: `"$@" >&-`."""
    return subprocess.run(
        ["bash", "-c", words, "bash", PLATOON, *arguments],
        cwd=cwd,
        text=True,
        check=False,
        capture_output=True,
        timeout=GUARD_S,
        env=os.environ | {"COLUMNS": "200"} | environment,
    )


@pytest.mark.parametrize("closed", [">&-", "2>&-", "<&-", "<&- >&- 2>&-"])
def test_closed_streams_do_not_matter_and_nothing_of_them_gets_into_the_log(tmp_path: Path, closed: str) -> None:
    done = in_shell(f'"$@" {closed}', *RUN, cwd=tmp_path)
    # A tenth of a second forms no platoon.
    assert done.returncode == 1
    assert "Traceback" not in done.stderr
    assert ("did not form a platoon" in done.stderr) == ("2>&-" not in closed)
    assert Run(tmp_path / "run.mcap").result["status"] == "completed"
    assert (tmp_path / "run.html").exists()


@pytest.mark.parametrize("arguments", [("--help",), ("scenarios",), ("fault",), ("metrics", "LOG"), RUN])
def test_a_reader_that_has_seen_enough_is_no_error(tmp_path: Path, log: str, arguments: tuple[str, ...]) -> None:
    words = [log if word == "LOG" else word for word in arguments]
    expected = called(*words, cwd=tmp_path).returncode
    for made in tmp_path.iterdir():
        made.unlink()
    done = in_shell('"$@" | head -c 1 >/dev/null; exit ${PIPESTATUS[0]}', *words, cwd=tmp_path)
    assert done.returncode == expected
    assert "Traceback" not in done.stderr
    if arguments is RUN:
        assert {made.name for made in tmp_path.iterdir()} == {"run.mcap", "run.html"}


@pytest.mark.parametrize("arguments", [("--help",), ("scenarios",), ("metrics", "LOG"), RUN])
def test_a_full_output_is_said(tmp_path: Path, log: str, arguments: tuple[str, ...]) -> None:
    done = in_shell('"$@" >/dev/full', *(log if word == "LOG" else word for word in arguments), cwd=tmp_path)
    assert done.returncode == 1
    assert done.stderr.endswith("platoon: not all output could be written: No space left on device\n")
    assert "Traceback" not in done.stderr


@pytest.mark.parametrize("most", [10, 12, 16, 24, 32, 48, LEAST_FILES - 1, LEAST_FILES + 3 * FILES_OF_VEHICLE - 1])
@pytest.mark.parametrize("live", [(), ("--live",)], ids=["", "live"])
def test_too_few_open_files_are_refused_with_the_number_needed(
    tmp_path: Path, most: int, live: tuple[str, ...]
) -> None:
    done = called(*RUN, *live, cwd=tmp_path, limits={resource.RLIMIT_NOFILE: most})
    assert done.returncode == 2
    needed = LEAST_FILES if most < LEAST_FILES else LEAST_FILES + 3 * FILES_OF_VEHICLE
    assert f"up to {needed} open files, but {most} are permitted; permit more: ulimit -n {needed}" in done.stderr
    assert done.stderr.count("\n") == 1
    assert list(tmp_path.iterdir()) == []


@pytest.mark.parametrize("vehicles", [1, 3, 16])
def test_so_many_open_files_are_enough(tmp_path: Path, vehicles: int) -> None:
    rows = ", ".join(f"{{x_m = {-12.0 * number}, y_m = 0.0, speed_mps = 20.0}}" for number in range(vehicles))
    limits = {resource.RLIMIT_NOFILE: LEAST_FILES + FILES_OF_VEHICLE * vehicles}
    done = called(*RUN, "--live", "--set", f"vehicles=[{rows}]", cwd=tmp_path, limits=limits)
    assert done.returncode in (0, 1)
    assert "open files" not in done.stderr
    assert Run(tmp_path / "run.mcap").result["status"] == "completed"


def test_the_soft_limit_on_open_files_is_raised(tmp_path: Path) -> None:
    done = in_shell('ulimit -S -n 20; "$@"', *RUN, cwd=tmp_path)
    assert done.returncode == 1
    assert "did not form a platoon" in done.stderr


@pytest.mark.parametrize(
    ("which", "most", "option"),
    [
        (resource.RLIMIT_AS, 300 << 20, "-v 1048576"),
        (resource.RLIMIT_AS, (1 << 30) - 1, "-v 1048576"),
        (resource.RLIMIT_STACK, 256 << 10, "-s 1024"),
        (resource.RLIMIT_STACK, 1000 << 10, "-s 1024"),
    ],
)
def test_too_little_memory_is_refused_with_what_is_needed(tmp_path: Path, which: int, most: int, option: str) -> None:
    done = called(*RUN, cwd=tmp_path, limits={which: most})
    assert done.returncode == 2
    assert f"permit more: ulimit {option}" in done.stderr
    assert list(tmp_path.iterdir()) == []


def test_the_least_memory_is_enough(tmp_path: Path) -> None:
    done = called(*RUN, cwd=tmp_path, limits={resource.RLIMIT_AS: 1 << 30, resource.RLIMIT_STACK: 1 << 20})
    assert done.returncode == 1
    assert "did not form a platoon" in done.stderr


@pytest.mark.parametrize("kib", [0, 1, 10, 100, 260, 280])
def test_files_that_may_not_grow_leave_a_message_and_no_half_files(tmp_path: Path, kib: int) -> None:
    done = called(*RUN, cwd=tmp_path, limits={resource.RLIMIT_FSIZE: kib * KIB})
    assert done.returncode in (1, 2)
    assert "Traceback" not in done.stderr
    assert done.stderr.splitlines()[-1].startswith(("platoon: ", "  The log up to there is"))
    assert {made.name for made in tmp_path.iterdir()} <= {"run.mcap"}


@pytest.mark.parametrize(
    "arguments",
    [
        ("report", "LOG", "-o", "out.html"),
        ("diff", "LOG", "LOG", "--plot", "out.html"),
        ("log", "export", "LOG", "--format", "csv", "-o", "out.csv"),
        ("log", "export", "LOG", "--format", "blf", "-o", "out.blf"),
        ("log", "recover", "LOG", "-o", "out.mcap"),
        ("fmu", "build", "-o", "built"),
    ],
    ids=" ".join,
)
def test_no_command_leaves_half_a_file(tmp_path: Path, log: str, arguments: tuple[str, ...]) -> None:
    words = (log if word == "LOG" else word for word in arguments)
    done = called(*words, cwd=tmp_path, limits={resource.RLIMIT_FSIZE: 2 * KIB})
    assert "Traceback" not in done.stderr
    left = [made for made in tmp_path.rglob("*") if made.is_file()]
    assert done.returncode in (1, 2), done.stderr
    assert left == []


@pytest.mark.skipif(os.getuid() != 0, reason="only root can act as a user without processes")
@pytest.mark.parametrize("most", [1, 2, 3, 4, 5, 6, 7, 8])
def test_too_few_processes_are_said(tmp_path: Path, most: int) -> None:
    tmp_path.chmod(0o777)
    user = 60_000 + os.getpid() % 5_000
    # Of the user's own rights only this is left: to read the packages of root.
    rights = ("--inh-caps=+dac_override,+dac_read_search", "--ambient-caps=+dac_override,+dac_read_search")
    as_user = ["setpriv", f"--reuid={user}", f"--regid={user}", "--clear-groups", *rights]
    done = subprocess.run(
        [*as_user, "bash", "-c", f'ulimit -u {most}; exec "$@"', "bash", PLATOON, *RUN],
        cwd=tmp_path,
        text=True,
        check=False,
        capture_output=True,
        timeout=GUARD_S,
        env=os.environ | {"HOME": str(tmp_path)},
    )
    assert done.returncode == 1
    assert "no further process or thread is permitted; permit more with: ulimit -u" in done.stderr
    assert "Traceback" not in done.stderr
    if (tmp_path / "run.mcap").exists():
        assert Run(tmp_path / "run.mcap").result["status"] == "failed"


@pytest.mark.parametrize("place", ["/nonexistent", "/dev/null", "relative"])
def test_a_temporary_directory_that_is_none_does_not_matter(tmp_path: Path, place: str) -> None:
    done = in_shell('"$@"', *RUN, "--live", cwd=tmp_path, TMPDIR=place)
    assert done.returncode == 1
    assert "did not form a platoon" in done.stderr
    assert {made.name for made in tmp_path.iterdir()} == {"run.mcap", "run.html"}
