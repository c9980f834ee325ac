"""The plan of a run's faults, and the board on which new ones reach every process."""

import pytest

from bench.faults.frames import FrameLoss, GilbertElliott
from bench.faults.plan import FaultBoard, FaultPlan
from bench.faults.vehicles import IcePatch
from tests.faults.sending import on


def test_faults_on_the_board_reach_every_plan() -> None:
    descriptor = FaultBoard.create()
    board, others = FaultBoard(descriptor), FaultBoard(descriptor)
    plan = FaultPlan([IcePatch(at_s=1.0, mu=0.1)], board=others)
    fault = FrameLoss(**on(at_s=0.0, bursts=GilbertElliott(to_bad=0.5, to_good=0.5)))
    plan.refresh()
    assert plan.at(0) == ()
    board.post(fault)
    plan.refresh()
    assert plan.at(0) == ((1, fault),)
    assert plan.at(100) == ((0, plan.faults[0]), (1, fault))


def test_a_full_board_says_so() -> None:
    board = FaultBoard(FaultBoard.create())

    def fill() -> None:
        for _ in range(10_000):
            board.post(IcePatch(at_s=1.0))

    with pytest.raises(ValueError, match="no room"):
        fill()
    assert len(board.read()) == board.count > 1000


def test_the_board_says_which_cycles_the_bench_has_opened_and_whether_it_has_stopped() -> None:
    descriptor = FaultBoard.create()
    board, plan = FaultPlan(board=FaultBoard(descriptor)), FaultPlan(board=FaultBoard(descriptor))
    assert not plan.has_opened(0, realtime=False)
    board.open_cycle(0x1FF, realtime=True)
    assert plan.has_opened(0x1FF, realtime=True)
    assert not plan.has_opened(0x200, realtime=True)
    assert not plan.has_opened(0, realtime=False)
    assert not plan.has_stopped
    board.stop()
    assert plan.has_stopped
    FaultBoard(descriptor).post(IcePatch(at_s=1.0))
    plan.refresh()
    assert [fault.at_s for fault in plan.faults] == [1.0]
    assert plan.has_opened(0x1FF, realtime=True)


def test_without_a_board_any_cycle_can_be_the_benchs_own() -> None:
    plan = FaultPlan()
    plan.open_cycle(0, realtime=False)
    plan.stop()
    assert plan.has_opened(7, realtime=True)
    assert plan.has_stopped
