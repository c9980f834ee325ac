"""The report's figures as data: which curves, over what, with which limits and marks. The page draws them.

Figures 7 to 13 are those of the paper, with its numbers.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import asdict, replace
from typing import Any

import numpy as np

from bench.analysis.boundary import margin, yaw_rate_max
from bench.analysis.bus_load import BusLoad
from bench.analysis.clearance import abreast, clearances
from bench.analysis.comfort import limits_of
from bench.analysis.figure import Curve, Figure, Line
from bench.analysis.metrics import CLEARANCE_M, CLEARANCE_WITH_FAULT_M
from bench.analysis.motion import Array
from bench.analysis.requirements import LEAST_DISTANCE_M
from bench.analysis.series import Pool, Series, Span
from bench.analysis.step_times import longest, longest_in_ms
from bench.analysis.timing import histograms, timing
from bench.control.comfort import JERK_WINDOW_S
from bench.names import V2V, vehicle_of
from bench.record import Run
from bench.record.drawing import colour, lane_edges
from bench.record.time_join import same_times
from platoon_fmu.parameters import BODY

NOTHING_YET = (0.0, 0.0)
"""An empty span: all figures, their columns empty, for a run that has not started."""

_ALL_PAIRS_UP_TO = 4
_WHEELS = ("FL", "FR", "RL", "RR")
_PAPER_BOUNDARY_FIGURES = {1: "Fig. 11", 2: "Fig. 12", 3: "Fig. 13"}


def pool_of(run: Run, span: Span) -> Pool:
    """Return the values that a span of a run in progress adds to the columns, which start empty with `NOTHING_YET`.

    Raises:
        BadInput: the log has no scenario, or no ground truth of all vehicles at a common time.
    """
    return Figures(run, span=span).columns


class Figures:
    """All figures of a run and the pool of values shared by their curves.

    Attributes:
        figures: in page order.
        not_sent: what is not drawn because the ECUs did not send it: the titles of figures, with the vehicles if it is
            not all of them.
    """

    def __init__(self, run: Run, buses: Sequence[BusLoad] = (), span: Span | None = None) -> None:
        """Create the figures of `run` and of the load of its `buses`.

        With `span` they are those of a run in progress: only figures that do not need the complete run, with the values
        of the span.

        Raises:
            BadInput: the log has no ground truth or no scenario.
        """
        self._run = run
        self._series = Series(run, span)
        self._truth = self._series.truth
        self._scenario = run.scenario
        self._vehicles = range(1, run.vehicles + 1)
        self.figures: list[Figure] = []
        self.not_sent: list[str] = []
        self._series.put("t", self._truth.t)
        self._paper_figures()
        self._more_of_the_motion()
        self._seen_from_above()
        self._comfort()
        self._commands()
        self._estimates()
        self._flocking()
        self._solvers()
        if not self._series.live:
            self._histogram(_SOLVERS)
            self._real_time()
        self._buses(buses)

    @property
    def pool(self) -> Pool:
        """Key -> values; `t` is time in s."""
        return self._series.pool

    @property
    def columns(self) -> Pool:
        """The part of the pool that is over time: columns of equal length."""
        return {key: self.pool[key] for key in self._series.over_time}

    def as_dict(self) -> dict[str, Any]:
        """Return figures, pool and what was not sent as JSON-serialisable values."""
        return {
            "figures": [asdict(figure) for figure in self.figures],
            "pool": self.pool,
            "not_sent": self.not_sent,
        }

    def _paper_figures(self) -> None:
        truth, goal = self._truth, self._scenario.platoon
        for index, v in enumerate(self._vehicles):
            values = {
                "X": truth.X,
                "Y": truth.Y,
                "psi": truth.psi,
                "v_x": truth.v_x,
                "gamma": truth.gamma,
            }
            for name, rows in values.items():
                self._series.put(f"{v}.{name}", rows[index])
        lanes = sorted({goal.lane_y_m, *(vehicle.y_m for vehicle in self._scenario.vehicles)})
        group = "The paper's figures"
        self._add(
            Figure(
                "fig7",
                "Fig. 7  Motion trails",
                group,
                "X, along the road [m]",
                "Y [m]",
                [self._curve(v, f"{v}.X", f"{v}.Y") for v in self._vehicles],
                caption=f"Platoon lane at Y = {goal.lane_y_m:g} m; Y is enlarged relative to X.",
                time=False,
                wide=True,
                lanes=lane_edges(lanes),
                y_range=[lane_edges(lanes)[0][0], lane_edges(lanes)[-1][0]],
            )
        )
        yaw = [self._curve(v, "t", f"{v}.psi") for v in self._vehicles]
        self._add(self._over_time("fig8", "Fig. 8  Yaw angle", group, "yaw angle [rad]", yaw))
        speed = self._with_reference("v_x", "VelocityX")
        lines = [Line(goal.speed_mps, "platoon")]
        self._add_referred(self._over_time("fig9", "Fig. 9  Longitudinal speed", group, "v_x [m/s]", speed, lines))
        rate = self._with_reference("gamma", "YawRate")
        self._add_referred(self._over_time("fig10", "Fig. 10  Yaw rate", group, "γ [rad/s]", rate))
        for v in self._vehicles:
            self._boundary_figure(v, group)

    def _boundary_figure(self, v: int, group: str) -> None:
        """Add the yaw rate of vehicle `v` over its speed, with the stability boundary."""
        truth, index = self._truth, v - 1
        if self._series.live:
            ends = (self._scenario.vehicles[index].speed_mps, self._scenario.platoon.speed_mps)
            low, high, mu = min(ends), max(ends), self._scenario.planner.adhesion
        else:
            low, high = float(truth.v_x[index].min()), float(truth.v_x[index].max())
            mu = float(truth.mu[index].min())
        spare = max(0.5, 2.0 - (high - low) / 2.0)
        speeds = np.linspace(max(1.0, low - spare), high + spare, 60)
        limit = yaw_rate_max(speeds, mu)
        self._series.put_as_is(f"{v}.limit_v", speeds)
        self._series.put_as_is(f"{v}.limit_up", limit)
        self._series.put_as_is(f"{v}.limit_down", -limit)
        number = _PAPER_BOUNDARY_FIGURES.get(v, "As Fig. 11")
        curves = [
            Curve("boundary", f"{v}.limit_v", f"{v}.limit_up", "limit", at="", label="upper boundary"),
            Curve("", f"{v}.limit_v", f"{v}.limit_down", "limit", at="", label="lower boundary"),
            self._curve(v, f"{v}.v_x", f"{v}.gamma"),
        ]
        self._add(
            Figure(
                f"fig{10 + v}",
                f"{number}  Yaw rate over speed, vehicle {v}",
                group,
                "v_x [m/s]",
                "γ [rad/s]",
                curves,
                caption=f"Boundary |γ| ≤ 0.85 μ g / v_x at μ = {mu:g}.",
                time=False,
                x_range=[float(speeds[0]), float(speeds[-1])],
            )
        )

    def _more_of_the_motion(self) -> None:
        truth, goal = self._truth, self._scenario.platoon
        group = "Formation and safety"
        if len(truth.order) > 1:
            minimum = (
                []
                if abreast([each.x_m for each in self._scenario.vehicles])
                else [Line(LEAST_DISTANCE_M, "minimum", limit=True)]
            )
            self._add(
                self._over_time(
                    "distances",
                    "Distances between vehicles",
                    group,
                    "centre to centre [m]",
                    self._pair_curves("distance", truth.distances()),
                    [Line(goal.gap_m, "gap"), *minimum],
                    y_range=[0.0, goal.gap_m],
                )
            )
            self._add(
                self._over_time(
                    "clearances",
                    "Clearance between vehicles",
                    group,
                    "body to body [m]",
                    self._pair_curves("clearance", clearances(truth)),
                    [self._least_clearance()],
                    y_range=[0.0, goal.gap_m - BODY.length],
                )
            )
        for index, v in enumerate(self._vehicles):
            self._series.put(f"{v}.lateral", truth.Y[index] - goal.lane_y_m)
            self._series.put(f"{v}.margin", margin(truth.gamma[index], truth.v_x[index], truth.mu[index]))
        lateral = [self._curve(v, "t", f"{v}.lateral") for v in self._vehicles]
        self._add(
            self._over_time("lateral", "Offset from the platoon's lane", group, "Y − Y_lane [m]", lateral, [Line(0.0)])
        )
        margins = [self._curve(v, "t", f"{v}.margin") for v in self._vehicles]
        self._add(
            self._over_time(
                "margin",
                "Margin to the stability boundary",
                group,
                "1 − |γ| / γ_max",
                margins,
                [Line(0.0, "boundary", limit=True)],
                y_range=[0.0, 1.0],
            )
        )

    def _pair_curves(self, quantity: str, values: dict[tuple[int, int], Array]) -> list[Curve]:
        """Return all pairs of a small platoon; of a larger one its neighbours and the minimum over all pairs."""
        truth = self._truth
        neighbours = [tuple(sorted(pair)) for pair in zip(truth.order, truth.order[1:], strict=False)]
        curves = []
        for index, (i, j) in enumerate(neighbours, start=1):
            curves.append(self._pair_curve(quantity, i, j, values[i, j], colour(len(truth.order) + index), dash=False))
        if len(truth.order) <= _ALL_PAIRS_UP_TO:
            others = [pair for pair in values if pair not in neighbours]
            for index, (i, j) in enumerate(others, start=len(neighbours) + 1):
                curves.append(
                    self._pair_curve(quantity, i, j, values[i, j], colour(len(truth.order) + index), dash=True)
                )
        else:
            self._series.put(f"{quantity}.least", np.min(list(values.values()), axis=0))
            curves.append(Curve("minimum of all pairs", "t", f"{quantity}.least", "ink", dash=True))
        return curves

    def _pair_curve(self, quantity: str, i: int, j: int, values: Array, line_colour: str, *, dash: bool) -> Curve:
        key = f"{quantity}.{i + 1}-{j + 1}"
        self._series.put(key, values)
        return Curve(f"{i + 1} – {j + 1}", "t", key, line_colour, dash)

    def _least_clearance(self) -> Line:
        """Return the line of the clearance to keep; a run that is still going on may yet have a fault injected."""
        if self._scenario.faults:
            return Line(CLEARANCE_WITH_FAULT_M, "minimum with a fault", limit=True)
        return Line(CLEARANCE_M, "minimum without a fault", limit=True)

    def _comfort(self) -> None:
        """Add acceleration and jerk in the vehicle's axes, with the limits of comfort if the run has any."""
        limits = limits_of(self._scenario)
        mean = f"averaged over {JERK_WINDOW_S:g} s"
        for name, title, unit in (
            ("a_y", "Lateral acceleration", "m/s²"),
            ("jerk_y", f"Lateral jerk, {mean}", "m/s³"),
            ("a_x", "Longitudinal acceleration", "m/s²"),
            ("jerk_x", f"Longitudinal jerk, {mean}", "m/s³"),
        ):
            limit = limits.get(name)
            lines = [Line(limit, "limit of comfort", limit=True), Line(-limit, limit=True)] if limit else []
            curves = [self._curve(v, "t", f"{v}.{name}") for v in self._vehicles if self._put_felt(v, name)]
            self._add_if(self._over_time(name.replace("_", ""), title, "Comfort", f"{name} [{unit}]", curves, lines))

    def _put_felt(self, v: int, name: str) -> bool:
        values = self._series.felt(v, name)
        if values is None:
            return False
        self._series.put(f"{v}.{name}", values)
        return True

    def _seen_from_above(self) -> None:
        """Put what only the animation shows: each vehicle's steering angle and the target position of its planner."""
        for v in self._vehicles:
            steering = self._series.true(v, "steering_angle")
            if steering is not None:
                self._series.put(f"{v}.steering", steering)
            for axis in "XY":
                self._put_signal(f"{v}.target.{axis}", v, "PlannerTarget", f"Target{axis}")

    def _commands(self) -> None:
        group = "Commands"
        steering = self._each("SteeringCommand", "SteeringAngle", "command.delta")
        self._add_sent(self._over_time("steering", "Steering angle command", group, "δ [rad]", steering))
        for v in self._vehicles:
            curves = []
            for wheel in _WHEELS:
                message = "TorqueCommandFront" if wheel.startswith("F") else "TorqueCommandRear"
                key = f"{v}.torque.{wheel}"
                if self._put_signal(key, v, message, f"Torque{wheel}"):
                    axle_colour = colour(v) if wheel.startswith("F") else "ink"
                    curves.append(Curve(wheel, "t", key, axle_colour, dash=wheel.endswith("R"), step=True))
            self._add_sent(
                self._over_time(f"torque{v}", f"Wheel torque commands, vehicle {v}", group, "torque [N m]", curves), [v]
            )

    def _estimates(self) -> None:
        group = "Disturbance estimates"
        for signal, title, unit in (
            ("DisturbanceX", "longitudinal", "m/s²"),
            ("DisturbanceY", "lateral", "m/s²"),
            ("DisturbanceYaw", "yaw", "rad/s²"),
        ):
            curves = self._each("TrackerDisturbance", signal, signal)
            self._add_sent(
                self._over_time(signal.lower(), f"Disturbance estimate, {title}", group, f"estimate [{unit}]", curves)
            )

    def _flocking(self) -> None:
        group = "Optimised flocking parameters"
        for message, solid, dashed, title, unit in (
            ("PlannerPotential", "Ga", "Gb", "Potential: G_a (solid), G_b (dashed)", "m/s²"),
            ("PlannerGains", "P11", "P12", "Position gains: p11 (solid), p12 (dashed)", "1/s²"),
            ("PlannerGains", "P21", "P22", "Velocity gains: p21 (solid), p22 (dashed)", "1/s"),
        ):
            curves = self._each(message, solid, f"flock.{solid}", step=True, what=solid)
            curves += self._each(message, dashed, f"flock.{dashed}", dash=True, step=True, what=dashed)
            self._add_sent(
                self._over_time(f"flock{solid}", title, group, f"value [{unit}]", curves, y_range=[0.0, 1.0])
            )

    def _solvers(self) -> None:
        group = _SOLVERS
        timings = (
            ("TrackerTiming", "SolveTime", "Tracker: solve time of the robust MPC"),
            ("TrackerTiming", "StepTime", "Tracker: time of the complete step"),
            ("PlannerTiming", "StepTime", "Planner: time of the complete step"),
        )
        for message, signal, title in timings:
            curves = self._each(message, signal, f"{message}.{signal}", factor=1e-3, peak=True, points=True)
            self._add_sent(self._timing(f"{message}{signal}".lower(), title, group, curves, self._longest(message)))
        iterations = self._each("TrackerStatus", "Iterations", "iterations", peak=True, points=True)
        self._add_sent(self._over_time("iterations", "Iterations of the solver", group, "iterations", iterations))
        tau = self._each("TrackerStatus", "Tau", "tau", peak=True)
        self._add_sent(self._over_time("tau", "Cost bound τ", group, "τ", tau))

    def _longest(self, message: str) -> str:
        """Return the sentence of what each time of a message is the longest; empty if every step has one."""
        of = longest(longest_in_ms(self._run, message))
        return f"Each is the {of}." if of else ""

    def _timing(self, figure_id: str, title: str, group: str, curves: list[Curve], of: str) -> Figure:
        """Return a figure of times in ms, cut off so that a few outliers do not flatten the other values."""
        times = [value for curve in curves for value in self.pool[curve.y] if value is not None] or [0.0]
        highest, usual = max(times), 1.6 * float(np.percentile(times, 99))
        if highest <= 2.0 * usual:
            return self._over_time(figure_id, title, group, "time [ms]", curves, caption=of, y_range=[0.0, 1.0])
        caption = f"{of} Maximum, outside the figure: {highest:.1f} ms.".strip()
        return replace(self._over_time(figure_id, title, group, "time [ms]", curves, caption=caption), y_top=usual)

    def _histogram(self, group: str) -> None:
        """Add the distribution of the tracker's solve times over all vehicles."""
        found = [self._series.signal(v, "TrackerTiming", "SolveTime", points=True) for v in self._vehicles]
        times = np.concatenate([values for values in found if values is not None] or [np.empty(0)]) * 1e-3
        times = times[np.isfinite(times) & (times > 0)]
        if not len(times):
            return
        of = self._longest("TrackerTiming")
        # Rare long solves would squeeze all others into one bar; the last bar counts them.
        top = float(np.percentile(times, 99.5))
        counts, edges = np.histogram(np.minimum(times, top), bins=60)
        self._series.put_as_is("hist.x", edges)
        self._series.put_as_is("hist.y", np.append(counts, counts[-1]).astype(np.float64))
        self._add(
            Figure(
                "histogram",
                "Distribution of the robust MPC's solve time",
                group,
                "time [ms]",
                "solves",
                [Curve("all vehicles", "hist.x", "hist.y", "ink", at="", step=True, fill=True)],
                caption=f"{of} The last bar includes all longer solves (over {top:.1f} ms).".strip(),
                time=False,
                y_range=[0.0, 1.0],
            )
        )

    def _real_time(self) -> None:
        """Add the distributions of the response times of a real-time run."""
        times = timing(self._run)
        if times is None:
            return
        found = histograms(times)
        self._series.put_as_is("rt.x", np.array(found["edges_ms"]))
        for role in ("planner", "tracker", "plant"):
            nodes = [node for node in found["nodes"] if node["name"].endswith(f".{role}")]
            curves = [
                self._counted(node["name"], node["counts"], colour(number)) for number, node in enumerate(nodes, 1)
            ]
            missed = sum(node["late"] + node["missing"] for node in nodes)
            of = sum(node["cycles"] for node in nodes)
            jitter = max((node["jitter_ms"] for node in nodes), default=0.0)
            caption = f"{missed} of {of} deadlines missed; jitter up to {jitter:.1f} ms."
            self._real_time_figure(role, f"Response time, {role}", curves, caption)
        late = self._counted("BenchSync", found["clock"]["counts"], "ink")
        caption = f"At most {found['clock'].get('max_ms', 0.0):.2f} ms."
        self._real_time_figure("clock", "Lateness of the clock", [late], caption)

    def _counted(self, name: str, counts: Sequence[int], line_colour: str) -> Curve:
        self._series.put_as_is(f"rt.{name}", np.array([*counts, counts[-1]], np.float64))
        return Curve(name, "rt.x", f"rt.{name}", line_colour, at="", step=True)

    def _real_time_figure(self, name: str, title: str, curves: list[Curve], caption: str) -> None:
        ids, group, label = f"realtime{name}", "Real time", "time from BenchSync [ms]"
        figure = Figure(ids, title, group, label, "cycles", curves, caption, time=False, y_range=[0.0, 1.0])
        self._add_if(figure)

    def _buses(self, buses: Sequence[BusLoad]) -> None:
        curves = []
        for bus in buses:
            t = self._truth.t
            values = np.where((t >= bus.t[0]) & (t <= bus.t[-1]), 0.0, np.nan)
            rows, at = same_times(bus.t, t)
            values[at] = 100.0 * bus.load[rows]
            self._series.put(f"load.{bus.bus}", values, peak=True)
            vehicle = vehicle_of(bus.bus)
            line_colour = "ink" if vehicle is None else colour(vehicle)
            curves.append(Curve(bus.bus, "t", f"load.{bus.bus}", line_colour, dash=bus.bus == V2V, step=True))
        lines = [Line(100.0, "full", limit=True)] if max((bus.worst for bus in buses), default=0.0) > 0.8 else []
        self._add_if(
            replace(
                self._over_time("busload", "Bus load per cycle", "Buses", "bus load [%]", curves, lines),
                y_range=[0.0, 1.0],
                wide=True,
            )
        )

    def _with_reference(self, truth_name: str, signal: str) -> list[Curve]:
        curves = [self._curve(v, "t", f"{v}.{truth_name}") for v in self._vehicles]
        return curves + self._each("Reference", signal, f"ref.{signal}", dash=True, what="reference")

    def _each(
        self,
        message: str,
        signal: str,
        key: str,
        *,
        dash: bool = False,
        step: bool = False,
        points: bool = False,
        factor: float = 1.0,
        peak: bool = False,
        what: str = "",
    ) -> list[Curve]:
        """Return one curve of a signal for each vehicle that has it; `what` tells it from others of the vehicle."""
        have = [
            v
            for v in self._vehicles
            if self._put_signal(f"{v}.{key}", v, message, signal, factor=factor, peak=peak, hold=step, points=points)
        ]
        curves = [self._curve(v, "t", f"{v}.{key}", dash=dash, step=step, points=points) for v in have]
        return [replace(curve, label=f"{curve.name} {what}") for curve in curves] if what else curves

    def _curve(self, v: int, x: str, y: str, *, dash: bool = False, step: bool = False, points: bool = False) -> Curve:
        return Curve(f"vehicle {v}", x, y, colour(v), dash, step=step, points=points)

    def _over_time(
        self,
        figure_id: str,
        title: str,
        group: str,
        y_label: str,
        curves: list[Curve],
        lines: Sequence[Line] = (),
        *,
        caption: str = "",
        y_range: Sequence[float] = (),
    ) -> Figure:
        return Figure(figure_id, title, group, "time [s]", y_label, curves, caption, list(lines), y_range=list(y_range))

    def _add(self, figure: Figure) -> None:
        self.figures.append(figure)

    def _add_sent(self, figure: Figure, of: Sequence[int] = ()) -> None:
        """Add a figure of what the ECUs of all vehicles, or `of` some, send; note who did not."""
        if not figure.curves:
            self.not_sent.append(figure.title)
            return
        missing = [] if of else self._without(figure.curves)
        if missing:
            self.not_sent.append(f"{figure.title} ({named(missing)})")
            figure = replace(figure, caption=f"{figure.caption} Not sent: {named(missing)}.".strip())
        self._add(figure)

    def _add_referred(self, figure: Figure) -> None:
        """Add a figure of the motion in which the planners' references are dashed; note who sent none."""
        missing = self._without([curve for curve in figure.curves if curve.dash])
        caption = _DASHED if len(missing) < len(self._vehicles) else ""
        if missing:
            self.not_sent.append(f"Reference in {figure.title} ({named(missing)})")
            caption = f"{caption} No reference was sent: {named(missing)}.".strip()
        self._add(replace(figure, caption=caption))

    def _without(self, curves: Sequence[Curve]) -> list[int]:
        """Return the vehicles that have none of the curves."""
        names = {curve.name for curve in curves}
        return [v for v in self._vehicles if f"vehicle {v}" not in names]

    def _add_if(self, figure: Figure) -> None:
        if figure.curves:
            self._add(figure)

    def _put_signal(
        self,
        key: str,
        v: int,
        message: str,
        signal: str,
        *,
        factor: float = 1.0,
        peak: bool = False,
        hold: bool = False,
        points: bool = False,
    ) -> bool:
        values = self._series.signal(v, message, signal, hold=hold, points=points)
        if values is None:
            return False
        self._series.put(key, values * factor, peak=peak)
        return True


_SOLVERS = "Solver and computing time"
_DASHED = "Dashed: the planner's reference for the same cycle."


def named(vehicles: Sequence[int]) -> str:
    """Return vehicles as text: `vehicle 2`, `vehicles 1, 3`."""
    return f"vehicle{'s' if len(vehicles) > 1 else ''} {', '.join(map(str, vehicles))}"
