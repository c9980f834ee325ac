"""Controllers wrapped as ECUs: frames in, frames out.

One's own controller needs only what is here: `TrackerBase` or `PlannerBase`, and the quantities they take and give. A
class that is to see every frame itself has the members of `Ecu` instead.
"""

from bench.bus.quantities import Command, Motion, Peer, Pose, Reference
from bench.ecu.base import Ecu, Health, Outgoing, Signals, Topic, vehicle_bus
from bench.ecu.planner_base import PlannerBase
from bench.ecu.tracker_base import TrackerBase

__all__ = [
    "Command",
    "Ecu",
    "Health",
    "Motion",
    "Outgoing",
    "Peer",
    "PlannerBase",
    "Pose",
    "Reference",
    "Signals",
    "Topic",
    "TrackerBase",
    "vehicle_bus",
]
