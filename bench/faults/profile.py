"""A scenario value that may change with time: a constant, a step or a sine.

In TOML a profile is a number, or a table such as `{kind = "step", at_s = 2.0, before = 0.0, after = 600.0}`.
"""

import math
from dataclasses import dataclass
from typing import Annotated, Any, Literal

from pydantic import (
    BaseModel,
    BeforeValidator,
    ConfigDict,
    Field,
    GetCoreSchemaHandler,
    GetJsonSchemaHandler,
    model_serializer,
)
from pydantic.json_schema import JsonSchemaValue
from pydantic_core import CoreSchema, core_schema

from bench.faults.meaning import describe

STRICT = ConfigDict(
    defer_build=True, frozen=True, extra="forbid", strict=True, allow_inf_nan=False, json_schema_extra=describe
)
"""Validation of all parts of a scenario: no unknown key, no text in place of a number, no NaN."""


class Constant(BaseModel):
    """A constant; written as a plain number.

    Attributes:
        level: the value.
    """

    model_config = STRICT

    kind: Literal["constant"] = "constant"
    level: float

    def value(self, t: float) -> float:
        """Return the value at time `t` (s)."""
        return self.level

    def extremes(self) -> tuple[float, float]:
        """Return the minimum and maximum of the profile."""
        return self.level, self.level

    @model_serializer
    def _as_number(self) -> float:
        return self.level


class Step(BaseModel):
    """`before` until the time `at_s` (s), `after` from then on.

    Attributes:
        at_s: simulated time of the step (s).
        before: the value before it.
        after: the value from then on.
    """

    model_config = STRICT

    kind: Literal["step"]
    at_s: Annotated[float, Field(ge=0, le=300)]
    before: float
    after: float

    def value(self, t: float) -> float:
        """Return the value at time `t` (s)."""
        return self.after if t >= self.at_s else self.before

    def extremes(self) -> tuple[float, float]:
        """Return the minimum and maximum of the profile."""
        return min(self.before, self.after), max(self.before, self.after)


class Sine(BaseModel):
    """`mean + amplitude * sin(2 pi frequency_hz t + phase_rad)`.

    Attributes:
        mean: mean value.
        amplitude: largest deviation from it.
        frequency_hz: frequency (Hz).
        phase_rad: phase at the time 0 (rad).
    """

    model_config = STRICT

    kind: Literal["sine"]
    mean: float
    amplitude: float
    # Above half the rate at which the plant samples the profile (100 Hz) the sine would alias.
    frequency_hz: Annotated[float, Field(gt=0, le=50)]
    phase_rad: Annotated[float, Field(ge=-2 * math.pi, le=2 * math.pi)] = 0.0

    def value(self, t: float) -> float:
        """Return the value at time `t` (s)."""
        return self.mean + self.amplitude * math.sin(2 * math.pi * self.frequency_hz * t + self.phase_rad)

    def extremes(self) -> tuple[float, float]:
        """Return the minimum and maximum of the profile."""
        return self.mean - abs(self.amplitude), self.mean + abs(self.amplitude)


def _number_as_constant(raw: Any) -> Any:
    if isinstance(raw, (int, float)) and not isinstance(raw, bool):
        return {"kind": "constant", "level": float(raw)}
    return raw


Profile = Annotated[Constant | Step | Sine, Field(discriminator="kind"), BeforeValidator(_number_as_constant)]


@dataclass(frozen=True)
class Within:
    """Annotation of a profile that must never leave [`low`, `high`]."""

    low: float
    high: float

    def _check(self, profile: Constant | Step | Sine) -> Constant | Step | Sine:
        least, greatest = profile.extremes()
        if least < self.low or greatest > self.high:
            reach = f"{least:g}" if least == greatest else f"{least:g} to {greatest:g}"
            raise ValueError(f"is {reach}; allowed: {self.low:g} to {self.high:g} at all times")
        return profile

    def __get_pydantic_core_schema__(self, source: Any, handler: GetCoreSchemaHandler) -> CoreSchema:
        """Add the range check after the profile's own validation."""
        return core_schema.no_info_after_validator_function(self._check, handler(source))

    def __get_pydantic_json_schema__(self, schema: CoreSchema, handler: GetJsonSchemaHandler) -> JsonSchemaValue:
        """Add the range to the schema for error messages: JSON Schema cannot state it for a union."""
        return {**handler(schema), "range": [self.low, self.high]}


def constant(level: float) -> Constant:
    """Return the constant profile `level`."""
    return Constant(level=level)
