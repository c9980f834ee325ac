"""A custom tracker: platoon run --ecu tracker=bench/examples/single_track.py:SingleTrack."""

from bench.ecu import Command, Motion, Reference, TrackerBase


class SingleTrack(TrackerBase):
    """Steers by the linear single-track model in steady cornering, plus proportional feedback."""

    def control(self, motion: Motion, reference: Reference) -> Command:
        """Return steering angle (rad) and torque on each wheel (N m)."""
        v_x = max(1.0, motion.v_x)
        steady = (3.0 / v_x + 0.0027 * v_x) * reference.yaw_rate
        steering_angle = steady + 0.3 * (reference.yaw_rate - motion.yaw_rate)
        return Command.evenly(646.13 * (reference.v_x - motion.v_x), steering_angle)
