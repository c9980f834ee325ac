"""Where in a user's code an error came from: the frames of a traceback that are neither the bench's nor a library's."""

import inspect
import sysconfig
import traceback
from collections.abc import Callable, Sequence
from pathlib import Path
from types import FrameType
from typing import Any

_BENCH = Path(__file__).resolve().parents[1]
_VEHICLE = _BENCH.parent / "platoon_fmu"
_EXAMPLES = _BENCH / "examples"
_LIBRARIES = tuple(Path(sysconfig.get_path(name)).resolve() for name in ("stdlib", "platstdlib", "purelib", "platlib"))


def described(error: BaseException) -> str:
    """Return an error as text: its kind, its message, and the lines of the user's code that led to it."""
    text = f"{type(error).__name__}: {_message(error)}" if _message(error) else type(error).__name__
    places = _places(error)
    if not places:
        return text
    (file, line, _), *callers = reversed(places)
    trail = "".join(f"\n  called in {path}, line {number}: {code}" for path, number, code in callers)
    return f"{text} ({file}, line {line}){trail}"


def is_users(error: BaseException) -> bool:
    """Return whether an error came from or through code that is neither the bench's nor a library's."""
    return bool(_places(error))


def caller() -> str:
    """Return file and line of the user's code that is running, as ` (file, line n)`; empty if there is none."""
    frame: FrameType | None = inspect.currentframe()
    while frame is not None and not _is_users(frame.f_code.co_filename):
        frame = frame.f_back
    return "" if frame is None else f" ({frame.f_code.co_filename}, line {frame.f_lineno})"


def place_of(item: Callable[..., Any] | type) -> str:
    """Return where a class or function is defined, as ` (file, line n)`; empty if unknown."""
    try:
        item = inspect.unwrap(item)
        _, line = inspect.getsourcelines(item)
        return f" ({inspect.getsourcefile(item)}, line {max(line, 1)})"
    except (OSError, TypeError, ValueError):
        return ""


def _message(error: BaseException) -> str:
    # A syntax error's own text repeats its place.
    if isinstance(error, SystemExit) and error.code is None:
        return ""
    return error.msg if isinstance(error, SyntaxError) else " ".join(str(error).split())


def _places(error: BaseException) -> Sequence[tuple[str, int, str]]:
    """Return file, line number and line of the user's code that led to an error, the outermost first."""
    frames = traceback.extract_tb(error.__traceback__)
    places = [(each.filename, each.lineno or 1, each.line or "") for each in frames if _is_users(each.filename)]
    if isinstance(error, SyntaxError) and error.filename:
        places.append((error.filename, error.lineno or 1, error.text or ""))
    return places


def _is_users(file: str) -> bool:
    # What a compiler has made is of no file: <string>, (tree fragment).
    if file.startswith(("<", "(")):
        return False
    # Compiled modules name their sources from the folder of the packages.
    path = (_BENCH.parent / file).resolve()
    if path.is_relative_to(_EXAMPLES):
        return True
    return not any(path.is_relative_to(folder) for folder in (_BENCH, _VEHICLE, *_LIBRARIES))
