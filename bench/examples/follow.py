"""A custom planner: platoon run --ecu planner=bench/examples/follow.py:Follow."""

from collections.abc import Mapping

from bench.ecu import Motion, Peer, PlannerBase, Pose, Reference

GAP_GAIN = 0.5  # 1/s
LANE_GAIN = 0.0125  # rad/s per m
COURSE_GAIN = 1.0  # 1/s


class Follow(PlannerBase):
    """Stays in its lane and keeps the platoon's gap to the next vehicle ahead, in any lane."""

    def plan(self, pose: Pose, motion: Motion, peers: Mapping[int, Peer]) -> Reference:
        """Return the platoon's speed, or the speed that closes the gap to the vehicle ahead."""
        platoon, start = self.scenario.platoon, self.scenario.vehicles[self.vehicle - 1]
        course = pose.yaw + motion.v_y / max(motion.v_x, 1.0)
        yaw_rate = LANE_GAIN * (start.y_m - pose.y) - COURSE_GAIN * course
        ahead = min((peer for peer in peers.values() if peer.x > pose.x), key=lambda peer: peer.x, default=None)
        if ahead is None:
            return Reference(platoon.speed_mps, yaw_rate)
        return Reference(max(0.0, ahead.speed + GAP_GAIN * (ahead.x - pose.x - platoon.gap_m)), yaw_rate)
