"""Slowing down in the lane, for a vehicle that can no longer take part in the platoon."""

import math

COURSE_RATE = 1.0
"""Rate at which the course is reduced to zero (1/s)."""

LATERAL_ACCELERATION = 2.0
"""Largest lateral acceleration (m/s^2), possible even on ice (adhesion 0.2)."""

YAW_ACCELERATION = 1.5
"""Largest change of the yaw rate (rad/s^2)."""


def slow_down(
    v: float, gamma: float, course: float, braking: float, crawl: float, step_s: float
) -> tuple[float, float]:
    """Return the next reference (m/s, rad/s): along the road, with the speed falling to a crawl.

    Args:
        v: this cycle's reference speed (m/s).
        gamma: this cycle's reference yaw rate (rad/s).
        course: direction of motion relative to the road (rad).
        braking: deceleration (m/s^2).
        crawl: final speed (m/s); a slower vehicle keeps its speed.
        step_s: cycle time T (s).
    """
    v_next = max(v - braking * step_s, min(v, crawl))
    largest = LATERAL_ACCELERATION / max(v_next, 1.0)
    wanted = min(max(-COURSE_RATE * math.remainder(course, 2.0 * math.pi), -largest), largest)
    change = YAW_ACCELERATION * step_s
    return v_next, gamma + min(max(wanted - gamma, -change), change)
