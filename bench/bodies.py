"""The bodies of vehicles seen from above, oriented rectangles, and the clearance between two of them."""

import numpy as np
import numpy.typing as npt

from platoon_fmu.parameters import BODY

Array = npt.NDArray[np.float64]

_HALF_LENGTH, _HALF_WIDTH = 0.5 * BODY.length, 0.5 * BODY.width
_CORNERS_X = np.array([[1.0], [-1.0], [-1.0], [1.0]]) * _HALF_LENGTH
_CORNERS_Y = np.array([[1.0], [1.0], [-1.0], [-1.0]]) * _HALF_WIDTH


Pose = tuple[float, float, float]
"""Position of a centre of mass, X and Y in the road frame (m), and yaw angle (rad)."""


def clearance_of(one: Pose, other: Pose) -> float:
    """Return the distance between two bodies, m, as `clearance` does."""
    dx, dy = ([theirs - own] for own, theirs in zip(one[:2], other[:2], strict=True))
    arrays = (np.array(values) for values in (dx, dy, [one[2]], [other[2]]))
    return float(clearance(*arrays)[0])


def clearance(dx: Array, dy: Array, psi_one: Array, psi_other: Array) -> Array:
    """Return the distance between two bodies at n times, (n,), m.

    Where they overlap it is negative: minus the depth, the shortest way that parts them (separating axis theorem).

    Args:
        dx: (n,) position of the other centre of mass relative to the one's along the road, m.
        dy: (n,) the same to the left, m.
        psi_one: (n,) yaw angle of the one, rad.
        psi_other: (n,) yaw angle of the other, rad.
    """
    seen_by_one = _corners_seen(dx, dy, psi_one, psi_other)
    seen_by_other = _corners_seen(-dx, -dy, psi_other, psi_one)
    parted = np.maximum(_parted(*seen_by_one), _parted(*seen_by_other))
    # The nearest points of two separate convex polygons include a corner of one of them.
    between = np.minimum(_to_body(*seen_by_one), _to_body(*seen_by_other))
    signed: Array = np.where(parted < 0.0, parted, between)
    return signed


def _corners_seen(dx: Array, dy: Array, psi: Array, psi_other: Array) -> tuple[Array, Array]:
    """Return the corners of a body at (dx, dy) in the frame of one with yaw angle psi, (4, n) ahead and to the left."""
    c, s = np.cos(psi), np.sin(psi)
    turned_c, turned_s = np.cos(psi_other - psi), np.sin(psi_other - psi)
    ahead = c * dx + s * dy + turned_c * _CORNERS_X - turned_s * _CORNERS_Y
    left = c * dy - s * dx + turned_s * _CORNERS_X + turned_c * _CORNERS_Y
    return ahead, left


def _parted(ahead: Array, left: Array) -> Array:
    """Return how far corners are parted from the own body along its axes, (n,), m; negative where both overlap."""
    along = np.maximum(ahead.min(axis=0), -ahead.max(axis=0)) - _HALF_LENGTH
    across = np.maximum(left.min(axis=0), -left.max(axis=0)) - _HALF_WIDTH
    least: Array = np.maximum(along, across)
    return least


def _to_body(ahead: Array, left: Array) -> Array:
    """Return the distance of the nearest corner from the own body, (n,), m."""
    out_ahead = np.maximum(np.abs(ahead) - _HALF_LENGTH, 0.0)
    out_left = np.maximum(np.abs(left) - _HALF_WIDTH, 0.0)
    nearest: Array = np.hypot(out_ahead, out_left).min(axis=0)
    return nearest
