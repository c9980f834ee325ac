"""Signals as something to wait for."""

import os
import select
import signal
import threading

import pytest

from bench.conductor.interrupts import Interrupted, Interrupts


@pytest.mark.parametrize("number", [signal.SIGINT, signal.SIGTERM, signal.SIGHUP])
def test_a_signal_is_noted_and_wakes(number: signal.Signals) -> None:
    before = signal.getsignal(number)
    with Interrupts() as interrupts:
        interrupts.check()
        assert select.select([interrupts.fileno()], [], [], 0)[0] == []
        os.kill(os.getpid(), number)
        assert select.select([interrupts.fileno()], [], [], 60)[0] == [interrupts.fileno()]
        assert interrupts.received == number.name
        with pytest.raises(Interrupted, match=number.name):
            interrupts.check()
    assert signal.getsignal(number) is before


def test_outside_the_main_thread_it_does_nothing() -> None:
    before, problems = signal.getsignal(signal.SIGINT), []

    def use() -> None:
        try:
            with Interrupts() as interrupts:
                interrupts.check()
        except (ValueError, Interrupted) as error:
            problems.append(error)

    thread = threading.Thread(target=use)
    thread.start()
    thread.join()
    assert problems == []
    assert signal.getsignal(signal.SIGINT) is before
