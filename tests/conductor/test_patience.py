"""When a person is told what is waited for, and when waiting ends; by a clock that the test turns."""

import itertools

import pytest

from bench.conductor.patience import LONGEST_S, Patience, listed
from bench.errors import RunFailed


class Clock:
    """A clock that is turned by hand."""

    def __init__(self) -> None:
        self.now = 100.0

    def __call__(self) -> float:
        return self.now


def waiting(progress: object, until_s: float, silence_s: float = 60.0, step_s: float = 0.5) -> list[str]:
    """What is said while waiting; `progress` is called for how far it is."""
    clock, said = Clock(), list[str]()
    patience = Patience(silence_s, said.append, clock)
    while clock.now < 100.0 + until_s:
        patience.look("veh1.tracker", "importing", progress)
        clock.now += step_s
    return said


def test_nothing_is_said_of_a_quick_start() -> None:
    assert waiting(lambda: 0, 2.0) == []


def test_after_two_seconds_it_is_said_every_second() -> None:
    assert waiting(lambda: 0, 4.5) == [
        f"waiting for veh1.tracker to start ({seconds} s): importing ..." for seconds in (2, 3, 4)
    ]


def test_it_ends_only_without_a_sign_of_progress() -> None:
    # A busy machine: something every 50 s.
    slow = itertools.count()
    waiting(lambda: next(slow) // 100, 400.0)
    with pytest.raises(RunFailed, match=r"veh1.tracker not ready after 60 s; importing$"):
        waiting(lambda: 0, 100.0)
    stops = itertools.count()
    with pytest.raises(RunFailed, match=r"not ready after 110 s; importing; no sign of progress since 50 s"):
        waiting(lambda: min(next(stops), 99), 200.0)


def test_it_ends_after_a_long_time_in_any_case() -> None:
    busy = itertools.count()
    with pytest.raises(RunFailed, match=f"not ready after {LONGEST_S:.0f} s; importing"):
        waiting(lambda: next(busy), LONGEST_S + 1.0)


def test_of_many_names_the_first_are_given() -> None:
    assert listed(["a", "b"]) == "a, b"
    assert listed(list("abcde")) == "a, b, c, d, e"
    assert listed(list("abcdefg")) == "a, b, c, d and 3 more"
