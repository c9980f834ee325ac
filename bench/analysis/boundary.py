"""The stability boundary of the paper's equation (29): |gamma| <= 0.85 mu g / v_x."""

from __future__ import annotations

import numpy as np
import numpy.typing as npt

# From the paper's boundary equation and Table 1. Repeated here so that a log is judged by the paper, independently of
# the controllers' code.
YAW_SHARE = 0.85
GRAVITY = 9.8

Array = npt.NDArray[np.float64]


def yaw_rate_max(v_x: Array, mu: Array | float) -> Array:
    """Return the largest stable yaw rate, rad/s, at speeds `v_x` (n,) in m/s on adhesion `mu`, (n,) or scalar."""
    limit: Array = YAW_SHARE * mu * GRAVITY / np.maximum(v_x, 1e-6)
    return limit


def margin(gamma: Array, v_x: Array, mu: Array | float) -> Array:
    """Return 1 - |gamma| / gamma_max, dimensionless (n,): 1 going straight, 0 on the boundary, negative outside.

    Not finite at zero adhesion, which occurs only in a damaged log.
    """
    with np.errstate(divide="ignore", invalid="ignore"):
        return 1.0 - np.abs(gamma) / yaw_rate_max(v_x, mu)
