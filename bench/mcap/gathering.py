"""Bytes from many places at once."""

from __future__ import annotations

from typing import Any

import numpy as np
import numpy.typing as npt


def gathered(data: npt.NDArray[np.uint8], offsets: npt.NDArray[np.int64], size: int) -> npt.NDArray[np.uint8]:
    """Return the `size` bytes of `data` from each of the offsets (n,) on, (n, size).

    Raises:
        IndexError: an offset is not so far before the end.
    """
    # An element of this many bytes begins at each place; numpy copies them as wholes.
    windows: npt.NDArray[Any] = np.ndarray((max(0, len(data) - size + 1),), f"V{size}", data, strides=(1,))
    return windows[offsets].view(np.uint8).reshape(len(offsets), size)
