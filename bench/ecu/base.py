"""What an ECU is to the bench: a name, the messages it takes, and one step a cycle.

Any class with these members is an ECU; it need not inherit from anything here, though `TrackerBase` and `PlannerBase`
see to most of it. It is made with the number of its vehicle and the scenario, and it sees nothing of the others but
frames. Where its class has a static method `warm_up`, it is called once before the processes are forked: what is loaded
there need not be loaded in each.
"""

from collections.abc import Mapping
from typing import Protocol

from bench.bus.reception import Health
from bench.bus.topic import Outgoing, Signals, Topic, vehicle_bus

__all__ = ["Ecu", "Health", "Outgoing", "Signals", "Topic", "vehicle_bus"]


class Ecu(Protocol):
    """A controller as an ECU: frames in, frames out, once a cycle.

    Attributes:
        name: who it is, as in messages to a person: `veh1.planner`.
        inputs: what it takes. A step comes when exactly one frame of each is there. A message on a vehicle's bus is of
            the step's own cycle; one on `v2v` was sent in the cycle before. All must be messages with E2E protection,
            as the alive counter tells a frame's cycle.
    """

    name: str
    inputs: tuple[Topic, ...]

    def step(self, cycle: int, time_s: float, inputs: Mapping[Topic, Signals | None], health: Health) -> list[Outgoing]:
        """Do this cycle's work and return the messages to send.

        Every message of this ECU that has E2E protection should be among them, in every cycle: one that is left out is
        missing at its receivers. The rest, its diagnostics, go out with their start values where they are left out.

        The outcome must follow from the arguments and earlier steps alone: no clock, no I/O; only the values of
        wall-clock messages may come from a timer.

        Args:
            cycle: number of the cycle, from 0.
            time_s: simulated time in s.
            inputs: signals of each topic of `inputs`; None where it is missing or came damaged. In the first cycle
                nothing has come over `v2v` yet.
            health: frames lost and E2E errors of this ECU up to now.
        """
