"""The machine code of what ECUs check gives the same bits as its plain text."""

from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st

from bench.bus.codec import load_codecs
from bench.bus.reception import Health, Reception, ReceptionState
from bench.bus.states import ActuatorState, CommandState
from bench.bus.topic import Outgoing
from platoon_fmu.parameters import VehicleParameters
from tests.ecu.drive import Drive
from tests.plain import bits, compiled, plain

WAYS = (compiled, plain)
some = settings(deadline=None, max_examples=30, suppress_health_check=[HealthCheck.too_slow])
numbers = st.one_of(st.floats(), st.floats(-50.0, 50.0))


def both(name: str) -> list:
    return [way(f"bench.ecu.{name}") for way in WAYS]


@some
@given(numbers, st.one_of(st.none(), numbers), st.integers(1, 5))
def test_limits(value, before, cycles):
    found = []
    for module in both("limits"):
        limits = module.limits_of("vehicle.dbc", "VehicleMotion")
        allowed = {name: limit.allows(value, before, cycles) for name, limit in limits.items()}
        frame = dict.fromkeys(limits, value)
        found.append((allowed, module.possible(limits, frame, tuple(limits)), bits(list(limits.values()))))
    assert found[0] == found[1]


changes = st.lists(
    st.tuples(st.integers(0, 40), st.sampled_from(["VehiclePosition", "VehicleMotion", "WheelSpeedsFront"]), numbers),
    max_size=8,
)


@some
@given(changes, st.integers(1, 3))
def test_own_motion(wrong, step):
    """A drive in which frames are missing, or one of their signals is anything."""
    found = []
    for module in both("plausibility"):
        own, drive, seen = module.OwnMotion(VehicleParameters()), Drive(), []
        for cycle in range(40):
            frames = drive.frames()
            for at, message, value in wrong:
                if at <= cycle < at + 3 and value != value:
                    frames[message] = None
                elif at <= cycle < at + 3 and frames[message] is not None:
                    frames[message][sorted(frames[message])[0]] = value
            seen.append((own.update(frames, step if cycle == 20 else 1), int(own.cause)))
            if seen[-1][0] is not None:
                seen.append((seen[-1][0].course, seen[-1][0].speed))
        found.append(bits(seen))
    assert found[0] == found[1]


statuses = st.fixed_dictionaries(
    {
        "ActuatorState": st.sampled_from(list(ActuatorState)),
        "CommandState": st.sampled_from(list(CommandState)),
        "HeldCycles": st.integers(0, 9),
    }
)


@some
@given(st.lists(st.tuples(st.one_of(st.none(), statuses), numbers, numbers), max_size=30))
def test_following(cycles):
    found = []
    for module in both("following"):
        follows, seen = module.Following(), []
        for status, v_x, yaw_rate in cycles:
            follows.update(status, v_x, yaw_rate)
            follows.ask(20.0, 0.0)
            seen.append(int(follows.cause))
        found.append(seen)
    assert found[0] == found[1]


heard = st.fixed_dictionaries({name: st.floats(-60.0, 60.0) for name in ("X", "Y", "Speed", "Course", "YawRate")})
told = st.fixed_dictionaries(
    {
        "State": st.integers(0, 3),
        "Cause": st.just(0),
        "Slot": st.integers(0, 3),
        "LeaderX": st.floats(-50.0, 50.0),
        "Manoeuvre": st.integers(0, 1),
    }
)


@some
@given(st.lists(st.tuples(st.one_of(st.none(), heard), st.one_of(st.none(), told), st.booleans()), max_size=30))
def test_peers(cycles):
    found = []
    for module in both("peers"):
        watch, seen = module.PeerWatch(2), []
        for cycle, (values, status, lost) in enumerate(cycles):
            state = ReceptionState.LOST if lost else ReceptionState.OK
            health = Health(inputs=dict.fromkeys(watch.topics, Reception(state, 0)))
            inputs = dict(zip(watch.topics, (values, values, status), strict=True))
            watch.update(inputs, health, 2 if cycle == 7 else 1)
            seen.append((watch.motion, watch.heard, int(watch.cause), watch.report))
        found.append(bits(seen))
    assert found[0] == found[1]


@some
@given(st.lists(st.tuples(numbers, numbers), max_size=20))
def test_sent_values(cycles):
    codecs, found = [load_codecs(1), plain("bench.bus.codec").load_codecs(1)], []
    for module, codec in zip(both("sent_values"), codecs, strict=True):
        notes: list = []
        values = module.SentValues("veh1.planner", codec, notes.append)
        good = [
            values.are_numbers(Outgoing("veh1", "Reference", {"VelocityX": v_x, "YawRate": gamma}), cycle)
            for cycle, (v_x, gamma) in enumerate(cycles)
        ]
        found.append((good, values.not_numbers, list(map(str, notes))))
    assert found[0] == found[1]
