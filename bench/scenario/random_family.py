"""The family of random scenarios: vehicles on a road form a platoon; each number is one scenario, for ever the same.

`random:SEED` is its name wherever a scenario is named. The numbers are drawn from a generator that is the bench's own,
in an order that must not change: `tests/scenario/test_random_family.py` holds hashes of some scenarios.
"""

from collections.abc import Callable
from dataclasses import dataclass

from bench.scenario.draw import Draw

VEHICLES = (2, 7)
SPEED_MPS = (12.0, 28.0)
"""Speed of the platoon (m/s)."""
SPEED_DIFFERENCE_MPS = 3.0
"""How much slower or faster a vehicle may start (m/s)."""
GAP_M = (8.0, 15.0)
"""Gap of the platoon, centre to centre (m)."""
START_GAP_M = (9.0, 18.0)
"""Distance between successive vehicles at the start: of all, or of those in one lane where some are abreast (m)."""
ADHESION = (0.4, 0.9)
START_LANES_M = (0.0, 3.5)
PLATOON_LANES_M = (-7.0, -3.5, 0.0, 3.5, 7.0, 10.5)
FREQUENCY_HZ = (0.1, 3.0)
WIND_N = 900.0
DURATION_S = 20.0
LATEST_STEP_S = 8.0

_ABREAST_M = 4.0
"""The largest distance along the road (m) at which the first two vehicles are abreast."""


@dataclass(frozen=True)
class Situation:
    """Vehicles on a road that form a platoon: a random scenario without its name.

    Attributes:
        vehicles: number of vehicles.
        description: what it is, in words.
        lines: the scenario's TOML from `duration_s` on; the last of its tables is that of a vehicle.
    """

    vehicles: int
    description: str
    lines: tuple[str, ...]


@dataclass(frozen=True)
class _Start:
    """The position of a vehicle at the start, m."""

    x: float
    y: float


def random_scenario(seed: int) -> str:
    """Return the scenario of a number from 0 to 2^32 - 1 as TOML."""
    found = situation(seed)
    title = f"# random:{seed}, a scenario of the random family: the same number is the same scenario, for ever."
    name, description = f'name = "random-{seed}"', f'description = "{found.description}"'
    return "\n".join([title, name, description, *found.lines]) + "\n"


def situation(seed: int) -> Situation:
    """Return the situation of a number from 0 to 2^32 - 1."""
    draw = Draw(seed)
    speed, gap = draw.between(*SPEED_MPS), draw.between(*GAP_M)
    lane, adhesion = draw.one_of(PLATOON_LANES_M), draw.between(*ADHESION)
    number = draw.one_of(range(VEHICLES[0], VEHICLES[1] + 1))
    formation = draw.one_of(tuple(_FORMATIONS))
    starts = _FORMATIONS[formation](draw, number)
    speeds = [round(speed + draw.between(-SPEED_DIFFERENCE_MPS, SPEED_DIFFERENCE_MPS), 2) for _ in range(number)]
    tyres = [f"{key} = {_stiffness(draw)}" for key in ("lambda_f", "lambda_r")]
    wind = draw.one_of(([], [f"force_y_n = {_step(draw, 0.0, draw.between(-WIND_N, WIND_N, 0))}"]))
    description = f"{number} vehicles, {formation}, form a platoon at Y = {lane} m and {speed} m/s, adhesion {adhesion}"
    lines = [
        f"duration_s = {DURATION_S}",
        f"seed = {seed}",
        *("", "[platoon]", f"lane_y_m = {lane}", f"speed_mps = {speed}", f"gap_m = {gap}"),
        *("", "[road]", f"mu = {adhesion}", *tyres, *wind),
        *("", "[planner]", f"adhesion = {adhesion}"),
    ]
    for start, own_speed in zip(starts, speeds, strict=True):
        lines += ["", "[[vehicles]]", f"x_m = {start.x}", f"y_m = {start.y}", f"speed_mps = {own_speed}"]
    return Situation(number, description, tuple(lines))


def _one_after_another(draw: Draw, number: int) -> list[_Start]:
    """Return vehicles of which each is behind the one before, in either lane."""
    starts = [_Start(0.0, draw.one_of(START_LANES_M))]
    while len(starts) < number:
        starts.append(_Start(_behind(draw, starts[-1].x), draw.one_of(START_LANES_M)))
    return starts


def _side_by_side(draw: Draw, number: int) -> list[_Start]:
    """Return vehicles in two lanes, whose first ones are abreast."""
    last = dict(zip(START_LANES_M, (0.0, draw.between(-_ABREAST_M, _ABREAST_M)), strict=True))
    starts = [_Start(x, y) for y, x in last.items()]
    while len(starts) < number:
        y = draw.one_of(START_LANES_M)
        last[y] = _behind(draw, last[y])
        starts.append(_Start(last[y], y))
    return starts


def _exactly_abreast(draw: Draw, number: int) -> list[_Start]:
    """Return vehicles in rows of two."""
    starts: list[_Start] = []
    x = 0.0
    while len(starts) < number:
        starts += [_Start(x, y) for y in START_LANES_M]
        x = _behind(draw, x)
    return starts[:number]


_FORMATIONS: dict[str, Callable[[Draw, int], list[_Start]]] = {
    "one after another": _one_after_another,
    "side by side": _side_by_side,
    "exactly abreast": _exactly_abreast,
}
"""How the vehicles start, in the words of the description."""


def _behind(draw: Draw, x: float) -> float:
    return round(x - draw.between(*START_GAP_M), 2)


def _stiffness(draw: Draw) -> str:
    """Return a profile of the cornering stiffness's uncertainty, from -1 to 1 at all times, as TOML."""
    kind = draw.one_of(("constant", "step", "sine"))
    if kind == "constant":
        return str(draw.between(-1.0, 1.0))
    if kind == "step":
        return _step(draw, draw.between(-1.0, 1.0), draw.between(-1.0, 1.0))
    mean = draw.between(-0.5, 0.5)
    amplitude = draw.between(0.0, round(1.0 - abs(mean), 2))
    frequency = draw.between(*FREQUENCY_HZ)
    return f'{{ kind = "sine", mean = {mean}, amplitude = {amplitude}, frequency_hz = {frequency} }}'


def _step(draw: Draw, before: float, after: float) -> str:
    at = draw.between(0.0, LATEST_STEP_S)
    return f'{{ kind = "step", at_s = {at}, before = {before}, after = {after} }}'
