"""Which commit of the bench runs, as git reports it; without git, or outside a checkout, none."""

import subprocess
from pathlib import Path

_GIT_S = 2.0

# An installed copy may lie inside another repository, which does not track it.
_TRACKED = ("ls-files", "--error-unmatch", Path(__file__).name)
_STATUS = ("status", "--porcelain=v2", "--branch", "--untracked-files=no")


class Checkout:
    """Asks git, which works while the caller prepares other things."""

    def __init__(self) -> None:
        """Start git."""
        self._tracked, self._status = _git(_TRACKED), _git(_STATUS)

    def commit(self) -> str:
        """Return the commit of this checkout, with `+` if files have been changed since; empty if none."""
        tracked, status = _told(self._tracked), _told(self._status)
        head, _, changes = status.partition("# branch.oid ")[2].partition("\n")
        if not tracked or not head or head == "(initial)":
            return ""
        changed = any(not line.startswith("#") for line in changes.splitlines())
        return f"{head}+" if changed else head


def _git(arguments: tuple[str, ...]) -> subprocess.Popen[str] | None:
    """Start git; return None if there is none."""
    try:
        return subprocess.Popen(
            ["git", "--no-optional-locks", *arguments],
            cwd=Path(__file__).parent,
            stdin=subprocess.DEVNULL,
            stdout=subprocess.PIPE,
            stderr=subprocess.DEVNULL,
            text=True,
        )
    except OSError:
        return None


def _told(process: subprocess.Popen[str] | None) -> str:
    """Return the output of git, empty on failure."""
    if process is None:
        return ""
    try:
        told, _ = process.communicate(timeout=_GIT_S)
    except subprocess.TimeoutExpired:
        process.kill()
        process.communicate()
        return ""
    return told if process.returncode == 0 else ""
