# cython: boundscheck=False, cdivision=True
"""The distance that keeps two vehicles apart whatever the one ahead does, and who may move where.

A follower that begins to brake a time rho after the one ahead, as hard as that, keeps a clearance c if the bodies are
`c + v_f rho + max(0, v_f^2 - v_l^2) / (2 b)` apart: the safe distance of responsibility-sensitive safety for equal
brakes (Shalev-Shwartz, Shammah, Shashua 2017). `excess` h is what the gap is longer. While the follower keeps
`dh/dt >= -kappa h`, h stays positive (a control barrier function, Ames et al. 2017); along one line its quadratic
program is the smaller of two accelerations.
"""

import cython

from platoon_fmu.parameters import BODY

_LENGTH = BODY.length
_HALF_WIDTH = 0.5 * BODY.width


@cython.cclass
class Separation:
    """The constants of the distance to keep.

    Args:
        clearance: c, m.
        response_s: rho, s.
        braking: b, at which every vehicle can brake and no planner brakes harder, m/s^2.
        rate: kappa, 1/s.
        aside: clearance between two corridors with which vehicles can be abreast, m.
    """

    def __init__(self, clearance: float, response_s: float, braking: float, rate: float, aside: float) -> None:
        self.clearance = clearance
        self.response_s = response_s
        self.braking = braking
        self.rate = rate
        self.aside = aside

    @cython.ccall
    @cython.exceptval(check=False)
    def excess(self, distance: cython.double, v_follower: cython.double, v_leader: cython.double) -> cython.double:
        """Return h (m) of two vehicles in one corridor.

        Args:
            distance: between centres of mass along the road, m.
            v_follower: speed of the one behind, m/s.
            v_leader: speed of the one ahead, m/s.
        """
        stopping: cython.double = (v_follower * v_follower - v_leader * v_leader) / (2.0 * self.braking)
        return distance - _LENGTH - self.clearance - v_follower * self.response_s - max(stopping, 0.0)

    @cython.ccall
    @cython.exceptval(check=False)
    def acceleration(
        self, distance: cython.double, v_follower: cython.double, v_leader: cython.double, a_leader: cython.double
    ) -> cython.double:
        """Return the largest acceleration (m/s^2) of the follower with which `dh/dt >= -kappa h`.

        Where the distance has been too short from the start, less braking is asked of a follower that is not faster:
        its gap does not shrink any more.

        Args:
            distance: between centres of mass along the road, m.
            v_follower: speed of the one behind, m/s.
            v_leader: speed of the one ahead, m/s.
            a_leader: acceleration of the one ahead, m/s^2.
        """
        room: cython.double = v_leader - v_follower + self.rate * self.excess(distance, v_follower, v_leader)
        if v_follower <= v_leader and room >= 0.0:
            return room / self.response_s
        return (room + v_leader * a_leader / self.braking) / (self.response_s + v_follower / self.braking)

    @cython.ccall
    @cython.exceptval(check=False)
    def needed(
        self, distance: cython.double, v_follower: cython.double, v_leader: cython.double, a_leader: cython.double
    ) -> cython.double:
        """Return the constant braking (m/s^2) of the follower that just keeps the clearance if the leader goes on so.

        It is 0 for a follower that is not faster, and at most the hardest braking.

        Args:
            distance: between centres of mass along the road, m.
            v_follower: speed of the one behind, m/s.
            v_leader: speed of the one ahead, m/s.
            a_leader: acceleration of the one ahead, m/s^2.
        """
        closing: cython.double = v_follower - v_leader
        if closing <= 0.0:
            return 0.0
        room: cython.double = distance - _LENGTH - self.clearance - closing * self.response_s
        if room <= 0.0:
            return self.braking
        return min(max(closing * closing / (2.0 * room) - a_leader, 0.0), self.braking)

    @cython.ccall
    @cython.exceptval(check=False)
    def meet(
        self, one_from: cython.double, one_to: cython.double, other_from: cython.double, other_to: cython.double
    ) -> cython.bint:
        """Return whether the corridors of two bodies that move across the road are too near for being abreast.

        Args:
            one_from: lateral position of the one's middle, m.
            one_to: where it comes to rest, m.
            other_from: the other's, m.
            other_to: m.
        """
        between: cython.double = max(
            min(one_from, one_to) - max(other_from, other_to), min(other_from, other_to) - max(one_from, one_to)
        )
        return between < 2.0 * _HALF_WIDTH + self.aside
