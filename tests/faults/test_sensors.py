"""Signals that are wrong under a good CRC and counter, and sensors that send nothing."""

import math

from bench.bus import e2e
from bench.faults.base import LOST, ON_TIME
from bench.faults.plan import FaultPlan
from bench.faults.sensors import SensorBias, SensorDropout, SensorNoise, SignalStuck
from tests.faults.sending import CYCLES, START, absences, angles, frame, on, sent


def test_a_stuck_signal_keeps_its_value_under_a_good_crc_and_counter() -> None:
    came = sent(SignalStuck(**on(signal="SteeringAngle", for_s=0.05)))
    assert [angles(came, cycle) for cycle in range(START - 1, START + 6)] == [
        [START - 1],
        *[[START]] * 5,
        [START + 5],
    ]
    assert all(e2e.check(data, 0x300) for name, _, data in came[START + 2] if name == "SteeringCommand")
    assert absences(came, START + 2) == []


def test_a_sensors_bias_and_noise_are_in_the_signals_unit() -> None:
    biased = sent(SensorBias(**on(signal="SteeringAngle", bias=0.1)))
    assert angles(biased, START) == [START + 100]
    noisy = sent(SensorNoise(**on(at_s=0.0, signal="SteeringAngle", sigma=0.05)))
    errors = [angle - cycle for cycle in range(CYCLES) for angle in angles(noisy, cycle)]
    assert 25 < (sum(error**2 for error in errors) / CYCLES) ** 0.5 < 80
    assert len(set(errors)) > 20


def test_the_noise_of_a_signal_follows_from_the_plan() -> None:
    noise = SensorNoise(**on(signal="SteeringAngle", sigma=0.05))
    plan = FaultPlan([noise], 3)
    for cycle in range(START, CYCLES):
        error = plan.chance(0, "veh1", 0x300, cycle).gauss(0.0, 0.05)
        assert noise.changed(0.1, plan.context(0, "veh1", 0x300, cycle), {}) == 0.1 + error


def test_a_sensors_dropout_is_a_frame_not_sent() -> None:
    assert absences(sent(SensorDropout(**on())), START) == [0x300]
    sometimes = SensorDropout(**on(probability=0.25))
    numbers = (0.0, math.nextafter(0.25, 0.0), 0.25)
    assert [sometimes.passage(b"", frame(number), {}) for number in numbers] == [LOST, LOST, ON_TIME]
