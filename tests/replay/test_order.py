"""When frames are due, and in which order."""

from bench.record.can_frame import Frame
from bench.replay.order import MOST_HELD, in_order


def frame(time_ns, bus, can_id, wire_ns=0):
    return Frame(time_ns, bus, can_id, b"", 0, wire_ns)


def test_frames_go_by_their_end_on_the_wire_over_all_buses():
    given = [
        frame(0, "a", 1, wire_ns=300),
        frame(0, "a", 2, wire_ns=1200),
        frame(0, "b", 3, wire_ns=200),
        frame(1000, "a", 4, wire_ns=1500),
        frame(1000, "b", 5, wire_ns=1100),
    ]
    assert [(f.can_id, f.due_ns) for f in in_order(given)] == [(3, 200), (1, 300), (5, 1100), (2, 1200), (4, 1500)]


def test_frames_without_a_wire_keep_their_order_and_go_at_their_cycle():
    given = [frame(time_ns, bus, n) for time_ns in (0, 10) for bus in ("a", "b") for n in (3, 1, 2)]
    found = list(in_order(given))
    assert [(f.due_ns, f.bus, f.can_id) for f in found] == [(f.time_ns, f.bus, f.can_id) for f in given]


def test_what_was_never_on_the_wire_goes_with_the_frame_before_it():
    given = [frame(0, "a", 1, wire_ns=300), frame(0, "a", 2), frame(0, "b", 3, wire_ns=299)]
    assert [(f.can_id, f.due_ns) for f in in_order(given)] == [(3, 299), (1, 300), (2, 300)]


def test_only_so_many_are_held_back():
    endless = (frame(0, "a", 1, wire_ns=10) for _ in range(MOST_HELD + 10))
    taken = in_order(endless)
    next(taken)
    assert sum(1 for _ in endless) == 9
