"""The documentation page inside the FMU: documentation.html with its tables and a computed example filled in.

The example is computed from the equations, not with a binary, so that it can be drawn when cross-compiling. Values are
rounded before they are drawn; the same model gives the same bytes.
"""

from __future__ import annotations

import html
from collections.abc import Iterable, Sequence
from dataclasses import dataclass, fields
from pathlib import Path
from string import Template

import casadi as ca
import numpy as np
from numpy.typing import NDArray

from platoon_fmu import interface
from platoon_fmu.codegen import SymbolicModel
from platoon_fmu.interface import Variable
from platoon_fmu.parameters import VehicleParameters

_PACKAGE = Path(__file__).resolve().parent

_SPEED, _STEER, _STEER_AT = 20.0, 0.03, 0.5
_DURATION, _STEP, _EVERY = 4.0, 0.001, 10
_DEGREE = np.pi / 180


def page(model: SymbolicModel) -> bytes:
    """The page, one HTML file without references outside the FMU."""
    example = _step_steer(model)
    text = Template((_PACKAGE / "documentation.html").read_text(encoding="utf-8")).substitute(
        icon=(_PACKAGE / "icon.svg").read_text(encoding="utf-8").strip(),
        n_states=len(interface.STATES),
        solver=_table(_SOLVER_COLUMNS, [("", (*interface.SOLVER_SETTINGS, interface.SOLVER))]),
        plot=_plot(example),
        caption=_caption(example),
        parameters=_table(_PARAMETER_COLUMNS, [("", interface.PARAMETERS)]),
        variables=_table(_COLUMNS, _GROUPS),
    )
    return text.encode()


# ---- tables ----

_GROUPS = (
    ("States", interface.STATES),
    ("Their derivatives", interface.DERIVATIVES),
    ("Other outputs", interface.OUTPUTS),
    ("Inputs", interface.INPUTS),
    ("Start values", interface.STARTS),
    ("Time", (interface.TIME,)),
    ("Solver, in Co-Simulation", (*interface.SOLVER_SETTINGS, interface.SOLVER)),
    ("Parameters: described above", interface.PARAMETERS),
)
_COLUMNS = ("name", "causality", "variability", "unit", "start", "min", "max", "description")
_PARAMETER_COLUMNS = ("name", "unit", "start", "min", "max", "meaning", "source")
_SOLVER_COLUMNS = ("name", "unit", "start", "min", "max", "description")
_NUMBERS = ("start", "min", "max")
_TEXTS = ("description", "meaning", "source")


def _number(value: float | None) -> str:
    return "" if value is None else f"{value:.6g}".replace("-", "−")


def _cells(variable: Variable) -> dict[str, str]:
    """A variable's cells in a table, by column."""
    origin = next((field.metadata for field in fields(VehicleParameters) if field.name == variable.name), None)
    items = "; ".join(f"{i} {name}: {text}" for i, (name, text) in enumerate(variable.items, start=1))
    return {
        "name": variable.name,
        "causality": variable.causality,
        "variability": variable.variability,
        "unit": variable.unit,
        "start": _number(variable.start),
        "min": _number(variable.minimum),
        "max": _number(variable.maximum),
        "description": f"{variable.description} ({items})" if items else variable.description,
        "meaning": origin["description"] if origin else "",
        "source": origin["source"] if origin else "",
    }


def _class(column: str) -> str:
    return "number" if column in _NUMBERS else "text" if column in _TEXTS else "plain"


def _row(columns: Sequence[str], variable: Variable) -> str:
    cells = _cells(variable)
    name, *others = columns
    row = f'<tr><th scope="row"><code>{html.escape(cells[name])}</code></th>'
    row += "".join(f'<td class="{_class(column)}">{html.escape(cells[column])}</td>' for column in others)
    return row + "</tr>\n"


def _table(columns: Sequence[str], groups: Iterable[tuple[str, Sequence[Variable]]]) -> str:
    head = "".join(f'<th scope="col" class="{_class(column)}">{column}</th>' for column in columns)
    body = ""
    for title, variables in groups:
        if title:
            body += f'<tr><th class="group" colspan="{len(columns)}" scope="rowgroup">{title}</th></tr>\n'
        body += "".join(_row(columns, variable) for variable in variables)
    return f"<table>\n<thead><tr>{head}</tr></thead>\n<tbody>\n{body}</tbody>\n</table>"


# ---- the example ----


@dataclass(frozen=True)
class _Example:
    """A step of the steering angle at speed: time [s], yaw rate [deg/s] and lateral acceleration [m/s^2], (rows,)."""

    t: NDArray[np.float64]
    yaw_rate: NDArray[np.float64]
    acceleration: NDArray[np.float64]


def _start_values(variables: Sequence[Variable], **changed: float) -> NDArray[np.float64]:
    return np.array([changed.get(variable.name, variable.start or 0.0) for variable in variables])


def _step_steer(model: SymbolicModel) -> _Example:
    """Integrated with the classical Runge-Kutta method, as in Co-Simulation."""
    slope = ca.Function("slope", [model.x, model.u, model.p], [model.derivatives])
    outputs = ca.Function("outputs", [model.x, model.u, model.p], [model.outputs])
    initial = ca.Function("initial", [model.p], [model.initial])
    k1 = slope(model.x, model.u, model.p)
    k2 = slope(model.x + _STEP / 2 * k1, model.u, model.p)
    k3 = slope(model.x + _STEP / 2 * k2, model.u, model.p)
    k4 = slope(model.x + _STEP * k3, model.u, model.p)
    step = ca.Function("step", [model.x, model.u, model.p], [model.x + _STEP / 6 * (k1 + 2 * k2 + 2 * k3 + k4)])

    p = _start_values((*interface.PARAMETERS, *interface.STARTS), v_x_start=_SPEED)
    straight = _start_values(interface.INPUTS)
    steered = _start_values(interface.INPUTS, steering_angle=_STEER)
    gamma = [v.name for v in interface.STATES].index("gamma")
    a_y = [v.name for v in interface.OUTPUTS].index("a_y")
    x, rows = initial(p), []
    for i in range(round(_DURATION / _STEP) + 1):
        u = straight if i < round(_STEER_AT / _STEP) else steered
        if i % _EVERY == 0:
            rows.append((i * _STEP, float(x[gamma]) / _DEGREE, float(outputs(x, u, p)[a_y])))
        x = step(x, u, p)
    return _Example(*np.array(rows).T)


def _caption(example: _Example) -> str:
    return (
        f"Step steer: at {_SPEED:g} m/s ({_SPEED * 3.6:g} km/h), rolling freely on a dry road, the front wheels are "
        f"turned by {_STEER:g} rad ({_STEER / _DEGREE:.2f} degrees) at {_STEER_AT:g} s. The yaw rate rises to "
        f"{example.yaw_rate.max():.1f} degrees per second; after {_DURATION:g} s the car, slowed by drag, rolling "
        f"resistance and the steered wheels, turns with {example.yaw_rate[-1]:.1f} degrees per second at "
        f"{example.acceleration[-1]:.2f} m/s<sup>2</sup> to the left."
    )


# ---- its picture ----

_WIDTH, _PANEL, _LEFT, _RIGHT, _TOP, _GAP = 860, 190, 56, 14, 26, 40


def _ticks(highest: float) -> list[float]:
    """Round values from 0 to the first that is at least the highest value."""
    size = next(s for s in (0.5, 1, 2, 5, 10, 20) if highest / s <= 5)
    return [size * i for i in range(int(np.ceil(highest / size)) + 1)]


def _panel(t: NDArray[np.float64], y: NDArray[np.float64], name: str, kind: str, top: float) -> str:
    """One curve over time with its grid and labels; the axes' upper edge is at `top`."""
    ticks = _ticks(float(y.max()))
    bottom, width = top + _PANEL, _WIDTH - _LEFT - _RIGHT

    def at(time: float) -> float:
        return _LEFT + width * time / _DURATION

    def height(value: float) -> float:
        return bottom - _PANEL * value / ticks[-1]

    lines = [f'<text class="name" x="{_LEFT}" y="{top - 10}">{name}</text>']
    for tick in ticks:
        lines.append(f'<path class="grid" d="M{_LEFT} {height(tick):.1f}h{width}"/>')
        lines.append(f'<text x="{_LEFT - 8}" y="{height(tick) + 4.5:.1f}" text-anchor="end">{tick:g}</text>')
    for second in range(int(_DURATION) + 1):
        lines.append(f'<path class="grid" d="M{at(second):.1f} {top}v{_PANEL}"/>')
        lines.append(f'<text x="{at(second):.1f}" y="{bottom + 17}" text-anchor="middle">{second}</text>')
    points = " ".join(f"{at(time):.1f},{height(value):.1f}" for time, value in zip(t, y, strict=True))
    lines.append(f'<polyline class="curve {kind}" points="{points}"/>')
    return "\n".join(lines)


def _plot(example: _Example) -> str:
    second = _TOP + _PANEL + _GAP + 8
    total = second + _PANEL + _GAP
    panels = (
        _panel(example.t, example.yaw_rate, "yaw rate, degrees per second", "one", _TOP),
        _panel(example.t, example.acceleration, "lateral acceleration, m/s²", "two", second),
    )
    label = f'<text x="{(_LEFT + _WIDTH - _RIGHT) / 2:g}" y="{total - 4}" text-anchor="middle">time, s</text>'
    title = "<title>Yaw rate and lateral acceleration over time after a step of the steering angle</title>"
    body = "\n".join((title, *panels, label))
    return f'<svg xmlns="http://www.w3.org/2000/svg" role="img" viewBox="0 0 {_WIDTH} {total}">\n{body}\n</svg>'
