"""The faults a scenario can bring about, or a person types into a running bench.

In TOML each is a table of `[[faults]]`: its kind, when it begins (`at_s`), how long it lasts (`for_s`, to the end of
the run where it is left out), and what it is done to. All that is random in a fault follows from the scenario's seed.
"""

from typing import Annotated, Literal

from pydantic import BaseModel, Field

from bench.faults.profile import STRICT

BusName = Annotated[str, Field(pattern=r"^(v2v|veh[1-9][0-9]?)$")]
EcuName = Annotated[str, Field(pattern=r"^veh[1-9][0-9]?\.(planner|tracker)$")]
NodeName = Annotated[str, Field(pattern=r"^veh[1-9][0-9]?\.(planner|tracker|plant)$")]
VehicleNumber = Annotated[int, Field(ge=1, le=16)]
Probability = Annotated[float, Field(gt=0, le=1)]
Chance = Annotated[float, Field(ge=0, le=1)]


class _Fault(BaseModel):
    """What all faults have.

    Attributes:
        at_s: simulated time at which it begins (s); it takes hold with the cycle that begins then.
        for_s: how long it lasts (s); to the end of the run where it is None.
    """

    model_config = STRICT

    at_s: Annotated[float, Field(ge=0, le=300)]
    for_s: Annotated[float, Field(gt=0, le=300)] | None = None

    def target(self) -> str:
        """Return what it is done to, in words."""
        given = self.model_dump(exclude_none=True, exclude={"kind", "at_s", "for_s"})
        return ", ".join(f"{key} {value}" for key, value in given.items())


class GilbertElliott(BaseModel):
    """Losses that come in bursts: a channel that is good or bad, and changes from frame to frame.

    Attributes:
        to_bad: probability that a good channel is bad for the next frame.
        to_good: probability that a bad channel is good for the next frame; bursts are 1 / to_good frames long.
        loss_good: probability that a good channel loses a frame.
        loss_bad: probability that a bad channel does.
    """

    model_config = STRICT

    to_bad: Probability
    to_good: Probability
    loss_good: Chance = 0.0
    loss_bad: Chance = 1.0


class _FrameFault(_Fault):
    """A fault of frames on their way: of one message, or of all messages on a bus.

    Attributes:
        bus: v2v or veh<i>.
        message: name in the DBC; None for every message but the bench's own.
    """

    bus: BusName
    message: str | None = None


class FrameLoss(_FrameFault):
    """Frames are lost: each on its own (Bernoulli), or in bursts where `bursts` is given."""

    kind: Literal["frame_loss"] = "frame_loss"
    probability: Probability = 1.0
    bursts: GilbertElliott | None = None


class FrameDelay(_FrameFault):
    """Frames come `cycles` cycles late, and up to `jitter_cycles` more, evenly distributed."""

    kind: Literal["frame_delay"] = "frame_delay"
    cycles: Annotated[int, Field(ge=0, le=100)] = 1
    jitter_cycles: Annotated[int, Field(ge=0, le=100)] = 0


class FrameDuplicate(_FrameFault):
    """Frames come more than once."""

    kind: Literal["frame_duplicate"] = "frame_duplicate"
    copies: Annotated[int, Field(ge=1, le=10)] = 1
    probability: Probability = 1.0


class FrameReorder(_FrameFault):
    """Every other frame comes after the one that follows it."""

    kind: Literal["frame_reorder"] = "frame_reorder"


class FrameCorrupt(_FrameFault):
    """Bits of a frame are turned over on the way, after its CRC was made."""

    kind: Literal["frame_corrupt"] = "frame_corrupt"
    bits: Annotated[int, Field(ge=1, le=64)] = 1
    probability: Probability = 1.0


class CounterStuck(_FrameFault):
    """The alive counter stays where it is, under a good CRC: a sender that has stopped calculating."""

    kind: Literal["counter_stuck"] = "counter_stuck"
    message: str


class SignalStuck(_FrameFault):
    """A signal keeps the value it has when the fault begins; CRC and counter are good."""

    kind: Literal["signal_stuck"] = "signal_stuck"
    message: str
    signal: str


class SensorBias(_FrameFault):
    """A signal is off by `bias`, in the signal's unit."""

    kind: Literal["sensor_bias"] = "sensor_bias"
    message: str
    signal: str
    bias: float


class SensorNoise(_FrameFault):
    """A signal has white Gaussian noise of standard deviation `sigma`, in the signal's unit."""

    kind: Literal["sensor_noise"] = "sensor_noise"
    message: str
    signal: str
    sigma: Annotated[float, Field(gt=0)]


class SensorDropout(_FrameFault):
    """A sensor sends nothing, now and then or at all."""

    kind: Literal["sensor_dropout"] = "sensor_dropout"
    message: str
    probability: Probability = 1.0


class BabblingIdiot(_Fault):
    """A node sends frames of its own without end, which win arbitration against all of lower priority.

    What is left of the bus goes to the other frames in the order of their priority; the rest starves.

    Attributes:
        node: who babbles; the frames go to the bus of its vehicle.
        identifier: of its frames; the lower, the higher their priority.
        frames_per_cycle: how many.
    """

    kind: Literal["babbling_idiot"] = "babbling_idiot"
    node: EcuName
    identifier: Annotated[int, Field(ge=0x12, le=0x7FF)] = 0x80
    frames_per_cycle: Annotated[int, Field(ge=1, le=60)] = 40


class BusOff(_Fault):
    """A node's CAN controller has gone off its vehicle's bus: it neither sends nor receives there."""

    kind: Literal["bus_off"] = "bus_off"
    node: NodeName


class V2VOutage(_Fault):
    """The radio is out: of one vehicle, or of all of them."""

    kind: Literal["v2v_outage"] = "v2v_outage"
    vehicle: VehicleNumber | None = None


class EcuCrash(_Fault):
    """An ECU's process is killed; after `for_s` it is started anew and joins the run under way."""

    kind: Literal["ecu_crash"] = "ecu_crash"
    ecu: EcuName


class EcuHang(_Fault):
    """An ECU's process is stopped where it is; after `for_s` it goes on from there."""

    kind: Literal["ecu_hang"] = "ecu_hang"
    ecu: EcuName


class ActuatorStuck(_Fault):
    """An actuator stays where it is, or goes to `value` (rad, N m) and stays there, whatever is commanded."""

    kind: Literal["actuator_stuck"] = "actuator_stuck"
    vehicle: VehicleNumber
    actuator: Literal["steering", "torque_fl", "torque_rl", "torque_rr", "torque_fr"]
    value: float | None = None


class TyreBlowout(_Fault):
    """The cornering stiffness of an axle falls to C (1 + 0.4 `lambda_level`)."""

    kind: Literal["tyre_blowout"] = "tyre_blowout"
    vehicle: VehicleNumber
    axle: Literal["front", "rear"]
    lambda_level: Annotated[float, Field(ge=-1, le=1)] = -1.0


class IcePatch(_Fault):
    """The adhesion is `mu` under one vehicle, or under all."""

    kind: Literal["ice_patch"] = "ice_patch"
    vehicle: VehicleNumber | None = None
    mu: Annotated[float, Field(ge=0.05, le=1.5)] = 0.2


FrameFault = (
    FrameLoss
    | FrameDelay
    | FrameDuplicate
    | FrameReorder
    | FrameCorrupt
    | CounterStuck
    | SignalStuck
    | SensorBias
    | SensorNoise
    | SensorDropout
)
NodeFault = BabblingIdiot | BusOff | V2VOutage
ProcessFault = EcuCrash | EcuHang
VehicleFault = ActuatorStuck | TyreBlowout | IcePatch
Fault = Annotated[FrameFault | NodeFault | ProcessFault | VehicleFault, Field(discriminator="kind")]

SENSOR_FAULTS = (SensorBias, SensorNoise, SensorDropout)
"""Faults that only messages of the plant can have."""


def kinds() -> dict[str, type[_Fault]]:
    """Return the class of each kind of fault."""
    classes = (*FrameFault.__args__, *NodeFault.__args__, *ProcessFault.__args__, *VehicleFault.__args__)
    return {each.model_fields["kind"].default: each for each in classes}


class Window:
    """In which cycles a fault is at work: from `first` to before `end`, which is None where it never ends."""

    __slots__ = ("end", "first")

    def __init__(self, fault: _Fault, cycle_s: float) -> None:
        """Find the cycles of `cycle_s` s in which `fault` is at work; it lasts at least one."""
        self.first = round(fault.at_s / cycle_s)
        self.end = None if fault.for_s is None else max(self.first + 1, round((fault.at_s + fault.for_s) / cycle_s))

    def __contains__(self, cycle: int) -> bool:
        """Whether the fault is at work in a cycle."""
        return self.first <= cycle and (self.end is None or cycle < self.end)
