"""The loop that lets the nodes of a process wait: for frames, for a time, or for neither."""

import os
import time
from collections.abc import Iterator

import pytest

from bench.bus.link.direct import DirectLink, Hub
from bench.bus.node import read_up, serve
from bench.errors import RunFailed


class PipeLink(DirectLink):
    """A link that is readable while bytes wait in a pipe; what they say does not matter."""

    def __init__(self) -> None:
        super().__init__("veh1", Hub())
        self.reader, self.writer = os.pipe()
        os.set_blocking(self.reader, False)

    def wake(self) -> None:
        os.write(self.writer, b"x")

    def receive(self) -> list[tuple[int, bytes]]:
        try:
            os.read(self.reader, 100)
        except BlockingIOError:
            return []
        return [(1, b"")]

    def fileno(self) -> int:
        return self.reader

    def close(self) -> None:
        os.close(self.reader)
        os.close(self.writer)


class CountingNode:
    """Notes when it is polled, and stops after so many times."""

    def __init__(self, link: PipeLink, polls: int) -> None:
        self.name = "veh1.counter"
        self.links = (link,)
        self.wake_at: float | None = None
        self.rest_until = 0.0
        self.awaited: PipeLink | None = None
        self.opened = -1
        self.left = polls
        self.opens = True
        self.heard: list[bool] = []
        self.polled_at: list[float] = []

    @property
    def stopped(self) -> bool:
        return self.left == 0

    def poll(self) -> bool:
        self.left -= 1
        self.polled_at.append(time.monotonic())
        self.heard.append(bool(self.links[0].receive()))
        if self.opens and self.heard[-1]:
            self.opened += 1
        return self.heard[-1]


@pytest.fixture
def link() -> Iterator[PipeLink]:
    with PipeLink() as link:
        yield link


def test_a_node_is_polled_when_frames_are_there(link: PipeLink) -> None:
    node = CountingNode(link, 1)
    link.wake()
    serve([node])
    assert node.heard == [True]


def test_a_node_is_polled_when_its_time_has_come_though_there_are_no_frames(link: PipeLink) -> None:
    node = CountingNode(link, 1)
    node.wake_at = time.monotonic() + 0.02
    serve([node], silence_s=0.001)
    assert node.heard == [False]
    assert node.polled_at[0] >= node.wake_at


def test_a_node_that_rests_is_not_woken_by_frames(link: PipeLink) -> None:
    node = CountingNode(link, 1)
    node.rest_until = time.monotonic() + 0.02
    link.wake()
    serve([node])
    assert node.heard == [True]
    assert node.polled_at[0] >= node.rest_until


def test_silence_is_an_error_once_a_cycle_has_begun(link: PipeLink) -> None:
    node = CountingNode(link, 3)
    link.wake()
    with pytest.raises(RunFailed, match=r"veh1\.counter heard of no new cycle for 0\.01 s"):
        serve([node], silence_s=0.01)
    assert node.heard[0] is True


def test_frames_that_begin_no_cycle_do_not_break_the_silence(link: PipeLink) -> None:
    class Babbled(CountingNode):
        def poll(self) -> bool:
            heard = super().poll()
            self.opens = False
            link.wake()
            return heard

    node = Babbled(link, -1)
    link.wake()
    with pytest.raises(RunFailed, match=r"veh1\.counter heard of no new cycle for 0\.02 s"):
        serve([node], silence_s=0.02)
    assert node.heard.count(True) > 1


def test_a_node_that_is_not_ready_yet_reads_what_came_before(link: PipeLink) -> None:
    node = CountingNode(link, -1)
    link.wake()
    read_up([node])
    assert node.heard == [True, False]


def test_the_end_of_the_lifeline_ends_the_loop(link: PipeLink) -> None:
    lifeline, conductor = os.pipe()
    node = CountingNode(link, 1)
    os.close(conductor)
    serve([node], lifeline)
    os.close(lifeline)
    assert node.heard == []


def test_frames_on_other_links_do_not_wake_a_node_that_awaits_one(link: PipeLink) -> None:
    """They are read with the frame that does, or after a while, so that their queue has room."""
    with PipeLink() as other:
        first = CountingNode(link, 1)
        second = CountingNode(other, 1)
        first.awaited = link
        second.opened = 5
        other.wake()
        link.wake()
        serve([first, second])
        assert (first.heard, second.heard) == ([True], [True])
        again = CountingNode(other, 1)
        again.awaited = link
        other.wake()
        serve([again])
        assert again.heard == [True]
