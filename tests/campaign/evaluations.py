"""Studies of made-up inputs, and functions that evaluate them: problems with known answers."""

from bench.campaign.distributions import Choice, Integers, Normal, Uniform
from bench.campaign.evaluating import Outcome
from bench.campaign.requirements import Requirement
from bench.campaign.statuses import OK, REFUSED
from bench.campaign.study import Input, Study

METRIC = "least_clearance_m"
ABOVE_0 = Requirement(METRIC, ">", 0.0)


def uniform(low=0.0, high=1.0):
    return Uniform(kind="uniform", low=low, high=high)


def normal(mean=0.0, deviation=1.0, reach=8.0):
    """A normal distribution that ends at so many standard deviations."""
    low, high = mean - reach * deviation, mean + reach * deviation
    return Normal(kind="normal", mean=mean, standard_deviation=deviation, low=low, high=high)


def integers(low, high):
    return Integers(kind="integers", low=low, high=high)


def choice(*values):
    return Choice(kind="choice", values=values)


def study_of(*distributions, base="formation", seed=1, groups=(), requirements=(), keys="abcdefghijklm"):
    """A study with these inputs, whose keys are letters unless given."""
    inputs = tuple(Input(key=key, distribution=each) for key, each in zip(keys, distributions, strict=False))
    return Study(
        name="s",
        base=base,
        seed=seed,
        runs=1,
        sampling="monte-carlo",
        inputs=inputs,
        groups=groups,
        requirements=requirements,
        ecus={},
        time_limit_s=1.0,
        text="",
    )


class Evaluated:
    """Evaluates a function of the values; keeps the batches."""

    def __init__(self, function):
        """`function(values)` is a metric's value or a status."""
        self.function = function
        self.batches = []

    @property
    def values(self):
        return [values for batch in self.batches for values in batch]

    def __call__(self, batch):
        before = len(self.values)
        self.batches.append(list(batch))
        return [self.outcome(before + place, self.function(values)) for place, values in enumerate(batch)]

    @staticmethod
    def outcome(number, found):
        if isinstance(found, str):
            return Outcome(number, None, found, "refused" if found == REFUSED else "it broke")
        return Outcome(number, {METRIC: found}, OK, "")
