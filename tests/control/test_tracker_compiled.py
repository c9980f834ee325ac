"""A course of the tracker gives the same compiled and interpreted: reference, observer, target, gain and input."""

import json
import os
import subprocess
import sys

import numpy as np

import bench.control.tracker
from bench.compiled.finder import INTERPRETED, ROOT, is_wanted
from bench.control.settings import TrackerSettings
from bench.control.tracker import Tracker
from platoon_fmu.interpreter import interpreter
from platoon_fmu.parameters import VehicleParameters

STEPS = 60


def answers() -> list[list[float]]:
    """What the tracker returns along random references, with jumps that bring the inputs to their bounds."""
    found = []
    for seed, settings in enumerate((TrackerSettings(), TrackerSettings(offset_free=False, steering_max_rad=0.02))):
        random = np.random.default_rng(seed)
        tracker = Tracker(settings, VehicleParameters(), 0.01)
        v, gamma = 20.0, 0.0
        for k in range(STEPS):
            jump = 5.0 if k % 20 == 10 else 0.02
            then = (v + random.normal() * jump, gamma + random.normal() * 0.1 * jump)
            xi = np.array([v, 0.0, gamma]) + random.normal(size=3) * [0.1, 0.05, 0.02]
            applied = None if k % 3 else random.normal(size=3) * [0.02, 500.0, 200.0]
            out = tracker.step(xi, (v, gamma), then, applied)
            vectors = (out.u, out.wheel_forces, out.reference, out.reference_u, out.disturbance, out.target)
            found.append([*np.concatenate(vectors).tolist(), out.steering, out.tau, out.status, out.source])
            v, gamma = then
    return found


def main() -> None:
    json.dump(answers(), sys.stdout)


def test_machine_code_and_plain_text_give_the_same() -> None:
    settings = os.environ | {INTERPRETED: "1", "PYTHONPATH": str(ROOT)}
    command = [*interpreter(), "-c", f"from {__name__} import main; main()"]
    plain = json.loads(subprocess.run(command, env=settings, capture_output=True, text=True, check=True).stdout)
    assert len({tuple(each) for each in plain}) == 2 * STEPS
    np.testing.assert_allclose(answers(), plain, rtol=1e-9, atol=1e-9)
    if is_wanted():
        assert type(bench.control.tracker.own_programs).__name__ == "cython_function_or_method"
