"""The clearance between bodies against cases worked out by hand, and against a search over their outlines."""

import math

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from bench.bodies import clearance, clearance_of
from platoon_fmu.parameters import BODY

QUARTER = math.pi / 2.0
# Half the diagonal of the body.
REACH = 0.5 * math.hypot(BODY.length, BODY.width)


def between(dx, dy, psi_one=0.0, psi_other=0.0):
    one, other = np.array([psi_one]), np.array([psi_other])
    return float(clearance(np.array([dx]), np.array([dy]), one, other)[0])


@pytest.mark.parametrize(
    ("pose", "expected"),
    [
        ((10.0, 0.0), 5.5),
        ((0.0, 3.5), 1.7),
        ((-7.5, 4.8), math.hypot(3.0, 3.0)),
        ((4.5, 0.5), 0.0),
        ((4.0, 0.5), -0.5),
        ((1.0, 1.5), -0.3),
        ((0.0, 0.0), -1.8),
        # The other across the road ahead: half a length and half a width apart.
        ((5.0, 0.0, 0.0, QUARTER), 5.0 - 2.25 - 0.9),
        # The same seen with both turned to the left.
        ((0.0, 10.0, QUARTER, QUARTER), 5.5),
        # A corner of the other points at the side of the one.
        ((0.0, 5.0, 0.0, math.atan2(4.5, 1.8)), 5.0 - 0.9 - REACH),
    ],
)
def test_the_clearance_of_poses_worked_out_by_hand(pose, expected):
    assert between(*pose) == pytest.approx(expected, abs=1e-12)


def test_of_two_poses_it_is_that_of_the_one_relative_to_the_other():
    assert clearance_of((100.0, -3.0, QUARTER), (100.0, 7.0, QUARTER)) == pytest.approx(10.0 - BODY.length)
    assert clearance_of((3.0, 1.0, 0.2), (-1.0, 2.0, -0.4)) == between(-4.0, 1.0, 0.2, -0.4)


def outline(X, Y, psi, points=400):
    """Points of a body's outline, (4 points, 2)."""
    share = np.linspace(-0.5, 0.5, points)
    x = BODY.length * np.concatenate([share, share, np.full(points, 0.5), np.full(points, -0.5)])
    y = BODY.width * np.concatenate([np.full(points, 0.5), np.full(points, -0.5), share, share])
    c, s = math.cos(psi), math.sin(psi)
    return np.stack([X + c * x - s * y, Y + s * x + c * y], axis=1)


@given(st.floats(-12.0, 12.0), st.floats(-8.0, 8.0), st.floats(-math.pi, math.pi), st.floats(-math.pi, math.pi))
def test_the_clearance_of_any_poses_is_that_of_their_outlines(dx, dy, psi, psi_other):
    one, other = outline(0.0, 0.0, psi, 60), outline(dx, dy, psi_other, 60)
    nearest = float(np.hypot(*(one[:, None, :] - other[None, :, :]).transpose(2, 0, 1)).min())
    found = between(dx, dy, psi, psi_other)
    step = BODY.length / 59
    if found >= 0.0:
        assert nearest - step <= found <= nearest + 1e-9
    else:
        # Moved apart by the depth along some direction, they touch; by less, along no direction.
        assert found >= -(BODY.length + BODY.width)
        ways = np.linspace(0.0, 2.0 * math.pi, 361)
        deep = np.full_like(ways, psi)
        moved = clearance(
            dx - 1.01 * found * np.cos(ways), dy - 1.01 * found * np.sin(ways), deep, np.full_like(ways, psi_other)
        )
        less = clearance(
            dx - 0.99 * found * np.cos(ways), dy - 0.99 * found * np.sin(ways), deep, np.full_like(ways, psi_other)
        )
        assert moved.max() > -1e-3
        assert less.max() <= 1e-12


@given(st.floats(-9.0, 9.0), st.floats(-6.0, 6.0), st.floats(-3.0, 3.0), st.floats(-3.0, 3.0))
def test_neither_who_is_asked_nor_where_the_road_leads_changes_it(dx, dy, psi, psi_other):
    found = between(dx, dy, psi, psi_other)
    assert between(-dx, -dy, psi_other, psi) == pytest.approx(found, abs=1e-9)
    c, s = math.cos(0.7), math.sin(0.7)
    assert between(c * dx - s * dy, s * dx + c * dy, psi + 0.7, psi_other + 0.7) == pytest.approx(found, abs=1e-9)
