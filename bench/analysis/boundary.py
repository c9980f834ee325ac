"""The stability boundary of the paper's equation (29): |gamma| <= 0.85 mu g / v_x."""

from __future__ import annotations

import numpy as np
import numpy.typing as npt

# From the boundary's equation in the paper and Table 1. Written here once more, so that a log is judged by the paper
# and not by the controllers' own code.
YAW_SHARE = 0.85
GRAVITY = 9.8

Array = npt.NDArray[np.float64]


def yaw_rate_max(v_x: Array, mu: Array | float) -> Array:
    """Return the largest stable yaw rate, rad/s, at speeds `v_x` (n,) in m/s on adhesion `mu`, (n,) or one."""
    limit: Array = YAW_SHARE * mu * GRAVITY / np.maximum(v_x, 1e-6)
    return limit


def margin(gamma: Array, v_x: Array, mu: Array | float) -> Array:
    """Return 1 - |gamma| / gamma_max, dimensionless (n,): 1 going straight, 0 on the boundary, negative outside.

    Without any adhesion, which only a damaged log has, it is no finite number.
    """
    with np.errstate(divide="ignore", invalid="ignore"):
        return 1.0 - np.abs(gamma) / yaw_rate_max(v_x, mu)
