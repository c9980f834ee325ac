"""An ECU under observation: records the inputs of its steps."""

from collections.abc import Mapping

from bench.ecu.base import Ecu, Health, Outgoing, Signals, Topic
from bench.ecu.runtime import INPUT_WAIT_S
from bench.resim.step_limit import StepLimit

_KEPT = 8
"""Number of steps remembered: as many as a frame may be late."""


class Witness:
    """Wraps an ECU and remembers its newest steps. See `bench.ecu.base.Ecu`.

    Attributes:
        steps: how many there have been.
        seen: the inputs of the newest of them, by cycle.
    """

    def __init__(self, ecu: Ecu, limit: StepLimit) -> None:
        """Observe `ecu`, whose steps are to end within `limit`."""
        self._ecu = ecu
        self._limit = limit
        self.name = ecu.name
        self.inputs: tuple[Topic, ...] = tuple(ecu.inputs)
        self.input_wait_s = float(getattr(ecu, "input_wait_s", INPUT_WAIT_S))
        self.steps = 0
        self.seen: dict[int, Mapping[Topic, Signals | None]] = {}

    def step(self, cycle: int, time_s: float, inputs: Mapping[Topic, Signals | None], health: Health) -> list[Outgoing]:
        """Let the ECU do its step."""
        self.seen[cycle] = dict(inputs)
        self.seen.pop(cycle - _KEPT, None)
        self.steps += 1
        with self._limit.step(cycle):
            # A generator would do its work only when consumed.
            return list(self._ecu.step(cycle, time_s, inputs, health))
