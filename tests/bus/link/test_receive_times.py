"""When frames came: the kernel's time, however late they are read."""

import time

from bench.bus.link.address import Address, settle
from bench.bus.link.base import Link
from bench.bus.link.direct import DirectLink, Hub
from bench.bus.link.opening import open_link


def test_frames_over_udp_have_the_time_the_kernel_got_them() -> None:
    with (
        settle(Address.parse("udp"), 1) as address,
        open_link("veh1", address) as here,
        open_link("veh1", address) as there,
    ):
        assert there.times is None
        there.keep_times()
        assert any(_is_stamped_at_once(here, there) for _ in range(100))
        before = time.time_ns()
        here.send(1, b"a")
        here.send(2, b"b")
        sent = time.time_ns()
        time.sleep(0.05)
        frames = there.receive()
        assert [can_id for can_id, _ in frames] == [1, 2]
        assert there.times is not None
        first, second = there.times
        # On one host the kernel has a frame when it is sent, and it has been waiting since.
        assert before <= first <= second <= sent
        assert there.receive() == []
        assert there.times == []


def _is_stamped_at_once(here: Link, there: Link) -> bool:
    """Whether the kernel notes times already: it begins a moment after it was asked to, until then with the reading."""
    here.send(1, b"")
    sent = time.time_ns()
    time.sleep(0.01)
    assert there.receive()
    assert there.times is not None
    return there.times[0] <= sent


def test_a_link_without_a_kernel_does_not_tell() -> None:
    link = DirectLink("veh1", Hub())
    link.keep_times()
    assert link.times is None
