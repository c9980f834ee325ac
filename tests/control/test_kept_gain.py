"""The kept gain of the observer is the designed one, and no broken file passes for it."""

import subprocess
import sys

import numpy as np
import pytest

from bench.control import kept_gain
from bench.control.kept_gain import observer_gain
from bench.control.observer_gain import design_gain
from tests.control.operating_points import MODEL, T

MODELS = [MODEL.linearise(np.array([v, 0.0, 0.0]), np.zeros(5)).A for v in (5.0, 10.0, 20.0, 40.0)]
RATE = 0.9
LOADED = """
import numpy as np
import sys
from bench.control.settings import TrackerSettings
from bench.control.tracker import Tracker
from platoon_fmu.parameters import VehicleParameters
tracker = Tracker(TrackerSettings(), VehicleParameters(), 0.01)
tracker.step(np.array([20.0, 0.1, 0.0]), (20.0, 0.0), (20.1, 0.01))
print(sorted({"clarabel", "cvxpy", "scipy"} & set(sys.modules)))
"""


@pytest.fixture
def folder(tmp_path, monkeypatch):
    monkeypatch.setattr(kept_gain, "library_folder", lambda: tmp_path / "compiled")
    return tmp_path / "observer"


def test_gain_is_the_designed_one_before_and_after_it_is_kept(folder):
    designed = design_gain(MODELS, T, RATE)
    np.testing.assert_array_equal(observer_gain(MODELS, T, RATE), designed)
    assert len(list(folder.iterdir())) == 1
    np.testing.assert_array_equal(observer_gain(MODELS, T, RATE), designed)


def test_each_design_has_its_own_file(folder):
    for rate in (RATE, 0.95):
        observer_gain(MODELS, T, rate)
    assert len(list(folder.iterdir())) == 2


@pytest.mark.parametrize("broken", [b"", b"no array", np.zeros(3), np.zeros((6, 3)), np.full((6, 3), np.nan)])
def test_broken_file_is_designed_again(folder, broken):
    designed = observer_gain(MODELS, T, RATE)
    (file,) = folder.iterdir()
    if isinstance(broken, bytes):
        file.write_bytes(broken)
    else:
        np.save(file, broken)
    np.testing.assert_array_equal(observer_gain(MODELS, T, RATE), designed)
    np.testing.assert_array_equal(np.load(file), designed)


def test_folder_that_cannot_be_written_does_no_harm(folder):
    folder.write_text("in the way")
    assert observer_gain(MODELS, T, RATE).shape == (6, 3)


def test_tracker_that_needs_no_semidefinite_program_loads_no_solver():
    observer_gain(MODELS, T, RATE)
    done = subprocess.run([sys.executable, "-c", LOADED], capture_output=True, text=True, check=True)
    assert done.stdout.strip() == "[]"
