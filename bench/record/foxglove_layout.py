"""A layout for Foxglove and Lichtblick: the road from above, the paper's figures, states, events, the machine.

Import it there as a file; it refers to the topics and fields of a log (`bench.record.writer`).
https://docs.foxglove.dev/docs/visualization/layouts
"""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from typing import Any

from bench.record.drawing import colour
from bench.record.foxglove import MAP_FRAME, frame_id

# Topic with {} for the vehicle, field, and label if a plot has more than one curve per vehicle.
_Curve = tuple[str, str, str]

_PLOTS: tuple[tuple[str, str, Sequence[_Curve]], ...] = (
    (
        "speed",
        "Longitudinal speed: true and reference [m/s]",
        (("/truth/{}", "v_x", ""), ("/signals/{}/Reference", "VelocityX", "reference")),
    ),
    (
        "yaw",
        "Yaw rate: true and reference [rad/s]",
        (("/truth/{}", "gamma", ""), ("/signals/{}/Reference", "YawRate", "reference")),
    ),
    ("lateral", "Lateral position Y [m]", (("/truth/{}", "Y", ""),)),
    ("steering", "Steering angle command [rad]", (("/signals/{}/SteeringCommand", "SteeringAngle", ""),)),
    ("disturbance", "Estimated lateral disturbance [m/s^2]", (("/signals/{}/TrackerDisturbance", "DisturbanceY", ""),)),
    ("solver", "Time of the tracker's step [us]", (("/signals/{}/TrackerTiming", "StepTime", ""),)),
)
_STATES = (("planner", "/signals/{}/PlannerStatus", "State"), ("tracker", "/signals/{}/TrackerStatus", "State"))


def layout(vehicles: int) -> dict[str, Any]:
    """Return the layout for logs of this number of vehicles, as the JSON object of the layout file."""
    names = [frame_id(vehicle) for vehicle in range(1, vehicles + 1)]
    panels: dict[str, Any] = {f"Plot!{key}": _plot(title, curves, names) for key, title, curves in _PLOTS}
    panels["3D!road"] = _road(names)
    panels["StateTransitions!ecus"] = {
        "paths": [
            _path(topic.format(name), field, f"{name}.{role}") for name in names for role, topic, field in _STATES
        ],
        "isSynced": True,
    }
    panels["RosOut!events"] = {"topicToRender": "/events", "minLogLevel": 1, "searchTerms": []}
    plots = [f"Plot!{key}" for key, _, _ in _PLOTS]
    return {
        "configById": panels,
        "globalVariables": {},
        "userNodes": {},
        "playbackConfig": {"speed": 1},
        "layout": _split(
            "row",
            _split("column", "3D!road", _split("column", "StateTransitions!ecus", "RosOut!events", 60), 55),
            _split("row", _stack(plots[::2]), _stack(plots[1::2]), 50),
            45,
        ),
    }


def _plot(title: str, curves: Iterable[_Curve], names: Sequence[str]) -> dict[str, Any]:
    paths = []
    for topic, field, what in curves:
        for vehicle, name in enumerate(names, start=1):
            path = _path(topic.format(name), field, f"{name} {what}".strip())
            # References are drawn thinner than true values.
            paths.append(path | {"color": colour(vehicle), "lineSize": 1.0 if what else 2.0})
    return {
        "title": title,
        "paths": paths,
        "showLegend": True,
        "legendDisplay": "floating",
        "showXAxisLabels": True,
        "showYAxisLabels": True,
        "isSynced": True,
        "xAxisVal": "timestamp",
    }


def _road(names: Sequence[str]) -> dict[str, Any]:
    shown = ["/scene", *(f"/plan/{name}" for name in names)]
    return {
        "followMode": "follow-position",
        "followTf": names[0] if names else MAP_FRAME,
        # From straight above, along the road to the right.
        "cameraState": {
            "perspective": False,
            "distance": 70.0,
            "phi": 0.0,
            "thetaOffset": 0.0,
            "target": [0.0, 0.0, 0.0],
            "targetOffset": [0.0, 0.0, 0.0],
            "targetOrientation": [0.0, 0.0, 0.0, 1.0],
            "fovy": 45.0,
            "near": 0.5,
            "far": 5000.0,
        },
        "topics": {topic: {"visible": True} for topic in shown},
    }


def _path(topic: str, field: str, label: str) -> dict[str, Any]:
    # receiveTime is log_time, the simulated time.
    return {"value": f"{topic}.{field}", "enabled": True, "timestampMethod": "receiveTime", "label": label}


def _split(direction: str, first: Any, second: Any, percentage: float) -> dict[str, Any]:
    return {"direction": direction, "first": first, "second": second, "splitPercentage": percentage}


def _stack(panels: Sequence[str]) -> Any:
    first, *rest = panels
    return _split("column", first, _stack(rest), 100 / len(panels)) if rest else first
