"""The values of one topic, by name."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import numpy as np
import numpy.typing as npt

from bench.errors import BadInput
from bench.mcap.time_span import Span
from bench.record.time_join import whole_ns


class Columns(dict[str, npt.NDArray[Any]]):
    """The values of a topic by name, each (n,), and `t`, the time in s.

    Access to a value that the topic does not have raises BadInput: the log is not as expected.
    """

    def __init__(self, where: str, values: Mapping[str, npt.NDArray[Any]]) -> None:
        super().__init__(values)
        self._where = where

    @property
    def nbytes(self) -> int:
        """Memory used by the values, bytes."""
        return sum(values.nbytes for values in self.values())

    @property
    def time_ns(self) -> npt.NDArray[np.int64]:
        """The time in whole ns, as in the log (n,)."""
        return whole_ns(self["t"])

    def select(self, rows: npt.NDArray[Any]) -> Columns:
        """Return these rows of all values."""
        return Columns(self._where, {name: values[rows] for name, values in self.items()})

    def within(self, span: Span) -> Columns:
        """Return the rows whose time is in `span`."""
        return self.select(span.holds(self.time_ns))

    def __missing__(self, name: str) -> npt.NDArray[Any]:
        """Raise BadInput for a value that the topic does not have."""
        raise BadInput(f"{self._where} has no {name!r}; it has {', '.join(key for key in self if key != 't')}")
