"""Flat protobuf messages whose records differ only in the values.

Protobuf lets a field be of fixed width (double, float, fixed32, ...), and a message may carry every field, in order,
even if its value is the default. Records of such a message have one layout, so that numpy can write and read thousands
of them at once, while any protobuf library can still read them. An enumeration below 128 is a varint of one byte.
Encoding: https://protobuf.dev/programming-guides/encoding/
"""

from __future__ import annotations

import re
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from functools import cached_property, lru_cache
from typing import Any, Literal

import numpy as np
import numpy.typing as npt
from google.protobuf import descriptor_pb2, descriptor_pool, message_factory
from google.protobuf.message import DecodeError, Message

Kind = Literal["double", "float", "fixed32", "sfixed32", "fixed64", "sfixed64", "enum"]

_WIRE_VARINT, _WIRE_64, _WIRE_32 = 0, 1, 5
_PROTO = descriptor_pb2.FieldDescriptorProto
# kind -> (numpy type of the value's bytes, wire type, descriptor type)
_KINDS: dict[Kind, tuple[str, int, int]] = {
    "double": ("<f8", _WIRE_64, _PROTO.TYPE_DOUBLE),
    "float": ("<f4", _WIRE_32, _PROTO.TYPE_FLOAT),
    "fixed32": ("<u4", _WIRE_32, _PROTO.TYPE_FIXED32),
    "sfixed32": ("<i4", _WIRE_32, _PROTO.TYPE_SFIXED32),
    "fixed64": ("<u8", _WIRE_64, _PROTO.TYPE_FIXED64),
    "sfixed64": ("<i8", _WIRE_64, _PROTO.TYPE_SFIXED64),
    "enum": ("u1", _WIRE_VARINT, _PROTO.TYPE_ENUM),
}
_KIND_OF_TYPE: dict[int, Kind] = {proto_type: kind for kind, (_, _, proto_type) in _KINDS.items()}


@dataclass(frozen=True)
class Field:
    """One field of a flat message.

    Attributes:
        name: field name, an identifier.
        kind: how the value is encoded.
        unit: physical unit, empty for none.
        comment: description of the value.
        names: the value table of an `enum`, value -> name; values 0..127.
    """

    name: str
    kind: Kind
    unit: str = ""
    comment: str = ""
    names: Mapping[int, str] = field(default_factory=dict)


def varint(value: int) -> bytes:
    """Return a non-negative integer as a protobuf varint."""
    out = bytearray()
    while value > 0x7F:
        out.append(value & 0x7F | 0x80)
        value >>= 7
    out.append(value)
    return bytes(out)


def tag(number: int, wire_type: int) -> bytes:
    """Return the bytes that open field `number` on the wire."""
    return varint(number << 3 | wire_type)


class Layout:
    """The bytes of a flat message: field i has protobuf number i + 1.

    Attributes:
        fields: the fields, in wire order.
        dtype: packed numpy type of one encoded record; value fields under their names, tag bytes under `#i`.
        template: one encoded record with all values zero.
    """

    def __init__(self, fields: Sequence[Field]) -> None:
        """Lay out `fields` in their order."""
        self.fields = tuple(fields)
        columns: list[tuple[str, str]] = []
        template = bytearray()
        for index, item in enumerate(self.fields):
            value_type, wire_type, _ = _KINDS[item.kind]
            opening = tag(index + 1, wire_type)
            columns += [(f"#{index}", f"V{len(opening)}"), (item.name, value_type)]
            template += opening + bytes(np.dtype(value_type).itemsize)
        self.dtype = np.dtype(columns)
        self.template = bytes(template)

    @classmethod
    def of(cls, kind: type[Message]) -> Layout | None:
        """Return the layout of a message read from a file, or None if it is not flat and of fixed width."""
        fields = []
        found: list[Any] = sorted(kind.DESCRIPTOR.fields, key=lambda f: f.number)
        for number, item in enumerate(found, start=1):
            encoding = _KIND_OF_TYPE.get(item.type)
            if encoding is None or item.is_repeated or item.number != number:
                return None
            fields.append(Field(item.name, encoding, names=_names(item)))
        return cls(fields)

    def offset(self, name: str) -> int:
        """Return where in a record the value of field `name` starts, in bytes."""
        return int(self.dtype.fields[name][1])  # type: ignore[index]

    def view(self, records: npt.NDArray[np.uint8]) -> npt.NDArray[Any] | None:
        """Return encoded records, shape (n, dtype.itemsize), as a structured array (n,).

        None if a tag is not where this layout has it: then another writer created them and they must be parsed.
        """
        if records.shape[1] != self.dtype.itemsize:
            return None
        template = np.frombuffer(self.template, np.uint8)
        for index, item in enumerate(self.fields):
            start, end = self.offset(f"#{index}"), self.offset(item.name)
            if (records[:, start:end] != template[start:end]).any():
                return None
            if item.kind == "enum" and (records[:, end] > 0x7F).any():
                return None
        return np.ascontiguousarray(records).view(self.dtype).reshape(-1)

    @cached_property
    def values(self) -> tuple[str, ...]:
        """The names of the fields."""
        return tuple(item.name for item in self.fields)


def _names(item: Any) -> dict[int, str]:
    return {value.number: value.name for value in item.enum_type.values} if item.enum_type else {}


def identifier(text: str) -> str:
    """Return `text` with all characters not allowed in a protobuf name replaced by `_`."""
    name = re.sub(r"\W", "_", text, flags=re.ASCII)
    return name if name[:1].isalpha() else f"_{name}"


def file_descriptor_set(full_name: str, layout: Layout, comment: str = "") -> bytes:
    """Return the serialised FileDescriptorSet that describes `layout` as the proto3 message `full_name`.

    Units and comments go in as leading comments, as protoc would keep them. Each value table becomes an enumeration in
    a separate message scope, because protobuf requires unique value names within the enclosing scope.
    """
    package, _, name = full_name.rpartition(".")
    file = descriptor_pb2.FileDescriptorProto(name=f"{full_name}.proto", package=package, syntax="proto3")
    message = file.message_type.add(name=name)
    _comment(file, [4, 0], comment)
    for index, item in enumerate(layout.fields):
        made = message.field.add(name=item.name, number=index + 1, label=_PROTO.LABEL_OPTIONAL)
        made.type = _KINDS[item.kind][2]  # type: ignore[assignment]
        if item.kind == "enum":
            scope = f"{item.name}Values"
            _add_enum(message.nested_type.add(name=scope), item.names)
            made.type_name = f".{full_name}.{scope}.Enum"
        unit = f" [{item.unit}]" if item.unit else ""
        _comment(file, [4, 0, 2, index], f"{item.comment}{unit}".strip())
    return descriptor_pb2.FileDescriptorSet(file=[file]).SerializeToString()


def _comment(file: descriptor_pb2.FileDescriptorProto, path: list[int], text: str) -> None:
    if text:
        file.source_code_info.location.add(path=path, span=[0, 0, 0], leading_comments=text)


def _add_enum(scope: descriptor_pb2.DescriptorProto, names: Mapping[int, str]) -> None:
    enum = scope.enum_type.add(name="Enum")
    taken: set[str] = set()
    # proto3 requires the first value to be zero.
    for number, text in sorted({0: "Value0", **names}.items()):
        name = identifier(text)
        name = f"{name}_{number}" if name in taken else name
        taken.add(name)
        enum.value.add(name=name, number=number)


@lru_cache(maxsize=1024)
def message_class(full_name: str, descriptor_set: bytes) -> type[Message]:
    """Return the class that parses messages `full_name` of a serialised FileDescriptorSet.

    Raises:
        ValueError: the set does not parse or does not hold the message.
    """
    pool = descriptor_pool.DescriptorPool()
    try:
        waiting = {file.name: file for file in descriptor_pb2.FileDescriptorSet.FromString(descriptor_set).file}
        while waiting:
            ready = [f for f in waiting.values() if not any(name in waiting for name in f.dependency)]
            if not ready:
                raise ValueError(f"the schema of {full_name} depends on itself")
            for file in ready:
                pool.Add(waiting.pop(file.name))
        return message_factory.GetMessageClass(pool.FindMessageTypeByName(full_name))
    except (KeyError, TypeError, DecodeError) as error:
        raise ValueError(f"the schema of {full_name} cannot be read: {error}") from error
