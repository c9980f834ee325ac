"""One suite over every kind of bus (direct, udp, vcan where it is), then what each has of its own."""

import os
import selectors
import shutil
import socket
import subprocess
import sys
import time
from contextlib import ExitStack

import can
import pytest
from can.interfaces.udp_multicast import UdpMulticastBus
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st

from bench.bus.codec import load_codecs
from bench.bus.link.base import EXTENDED
from bench.bus.link.interface import InterfaceLink
from bench.bus.link.kernel_links import check_links, require_links
from bench.bus.link.opening import Address, LinkError, open_link, reserve_udp_ports, settle
from bench.errors import BadInput

FRAMES = st.tuples(
    st.integers(0, 0x7FF) | st.integers(0, 0x1FFF_FFFF).map(lambda i: i | EXTENDED), st.binary(max_size=8)
)
SAME_LINKS = settings(
    suppress_health_check=[HealthCheck.function_scoped_fixture, HealthCheck.differing_executors],
    deadline=None,
)


def socket_of(link):
    """Return the link's socket, as anybody can get at it who holds the link."""
    return socket.socket(fileno=os.dup(link.fileno()))


def receive(link, count, seconds=5.0):
    """Return the next `count` frames, waiting for them where the kernel needs time to deliver."""
    frames = link.receive()
    end = time.monotonic() + seconds
    while len(frames) < count and time.monotonic() < end:
        frames += link.receive()
    return frames


class BackToBack:
    """What holds on every bus."""

    address = ""

    @pytest.fixture
    def at(self):
        with settle(Address.parse(self.address), vehicles=1) as address:
            yield address

    @pytest.fixture
    def links(self, at):
        """Three ends of veh1."""
        with ExitStack() as stack:
            yield [stack.enter_context(open_link("veh1", at)) for _ in range(3)]

    def test_what_is_selected_comes(self, links):
        """Identifiers on both sides of where their encoding grows by a byte."""
        selected = [0x010, 0x07F, 0x080, 0x0FF, 0x100, 0x7FF]
        links[1].select(selected)
        for can_id in sorted([*selected, 0x011, 0x07E, 0x081, 0x0FE, 0x101, 0x7FE]):
            links[0].send(can_id, b"data")
        links[0].send(0x010, b"last")
        got = receive(links[1], len(selected) + 1)
        while got[-1] != (0x010, b"last"):
            got += receive(links[1], 1)
        assert [frame for frame in got if frame[0] in selected] == [
            *((can_id, b"data") for can_id in selected),
            (0x010, b"last"),
        ]
        assert {can_id for can_id, _ in got} == set(selected)

    def test_frames_sent_together_arrive_one_by_one_and_in_order(self, links):
        """More than one call of the system takes, of all lengths: not all can go as one long datagram."""
        frames = [(i % 0x800, bytes(8)) for i in range(150)] + [(i % 3, bytes(i % 9)) for i in range(150)]
        links[0].send_all(frames)
        for link in links[1:]:
            got = receive(link, len(frames))
            while len(got) < len(frames):
                got += receive(link, 1)
            assert got == frames
        assert links[0].receive() == []
        links[0].send_all([])
        assert links[1].receive() == []

    def test_a_frame_reaches_all_others_and_not_its_sender(self, links):
        links[0].send(0x123, b"\x01\x02\x03")
        assert receive(links[1], 1) == [(0x123, b"\x01\x02\x03")]
        assert receive(links[2], 1) == [(0x123, b"\x01\x02\x03")]
        assert links[0].receive() == []

    def test_receive_returns_at_once_when_there_is_nothing(self, links):
        assert [link.receive() for link in links] == [[], [], []]

    def test_order_is_kept_and_receive_drains(self, links):
        frames = [(i % 0x800, i.to_bytes(2, "big") * (i % 5)) for i in range(3000)]
        for can_id, data in frames:
            links[0].send(can_id, data)
        assert receive(links[1], len(frames)) == frames
        assert links[1].receive() == []
        assert receive(links[2], len(frames)) == frames
        assert [link.frames_lost() for link in links] == [0, 0, 0]

    def test_a_flood_is_returned_in_parts(self, links):
        for i in range(5000):
            links[0].send(i % 0x800, b"")
        first = links[1].receive()
        assert 0 < len(first) < 5000
        assert len(first + receive(links[1], 5000 - len(first))) == 5000

    @SAME_LINKS
    @given(st.lists(FRAMES, max_size=20))
    def test_all_frames_go_through_unchanged(self, links, frames):
        for can_id, data in frames:
            links[0].send(can_id, data)
        assert receive(links[1], len(frames)) == frames
        receive(links[2], len(frames))
        assert [link.ignored for link in links] == [0, 0, 0]

    def test_every_message_of_the_dbc_survives(self, links):
        codec = load_codecs(1)["veh1"]
        for name in codec.names:
            frame = codec.encode(name, codec.start_values(name), 4)
            links[0].send(*frame)
            assert receive(links[1], 1) == [frame]
            assert codec.decode(*frame)[0] == name

    def test_buses_do_not_hear_each_other(self, links, at):
        with open_link("v2v", at) as v2v, open_link("v2v", at) as v2v_too:
            links[0].send(0x001, b"veh1")
            v2v.send(0x002, b"v2v")
            assert receive(v2v_too, 1) == [(0x002, b"v2v")]
            assert receive(links[1], 1) == [(0x001, b"veh1")]
            assert v2v.receive() == v2v_too.receive() == links[1].receive() == []

    def test_bytes_like_data_is_sent_as_bytes(self, links):
        data = bytearray(b"abc")
        links[0].send(1, data)
        data[0] = 0
        assert receive(links[1], 1) == [(1, b"abc")]

    def test_a_closed_link_takes_no_part(self, links, at):
        gone = open_link("veh1", at)
        gone.close()
        gone.close()
        links[0].send(7, b"")
        assert receive(links[1], 1) == [(7, b"")]

    def test_its_name_is_the_bus(self, links):
        assert links[0].name == "veh1"
        assert "veh1" in repr(links[0])


class OnSockets(BackToBack):
    """What holds on every bus that is a socket of the kernel."""

    def test_a_selector_wakes_up_for_a_frame(self, links):
        with selectors.DefaultSelector() as selector:
            selector.register(links[1].fileno(), selectors.EVENT_READ)
            assert selector.select(timeout=0) == []
            links[0].send(1, b"x")
            assert selector.select(timeout=5) != []
            links[1].receive()
            assert selector.select(timeout=0) == []

    def test_lost_frames_are_counted_exactly(self, links):
        """A small buffer overflows; the counter tells what is missing even before anything more arrives."""
        sent = 5000
        with socket_of(links[1]) as sock:
            sock.setsockopt(socket.SOL_SOCKET, socket.SO_RCVBUF, 8192)
        for i in range(sent):
            links[0].send(i % 0x800, b"12345678")
        received = len(receive(links[2], sent))
        assert received == sent
        assert links[2].frames_lost() == 0
        received = len(links[1].receive())
        assert 0 < received < sent
        assert links[1].frames_lost() == sent - received
        assert links[0].frames_lost() == 0

    def test_losses_add_up_over_bursts(self, links):
        with socket_of(links[1]) as sock:
            sock.setsockopt(socket.SOL_SOCKET, socket.SO_RCVBUF, 4096)
        sent = received = 0
        for burst in (1, 300, 1, 700):
            for _ in range(burst):
                links[0].send(0x10, bytes(8))
            receive(links[2], burst)
            sent += burst
            received += len(links[1].receive())
            assert links[1].frames_lost() == sent - received
        assert received < sent

    def test_the_receive_buffer_is_large(self, links):
        with socket_of(links[0]) as sock:
            size = sock.getsockopt(socket.SOL_SOCKET, socket.SO_RCVBUF)
        assert size > 212_992 or os.geteuid() != 0


class TestDirect(BackToBack):
    address = "direct"

    def test_it_has_no_file_descriptor(self, links):
        assert links[0].fileno() == -1

    def test_two_benches_do_not_hear_each_other(self, links):
        with open_link("veh1", Address.parse("direct")) as other:
            other.send(1, b"other")
            links[0].send(2, b"ours")
            assert links[1].receive() == [(2, b"ours")]
            assert other.receive() == []


class TestUdp(OnSockets):
    address = "udp"

    @pytest.fixture
    def bare(self, at):
        """A python-can bus as any python-can tool would open it."""
        bus = UdpMulticastBus(UdpMulticastBus.DEFAULT_GROUP_IPv4, port=at.place_of("veh1").port, hop_limit=0)
        yield bus
        bus.shutdown()

    @pytest.mark.parametrize("can_id", [0x000, 0x7FF, EXTENDED | 0x123, EXTENDED | 0x1FFF_FFFF])
    def test_python_can_reads_what_is_sent(self, links, bare, can_id):
        links[0].send(can_id, b"abc")
        message = bare.recv(5)
        assert message.arbitration_id == can_id & ~EXTENDED
        assert message.is_extended_id == bool(can_id & EXTENDED)
        assert bytes(message.data) == b"abc"
        assert message.dlc == 3
        assert [message.is_fd, message.is_remote_frame, message.is_error_frame] == [False] * 3

    @SAME_LINKS
    @given(FRAMES)
    def test_what_python_can_sends_is_read(self, links, bare, frame):
        can_id, data = frame
        extended = bool(can_id & EXTENDED)
        bare.send(can.Message(arbitration_id=can_id & ~EXTENDED, data=data, is_extended_id=extended))
        assert [receive(link, 1) for link in links] == [[frame]] * 3

    @pytest.mark.parametrize(
        "other",
        [
            can.Message(arbitration_id=1, is_extended_id=False, is_remote_frame=True, dlc=3),
            can.Message(arbitration_id=1, is_error_frame=True),
            can.Message(arbitration_id=1, is_extended_id=False, is_fd=True, data=bytes(16)),
        ],
        ids=["remote", "error", "fd"],
    )
    def test_other_kinds_of_frames_are_ignored_and_counted(self, links, bare, other):
        bare.send(other)
        links[0].send(5, b"good")
        assert receive(links[1], 1) == [(5, b"good")]
        assert links[1].ignored == 1

    @SAME_LINKS
    @given(st.binary(max_size=600) | FRAMES.map(lambda f: b"\x8b\xa9" + f[1] * 9))
    def test_nothing_that_comes_to_the_port_breaks_a_link(self, links, at, datagram):
        before = links[1].ignored
        with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as stranger:
            stranger.sendto(datagram, (UdpMulticastBus.DEFAULT_GROUP_IPv4, at.place_of("veh1").port))
        links[0].send(5, b"good")
        assert receive(links[1], 1) == [(5, b"good")]
        assert links[1].ignored == before + 1
        receive(links[2], 1)

    @pytest.mark.parametrize(
        ("field", "value"),
        [
            ("arbitration_id", 0x800),
            ("arbitration_id", -1),
            ("arbitration_id", "1"),
            ("arbitration_id", None),
            ("data", bytes(9)),
            ("data", None),
            ("data", 12),
            ("data", "text"),
            ("is_extended_id", None),
        ],
    )
    def test_frames_that_cannot_be_are_ignored(self, links, at, field, value):
        import msgpack

        frame = {
            "arbitration_id": 0x7FF + (field == "is_extended_id"),
            "data": b"12",
            "is_extended_id": False,
        }
        frame |= dict.fromkeys(("is_remote_frame", "is_error_frame", "is_fd"), False) | {field: value}
        with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as stranger:
            stranger.sendto(msgpack.packb(frame), (UdpMulticastBus.DEFAULT_GROUP_IPv4, at.place_of("veh1").port))
        links[0].send(5, b"good")
        assert receive(links[1], 1) == [(5, b"good")]
        assert links[1].ignored == 1

    def test_frames_stay_on_this_host(self, links):
        """The hop limit of the sending socket is 0; it shares its options with the link's."""
        with socket_of(links[0]) as sock:
            assert sock.getsockopt(socket.IPPROTO_IP, socket.IP_MULTICAST_TTL) == 0

    def test_sending_on_a_closed_link_fails_with_the_bus(self, links):
        links[0].close()
        with pytest.raises(LinkError, match=r"veh1.*0x012"):
            links[0].send(0x12, b"")

    def test_python_can_reads_frames_sent_together_one_by_one(self, links, bare):
        links[0].send_all([(0x100 + i, bytes([i] * 8)) for i in range(70)])
        messages = [bare.recv(5) for _ in range(70)]
        assert [(m.arbitration_id, bytes(m.data)) for m in messages] == [(0x100 + i, bytes([i] * 8)) for i in range(70)]

    def test_frames_sent_together_on_a_closed_link_fail_with_the_first(self, links):
        links[0].close()
        with pytest.raises(LinkError, match=r"veh1.*0x012"):
            links[0].send_all([(0x12, bytes(8)), (0x13, bytes(8))])

    def test_a_port_that_another_program_has_is_named(self):
        with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as other:
            other.bind(("", 0))
            port = other.getsockname()[1]
            with pytest.raises(BadInput, match=rf"v2v: UDP port {port} is used by another program"):
                open_link("v2v", Address.parse(f"udp:{port}"))

    def test_without_a_port_it_says_which_is_missing(self):
        with pytest.raises(BadInput, match="udp:PORT"):
            open_link("v2v", Address.parse("udp"))

    def test_without_msgpack_it_says_what_to_type(self, monkeypatch):
        monkeypatch.setitem(sys.modules, "msgpack", None)
        with pytest.raises(BadInput, match="pip install msgpack"):
            open_link("v2v", Address.parse("udp:43113"))

    def test_without_a_multicast_route_what_it_says_to_type_mends_it(self):
        """Run in a network namespace of its own, which has no routes; then type what the message says."""
        unshare, ip = shutil.which("unshare"), shutil.which("ip")
        in_namespace = [unshare, "--net", "--map-root-user"]
        if not (unshare and ip) or subprocess.run([*in_namespace, "true"], check=False, capture_output=True).returncode:
            pytest.skip("needs unshare and ip, and the right to make a network namespace")
        code = """
import subprocess, sys
from bench.bus.link.opening import *
try:
    open_link("v2v", Address.parse("udp:43113"))
    sys.exit("opened without a route")
except Exception as error:
    print(error)
    subprocess.run(str(error).splitlines()[-1].replace("sudo ", ""), shell=True, check=True)
with open_link("v2v", Address.parse("udp:43113")) as a, open_link("v2v", Address.parse("udp:43113")) as b:
    a.send(1, b"mended")
    print(b.receive())
"""
        done = subprocess.run([*in_namespace, sys.executable, "-c", code], capture_output=True, text=True, check=False)
        assert done.stderr == ""
        assert "no route for multicast" in done.stdout
        assert done.stdout.splitlines()[-1] == "[CanFrame(can_id=1, data=b'mended')]"


def missing_vcan():
    try:
        require_links(["vcan0", "vcan1"])
    except BadInput as error:
        return "vcan0 and vcan1 are needed: " + str(error).partition(";")[0]
    return ""


@pytest.mark.skipif(bool(missing_vcan()), reason=missing_vcan())
@pytest.mark.kernel_can
class TestVcan(OnSockets):
    address = "vcan"

    def test_remote_frames_are_ignored_and_counted(self, links):
        with can.Bus(interface="socketcan", channel="vcan1") as bare:
            bare.send(can.Message(arbitration_id=1, is_extended_id=False, is_remote_frame=True))
            bare.send(can.Message(arbitration_id=2, is_extended_id=False, data=b"good"))
        assert receive(links[1], 1) == [(2, b"good")]
        assert links[1].ignored == 1

    def test_python_can_reads_what_is_sent(self, links):
        with can.Bus(interface="socketcan", channel="vcan1") as bare:
            links[0].send(EXTENDED | 0x123, b"abc")
            message = bare.recv(5)
        assert (message.arbitration_id, message.is_extended_id) == (0x123, True)
        assert bytes(message.data) == b"abc"

    def test_missing_links_are_all_named_with_what_to_type(self):
        with pytest.raises(BadInput) as caught:
            check_links(["vcan0", "vcan98", "vcan99"])
        for missing in ("vcan98", "vcan99"):
            assert f"sudo ip link add {missing} type vcan\n  sudo ip link set {missing} up" in str(caught.value)
        assert "vcan0 " not in str(caught.value)

    def test_missing_real_links_are_all_named_with_what_to_type(self):
        with pytest.raises(BadInput) as caught, settle(Address.parse("socketcan:can{}"), vehicles=2):
            pass
        commands = [f"  sudo ip link set can{number} up type can bitrate 500000" for number in range(3)]
        assert str(caught.value).splitlines()[1:] == commands


@pytest.mark.skipif(not missing_vcan(), reason="this machine has vcan0 and vcan1")
def test_without_vcan_it_says_what_to_type():
    with pytest.raises(BadInput, match=r"sudo (modprobe -a can_raw vcan|ip link add vcan\d type vcan)"):
        open_link("v2v", Address.parse("vcan"))
    with pytest.raises(BadInput, match=r"sudo "), settle(Address.parse("vcan"), vehicles=1):
        pass


def test_an_interface_that_cannot_be_opened_is_named():
    """Whatever its driver raises: kvaser's without its library a NameError."""
    with pytest.raises(BadInput, match=r"veh1: python-can cannot open kvaser:7"):
        open_link("veh1", Address.parse("kvaser:7"))


def test_an_interface_without_a_file_descriptor_is_refused():
    with pytest.raises(BadInput, match="VirtualBus has no file descriptor"):
        open_link("veh1", Address.parse("virtual:here"))


@pytest.fixture
def any_ends():
    """A link over a bus that it knows only through python-can's own calls, and such a bus itself."""
    with reserve_udp_ports(1) as ports:
        group = UdpMulticastBus.DEFAULT_GROUP_IPv4
        link_bus, bare = (UdpMulticastBus(group, port=ports[0], hop_limit=0) for _ in range(2))
        with InterfaceLink("v2v", link_bus) as link:
            yield link, bare
        bare.shutdown()


@SAME_LINKS
@given(FRAMES)
def test_frames_go_through_any_interface_unchanged(any_ends, frame):
    link, bare = any_ends
    can_id, data = frame
    extended = bool(can_id & EXTENDED)
    bare.send(can.Message(arbitration_id=can_id & ~EXTENDED, data=data, is_extended_id=extended))
    assert receive(link, 1) == [frame]
    assert bare.recv(5).arbitration_id == can_id & ~EXTENDED
    link.send(can_id, data)
    message = bare.recv(5)
    assert (message.arbitration_id, message.is_extended_id) == (can_id & ~EXTENDED, extended)
    assert bytes(message.data) == data
    # This interface, unlike hardware, gives a link its own frames back.
    assert receive(link, 1) == [frame]
    assert link.frames_lost() == 0


def test_any_interface_can_be_waited_on(any_ends):
    link, bare = any_ends
    with selectors.DefaultSelector() as selector:
        selector.register(link.fileno(), selectors.EVENT_READ)
        assert selector.select(timeout=0) == []
        bare.send(can.Message())
        assert selector.select(timeout=5) != []


def test_any_interface_ignores_and_counts_other_kinds_of_frames(any_ends):
    link, bare = any_ends
    bare.send(can.Message(arbitration_id=1, is_extended_id=False, is_remote_frame=True))
    bare.send(can.Message(arbitration_id=2, is_extended_id=False, data=b"good"))
    assert receive(link, 1) == [(2, b"good")]
    assert link.ignored == 1


def test_a_closed_interface_fails_with_the_bus(any_ends):
    link, _ = any_ends
    link.close()
    with pytest.raises(LinkError, match="v2v: frame 0x012 cannot be sent"):
        link.send(0x12, b"")
