"""A universal binary: one file with a Mach-O for each of several processors; macOS loads the matching one.

The format is that of Apple's <mach-o/fat.h>: a header of big-endian words (a magic number, the number of binaries and
for each its processor, offset, size and alignment), then the binaries as they are. Each keeps its own signature, whose
offsets are relative to the binary's start.
"""

from __future__ import annotations

import struct
from collections.abc import Sequence

_FAT_MAGIC = 0xCAFEBABE
_MACHO_64_MAGIC = 0xFEEDFACF
# Pages are 16 KiB on Apple's processors; lipo aligns to them on all.
_ALIGNMENT_LOG2 = 14


def universal_binary(binaries: Sequence[bytes]) -> bytes:
    """The universal binary of 64-bit Mach-O binaries; a single one is returned unchanged.

    Raises:
        ValueError: one is not a little-endian 64-bit Mach-O.
    """
    if len(binaries) == 1:
        return binaries[0]
    header = struct.pack(">II", _FAT_MAGIC, len(binaries))
    body = b""
    end_of_header = len(header) + 20 * len(binaries)
    for binary in binaries:
        magic, processor, variant = struct.unpack_from("<III", binary)
        if magic != _MACHO_64_MAGIC:
            raise ValueError(f"not a 64-bit Mach-O: it begins with {magic:#x}, not {_MACHO_64_MAGIC:#x}")
        body += b"\0" * (-(end_of_header + len(body)) % 2**_ALIGNMENT_LOG2)
        offset = end_of_header + len(body)
        header += struct.pack(">IIIII", processor, variant, offset, len(binary), _ALIGNMENT_LOG2)
        body += binary
    return header + body
