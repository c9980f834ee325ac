"""Files that commands read and write: refused early where they cannot be, and never left half written."""

import os
from pathlib import Path

from bench.errors import BadInput


def readable_log(log: Path) -> Path:
    """Return the log, refusing what is no file to read.

    Raises:
        BadInput: no such file, no regular one, or no permission.
    """
    if not log.is_file():
        what = "a directory" if log.is_dir() else "no regular file" if log.exists() else "not there"
        raise BadInput(f"{log} is {what}; give the log of a run, a .mcap file")
    if not os.access(log, os.R_OK):
        raise BadInput(f"{log} cannot be read: no permission")
    return log


def check_suffix(target: Path, suffix: str) -> None:
    """Refuse a file name that says something else than what is to be written.

    Raises:
        BadInput: it does not end in `suffix`.
    """
    if target.suffix.lower() != suffix:
        raise BadInput(f"{target}: want a name that ends in {suffix}")


def check_directory(target: Path) -> None:
    """Refuse a file that could not be written, before any work is done for it.

    Raises:
        BadInput: its directory is missing or read-only.
    """
    directory = target.parent
    if not directory.is_dir():
        raise BadInput(f"{target}: there is no directory {directory}; make it with: mkdir -p {directory}")
    if not os.access(directory, os.W_OK | os.X_OK):
        raise BadInput(f"{target}: the directory {directory} cannot be written to")


def check_report(target: Path) -> None:
    """Refuse a place for a report, before any work is done for it.

    Raises:
        BadInput: it is a directory, has another suffix (so that no log or FMU is ever written over), or its
            directory is missing or read-only.
    """
    if target.is_dir():
        raise BadInput(f"{target} is a directory; give a file: -o {target}/report.html")
    check_suffix(target, ".html")
    check_directory(target)


def write_report(target: Path, page: str) -> None:
    """Write a report, over what is there.

    Raises:
        BadInput: the file cannot be written.
    """
    # Written aside and moved into place, so that a full disk leaves no half of it.
    aside = target.with_name(f".{target.name}.part")
    try:
        aside.write_text(page, encoding="utf-8")
        aside.replace(target)
    except OSError as error:
        aside.unlink(missing_ok=True)
        raise BadInput(f"cannot write the report {target}: {error.strerror or error}") from error
