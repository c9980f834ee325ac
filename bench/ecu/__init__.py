"""Controllers wrapped as ECUs: frames in, frames out.

A custom controller needs only this package: `TrackerBase` or `PlannerBase`, and their input and output quantities. A
class that handles every frame itself implements the members of `Ecu` instead.
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
