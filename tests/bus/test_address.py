"""Addresses as typed, and the ports that keep benches on one host apart."""

import os
import re
import signal
import socket
import subprocess
import sys
from contextlib import ExitStack

import pytest

from bench.bus.link import Address, open_link, reserve_udp_ports, settle
from bench.errors import BadInput

HOLDER = """
import sys
from bench.bus.link import reserve_udp_ports
with reserve_udp_ports(4, first=int(sys.argv[1])):
    print("held", flush=True)
    sys.stdin.read()
"""


@pytest.fixture
def first_port(monkeypatch):
    """Make the search for free ports start where no other bench or test of this machine looks."""
    port = 20_000 + os.getpid() % 600 * 20
    monkeypatch.setattr("bench.bus.udp.FIRST_PORT", port)
    return port


@pytest.mark.parametrize("text", ["udp", "udp:43113", "udp:1024", "vcan", "direct", "socketcan:can{}", "pcan:A:{}"])
def test_an_address_reads_what_it_writes(text):
    assert str(Address.parse(text)) == text


@pytest.mark.parametrize(
    "text",
    [
        "",
        "can0",
        "udp:",
        "udp:x",
        "udp:80",
        "udp:65535",
        "udp:-5",
        ":can0",
        "pcan:",
        "udp_multicast:x",
        "direct:1",
        "foo:{}",
    ],
)
def test_what_is_no_address_is_refused_with_what_is_allowed(text):
    with pytest.raises(BadInput, match=f"--can {re.escape(text)}: .*(allowed: udp, udp:PORT, vcan, direct|1024 to)"):
        Address.parse(text)


def test_buses_are_numbered_from_v2v():
    assert [Address.parse("vcan").channel_of(bus) for bus in ("v2v", "veh1", "veh16")] == [
        "vcan0",
        "vcan1",
        "vcan16",
    ]
    assert [Address.parse("udp:5000").port_of(bus) for bus in ("v2v", "veh1", "veh16")] == [5000, 5001, 5016]
    assert Address.parse("pcan:USB{}").channel_of("veh2") == "USB2"


@pytest.mark.parametrize("bus", ["veh0", "veh17", "veh", "vehicle1", "V2V", ""])
def test_a_bus_that_does_not_exist_is_named(bus):
    with pytest.raises(BadInput, match=f"bus '{bus}' does not exist"):
        open_link(bus, Address.parse("udp:5000"))


def test_one_channel_for_all_buses_is_refused():
    with (
        pytest.raises(BadInput, match=r"one channel for 4 buses; write \{\}"),
        settle(Address.parse("pcan:A"), 3),
    ):
        pass


def test_udp_ports_are_chosen_and_freed(first_port):
    for _ in range(2):
        with (
            settle(Address.parse("udp"), vehicles=3) as one,
            settle(Address.parse("udp"), vehicles=3) as two,
        ):
            assert (one.port, two.port) == (first_port, first_port + 4)
    with settle(Address.parse(f"udp:{first_port}"), vehicles=3) as again:
        assert again.port == first_port


def test_ports_held_by_another_bench_are_refused_with_the_mend(first_port):
    with (
        reserve_udp_ports(4),
        pytest.raises(BadInput, match=r"not all of the UDP ports .* are free.*take others"),
        settle(Address.parse(f"udp:{first_port + 3}"), vehicles=1),
    ):
        pass


def test_a_refused_reservation_holds_nothing(first_port):
    with reserve_udp_ports(1, first=first_port + 3):
        with pytest.raises(BadInput), reserve_udp_ports(4, first=first_port):
            pass
        with reserve_udp_ports(3, first=first_port) as ports:
            assert list(ports) == [first_port, first_port + 1, first_port + 2]


def test_a_port_that_any_program_uses_is_passed_over(first_port):
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as other:
        other.bind(("", first_port + 2))
        with reserve_udp_ports(4) as ports:
            assert ports[0] == first_port + 4
        with pytest.raises(BadInput, match="not all"), reserve_udp_ports(4, first=first_port):
            pass


def test_a_port_that_somebody_listens_on_without_a_reservation_is_passed_over(first_port):
    """A python-can tool shares the port by design; still nobody may choose it for a bench of their own."""
    with (
        open_link("v2v", Address("udp_multicast", port=first_port)),
        reserve_udp_ports(2) as ports,
    ):
        assert ports[0] == first_port + 2


def test_two_benches_at_once_never_hear_each_other():
    with ExitStack() as stack:
        benches = [stack.enter_context(settle(Address.parse("udp"), vehicles=3)) for _ in range(2)]
        buses = ("v2v", "veh1", "veh2", "veh3")
        ends = {
            (bench, bus): [stack.enter_context(open_link(bus, address)) for _ in "ab"]
            for bench, address in enumerate(benches)
            for bus in buses
        }
        for repeat in range(50):
            for (bench, bus), (sender, _) in ends.items():
                sender.send(repeat, f"{bench}{bus}".encode())
        for (bench, bus), (_, receiver) in ends.items():
            assert receiver.receive() == [(repeat, f"{bench}{bus}".encode()) for repeat in range(50)]


def test_a_reservation_holds_against_other_processes_and_ends_with_kill_9(first_port):
    with subprocess.Popen(
        [sys.executable, "-c", HOLDER, str(first_port)],
        stdin=subprocess.PIPE,
        stdout=subprocess.PIPE,
        text=True,
    ) as holder:
        try:
            assert holder.stdout.readline() == "held\n"
            with reserve_udp_ports(4) as ports:
                assert ports[0] == first_port + 4
            with pytest.raises(BadInput, match="not all"), reserve_udp_ports(4, first=first_port):
                pass
        finally:
            holder.send_signal(signal.SIGKILL)
    with reserve_udp_ports(4) as ports:
        assert ports[0] == first_port
