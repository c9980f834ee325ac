"""Files that have no name and need no disk: for what a bench passes to its processes."""

import os
import tempfile


def memory_file(content: bytes) -> int:
    """Return the descriptor of a file with this content, at its beginning; it lasts until everybody has closed it.

    Raises:
        OSError: the system does not permit it, for example for its limit on the size of files.
    """
    if hasattr(os, "memfd_create"):
        descriptor = os.memfd_create("platoon")
    else:
        with tempfile.TemporaryFile() as file:
            descriptor = os.dup(file.fileno())
    try:
        with open(descriptor, "wb", closefd=False) as file:
            file.write(content)
        os.lseek(descriptor, 0, os.SEEK_SET)
    except OSError:
        os.close(descriptor)
        raise
    return descriptor
