"""The interface of an ECU: a name, its input messages, and one step per cycle.

Any class with these members is an ECU; it need not inherit from anything here, though `TrackerBase` and `PlannerBase`
handle most of it. It is created with its vehicle number and the scenario, and receives nothing from the others but
frames. If its class has a static method `warm_up`, it is called once before the processes are forked, so that they
share what it loads.
"""

from collections.abc import Mapping
from typing import Protocol

from bench.bus.reception import Health
from bench.bus.topic import Outgoing, Signals, Topic
from bench.names import vehicle_bus

__all__ = ["Ecu", "Health", "Outgoing", "Signals", "Topic", "vehicle_bus"]


class Ecu(Protocol):
    """A controller as an ECU: frames in, frames out, once a cycle.

    Attributes:
        name: name in messages to people, e.g. `veh1.planner`.
        inputs: its input messages. A step runs once exactly one frame of each has arrived: of the same cycle on the
            vehicle's bus, of the cycle before on `v2v`. All must have E2E protection, because the alive counter gives
            the cycle of a frame.
    """

    name: str
    inputs: tuple[Topic, ...]

    def step(self, cycle: int, time_s: float, inputs: Mapping[Topic, Signals | None], health: Health) -> list[Outgoing]:
        """Run this cycle and return the messages to send.

        Return every E2E-protected message of this ECU in every cycle: receivers miss one that is left out. Diagnostic
        messages may be left out: figures and metrics then show them as not sent. Signals left out of a message
        have their start values.

        The result must depend only on the arguments and earlier steps: no clock, no I/O; only the values of wall-clock
        messages may come from a timer.

        Args:
            cycle: number of the cycle, from 0.
            time_s: simulated time in s.
            inputs: signals of each topic of `inputs`; None if missing or damaged. In the first cycle nothing has
                arrived on `v2v` yet.
            health: frames lost and E2E errors of this ECU so far.
        """
