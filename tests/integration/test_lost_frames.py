"""Frames that a receive queue had no room for: nobody loses one without its being said."""

import os
import re
import signal
from pathlib import Path

from bench.bus.link.address import Address
from bench.bus.link.opening import open_link
from bench.events import ReceptionErrors
from bench.record.reader import Run

STRANGER = 0x7FE
MANY = 40_000
"""More than a queue of 8 MiB holds; the kernel counts some 800 bytes for each."""


def test_what_a_full_receive_queue_drops_is_counted_logged_and_shown(start) -> None:
    # Ports that no bench takes unasked, another one for each worker.
    can = f"udp:{61000 + os.getpid() % 400 * 8}"
    run = start(set=["duration_s=5.0"], can=can)
    run.await_time(0.3)
    pid = run.pid_of("veh2.tracker")
    os.kill(pid, signal.SIGSTOP)
    with open_link("veh2", Address.parse(can)) as link:
        for _ in range(MANY):
            link.send(STRANGER, bytes(8))
    os.kill(pid, signal.SIGCONT)
    code, _, errors = run.end()
    assert (code, "Traceback" in errors) == (0, False), errors
    log = Run(Path(run.out))
    lost = log.signal("veh2", "TrackerBusHealth", "FramesLost")[1]
    assert lost[0] == 0
    assert lost[-1] > 1000
    told = [event.fields for event in log.events if (event.kind, event.source) == (ReceptionErrors.kind, "veh2")]
    assert lost[-1] in [fields["frames_lost"] for fields in told if fields["message"] == "TrackerBusHealth"]
    assert int(log.result["frames_lost"]) >= lost[-1]


def test_a_run_that_ends_where_frames_were_lost_says_so(start, unruly) -> None:
    can = f"udp:{61000 + os.getpid() % 400 * 8}"
    run = start(set=["duration_s=60.0"], can=can, ecus=unruly(tracker="HangingTracker"), silence_s=3.0)
    run.await_time(0.1)
    with open_link("veh2", Address.parse(can)) as link:
        for _ in range(MANY):
            link.send(STRANGER, bytes(8))
    code, _, errors = run.end()
    assert code == 1
    assert "veh2.tracker sends no SteeringCommand (0x300 on veh2)" in errors
    assert re.search(r"; frames came faster than they were read and were lost: .*\d+ by veh2\.tracker", errors), errors
    assert "were lost" in Run(Path(run.out)).result["reason"]
