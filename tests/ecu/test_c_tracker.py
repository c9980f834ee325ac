"""The C tracker: its build, its E2E protection against the bench's own, and what it says where it cannot start."""

import ctypes
import shutil
import subprocess
import sys
from collections.abc import Sequence
from pathlib import Path

import pytest
from hypothesis import given
from hypothesis import strategies as st

from bench.bus import e2e
from bench.bus.codec import DBC_DIR, Codec

SOURCE = Path(__file__).parents[2] / "bench" / "examples" / "tracker"
STATUSES = [e2e.Status.OK, e2e.Status.REPEATED, e2e.Status.WRONG_SEQUENCE, e2e.Status.ERROR]


def make(build: Path, *more: str) -> subprocess.CompletedProcess[str]:
    command = ["make", "-C", str(SOURCE), f"BUILD={build}", f"PYTHON={sys.executable}", *more]
    return subprocess.run(command, capture_output=True, text=True, check=False)


@pytest.fixture(scope="module")
def build(c_tracker: Path) -> Path:
    """Where the C tracker and what it is made of are."""
    return c_tracker.parent


class Receiver(ctypes.Structure):
    """struct e2e_receiver."""

    _fields_ = (("data_id", ctypes.c_uint16), ("counter", ctypes.c_int), ("allowed", ctypes.c_uint))


@pytest.fixture(scope="module")
def library(tmp_path_factory: pytest.TempPathFactory) -> ctypes.CDLL:
    path = tmp_path_factory.mktemp("e2e") / "e2e.so"
    subprocess.run(["cc", "-shared", "-fPIC", str(SOURCE / "e2e.c"), "-o", str(path)], check=True)
    return ctypes.CDLL(str(path))


@given(data=st.binary(min_size=2, max_size=8), data_id=st.integers(0, 0xFFFF), counter=st.integers(0, 2**24))
def test_it_protects_as_the_bench_does(library: ctypes.CDLL, data: bytes, data_id: int, counter: int) -> None:
    ours = bytearray(data)
    e2e.protect(ours, data_id, counter)
    theirs = ctypes.create_string_buffer(data, len(data))
    library.e2e_protect(theirs, ctypes.c_size_t(len(data)), ctypes.c_uint16(data_id), ctypes.c_uint(counter))
    assert theirs.raw == bytes(ours)


# A counter that goes on by some steps, an old or damaged frame, or a cycle without one.
EVENTS = st.lists(st.one_of(st.integers(0, 16), st.just("damaged"), st.just("short"), st.just("missed")), max_size=60)


@given(events=EVENTS)
def test_it_judges_as_the_bench_does(library: ctypes.CDLL, events: Sequence[int | str]) -> None:
    ours, theirs = e2e.Receiver(0x302), Receiver()
    library.e2e_receiver_init(ctypes.byref(theirs), ctypes.c_uint16(0x302))
    counter = 0
    for event in events:
        if event == "missed":
            ours.missed()
            library.e2e_missed(ctypes.byref(theirs))
            continue
        counter += event if isinstance(event, int) else 1
        data = bytearray(8)
        e2e.protect(data, 0x302, counter)
        if event == "damaged":
            data[5] ^= 0x40
        sent = bytes(data[:1] if event == "short" else data)
        judged = library.e2e_check(ctypes.byref(theirs), sent, ctypes.c_size_t(len(sent)))
        assert STATUSES[judged] is ours.check(sent)


def test_it_knows_the_data_ids_and_what_it_owes_the_bus(build: Path) -> None:
    codec = Codec(DBC_DIR / "vehicle.dbc")
    text = (build / "messages.h").read_text()
    own = [name for name in codec.names if "Tracker" in codec.message(name).senders]
    assert own
    for name in codec.names:
        can_id, data_id = codec.can_id(name), codec.data_id(name)
        if data_id:
            assert f"X(0x{can_id:03X}, {codec.message(name).length}, {data_id}, " in text
        elif name in own:
            assert f"X(0x{can_id:03X}, {codec.period(name) * 10})" in text


def test_it_says_how_it_is_called(build: Path) -> None:
    done = subprocess.run([str(build / "tracker")], capture_output=True, text=True, check=False)
    assert (done.returncode, done.stdout) == (2, "")
    assert done.stderr.startswith("usage: tracker LINK")


@pytest.mark.kernel_can
def test_a_link_that_is_not_there_is_said(build: Path) -> None:
    done = subprocess.run([str(build / "tracker"), "nowhere0"], capture_output=True, text=True, check=False)
    assert done.returncode == 1
    assert "there is no CAN link nowhere0" in done.stderr or "no SocketCAN" in done.stderr


def test_without_a_compiler_the_build_says_what_to_type(tmp_path: Path) -> None:
    done = make(tmp_path, "CC=no-such-compiler")
    assert done.returncode != 0
    assert "No working C compiler (no-such-compiler)" in done.stderr
    assert "apt install gcc libc6-dev" in done.stderr


def test_without_cantools_the_build_says_what_to_type(tmp_path: Path) -> None:
    bare = tmp_path / "python"
    bare.write_text(f'#!/bin/sh\nexec {shutil.which("python3")} -I -S "$@"\n')
    bare.chmod(0o755)
    done = make(tmp_path / "build", f"PYTHON={bare}")
    assert done.returncode != 0
    assert f"{bare} has no cantools" in done.stderr
    assert "pip install cantools" in done.stderr
