"""Which logs stay: at the end those of failures, of exactly the worst runs, and those asked for, in whatever order."""

import math

from hypothesis import given
from hypothesis import strategies as st

from bench.campaign.jobs import Made
from bench.campaign.keeping import MOST_FAILURES, Keeping, failed, is_wanted
from bench.campaign.requirements import requirement
from bench.campaign.statuses import FAILED, OK

CLEARANCE, TIME = requirement("least_clearance_m > 1.0"), requirement("formation_time_s <= 6")
BOTH = (CLEARANCE, TIME)


def made(number, clearance, time, *, status=OK):
    formed = time is not None
    return Made(number, status, metrics={"least_clearance_m": clearance, "formation_time_s": time, "formed": formed})


def kept_of(runs, keeping, late, before=frozenset()):
    """The logs kept, if each run learns the limits of `late` runs before, as runs do that are made in parallel."""
    kept, limits = set(before), [keeping.limits()] * (late + 1)
    for run in runs:
        if keeping.is_asked(run.number) or is_wanted(run, BOTH, limits[-late - 1]):
            kept.add(run.number)
            gone = keeping.note(run)
            # What goes had been kept.
            assert gone <= kept
            kept -= gone
        limits.append(keeping.limits())
    return kept


def worst_of(runs, worst):
    found = set()
    for each in BOTH:
        margins = [(each.margin(run.metrics), run.number) for run in runs]
        found |= {number for _, number in sorted(one for one in margins if one[0] is not None)[:worst]}
    return found


runs_in_any_order = st.lists(
    st.tuples(st.sampled_from([0.5, 1.5, 2.0, 3.0, math.nan, None]), st.sampled_from([None, 4.0, 5.0, 6.0, 7.0])),
    max_size=40,
).flatmap(lambda values: st.permutations([made(number, *each) for number, each in enumerate(values)]))


@given(runs_in_any_order, st.integers(0, 4), st.sets(st.integers(0, 40)), st.integers(0, 8))
def test_failures_the_worst_and_those_asked_for_stay_and_no_others(runs, worst, asked, late):
    kept = kept_of(runs, Keeping(BOTH, worst, asked), late)
    numbers = {run.number for run in runs}
    failures = {run.number for run in runs if failed(run, BOTH)}
    assert kept == failures | worst_of(runs, worst) | (asked & numbers)


@given(runs_in_any_order, st.integers(0, 4), st.integers(0, 40))
def test_what_stays_is_the_same_after_a_resume(runs, worst, done):
    whole = kept_of(runs, Keeping(BOTH, worst, ()), 0)
    before = kept_of(runs[:done], Keeping(BOTH, worst, ()), 0)
    resumed = Keeping(BOTH, worst, ())
    for run in runs[:done]:
        if run.number in before:
            assert not resumed.note(run)
    assert kept_of(runs[done:], resumed, 0, before) == whole


def test_all_may_be_asked_for():
    keeping = Keeping(BOTH, 0, None)
    assert kept_of([made(number, 2.0, 5.0) for number in range(5)], keeping, 0) == set(range(5))


def test_the_first_of_very_many_failures_stay():
    runs = [made(number, 2.0, 5.0, status=FAILED) for number in range(MOST_FAILURES + 20)]
    assert kept_of(runs, Keeping((), 0, {MOST_FAILURES + 3}), 0) == {*range(MOST_FAILURES), MOST_FAILURES + 3}
