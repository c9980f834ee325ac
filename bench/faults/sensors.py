"""Faults of sensors and senders: signals that are stuck, biased, noisy or missing, with valid CRC and counter."""

from abc import abstractmethod
from collections.abc import Sequence
from typing import Annotated, Literal

from pydantic import Field

from bench.faults.base import LOST, ON_TIME, Bench, FrameContext, Memory, Passage, Probability, Problem
from bench.faults.frames import FrameFault
from bench.names import PLANT


class SignalFault(FrameFault):
    """A fault in one signal of a message.

    Attributes:
        message: name in the DBC.
        signal: name of the signal in the message.
    """

    message: str
    signal: str

    def message_problems(self, message: str, bench: Bench) -> list[Problem]:
        """See `FrameFault`."""
        signals = bench.signals(self.bus, message)
        if self.signal in signals:
            return []
        return [(("signal",), f"= {self.signal} is not a signal of {message}; allowed: {', '.join(signals)}")]

    def on_values(self, values: dict[str, float], frame: FrameContext, memory: Memory) -> None:
        """See `Fault`."""
        values[self.signal] = self.changed(values[self.signal], frame, memory)

    @abstractmethod
    def changed(self, value: float, frame: FrameContext, memory: Memory) -> float:
        """Return the signal's value under the fault."""


class SensorFault(FrameFault):
    """A fault that only messages of the plant can have."""

    def messages(self, bench: Bench) -> Sequence[str]:
        """See `FrameFault`."""
        return [message for message, sender in bench.senders(self.bus).items() if sender == PLANT]


class SignalStuck(SignalFault):
    """A signal keeps its value from the beginning of the fault; CRC and counter are valid."""

    kind: Literal["signal_stuck"] = "signal_stuck"

    def changed(self, value: float, frame: FrameContext, memory: Memory) -> float:
        """See `SignalFault`."""
        return float(memory.setdefault("value", value))


class SensorBias(SensorFault, SignalFault):
    """A signal is off by `bias`, in the signal's unit.

    Attributes:
        bias: error of the signal, in its unit.
    """

    kind: Literal["sensor_bias"] = "sensor_bias"
    message: str
    bias: float

    def changed(self, value: float, frame: FrameContext, memory: Memory) -> float:
        """See `SignalFault`."""
        return value + self.bias


class SensorNoise(SensorFault, SignalFault):
    """A signal has white Gaussian noise of standard deviation `sigma`, in the signal's unit.

    Attributes:
        sigma: standard deviation of the noise, in the signal's unit.
    """

    kind: Literal["sensor_noise"] = "sensor_noise"
    message: str
    sigma: Annotated[float, Field(gt=0)]

    def changed(self, value: float, frame: FrameContext, memory: Memory) -> float:
        """See `SignalFault`."""
        return value + frame.dice().gauss(0.0, self.sigma)


class SensorDropout(SensorFault):
    """A sensor sends nothing, intermittently or permanently.

    Attributes:
        message: name of its message in the DBC.
        probability: probability that a frame is not sent.
    """

    kind: Literal["sensor_dropout"] = "sensor_dropout"
    message: str
    probability: Probability = 1.0

    def passage(self, data: bytes, frame: FrameContext, memory: Memory) -> Passage:
        """See `Fault`."""
        return LOST if frame.dice().random() < self.probability else ON_TIME
