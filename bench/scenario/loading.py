"""Reads a scenario from TOML, a shipped one, a random one or a file, and applies command-line overrides."""

import json
import re
import tomllib
from collections.abc import Sequence
from pathlib import Path
from typing import Any, TypeVar

from pydantic import BaseModel, ValidationError

from bench.errors import BadInput
from bench.faults.former import renewed
from bench.scenario.errors import Source, closest, explain
from bench.scenario.families import is_random, random_text
from bench.scenario.model import FROM_LOG, LONGEST_DESCRIPTION, Scenario
from bench.scenario.overrides import put

_Model = TypeVar("_Model", bound=BaseModel)

SCENARIO_DIR = Path(__file__).parent / "shipped"

MOST_BYTES = 2 * 1024 * 1024
"""Limit on the size of a scenario's file; a thousand faults take a twentieth of it."""

LONGEST_LINE = 20_000
"""Characters of a line: the reader's work grows with the square of the number of parts of a key."""


def shipped() -> list[str]:
    """Return the names of the shipped scenarios."""
    return sorted(path.stem for path in SCENARIO_DIR.glob("*.toml"))


def load(name_or_path: str | Path, overrides: Sequence[str] = (), seed: int | None = None) -> Scenario:
    """Return a validated scenario.

    Args:
        name_or_path: the name of a shipped scenario, `random:SEED`, `random-fault:SEED`, or a TOML file.
        overrides: `KEY=VALUE` each, with a dotted KEY (`vehicles.0.x_m`, `vehicles[0].x_m`) and a TOML VALUE.
        seed: replaces the scenario's seed.

    Raises:
        BadInput: one message with all errors: key, line, value, allowed range and remedy.
    """
    if is_random(str(name_or_path)):
        where, text = str(name_or_path), random_text(str(name_or_path))
        document = tomllib.loads(text)
    else:
        path = _find(name_or_path)
        where, (text, document) = str(path), read_toml(path)
        document.setdefault("name", name_from(path))
    given: dict[tuple[str | int, ...], str] = {}
    for override in overrides:
        given[put(document, override)] = f"--set {override}"
    if seed is not None:
        document["seed"] = seed
        given["seed",] = f"--seed {seed}"
    return validated(Scenario, Source(where, text, document, given))


def validated(model: type[_Model], source: Source) -> _Model:
    """Return a document as what it describes.

    Raises:
        BadInput: one message with all errors.
    """
    noun = source.noun
    try:
        # From JSON, because only then strict validation accepts lists as tuples and tables as dataclasses.
        return model.model_validate_json(json.dumps(source.document, default=str))
    except RecursionError:
        raise BadInput(
            f"{noun.capitalize()} {source.name} is nested too deeply; a {noun}'s keys have at most four parts"
        ) from None
    except ValidationError as error:
        raise BadInput(explain(error, source, model.model_json_schema())) from error


def from_log(text: str) -> Scenario:
    """Return the scenario attached to a log as TOML, possibly written by an earlier version.

    Raises:
        ValueError: it cannot be read.
    """
    if len(text) > MOST_BYTES:
        raise ValueError(f"it has {len(text)} characters; at most {MOST_BYTES} are read")
    try:
        return _from_log(tomllib.loads(text))
    except RecursionError:
        raise ValueError("it is nested too deeply") from None


def _from_log(document: dict[str, Any]) -> Scenario:
    if isinstance(document.get("description"), str):
        # Earlier versions had no limit.
        document["description"] = document["description"][:LONGEST_DESCRIPTION]
    faults = document.get("faults")
    if isinstance(faults, list):
        document["faults"] = [renewed(fault) if isinstance(fault, dict) else fault for fault in faults]
    return Scenario.model_validate_json(json.dumps(document, default=str), context=FROM_LOG)


def _find(name_or_path: str | Path) -> Path:
    name = str(name_or_path)
    if name in shipped():
        return SCENARIO_DIR / f"{name}.toml"
    path = Path(name_or_path)
    if path.is_file():
        return path
    if path.is_dir():
        raise BadInput(f"Scenario {name!r} is a directory; give a file or one of {', '.join(shipped())}.")
    near = closest(name, shipped())
    meant = f" Did you mean {near}?" if near else ""
    raise BadInput(f"No scenario {name!r}: not a file; shipped scenarios are {', '.join(shipped())}.{meant}")


def name_from(path: Path) -> str:
    """Return the name of a scenario, or of another document, whose file gives it none."""
    return re.sub(r"[^A-Za-z0-9_.-]", "-", path.stem)[:64].lstrip("_.-") or "scenario"


def read_toml(path: Path, noun: str = "scenario") -> tuple[str, dict[str, Any]]:
    """Return the text of a TOML file and the document in it; `noun` is what the file holds, for messages.

    Raises:
        BadInput: not readable, not TOML, or too large.
    """
    try:
        size = path.stat().st_size
        if size > MOST_BYTES:
            raise BadInput(f"{path} has {size} bytes; a {noun}'s file may have at most {MOST_BYTES}")
        text = path.read_text(encoding="utf-8")
        longest, line = max((len(line), number) for number, line in enumerate(("", *text.split("\n"))))
        if longest > LONGEST_LINE:
            raise BadInput(f"{path}: line {line} has {longest} characters; allowed: at most {LONGEST_LINE}")
        return text, tomllib.loads(text)
    except OSError as error:
        raise BadInput(f"Cannot read the {noun} {path}: {error.strerror}.") from error
    except UnicodeDecodeError as error:
        raise BadInput(f"{path} is not TOML: not UTF-8 text (byte {error.start}).") from error
    except (
        ValueError,
        RecursionError,
    ) as error:  # errors of the reader, and numbers with thousands of digits
        raise BadInput(f"{path} is not TOML: {error}.") from error
