# cython: boundscheck=False, cdivision=True
"""What a vehicle may do beside others: accelerate behind those in its corridor, and change to the platoon's lane.

A vehicle's corridor is what its body covers across the road until it rests there: its own lane, or from when it changes
all from there to the platoon's lane. Two rules keep vehicles apart (docs/safety.md has the argument):

1. Whoever is behind another one in its corridor keeps `Separation.excess` positive.
2. Nobody begins a lane change before the excess to everyone in the new corridor is positive, at rest or nearly so. To
   those with a slot further ahead the platoon's lane counts as taken, since they may begin at any time; those further
   behind wait for this vehicle in turn. So two never begin at the same time without room for both, and the foremost
   who still waits only waits for vehicles that do not wait for it.
"""

from collections.abc import Collection, Mapping
from typing import NamedTuple

import cython

if cython.compiled:
    from cython.cimports.bench.control.separation import Separation
else:
    from bench.control.separation import Separation

ACCELERATION_SHARE = 0.1
"""Fraction of a new difference of speeds that goes into the estimated acceleration of another vehicle, every cycle."""

GENTLY = 0.7
"""Largest braking (m/s^2) beyond the present one that a lane change may ask of who is behind."""


class Place(NamedTuple):
    """Where a vehicle is and how fast.

    Attributes:
        X: position of the centre of mass along the road, m.
        Y: position to the left, m.
        v_x: velocity along the road, m/s.
    """

    X: float
    Y: float
    v_x: float


class RightOfWay:
    """The rules for one vehicle.

    Args:
        separation: the distance to keep.
        lane_y: the platoon's lane, m.
        braking: largest comfortable braking and acceleration, m/s^2.
        step_s: T, s.
    """

    def __init__(self, separation: Separation, lane_y: float, braking: float, step_s: float) -> None:
        self._separation = separation
        self._lane_y = lane_y
        self._braking = braking
        self._step_s = step_s
        self._others: Mapping[int, Place] = {}
        self._staying: Collection[int] = ()
        self._unheard: Collection[int] = ()
        self._accelerations: dict[int, float] = {}

    def hear(self, others: Mapping[int, Place], staying: Collection[int], unheard: Collection[int] = ()) -> None:
        """Take this cycle's places of the others by number.

        Args:
            others: their places, of unheard ones as assumed: the rearmost of those with a slot further ahead, the
                foremost of the others.
            staying: numbers of those that stay in their own lanes.
            unheard: numbers of those that are not heard, or not believed.
        """
        accelerations = {}
        for number, place in others.items():
            before = self._others.get(number)
            a = self._accelerations.get(number, 0.0)
            change = 0.0 if before is None else (place.v_x - before.v_x) / self._step_s - a
            accelerations[number] = a + ACCELERATION_SHARE * change
        self._others, self._staying, self._accelerations = others, staying, accelerations
        self._unheard = unheard

    def most(self, own: Place, *, changing: bool) -> float:
        """Return the largest acceleration (m/s^2) with which the vehicle keeps clear of those ahead in its corridor.

        It asks for more than comfortable braking only where that does not keep the clearance; for as much as does.

        Args:
            own: own place.
            changing: whether the own corridor reaches to the platoon's lane.
        """
        separation: Separation = self._separation
        most = 1e3
        for number, other in self._others.items():
            if other.X < own.X or not self._meets(own, other, changing, number not in self._staying):
                continue
            distance = other.X - own.X
            a_other = self._accelerations[number]
            a = separation.acceleration(distance, own.v_x, other.v_x, a_other)
            needed = separation.needed(distance, own.v_x, other.v_x, a_other)
            most = min(most, max(a, -max(self._braking, needed)))
        return most

    def least(self, own: Place, *, changing: bool) -> float:
        """Return the least acceleration (m/s^2) with which those behind keep clear by braking comfortably.

        Args:
            own: own place.
            changing: whether the own corridor reaches to the platoon's lane.
        """
        separation: Separation = self._separation
        least = -1e3
        for number, other in self._others.items():
            if other.X > own.X or not self._meets(own, other, changing, number not in self._staying):
                continue
            needed = separation.needed(own.X - other.X, other.v_x, own.v_x, 0.0)
            least = max(least, min(needed - self._braking, self._braking))
        return least

    def may_change(self, own: Place, a: float, ahead: Collection[int]) -> bool:
        """Return whether the vehicle may begin to change to the platoon's lane.

        Args:
            own: own place.
            a: own acceleration, m/s^2.
            ahead: numbers of the vehicles whose slot is further ahead.
        """
        separation: Separation = self._separation
        for number, other in self._others.items():
            if not self._meets(own, other, True, number in ahead or number not in self._staying):
                continue
            if number in self._unheard and (number in ahead) != (other.X > own.X):
                # It may be anywhere from there to beside this vehicle.
                return False
            a_other = self._accelerations[number]
            behind, before, a_behind, a_before = (
                (other, own, a_other, a) if other.X < own.X else (own, other, a, a_other)
            )
            distance = before.X - behind.X
            allowed = separation.acceleration(distance, behind.v_x, before.v_x, a_before)
            if separation.excess(distance, behind.v_x, before.v_x) < 0.0 or allowed < min(a_behind, 0.0) - GENTLY:
                return False
        return True

    def _meets(self, own: Place, other: Place, own_changes: bool, other_changes: bool) -> bool:
        lane_y = self._lane_y
        separation: Separation = self._separation
        own_end, other_end = lane_y if own_changes else own.Y, lane_y if other_changes else other.Y
        return bool(separation.meet(own.Y, own_end, other.Y, other_end))
