"""The random faults: always the same, of every kind with all its keys, on every target, within sensible ranges."""

import hashlib
import tomllib
from collections import Counter, defaultdict

import pytest

from bench.errors import BadInput
from bench.faults.base import Fault
from bench.faults.kinds import kinds
from bench.scenario import Scenario, load
from bench.scenario.families import MOST
from bench.scenario.fault_targets import _bench
from bench.scenario.random_faults import BROADCASTS, COMMANDS, KINDS, SENSORS, STATES, kind_of, random_fault_scenario

SEEDS = range(3000)


@pytest.fixture(scope="module")
def family() -> list[Scenario]:
    return [load(f"random-fault:{seed}") for seed in SEEDS]


@pytest.fixture(scope="module")
def of_kind(family) -> dict[str, list[Fault]]:
    found = defaultdict(list)
    for each in family:
        found[each.faults[0].name()].append(each.faults[0])
    return found


@pytest.mark.parametrize(
    ("seed", "digest"),
    [
        (0, "2740ee2742977a97"),
        (1, "c749af72588906bf"),
        (7, "d85aa6d04bb3a33a"),
        (299, "79e155d6a39b8852"),
        (MOST, "1ff8ad382c3a5dd2"),
    ],
)
def test_a_number_is_the_same_scenario_for_ever(seed, digest):
    """Mend a hash only if its number has got a kind of fault that is new: results name these numbers."""
    assert hashlib.sha256(random_fault_scenario(seed).encode()).hexdigest()[:16] == digest


def test_every_kind_of_fault_that_the_bench_has_is_drawn():
    missing = kinds().keys() - KINDS.keys()
    assert not missing, f"add what draws {', '.join(missing)} to KINDS in bench/scenario/random_faults.py"
    assert KINDS.keys() == kinds().keys()


def test_every_key_of_every_kind_is_drawn(of_kind):
    for name, kind in kinds().items():
        given = set().union(*(fault.model_fields_set for fault in of_kind[name]))
        assert given == kind.model_fields.keys(), f"add {name}'s keys to what draws it in random_faults.py"


def test_a_kind_that_is_added_changes_only_the_numbers_that_it_takes():
    before = [kind_of(seed, KINDS) for seed in range(500)]
    after = [kind_of(seed, [*KINDS, "earthquake"]) for seed in range(500)]
    assert {new for old, new in zip(before, after, strict=True) if old != new} == {"earthquake"}
    assert 5 < after.count("earthquake") < 60
    assert before == [kind_of(seed, reversed(KINDS)) for seed in range(500)]


def test_it_is_the_random_scenario_of_its_number_with_one_fault(family):
    for seed in (0, 7, 299):
        base, faulted = load(f"random:{seed}"), family[seed]
        same = {"name": base.name, "description": base.description, "faults": ()}
        assert faulted.model_copy(update=same) == base
        assert (faulted.name, len(faulted.faults)) == (f"random-fault-{seed}", 1)
        assert faulted.description.startswith(f"{base.description}; {faulted.faults[0].name()} from ")


def test_the_text_is_the_scenario(family, tmp_path):
    path = tmp_path / "mine.toml"
    path.write_text(random_fault_scenario(7))
    assert load(path) == family[7]
    assert load(f"random-fault:{MOST}").seed == MOST


def test_messages_and_signals_are_all_protected_ones():
    """A message that is new changes what others are drawn: decide whether it is worth new scenarios for old numbers."""
    bench = _bench(1)
    tables = SENSORS, COMMANDS, BROADCASTS
    known = {message: [*signals, *STATES.get(message, ())] for table in tables for message, signals in table.items()}
    there = {}
    for bus in bench.buses:
        for message in bench.senders(bus):
            if bench.has_counter(bus, message):
                there[message.partition("_")[0]] = list(bench.signals(bus, message))
    assert known == there
    sent_by_plant = {m for m, sender in bench.senders("veh1").items() if sender == "plant"}
    assert SENSORS.keys() == {m for m in sent_by_plant if bench.has_counter("veh1", m)}


def test_kinds_vehicles_and_times_are_spread_evenly(family, of_kind):
    expected = len(SEEDS) / len(KINDS)
    assert all(0.7 * expected < len(faults) < 1.3 * expected for faults in of_kind.values())
    faults = [each.faults[0] for each in family]
    tenths = Counter(int(fault.at_s / 1.5) for fault in faults if fault.at_s < 15.0)
    assert tenths.keys() == set(range(10))
    assert max(tenths.values()) < 1.5 * min(tenths.values())
    to_the_end = sum(fault.for_s is None for fault in faults)
    assert 0.45 < to_the_end / len(faults) < 0.55
    # Of all vehicles that could have a stuck actuator, about the same share has one.
    hit, could = Counter(), Counter()
    for each in family:
        if each.faults[0].name() in ("actuator_stuck", "tyre_blowout", "axle_softening"):
            hit[each.faults[0].vehicle] += 1
            for vehicle in range(1, len(each.vehicles) + 1):
                could[vehicle] += 1 / len(each.vehicles)
    assert hit.keys() == set(range(1, 8))
    assert all(abs(hit[vehicle] - could[vehicle]) < 4 * could[vehicle] ** 0.5 for vehicle in could)


def test_values_are_within_their_ranges_and_use_them(of_kind):
    biases = [fault.bias / SENSORS[fault.message][fault.signal] for fault in of_kind["sensor_bias"]]
    assert all(0.049 < abs(bias) <= 1.0 for bias in biases)
    assert min(biases) < -0.9
    assert max(biases) > 0.9
    noise = [fault.sigma / SENSORS[fault.message][fault.signal] for fault in of_kind["sensor_noise"]]
    assert 0.024 < min(noise) < 0.1
    assert 0.4 < max(noise) <= 0.5
    steering = [f.value for f in of_kind["actuator_stuck"] if f.actuator == "steering" and f.value is not None]
    assert max(map(abs, steering)) <= 0.1
    assert min(steering) < 0.0 < max(steering)
    assert all(0.1 <= fault.mu <= 0.35 for fault in of_kind["ice_patch"])
    assert {fault.vehicle is None for fault in of_kind["ice_patch"]} == {True, False}
    assert all(fault.lambda_level <= 0.0 for fault in of_kind["axle_softening"])
    assert {fault.bus == "v2v" for fault in of_kind["frame_loss"]} == {True, False}
    assert {fault.message is None for fault in of_kind["frame_loss"]} == {True, False}
    assert {fault.bursts is None for fault in of_kind["frame_loss"]} == {True, False}


def test_numbers_are_written_as_people_write_them():
    for seed in range(500):
        fault = tomllib.loads(random_fault_scenario(seed))["faults"][0]
        assert all(len(repr(value)) <= 8 for value in fault.values() if isinstance(value, float)), fault


@pytest.mark.parametrize("number", ["", "-1", "1.5", "4294967296"])
def test_what_is_no_number_of_one_is_refused(number):
    with pytest.raises(BadInput, match="allowed: random-fault:0 to random-fault:4294967295"):
        load(f"random-fault:{number}")
