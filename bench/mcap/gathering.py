"""Bytes from and to many places at once."""

from __future__ import annotations

from typing import Any

import numpy as np
import numpy.typing as npt


def gathered(data: npt.NDArray[np.uint8], offsets: npt.NDArray[np.int64], size: int) -> npt.NDArray[np.uint8]:
    """Return the `size` bytes of `data` from each of the offsets (n,) on, (n, size).

    Raises:
        IndexError: an offset is too close to the end.
    """
    return _windows(data, size)[offsets].view(np.uint8).reshape(len(offsets), size)


def scatter(data: npt.NDArray[np.uint8], offsets: npt.NDArray[np.int64], values: npt.NDArray[Any]) -> None:
    """Write the bytes of values (n,) to `data`, each from its offset (n,) on.

    Raises:
        IndexError: an offset is too close to the end.
    """
    size = values.dtype.itemsize
    _windows(data, size)[offsets] = np.ascontiguousarray(values).view(f"V{size}")


def _windows(data: npt.NDArray[np.uint8], size: int) -> npt.NDArray[Any]:
    """Return an element of this many bytes for each place in `data`; numpy copies them as wholes."""
    return np.ndarray((max(0, len(data) - size + 1),), f"V{size}", data, strides=(1,))
