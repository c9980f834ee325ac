"""Files that commands read and write: checked before any work is done, and never left half written."""

import os
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

from bench.errors import BadInput


def readable_log(log: Path) -> Path:
    """Return the log's path if it is a readable file.

    Raises:
        BadInput: no such file, not a regular file, or no permission.
    """
    if not log.is_file():
        what = "a directory" if log.is_dir() else "not a regular file" if log.exists() else "not there"
        raise BadInput(f"{log} is {what}; give the log of a run, a .mcap file")
    if not os.access(log, os.R_OK):
        raise BadInput(f"{log} cannot be read: no permission")
    return log


def check_suffix(target: Path, suffix: str) -> None:
    """Check the suffix of a file to be written.

    Raises:
        BadInput: it does not end in `suffix`.
    """
    if target.suffix.lower() != suffix:
        raise BadInput(f"{target}: give a name that ends in {suffix}")


def check_directory(target: Path) -> None:
    """Check that a file's directory exists and is writable.

    Raises:
        BadInput: its directory is missing or read-only.
    """
    directory = target.parent
    if not directory.is_dir():
        raise BadInput(f"{target}: there is no directory {directory}; create it with: mkdir -p {directory}")
    if not os.access(directory, os.W_OK | os.X_OK):
        raise BadInput(f"{target}: the directory {directory} is not writable")


def check_new(target: Path, suffix: str, *, option: str = "-o") -> None:
    """Check that a file can be created and does not exist yet.

    Args:
        target: the file.
        suffix: required suffix of its name.
        option: the command's option for another name.

    Raises:
        BadInput: wrong suffix, no writable directory, or it already exists.
    """
    check_suffix(target, suffix)
    check_directory(target)
    if os.path.lexists(target):
        raise already_exists(target, option)


def check_report(target: Path) -> None:
    """Check the path of a report; it may overwrite an older report.

    Raises:
        BadInput: it is a directory, has another suffix (so that no log or FMU is overwritten), or its directory is
            missing or read-only.
    """
    if target.is_dir():
        raise BadInput(f"{target} is a directory; give a file: -o {target}/report.html")
    check_suffix(target, ".html")
    check_directory(target)


def already_exists(target: Path, option: str = "-o") -> BadInput:
    """Return the error for a file that is to be new; `option` is the command's option for another name."""
    return BadInput(f"{target} already exists; give another {option}, or remove it")


@contextmanager
def written_aside(target: Path, *, new: bool = False, option: str = "-o") -> Iterator[Path]:
    """Yield a temporary path to write to, renamed to `target` on success, so that no half-written file is left.

    Args:
        target: the file.
        new: whether it must not exist: of several processes that write it at once, one succeeds.
        option: the command's option for another name.

    Raises:
        BadInput: the file cannot be written, or exists and was to be new.
    """
    # The suffix stays: asammdf depends on it.
    aside = target.with_name(f".{target.stem}.{os.getpid()}.part{target.suffix}")
    try:
        yield aside
        if new:
            _rename_new(aside, target, option)
        else:
            aside.replace(target)
    except OSError as error:
        raise BadInput(f"cannot write {target}: {error.strerror or error}") from error
    finally:
        aside.unlink(missing_ok=True)


def _rename_new(aside: Path, target: Path, option: str) -> None:
    """Rename a file to one that does not exist; renaming as such would replace it.

    Raises:
        BadInput: it exists.
        OSError: it cannot be written.
    """
    try:
        try:
            target.hardlink_to(aside)
        except FileExistsError:
            raise
        except OSError:
            # A file system without hard links.
            target.touch(exist_ok=False)
            aside.replace(target)
    except FileExistsError as error:
        raise already_exists(target, option) from error


def write_text(target: Path, text: str, *, new: bool = False, option: str = "-o") -> None:
    """Write a text file; overwrite an existing one unless it is to be `new`.

    Raises:
        BadInput: see `written_aside`.
    """
    with written_aside(target, new=new, option=option) as aside:
        aside.write_text(text, encoding="utf-8")
