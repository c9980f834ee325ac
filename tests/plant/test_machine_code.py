"""The plant's machine code gives the same bits as its plain text, which is interpreted."""

from collections.abc import Sequence
from contextlib import closing

from hypothesis import given, settings
from hypothesis import strategies as st

from bench.plant.description import read_description
from bench.plant.fmu import unpack
from bench.plant.plant import start_values
from bench.scenario import load
from platoon_fmu.build import default_fmu
from tests.plain import bits, compiled, plain

STEPS = st.tuples(st.floats(-0.3, 0.3), st.floats(-600.0, 600.0), st.floats(0.2, 1.0))


@settings(max_examples=20, deadline=None)
@given(st.lists(STEPS, min_size=1, max_size=20))
def test_fmu(steps: Sequence[tuple[float, float, float]]) -> None:
    description = read_description(default_fmu())
    vehicle = load("formation").vehicles[0]
    rows = []
    for way in (compiled, plain):
        fmu = way("bench.plant.fmu").FmuInstance(description, unpack(default_fmu()), "veh1", start_values(vehicle))
        with closing(fmu):
            found = [[*fmu.outputs(), *fmu.inputs()]]
            given_inputs = dict(zip(description.inputs, fmu.inputs(), strict=True))
            for cycle, (angle, torque, mu) in enumerate(steps):
                inputs = given_inputs | {"steering_angle": angle, "wheel_torque_rl": torque, "mu": mu}
                fmu.step(cycle / 100, 0.01, list(inputs.values()))
                found.append([*fmu.outputs(), *fmu.inputs()])
        rows.append(bits(found))
    assert rows[0] == rows[1]
    assert len(set(map(tuple, found))) == len(steps) + 1
