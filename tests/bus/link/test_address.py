"""Addresses as typed, and the ports that keep benches on one host apart."""

import os
import re
import signal
import socket
import subprocess
import sys
from contextlib import ExitStack

import pytest

from bench.bus.codec import load_codecs
from bench.bus.link.opening import Address, open_link, reserve_udp_ports, settle
from bench.bus.link.place import Place
from bench.errors import BadInput

HOLDER = """
import sys
from bench.bus.link.opening import reserve_udp_ports
with reserve_udp_ports(4, first=int(sys.argv[1])):
    print("held", flush=True)
    sys.stdin.read()
"""


@pytest.fixture
def first_port(monkeypatch):
    """Make the search for free ports start where no other bench or test of this machine looks."""
    port = 20_000 + os.getpid() % 600 * 20
    monkeypatch.setattr("bench.bus.link.udp.FIRST_PORT", port)
    return port


@pytest.mark.parametrize(
    "texts",
    [
        "udp",
        "udp:43113",
        "udp:1024",
        "udp:45000@eth0",
        "vcan",
        "direct",
        "socketcan:can{}",
        "pcan:A:{}",
        "slcan:/dev/ttyACM{}?tty_baudrate=115200&timeout=0.1",
        "udp v2v=udp:45000",
        "vcan v2v=udp:45000@br-lan veh1=socketcan:can0 veh2=pcan:PCAN_USBBUS1?fd=False",
    ],
)
def test_an_address_reads_what_it_writes(texts):
    address = Address.parse(*texts.split())
    assert str(address) == texts
    assert address.hub is not None or address == Address.parse(*str(address).split())


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
        "udp:\u00b2",
        f"udp:{'9' * 5000}",
        "udp:٤٥٠٠٠",
        ":can0",
        "pcan:",
        "pcan:?fd=True",
        "udp_multicast:x",
        "direct:1",
        "foo:{}",
        "=udp",
        "veh1=",
        "veh1=can0",
        "veh1=udp:80",
        "veh1=udp:65536",
        "veh1=foo:{}",
    ],
)
def test_what_is_no_address_is_refused_with_what_is_allowed(text):
    allowed = "allowed: udp, udp:PORT, udp:PORT@DEVICE, vcan, direct|1024 to|after \\? give"
    with pytest.raises(BadInput, match=f"^--can {re.escape(text)}: .*({allowed})"):
        Address.parse(text)


@pytest.mark.parametrize(
    ("texts", "words"),
    [
        ("veh17=udp", "--can bus 'veh17' does not exist; buses are v2v and veh1 to veh16"),
        ("V2V=udp", "--can bus 'V2V' does not exist"),
        ("udp vcan", "--can vcan: every bus already has udp"),
        ("veh1=udp veh1=vcan", "--can veh1=vcan: veh1 already has udp"),
        ("direct veh1=udp", "--can direct --can veh1=udp: direct "),
        ("udp veh1=direct", "give it alone"),
        ("udp:45000@", "after @ give the name of a network device"),
        ("udp:45000@a b", "after @ give the name of a network device"),
        ("pcan:A?fd", "after ? give KEY=VALUE"),
        ("pcan:A?fd=1&", "after ? give KEY=VALUE"),
        ("socketcan:can{}?bitrate=1", "a CAN link of the kernel takes no parameters here"),
    ],
)
def test_what_does_not_go_together_is_refused_with_the_mend(texts, words):
    given = ["udp:45000@a b"] if texts.endswith("a b") else texts.split()
    with pytest.raises(BadInput, match=re.escape(words)):
        Address.parse(*given)


def channels(address, *buses):
    return [address.place_of(bus).channel for bus in buses]


def ports(address, *buses):
    return [address.place_of(bus).port for bus in buses]


def test_buses_are_numbered_from_v2v():
    assert channels(Address.parse("vcan"), "v2v", "veh1", "veh16") == ["vcan0", "vcan1", "vcan16"]
    assert ports(Address.parse("udp:5000"), "v2v", "veh1", "veh16") == [5000, 5001, 5016]
    assert channels(Address.parse("pcan:USB{}"), "veh2") == ["USB2"]


def test_a_bus_may_have_a_place_of_its_own():
    address = Address.parse("veh2=udp:47000@lo", "vcan", "veh3=socketcan:can{}")
    assert channels(address, "v2v", "veh1", "veh3") == ["vcan0", "vcan1", "can3"]
    assert ports(address, "veh2") == [47000]
    assert address.place_of("veh2").device == "lo"
    assert Address.parse("veh1=vcan").place_of("v2v") == Place("udp_multicast")


def test_options_and_the_bit_rate_go_to_python_can(monkeypatch):
    asked = []

    def refuse(**given):
        asked.append(given)
        raise OSError("not here")

    monkeypatch.setattr("can.Bus", refuse)
    for text in ("pcan:USB{}?fd=False&f_clock=80000000", "pcan:USB{}?bitrate=250000"):
        with pytest.raises(BadInput, match=re.escape("v2v: python-can cannot open pcan:USB0?")):
            open_link("v2v", Address.parse(text))
    common = {"interface": "pcan", "channel": "USB0"}
    bit_rate = load_codecs(1)["v2v"].bit_rate
    assert asked == [
        common | {"bitrate": bit_rate, "fd": False, "f_clock": 80_000_000},
        common | {"bitrate": 250_000},
    ]


@pytest.mark.parametrize("bus", ["veh0", "veh17", "veh", "vehicle1", "V2V", ""])
def test_a_bus_that_does_not_exist_is_named(bus):
    with pytest.raises(BadInput, match=f"bus '{bus}' does not exist"):
        open_link(bus, Address.parse("udp:5000"))


@pytest.mark.parametrize(
    ("texts", "words"),
    [
        ("pcan:A", "one channel for 4 buses; write {}"),
        ("pcan:A v2v=udp", "--can pcan:A: one channel for 3 buses; write {}"),
        ("pcan:A?fd=True v2v=udp", "one channel for 3 buses"),
        ("udp veh1=pcan:A veh2=pcan:A", "--can: veh1 and veh2 are both on pcan:A"),
        ("udp veh1=pcan:A veh2=pcan:A?fd=True", "veh1 and veh2 are both on pcan:A"),
        ("udp:45000 veh1=udp:45002", "--can: veh1 and veh2 are both on udp:45002"),
        ("vcan v2v=vcan veh2=socketcan:vcan1", "--can: veh1 and veh2 are both on socketcan:vcan1"),
        ("udp veh4=vcan", "--can veh4=...: the scenario has the buses v2v, veh1, veh2, veh3"),
    ],
)
def test_buses_that_cannot_be_are_refused(texts, words):
    with pytest.raises(BadInput, match=re.escape(words)), settle(Address.parse(*texts.split()), 3):
        pass


def test_a_network_device_that_is_not_there_is_refused_with_those_that_are():
    with (
        pytest.raises(BadInput, match=r"no network device nowhere0; this host has .*lo"),
        settle(Address.parse("udp", "veh1=udp:45000@nowhere0"), 3),
    ):
        pass


def test_only_others_can_tell_a_bus_whose_port_is_given():
    address = Address.parse("udp", "veh1=udp:45000", "veh2=vcan")
    assert [address.is_known(bus) for bus in ("v2v", "veh1", "veh2", "veh3")] == [False, True, True, False]
    assert not Address.parse("direct").is_known("veh1")


def test_udp_ports_are_chosen_and_freed(first_port):
    for _ in range(2):
        with (
            settle(Address.parse("udp"), vehicles=3) as one,
            settle(Address.parse("udp"), vehicles=3) as two,
        ):
            assert ports(one, "v2v", "veh3") == [first_port, first_port + 3]
            assert ports(two, "v2v", "veh3") == [first_port + 4, first_port + 7]
    with settle(Address.parse(f"udp:{first_port}"), vehicles=3) as again:
        assert ports(again, "v2v") == [first_port]


def test_given_ports_are_held_beside_those_that_are_chosen(first_port):
    with settle(Address.parse("udp", f"veh2=udp:{first_port + 1}", "veh3=udp"), vehicles=3) as one:
        assert ports(one, "v2v", "veh1", "veh2", "veh3") == [first_port + n for n in (4, 5, 1, 7)]
        with (
            pytest.raises(BadInput, match=f"udp:{first_port + 1}: not all of the UDP ports {first_port + 1} are free"),
            settle(Address.parse("udp", f"veh1=udp:{first_port + 1}"), vehicles=1),
        ):
            pass


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
        with reserve_udp_ports(3, first=first_port) as found:
            assert list(found) == [first_port, first_port + 1, first_port + 2]


def test_a_port_that_any_program_uses_is_passed_over(first_port):
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as other:
        other.bind(("", first_port + 2))
        with reserve_udp_ports(4) as found:
            assert found[0] == first_port + 4
        with pytest.raises(BadInput, match="not all"), reserve_udp_ports(4, first=first_port):
            pass


def test_a_port_that_somebody_listens_on_without_a_reservation_is_passed_over(first_port):
    """A python-can tool shares the port by design; still nobody may choose it for a bench of their own."""
    with (
        open_link("v2v", Address.parse(f"udp:{first_port}")),
        reserve_udp_ports(2) as found,
    ):
        assert found[0] == first_port + 2


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
            with reserve_udp_ports(4) as found:
                assert found[0] == first_port + 4
            with pytest.raises(BadInput, match="not all"), reserve_udp_ports(4, first=first_port):
                pass
        finally:
            holder.send_signal(signal.SIGKILL)
    with reserve_udp_ports(4) as found:
        assert found[0] == first_port
