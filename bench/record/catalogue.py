"""The signals of a log by name: `veh1.VehicleMotion.YawRate`, `truth.veh1.v_x`.

A name is a topic with dots for slashes, `signals` left out, and a field.
"""

from __future__ import annotations

import difflib
from collections.abc import Iterable, Sequence
from fnmatch import fnmatchcase
from pathlib import Path
from typing import NamedTuple

from bench.errors import BadInput
from bench.record.topic_decoder import TopicDecoder

_NEAR = 5


class Place(NamedTuple):
    """The place of a signal in the log."""

    topic: str
    field: str


def topic_name(topic: str) -> str:
    """Return a topic as written in the names of its signals."""
    return topic.removeprefix("/").removeprefix("signals/").replace("/", ".")


def check_text(**arguments: object) -> None:
    """Check that arguments (name -> value) are text.

    Raises:
        BadInput: one is not.
    """
    for argument, value in arguments.items():
        if not isinstance(value, str):
            raise BadInput(f"{argument} {value!r}: give a name as text, for example 'veh1.VehicleMotion.YawRate'")


class Catalogue:
    """All topics of a log that are tables of numbers."""

    def __init__(self, path: Path, decoders: Sequence[TopicDecoder], *, has_frames: bool) -> None:
        """Name the fields of these topics in their order.

        Args:
            path: the log.
            decoders: of the topics.
            has_frames: whether the log also has raw frames.
        """
        self._path = path
        self._has_frames = has_frames
        self._topics = {topic_name(decoder.topic): decoder.topic for decoder in decoders}
        self._places = {
            f"{name}.{field}": Place(decoder.topic, field)
            for name, decoder in zip(self._topics, decoders, strict=True)
            for field in decoder.names
        }

    def matching(self, pattern: str) -> list[str]:
        """Return the names that match a pattern, in which `*` and `?` are wild."""
        return [name for name in self._places if fnmatchcase(name, pattern)]

    def chosen(self, patterns: str | Sequence[str]) -> dict[str, Place]:
        """Return the signals of some names or patterns, each once, in that order.

        Raises:
            BadInput: there is no such signal, or no name is given.
        """
        if not isinstance(patterns, Iterable):
            check_text(names=patterns)
        asked = [patterns] if isinstance(patterns, str) else list(patterns)
        found: dict[str, Place] = {}
        for pattern in asked:
            check_text(names=pattern)
            names = [pattern] if pattern in self._places else self.matching(pattern)
            if not names:
                raise self._unknown("signal", pattern, list(self._places))
            found.update((name, self._places[name]) for name in names)
        if not found:
            raise BadInput("no signal was asked for; name some, for example veh1.VehicleMotion.YawRate")
        return found

    def place(self, name: str) -> Place:
        """Return the place of the signal of this name.

        Raises:
            BadInput: there is no such signal.
        """
        if name not in self._places:
            raise self._unknown("signal", name, list(self._places))
        return self._places[name]

    def topic(self, name: str) -> str:
        """Return the topic of a message, `veh1.VehicleMotion`, or of the truth, `truth.veh1`.

        Raises:
            BadInput: there is no such message.
        """
        if name not in self._topics:
            raise self._unknown("message", name, list(self._topics))
        return self._topics[name]

    def _unknown(self, what: str, name: str, known: Sequence[str]) -> BadInput:
        if not known:
            frames = "raw frames only; platoon log import decodes frames of other tools' logs with --dbc"
            return BadInput(f"{self._path} has no {what} {name!r}: it holds {frames if self._has_frames else 'none'}")
        by_lower = {each.lower(): each for each in known}
        near = [by_lower[each] for each in difflib.get_close_matches(name.lower(), by_lower, _NEAR)]
        # A name without its bus, for example, is not similar to any complete name.
        near += [each for each in known if name.lower().strip("*.") in each.lower() and each not in near]
        if near:
            mend = f"near are {', '.join(near[:_NEAR])}"
        else:
            mend = f"it has {len(known)}, among them {', '.join(known[:_NEAR])}"
        return BadInput(f"{self._path} has no {what} {name!r}; {mend}; platoon log signals lists all")
