"""A file written aside and moved into place when it is whole, so that no half of it is ever there."""

import os
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

from bench.errors import BadInput
from bench.output_paths import check_directory, check_suffix


def check_new(target: Path, suffix: str) -> None:
    """Refuse a file that could not be made, before any work is done for it.

    Raises:
        BadInput: another suffix, no directory that can be written to, or something is there already.
    """
    check_suffix(target, suffix)
    check_directory(target)
    if os.path.lexists(target):
        raise BadInput(f"{target} is there already; give another -o, or remove it")


@contextmanager
def written_aside(target: Path) -> Iterator[Path]:
    """Give the name to write to; it becomes `target` at the end, and is removed where anything goes wrong.

    Raises:
        BadInput: the file cannot be written.
    """
    # The suffix stays: asammdf goes by it.
    aside = target.with_name(f".{target.stem}.{os.getpid()}.part{target.suffix}")
    try:
        yield aside
        aside.rename(target)
    except OSError as error:
        raise BadInput(f"cannot write {target}: {error.strerror or error}") from error
    finally:
        aside.unlink(missing_ok=True)
