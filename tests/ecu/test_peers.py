"""Whom a vehicle trusts of the others, and what it takes them to do when it does not hear them."""

import math

import pytest

from bench.bus.reception import Health, Reception, ReceptionState
from bench.bus.states import Cause, EcuState, Manoeuvre
from bench.ecu.peers import RECOVERY_CYCLES, PeerWatch

T = 0.01


class Peer:
    """Vehicle 2 on a bend, as its broadcasts tell, and what vehicle 1 makes of it."""

    def __init__(self) -> None:
        self.watch = PeerWatch(2)
        self.cycle = 0
        self.x, self.y, self.course = 50.0, 3.5, 0.0
        self.speed, self.yaw_rate = 20.0, 0.1
        self.state, self.manoeuvre = EcuState.RUN, Manoeuvre.PLATOON
        self.lost_for = 0

    def step(self, *, silent: bool = False, cycles: int = 1, **wrong: float) -> Cause:
        position = {"X": self.x, "Y": self.y}
        motion = {"Speed": self.speed, "Course": self.course, "YawRate": self.yaw_rate}
        status = {"State": self.state, "Slot": 2, "Cause": 0, "LeaderX": 60.0, "Manoeuvre": self.manoeuvre}
        frames = [position | {k: v for k, v in wrong.items() if k in position}]
        frames += [motion | {k: v for k, v in wrong.items() if k in motion}, status]
        self.lost_for = self.lost_for + 1 if silent else 0
        state = ReceptionState.OK if not silent else ReceptionState.MISSING
        reception = Reception(ReceptionState.LOST if self.lost_for >= 10 else state, self.lost_for)
        inputs = dict(zip(self.watch.topics, [None] * 3 if silent else frames, strict=True))
        self.watch.update(inputs, Health(inputs=dict.fromkeys(self.watch.topics, reception)), cycles)
        self.drive()
        return self.watch.cause

    def drive(self) -> None:
        self.x += T * self.speed * math.cos(self.course)
        self.y += T * self.speed * math.sin(self.course)
        self.course += T * self.yaw_rate


def test_a_vehicle_that_is_heard_is_trusted_and_is_where_it_is_now() -> None:
    peer = Peer()
    assert {peer.step() for _ in range(50)} == {Cause.NONE}
    assert peer.watch.motion is not None
    # What was heard was sent in the cycle before; by now the vehicle is where it has driven to.
    assert pytest.approx(peer.x, abs=1e-3) == peer.watch.motion.X
    assert pytest.approx(peer.y, abs=1e-3) == peer.watch.motion.Y
    assert peer.watch.report is not None
    assert (peer.watch.report.slot, peer.watch.report.leader_x) == (2, 60.0)


def test_one_that_falls_silent_is_missing_then_lost_and_trusted_again_after_a_while() -> None:
    peer = Peer()
    peer.step()
    assert [peer.step(silent=True) for _ in range(12)] == [Cause.PEER_MISSING] * 9 + [Cause.PEER_LOST] * 3
    back = [peer.step() for _ in range(RECOVERY_CYCLES + 1)]
    assert back == [Cause.PEER_LOST] * (RECOVERY_CYCLES - 1) + [Cause.NONE] * 2


def test_one_that_is_lost_is_taken_to_coast() -> None:
    peer = Peer()
    peer.step()
    for _ in range(110):
        peer.step(silent=True)
    assert peer.watch.motion is not None
    assert peer.watch.motion.speed == pytest.approx(20.0 - 0.3 * 1.01)
    assert pytest.approx(50.0 + 1.11 * 20.0, abs=0.3) == peer.watch.motion.X


def test_one_ahead_that_is_lost_is_taken_to_fall_back_down_to_a_crawl() -> None:
    peer = Peer()
    peer.watch.braking, peer.watch.crawl = 2.0, 5.0
    peer.step()
    for _ in range(110):
        peer.step(silent=True)
    assert peer.watch.motion is not None
    assert peer.watch.motion.speed == pytest.approx(20.0 - 2.0 * 1.01)
    for _ in range(900):
        peer.step(silent=True)
    assert peer.watch.motion.speed == 5.0


@pytest.mark.parametrize(
    ("wrong", "within"),
    [({"X": 50.0}, 3), ({"X": 13000.0}, 0), ({"Speed": 5.0}, 4), ({"Course": 1.0}, 3), ({"YawRate": 1.0}, 10)],
)
def test_one_that_contradicts_itself_is_found(wrong: dict[str, float], within: int) -> None:
    peer = Peer()
    for _ in range(60):
        peer.step()
    causes = [peer.step(**wrong) for _ in range(40)]
    assert causes.index(Cause.PEER_IMPLAUSIBLE) <= within
    assert causes[-1] is Cause.PEER_IMPLAUSIBLE


@pytest.mark.parametrize(
    ("state", "manoeuvre"),
    [
        (EcuState.SAFE, Manoeuvre.PLATOON),
        (EcuState.RUN, Manoeuvre.SLOW_DOWN),
        (EcuState.DEGRADED, Manoeuvre.FALL_BACK),
    ],
)
def test_one_that_says_it_slows_down_is_kept_clear_of(state: EcuState, manoeuvre: Manoeuvre) -> None:
    peer = Peer()
    peer.step()
    peer.state, peer.manoeuvre = state, manoeuvre
    assert peer.step() is Cause.PEER_UNSAFE
    peer.state, peer.manoeuvre = EcuState.DEGRADED, Manoeuvre.PLATOON
    assert peer.step() is Cause.NONE


def test_cycles_that_the_ecu_was_not_there_for_are_no_contradiction() -> None:
    peer = Peer()
    peer.step()
    for _ in range(10):
        peer.drive()
        assert peer.step(cycles=2) is Cause.NONE
        assert peer.watch.motion is not None
        assert pytest.approx(peer.x, abs=1e-3) == peer.watch.motion.X
