"""Decodes the messages of one topic into columns, thousands at once if they are of fixed width."""

from __future__ import annotations

from functools import cached_property
from typing import Any

import numpy as np
import numpy.typing as npt
from google.protobuf import descriptor_pb2
from google.protobuf.descriptor import FieldDescriptor
from google.protobuf.message import DecodeError, Message
from mcap.records import Channel, Schema

from bench.errors import BadInput
from bench.mcap.blocks import Part
from bench.mcap.gathering import gathered
from bench.record.layout import Layout, message_class

_DTYPES = {
    FieldDescriptor.CPPTYPE_DOUBLE: "<f8",
    FieldDescriptor.CPPTYPE_FLOAT: "<f4",
    FieldDescriptor.CPPTYPE_INT32: "<i4",
    FieldDescriptor.CPPTYPE_UINT32: "<u4",
    FieldDescriptor.CPPTYPE_INT64: "<i8",
    FieldDescriptor.CPPTYPE_UINT64: "<u8",
    FieldDescriptor.CPPTYPE_BOOL: "?",
    FieldDescriptor.CPPTYPE_ENUM: "<i4",
}


class TopicDecoder:
    """The schema of a topic, and its messages as numbers.

    Attributes:
        topic: the topic.
        names: the fields that are numbers, in the order of the schema.
        labels: field with a value table -> value -> name.
        dtypes: field -> numpy type that holds all its values.
    """

    def __init__(self, where: str, channel: Channel, schema: Schema | None) -> None:
        """Read the schema of `channel`, in the log `where`.

        Raises:
            BadInput: there is no protobuf schema, or it cannot be read.
        """
        self.topic = channel.topic
        self._where = where
        if schema is None or schema.encoding != "protobuf":
            raise BadInput(f"{where}: topic {channel.topic} has no protobuf schema")
        self._schema = schema
        self._units = channel.metadata
        try:
            self._kind: type[Message] = message_class(schema.name, schema.data)
        except ValueError as error:
            raise BadInput(f"{where}: {error}") from error
        fields: list[Any] = list(self._kind.DESCRIPTOR.fields)
        numbers = [item for item in fields if not item.is_repeated and item.cpp_type in _DTYPES]
        self.names = tuple(item.name for item in numbers)
        self.labels = {
            item.name: {value.number: value.name for value in item.enum_type.values}
            for item in numbers
            if item.enum_type
        }
        self.dtypes = {item.name: np.dtype(_DTYPES[item.cpp_type]) for item in numbers}
        self._layout = Layout.of(self._kind)

    @property
    def is_table(self) -> bool:
        """Whether all fields are numbers."""
        return len(self.names) == len(self._kind.DESCRIPTOR.fields) > 0

    @cached_property
    def comments(self) -> dict[str, str]:
        """The schema's comment on each field that has one, without the unit."""
        file = descriptor_pb2.FileDescriptorSet.FromString(self._schema.data).file[-1]
        fields = file.message_type[0].field if file.message_type else []
        found = {}
        for location in file.source_code_info.location:
            # Field 2 (field) of field 4 (message_type) of a FileDescriptorProto, see descriptor.proto.
            if len(location.path) == 4 and list(location.path[:3]) == [4, 0, 2] and location.path[3] < len(fields):
                name = fields[location.path[3]].name
                # Text that is not UTF-8, as in a damaged log, is given as bytes.
                told: str | bytes = location.leading_comments
                text = (told if isinstance(told, str) else told.decode(errors="replace")).strip()
                found[name] = text.removesuffix(f"[{self.unit(name)}]").strip()
        return {name: text for name, text in found.items() if text}

    def unit(self, name: str) -> str:
        """Return the unit of a field, empty for none."""
        return str(self._units.get(f"unit {name}", ""))

    def columns(self, part: Part) -> dict[str, npt.NDArray[Any]]:
        """Return the values of messages by field, each (n,).

        Raises:
            BadInput: a message cannot be decoded.
        """
        flat = self._flat(part) if self._layout else None
        if flat is not None:
            # Copies, so that the complete messages are not kept in memory.
            return {name: flat[name].copy() for name in self.names}
        # Another writer used a different encoding.
        rows = [self.message(payload) for payload in part.payloads()]
        return {name: np.array([getattr(row, name) for row in rows], self.dtypes[name]) for name in self.names}

    def message(self, payload: bytes) -> Any:
        """Return one message, decoded by protobuf.

        Raises:
            BadInput: it cannot be decoded.
        """
        try:
            return self._kind.FromString(payload)
        except DecodeError as error:
            name = self._kind.DESCRIPTOR.full_name
            raise BadInput(f"{self._where}: a message {name} cannot be decoded: {error}") from error

    def _flat(self, part: Part) -> Any:
        """Return messages as a structured array (n,), None if they are not in the schema's layout."""
        if self._layout is None:
            return None
        size = self._layout.dtype.itemsize
        if (part.payload_size != size).any():
            return None
        return self._layout.view(gathered(part.data, part.payload_at, size))
