"""Checkouts of this repository that can run: this one, and another revision built beside it.

The other revision gets a folder `build/against/<commit>` with what git has of it, and its own `make setup` does the
rest: a virtual environment with its own pinned packages, its FMU, its compiled code. The folder is kept for the next
time.
"""

import fcntl
import os
import shutil
import subprocess
from collections.abc import Callable, Iterator, Mapping
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path

from bench.benchmarks.against.processes import Command
from bench.compiled.build import compile_modules
from bench.errors import BadInput, RunFailed
from platoon_fmu.interpreter import interpreter

ROOT = Path(__file__).resolve().parents[3]
"""This checkout."""

BUILDS = Path("build/against")
"""Where other revisions are built, in this checkout."""

_BUILT = ".built"

# What `make` or a user tells this checkout must not reach the other one.
_OWN_SETTINGS = ("MAKEFLAGS", "MAKELEVEL", "MFLAGS", "PYTHONPATH", "PYTHONHOME", "VIRTUAL_ENV", "PLATOON_INTERPRETED")

Say = Callable[[str], None]


@dataclass(frozen=True)
class Checkout:
    """A checkout that can run.

    Attributes:
        name: as in tables.
        python: the interpreter of its virtual environment.
    """

    name: str
    python: Path

    @property
    def platoon(self) -> Path:
        """Its command."""
        return self.python.with_name("platoon")


def environment() -> Mapping[str, str]:
    """Return the environment in which both checkouts run."""
    return {name: value for name, value in os.environ.items() if name not in _OWN_SETTINGS}


def this_checkout(say: Say) -> Checkout:
    """Return this checkout as it is, with its uncommitted changes, its compiled code up to date.

    Raises:
        BadInput: it has no `platoon` command, or its code cannot be compiled.
    """
    compile_modules(say)
    checkout = Checkout("this", Path(interpreter()[0]))
    if not checkout.platoon.exists():
        raise BadInput(f"{checkout.platoon} does not exist; run make setup")
    return checkout


def commit_of(revision: str, root: Path = ROOT) -> str:
    """Return the commit that a revision names.

    Raises:
        BadInput: there is no git, no repository, or no such revision.
    """
    # A revision that begins with a hyphen would be an option.
    found = _git(root, "rev-parse", "--verify", "--quiet", "--end-of-options", f"{revision}^{{commit}}")
    if found.returncode:
        _git_checked(root, "rev-parse", "--git-dir")
        raise BadInput(f"{revision}: no such revision in {root}; git log lists commits, git branch -a branches")
    return found.stdout.strip()


def build(commit: str, builds: Path, say: Say, root: Path = ROOT) -> Checkout:
    """Return a checkout of a commit, built in a folder of `builds` unless it is there already.

    Raises:
        BadInput: the folder cannot be written, or its files are no longer those of the commit.
        RunFailed: the revision cannot be set up.
    """
    folder = builds.resolve() / commit
    try:
        builds.mkdir(parents=True, exist_ok=True)
        with _locked(folder.with_suffix(".lock")):
            if not (folder / _BUILT).exists():
                _unpack(commit, folder, root)
                _set_up(folder, commit, say)
                (folder / _BUILT).touch()
            _check_unchanged(folder, root)
    except OSError as error:
        raise BadInput(
            f"{error.filename}: {error.strerror}; remove it, or give another folder with --builds"
        ) from error
    return Checkout(commit[:7], folder / ".venv" / "bin" / "python")


@contextmanager
def _locked(path: Path) -> Iterator[None]:
    """Wait until no other process builds the same."""
    with path.open("w") as lock:
        fcntl.flock(lock, fcntl.LOCK_EX)
        yield


def _unpack(commit: str, folder: Path, root: Path) -> None:
    """Write the commit's files into the folder."""
    folder.mkdir(exist_ok=True)
    _git_in(folder, root, "read-tree", commit)
    _git_in(folder, root, "checkout-index", "--all", "--force")


def _set_up(folder: Path, commit: str, say: Say) -> None:
    say(f"building {commit[:7]} in {folder}: its packages, its FMU, its compiled code (some minutes) ...")
    if shutil.which("make") is None:
        raise BadInput("make is not installed; on Debian or Ubuntu: apt install make")
    # The same Python for both.
    base = Path(interpreter()[0]).resolve()
    log = folder / "build" / "setup.log"
    log.parent.mkdir(exist_ok=True)
    with log.open("wb") as output:
        command = ["make", "setup", f"PYTHON={base}"]
        with Command(command, cwd=folder, env=environment(), stdout=output, stderr=output) as made:
            made.wait()
    if made.returncode:
        last = "\n".join(log.read_text(errors="replace").splitlines()[-10:])
        raise RunFailed(f"make setup of {commit[:7]} failed, see {log}:\n{last}")


def _check_unchanged(folder: Path, root: Path) -> None:
    """Raise BadInput unless the folder has the files of its commit."""
    changed = _git_in(folder, root, "diff", "--name-only").split()
    if changed:
        some = ", ".join(changed[:3])
        raise BadInput(f"{folder} has been edited ({some}); remove it, and it is built again")


def _git_in(folder: Path, root: Path, *arguments: str) -> str:
    """Run git on the files of a folder outside its repository, with an index of their own."""
    there = {"GIT_INDEX_FILE": str(folder.with_suffix(".index"))}
    return _git_checked(root, f"--work-tree={folder}", *arguments, settings=there)


def _git_checked(root: Path, *arguments: str, settings: Mapping[str, str] | None = None) -> str:
    done = _git(root, *arguments, settings=settings)
    if done.returncode:
        raise BadInput(
            f"git {arguments[-2]}: {done.stderr.strip()}; other revisions come from this checkout's repository"
        )
    return done.stdout


def _git(root: Path, *arguments: str, settings: Mapping[str, str] | None = None) -> subprocess.CompletedProcess[str]:
    command = ["git", "-C", str(root), *arguments]
    try:
        return subprocess.run(
            command, capture_output=True, text=True, check=False, env=os.environ | dict(settings or {})
        )
    except FileNotFoundError:
        raise BadInput("git is not installed; on Debian or Ubuntu: apt install git") from None
