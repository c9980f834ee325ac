"""Files that commands read and write: refused before any work is done for them, and never left half written."""

import os
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

from bench.errors import BadInput


def readable_log(log: Path) -> Path:
    """Return the log, refusing what is no file to read.

    Raises:
        BadInput: no such file, no regular one, or no permission.
    """
    if not log.is_file():
        what = "a directory" if log.is_dir() else "not a regular file" if log.exists() else "not there"
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
    """Refuse a file that could not be written because of its directory.

    Raises:
        BadInput: its directory is missing or read-only.
    """
    directory = target.parent
    if not directory.is_dir():
        raise BadInput(f"{target}: there is no directory {directory}; make it with: mkdir -p {directory}")
    if not os.access(directory, os.W_OK | os.X_OK):
        raise BadInput(f"{target}: the directory {directory} cannot be written to")


def check_new(target: Path, suffix: str, *, option: str = "-o") -> None:
    """Refuse a file that could not be made, or would be written over another.

    Args:
        target: the file.
        suffix: how its name must end.
        option: of the command, to give another name with.

    Raises:
        BadInput: another suffix, no directory that can be written to, or something is there already.
    """
    check_suffix(target, suffix)
    check_directory(target)
    if os.path.lexists(target):
        raise BadInput(f"{target} already exists; give another {option}, or remove it")


def check_report(target: Path) -> None:
    """Refuse a place for a report; an older report there may be written over.

    Raises:
        BadInput: it is a directory, has another suffix (so that no log or FMU is ever written over), or its
            directory is missing or read-only.
    """
    if target.is_dir():
        raise BadInput(f"{target} is a directory; give a file: -o {target}/report.html")
    check_suffix(target, ".html")
    check_directory(target)


@contextmanager
def written_aside(target: Path) -> Iterator[Path]:
    """Give the name to write to; it becomes `target` when all went well, so that no half of a file is ever there.

    Raises:
        BadInput: the file cannot be written.
    """
    # The suffix stays: asammdf goes by it.
    aside = target.with_name(f".{target.stem}.{os.getpid()}.part{target.suffix}")
    try:
        yield aside
        aside.replace(target)
    except OSError as error:
        raise BadInput(f"cannot write {target}: {error.strerror or error}") from error
    finally:
        aside.unlink(missing_ok=True)


def write_text(target: Path, text: str) -> None:
    """Write a text file, over what is there.

    Raises:
        BadInput: the file cannot be written.
    """
    with written_aside(target) as aside:
        aside.write_text(text, encoding="utf-8")
