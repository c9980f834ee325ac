"""Events in the log: `platoon.Event`, complete, on a separate topic.

So `/events` keeps Foxglove's schema, and a program needs to read only one topic. Older logs have only `/events`.
"""

from __future__ import annotations

import json
from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

from google.protobuf import descriptor_pb2

from bench import events
from bench.mcap.container import storable
from bench.record import foxglove
from bench.record.layout import message_class
from bench.record.old_events import kind_and_fields

TOPIC, OLD_TOPIC = "/events/data", "/events"
NAME = "platoon.Event"

_FIELDS = {
    "kind": "what has happened: state_change, fault_begins ...",
    "level": "debug, info, warning, error or fatal",
    "source": "who says so",
    "text": "the event in words, for people",
    "fields": "what events of this kind have beside, by name: a JSON object",
}


@dataclass(frozen=True, slots=True)
class Event:
    """An event of a run.

    Attributes:
        time_s: simulated time in s.
        level: severity, one of `bench.events.Level`.
        source: source of the event.
        text: text for people.
        kind: kind of the event, see `bench.events`.
        fields: further fields of this kind, by name.
    """

    time_s: float
    level: str
    source: str
    text: str
    kind: str
    fields: Mapping[str, Any]


def _schema() -> bytes:
    kind = descriptor_pb2.FieldDescriptorProto
    file = descriptor_pb2.FileDescriptorProto(name=f"{NAME}.proto", package="platoon", syntax="proto3")
    message = file.message_type.add(name=NAME.rpartition(".")[2])
    for index, (name, comment) in enumerate(_FIELDS.items()):
        message.field.add(name=name, number=index + 1, label=kind.LABEL_OPTIONAL, type=kind.TYPE_STRING)
        file.source_code_info.location.add(path=[4, 0, 2, index], span=[0, 0, 0], leading_comments=comment)
    return descriptor_pb2.FileDescriptorSet(file=[file]).SerializeToString()


SCHEMA = _schema()
_Message = message_class(NAME, SCHEMA)


def encoded(event: events.Event) -> bytes:
    """Return an event as a message.

    Raises:
        ValueError: its fields are not JSON values.
    """
    fields = json.dumps(event.fields, ensure_ascii=False, allow_nan=False)
    values = {"kind": event.kind, "level": event.level, "source": event.source, "text": event.text, "fields": fields}
    return _Message(**{key: storable(text) for key, text in values.items()}).SerializeToString()


def read(time_s: float, message: Any) -> Event:
    """Return the event in a message of `TOPIC`.

    Raises:
        ValueError: its fields are not a JSON object.
        AttributeError: it is not a `platoon.Event`.
    """
    fields = json.loads(message.fields)
    if not isinstance(fields, dict):
        raise ValueError(f"the fields of an event are {message.fields!r}, not a JSON object")
    return Event(time_s, message.level, message.source, message.text, message.kind, fields)


def read_old(time_s: float, log: Any) -> Event:
    """Return the event in a message of `OLD_TOPIC`, in a log without `TOPIC`.

    Raises:
        AttributeError: it is not a `foxglove.Log`.
    """
    level = foxglove.LEVEL_NAMES.get(log.level, "info")
    return Event(time_s, level, log.name, log.message, *kind_and_fields(level, log.name, log.message))
