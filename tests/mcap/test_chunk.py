"""Chunks that are not what they say."""

import struct
import tracemalloc
import zlib

import lz4.frame
import pytest
import zstandard

from bench.mcap.chunk import MAX_CHUNK, chunk_head, unpacked
from bench.mcap.container import MAGIC
from bench.mcap.pages import Pages
from bench.mcap.walk import walk

MIB = 1024 * 1024
SIZES = (10, MIB, 3 * MIB + 5)


def chunk(records, *, size=None, told=True, compression=b"zstd"):
    """A chunk record's content; `size` is what it says, `told` whether the packed data say it too."""
    packed = records
    if compression == b"zstd":
        packed = zstandard.ZstdCompressor(write_content_size=told).compress(records)
    elif compression == b"lz4":
        packed = lz4.frame.compress(records, store_size=told)
    crc = zlib.crc32(records)
    head = struct.pack("<QQQII", 1, 2, len(records) if size is None else size, crc, len(compression))
    return head + compression + struct.pack("<Q", len(packed)) + packed


def unpack(content):
    return unpacked(content, chunk_head(content, 0, len(content)))


@pytest.mark.parametrize("size", SIZES)
@pytest.mark.parametrize("told", [True, False])
@pytest.mark.parametrize("compression", [b"zstd", b"lz4", b""])
def test_a_true_one_comes_back(size, told, compression):
    records = bytes(range(256)) * (size // 256) + b"end"
    assert unpack(chunk(records, told=told, compression=compression)) == records


@pytest.mark.parametrize("size", SIZES)
@pytest.mark.parametrize("told", [True, False])
@pytest.mark.parametrize("more", [-1, 1, 10 * MIB])
@pytest.mark.parametrize("compression", [b"zstd", b"lz4", b""])
def test_one_of_another_size_than_it_says_is_refused(size, told, more, compression):
    with pytest.raises((ValueError, zstandard.ZstdError)):
        unpack(chunk(bytes(size), size=size + more, told=told, compression=compression))


@pytest.mark.parametrize("place", [0, 4, 7, 20, -6])
def test_lz4_that_is_damaged_is_refused(place):
    content = bytearray(chunk(bytes(range(256)) * 20, compression=b"lz4"))
    at = place if place < 0 else struct.calcsize("<QQQII3sQ") + place
    content[at] ^= 0x55
    with pytest.raises(ValueError, match=r"unpacked|checksum|another size"):
        unpack(bytes(content))


@pytest.mark.parametrize("size", [MAX_CHUNK + 1, 2**62, 2**64 - 1])
def test_one_that_says_it_is_huge_is_refused(size):
    with pytest.raises(ValueError, match="a chunk of"):
        unpack(chunk(b"x", size=size))


@pytest.mark.parametrize("compression", [b"lz5", b"zst\x64x"])
def test_a_compression_that_is_not_known_is_refused(compression):
    with pytest.raises(ValueError, match="compression"):
        unpack(chunk(b"x", compression=compression))


def test_memory_is_taken_for_what_comes_and_not_for_what_is_said():
    liar = chunk(b"x", size=MAX_CHUNK, told=False)
    bombs = [chunk(bytes(MAX_CHUNK), size=2 * MIB, told=False, compression=name) for name in (b"zstd", b"lz4")]
    tracemalloc.start()
    try:
        for content in (liar, *bombs):
            with pytest.raises((ValueError, zstandard.ZstdError)):
                unpack(content)
        assert tracemalloc.get_traced_memory()[1] < 8 * MIB
    finally:
        tracemalloc.stop()


@pytest.mark.parametrize("place", [0, 8, 16, 24, 28, 32, 36, 40])
def test_a_length_that_points_outside_is_refused(place):
    content = bytearray(chunk(b"x" * 100))
    content[place : place + 4] = b"\xff\xff\xff\x7f"
    try:
        assert unpack(bytes(content)) == b"x" * 100
    except (ValueError, struct.error, zstandard.ZstdError):
        # The two times are the only ones of these that are no lengths and no checksum.
        assert place > 8


def test_a_file_full_of_what_looks_like_chunks_is_given_up_on():
    data = MAGIC + (b"\x06" + bytes(36) + b"\x04\0\0\0zstd") * 100_000
    walked = walk(data, Pages(data))
    assert len(walked.contents.chunks) == 0
    assert walked.lost[-1][1] == len(data)
