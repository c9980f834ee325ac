"""The distributions of an uncertain value, each sampled by its inverse cumulative distribution function."""

from __future__ import annotations

import math
from typing import Annotated, Literal, Self

import numpy as np
import numpy.typing as npt
from pydantic import BaseModel, Field, model_validator

from bench.faults.profile import STRICT

Array = npt.NDArray[np.float64]
Value = float | int | str | bool
"""A value of a scenario's key."""

MOST_CHOICES = 1000
LARGEST_INTEGER = 2**53
"""Integers up to this are exact as floating-point numbers."""

FURTHEST = 8.0
"""A range must come within this many standard deviations of the mean: beyond, its probability is below 1e-15."""


class Uniform(BaseModel):
    """Every value of a range is equally likely.

    Attributes:
        low: smallest value.
        high: largest value.
    """

    model_config = STRICT

    kind: Literal["uniform"]
    low: float
    high: float

    @model_validator(mode="after")
    def _check(self) -> Self:
        _check_order(self.low, self.high)
        return self

    def at(self, shares: Array) -> list[Value]:
        """Return the values at these shares (n,) of the probability, from 0 to 1."""
        return _within(self.low + shares * (self.high - self.low), shares, self.low, self.high)

    def extremes(self) -> list[Value]:
        """Return the values at the ends of the range."""
        return [self.low, self.high]

    def grid(self, points: int) -> list[Value]:
        """Return `points` values at evenly spaced shares of the probability."""
        return self.at(_shares(points))


class LogUniform(BaseModel):
    """The logarithm is uniform: every ratio within a range of positive values is equally likely.

    Attributes:
        low: smallest value, above 0.
        high: largest value.
    """

    model_config = STRICT

    kind: Literal["log-uniform"]
    low: Annotated[float, Field(gt=0)]
    high: Annotated[float, Field(gt=0)]

    @model_validator(mode="after")
    def _check(self) -> Self:
        _check_order(self.low, self.high)
        return self

    def at(self, shares: Array) -> list[Value]:
        """Return the values at these shares (n,) of the probability, from 0 to 1."""
        low, high = math.log(self.low), math.log(self.high)
        return _within(np.exp(low + shares * (high - low)), shares, self.low, self.high)

    def extremes(self) -> list[Value]:
        """Return the values at the ends of the range."""
        return [self.low, self.high]

    def grid(self, points: int) -> list[Value]:
        """Return `points` values at evenly spaced shares of the probability."""
        return self.at(_shares(points))


class Normal(BaseModel):
    """A normal distribution, truncated to a range.

    Attributes:
        mean: mean of the distribution before it is truncated.
        standard_deviation: its standard deviation, above 0.
        low: smallest value.
        high: largest value.
    """

    model_config = STRICT

    kind: Literal["normal"]
    mean: float
    standard_deviation: Annotated[float, Field(gt=0)]
    low: float
    high: float

    @model_validator(mode="after")
    def _check(self) -> Self:
        _check_order(self.low, self.high)
        check_reach(self.mean, self.standard_deviation, self.low, self.high)
        return self

    def at(self, shares: Array) -> list[Value]:
        """Return the values at these shares (n,) of the probability, from 0 to 1."""
        # Only this distribution needs it, and it is slow to import.
        from scipy.stats import truncnorm

        low, high = ((end - self.mean) / self.standard_deviation for end in (self.low, self.high))
        values = truncnorm.ppf(shares, low, high, loc=self.mean, scale=self.standard_deviation)
        return _within(np.asarray(values, dtype=float), shares, self.low, self.high)

    def extremes(self) -> list[Value]:
        """Return the values at the ends of the range."""
        return [self.low, self.high]

    def grid(self, points: int) -> list[Value]:
        """Return `points` values at evenly spaced shares of the probability."""
        return self.at(_shares(points))


class Choice(BaseModel):
    """Each of some values is equally likely; one value makes a constant.

    Attributes:
        values: the values: numbers, texts, true or false.
    """

    model_config = STRICT

    kind: Literal["choice"]
    values: Annotated[tuple[bool | int | float | str, ...], Field(min_length=1, max_length=MOST_CHOICES)]

    @model_validator(mode="after")
    def _check(self) -> Self:
        # True and 1 are equal in Python and different in TOML.
        if len({(type(value), value) for value in self.values}) < len(self.values):
            raise ValueError("values name one value twice; allowed: each value once")
        return self

    def at(self, shares: Array) -> list[Value]:
        """Return the values at these shares (n,) of the probability, from 0 to 1."""
        return [self.values[place] for place in _places(shares, len(self.values))]

    def extremes(self) -> list[Value]:
        """Return all values: none of them is between others."""
        return list(self.values)

    def grid(self, points: int) -> list[Value]:  # noqa: ARG002 - the same for all distributions
        """Return all values, whatever the number of points."""
        return list(self.values)


class Integers(BaseModel):
    """Every whole number of a range is equally likely.

    Attributes:
        low: smallest number.
        high: largest number.
    """

    model_config = STRICT

    kind: Literal["integers"]
    low: Annotated[int, Field(ge=-LARGEST_INTEGER, le=LARGEST_INTEGER)]
    high: Annotated[int, Field(ge=-LARGEST_INTEGER, le=LARGEST_INTEGER)]

    @model_validator(mode="after")
    def _check(self) -> Self:
        _check_order(self.low, self.high)
        return self

    def at(self, shares: Array) -> list[Value]:
        """Return the values at these shares (n,) of the probability, from 0 to 1."""
        return [self.low + place for place in _places(shares, self.high - self.low + 1)]

    def extremes(self) -> list[Value]:
        """Return the numbers at the ends of the range."""
        return [self.low, self.high]

    def grid(self, points: int) -> list[Value]:
        """Return at most `points` evenly spaced numbers; all of the range if there are no more."""
        count = self.high - self.low + 1
        if points >= count:
            return list(range(self.low, self.high + 1))
        if points == 1:
            return [self.low + (count - 1) // 2]
        return [self.low + round(place * (count - 1) / (points - 1)) for place in range(points)]


Distribution = Annotated[Uniform | LogUniform | Normal | Choice | Integers, Field(discriminator="kind")]


def check_reach(mean: float, standard_deviation: float, low: float, high: float) -> None:
    """Refuse a range that a normal distribution does not reach.

    Raises:
        ValueError: all of the range is further from the mean than `FURTHEST` standard deviations.
    """
    if max(low - mean, mean - high) > FURTHEST * standard_deviation:
        raise ValueError(
            f"mean = {mean:g} is too far from the range {low:g} to {high:g} for standard_deviation ="
            f" {standard_deviation:g}; allowed: at most {FURTHEST:g} standard deviations from it"
        )


def _check_order(low: float, high: float) -> None:
    if not low < high:
        raise ValueError(f'low = {low:g} is not below high = {high:g}; for one value use kind = "choice"')
    if not math.isfinite(high - low):
        raise ValueError(f"low = {low:g} is too far below high = {high:g}; their difference must be finite")


def _within(values: Array, shares: Array, low: float, high: float) -> list[Value]:
    """Return the values at these shares, with the exact ends of the range and none outside by rounding."""
    inside = np.clip(values, low, high)
    inside[shares == 0.0], inside[shares == 1.0] = low, high
    found: list[Value] = inside.tolist()
    return found


def _places(shares: Array, count: int) -> list[int]:
    """Return which of `count` equally likely cases each share is in."""
    return [min(int(share * count), count - 1) for share in shares.tolist()]


def _shares(points: int) -> Array:
    return np.linspace(0.0, 1.0, points) if points > 1 else np.array([0.5])
