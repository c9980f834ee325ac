"""The tables: all random scenarios together, those that failed, the shipped scenarios, and the price of comfort."""

import statistics
from collections.abc import Mapping, Sequence
from dataclasses import dataclass

from bench.benchmarks.comfort.front import Point, on_front
from bench.benchmarks.comfort.limits import LIMITS, NAMES, UNITS, WORDS
from bench.benchmarks.comfort.results import FORMED_WITHIN_S, Result
from bench.benchmarks.sheet import Sheet

KEPT_SHARE = 0.95
"""Share of the random scenarios in which all limits of comfort are to be kept."""

_HEADINGS = ("", "wanted", "found")


def random_sheet(results: Sequence[Result]) -> Sheet:
    """Return what was found in the random scenarios together."""
    done = [each for each in results if not each.failure]
    kept = [each for each in done if not each.exceeded]
    silent = [each for each in done if each.exceeded and not each.told]
    in_time = [each for each in done if each.in_time]
    rows = [
        ("scenarios", "at least 300", f"{len(results)}"),
        ("runs that ended early", "0", f"{len(results) - len(done)}"),
        ("clearance below 1 m, or the start's", "0", f"{sum(not each.clear for each in done)}"),
        ("least clearance", "", _least([each.clearance_m for each in done], "m")),
        ("outside the stability boundary", "0", f"{sum(not each.inside for each in done)}"),
        ("least margin to it", "", _least([each.margin for each in done])),
        ("comfort limits kept", f"at least {100 * KEPT_SHARE:g} %", _share(len(kept), len(results))),
        *((f"... {WORDS[name]} above {LIMITS[name]:g} {UNITS[name]}", "", _exceeding(done, name)) for name in NAMES),
        ("comfort limits exceeded, and no planner said so", "0", f"{len(silent)}"),
        (f"formed within {FORMED_WITHIN_S:g} s", "all", _share(len(in_time), len(results))),
        ("formation time, median / 9th decile / longest", "", _times([each.formed_s for each in done])),
        ("steps with a fallback gain", "", f"{sum(each.fallback_steps for each in done)}"),
    ]
    return Sheet(f"{len(results)} random scenarios", _HEADINGS, rows)


def failed_sheet(results: Mapping[int, Result]) -> Sheet | str:
    """Return each random scenario in which something is wrong, by its number."""
    rows = [
        (f"random:{seed}", each.description, "; ".join(each.problems))
        for seed, each in results.items()
        if each.problems
    ]
    if not rows:
        return "No random scenario failed.\n"
    return Sheet("Random scenarios that failed", ("scenario", "what", "problem"), rows, words=3)


def gave_way_sheet(results: Mapping[int, Result]) -> Sheet | str:
    """Return each random scenario in which comfort gave way to safety, and a planner said so."""
    rows = [
        (f"random:{seed}", each.description, each.discomfort)
        for seed, each in results.items()
        if each.exceeded and each.told
    ]
    if not rows:
        return "Comfort gave way to safety in no random scenario.\n"
    return Sheet(
        "Random scenarios in which comfort gave way to safety", ("scenario", "what", "exceeded"), rows, words=3
    )


@dataclass(frozen=True)
class Wanted:
    """What a shipped scenario is to reach.

    Attributes:
        formed_s: time by which the platoon is formed, s.
        margin: least margin to the stability boundary.
        reversals: most reversals of the steering of a vehicle.
        distance_m: least distance between centres of mass, m; None for scenarios of more vehicles than three.
        comfortable: whether the limits of comfort are to be kept.
    """

    formed_s: float
    margin: float
    reversals: int = 5
    distance_m: float | None = None
    comfortable: bool = True


SHIPPED = {
    "formation": Wanted(6.0, 0.5, distance_m=8.0),
    "five": Wanted(6.0, 0.5),
    "ten": Wanted(6.0, 0.5),
    "low-grip": Wanted(8.0, 0.25, distance_m=8.0),
    "formation-fast": Wanted(4.2, 0.2, reversals=6, distance_m=8.0, comfortable=False),
}
"""The shipped scenarios that are judged, as far as they are shipped."""

TYRES = {"-1": (-1.0, -1.0), "0": (0.0, 0.0), "+1": (1.0, 1.0), "uneven": (1.0, -1.0)}
"""lambda_f and lambda_r at which each of them is run, by name."""


def shipped_sheets(results: Mapping[tuple[str, str], Result]) -> list[Sheet]:
    """Return the figures of the shipped scenarios, by scenario and tyres; what misses its target is in bold."""
    comfort = ("scenario", "λ", "formed s", "a_y m/s²", "j_y m/s³", "a_x m/s²", "j_x m/s³", "reversals", "weighted RMS")
    safety = ("scenario", "λ", "margin", "distance m", "clearance m", "speed RMSE m/s", "yaw rate RMSE rad/s")
    first = [[name, tyres, *_comfort_cells(each, SHIPPED[name])] for (name, tyres), each in results.items()]
    other = [[name, tyres, *_safety_cells(each, SHIPPED[name])] for (name, tyres), each in results.items()]
    return [Sheet("Time and comfort", comfort, first, words=2), Sheet("Safety and tracking", safety, other, words=2)]


def _comfort_cells(result: Result, wanted: Wanted) -> list[str]:
    values = result.comfort
    if values is None:
        return [f"**{result.failure}**", *[""] * 6]
    formed = result.formed_s
    return [
        _marked("never" if formed is None else f"{formed:.2f}", formed is not None and formed <= wanted.formed_s),
        *(_marked(f"{values[name]:.2f}", not wanted.comfortable or values[name] <= LIMITS[name]) for name in NAMES),
        _marked(str(result.reversals), result.reversals <= wanted.reversals),
        f"{result.weighted_rms_mps2:.2f}",
    ]


def _safety_cells(result: Result, wanted: Wanted) -> list[str]:
    if result.failure:
        return [f"**{result.failure}**", *[""] * 4]
    far = wanted.distance_m is None or result.distance_m >= wanted.distance_m
    return [
        _marked(f"{result.margin:.2f}", result.margin >= wanted.margin),
        _marked(f"{result.distance_m:.2f}", far),
        _marked(f"{result.clearance_m:.2f}", result.clear),
        f"{result.speed_rmse_mps:.4f}",
        f"{result.yaw_rate_rmse_radps:.5f}",
    ]


def front_sheet(points: Sequence[Point]) -> Sheet:
    """Return the formation time with each pair of limits; in bold where no stricter pair is as fast."""
    headings = (
        "acceleration m/s²",
        "jerk m/s³",
        "formed s",
        "largest a_y, a_x m/s²",
        "largest j_y, j_x m/s³",
        "margin",
    )
    best = on_front(points)
    return Sheet(
        "The price of comfort, in `formation`", headings, [_front_row(point, point in best) for point in points]
    )


def _front_row(point: Point, is_best: bool) -> list[str]:
    values = point.result.comfort
    if values is None:
        return [f"{point.acceleration:g}", f"{point.jerk:g}", point.result.failure, "", "", ""]
    a_y, j_y, a_x, j_x = (values[name] for name in NAMES)
    return [
        f"{point.acceleration:g}",
        f"{point.jerk:g}",
        _marked("never" if point.formed_s is None else f"{point.formed_s:.2f}", not is_best),
        f"{a_y:.2f}, {a_x:.2f}",
        f"{j_y:.2f}, {j_x:.2f}",
        f"{point.result.margin:.2f}",
    ]


def _marked(text: str, is_usual: bool) -> str:
    return text if is_usual else f"**{text}**"


def _share(part: int, whole: int) -> str:
    return f"{part} ({100 * part / whole:.1f} %)" if whole else "0"


def _least(values: Sequence[float], unit: str = "") -> str:
    return f"{min(values):.2f} {unit}".rstrip() if values else "-"


def _exceeding(results: Sequence[Result], name: str) -> str:
    values = [(each.comfort or {})[name] for each in results if name in each.exceeded]
    return f"{len(values)}, at most {max(values):.2f} {UNITS[name]}" if values else "0"


def _times(times: Sequence[float | None]) -> str:
    known = sorted(time for time in times if time is not None)
    if not known:
        return "-"
    ninth = known[min(len(known) - 1, int(0.9 * len(known)))]
    return f"{statistics.median(known):.2f} / {ninth:.2f} / {known[-1]:.2f} s"
