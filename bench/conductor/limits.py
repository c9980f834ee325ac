"""The limits that the system sets to a process (getrlimit(2)), checked before they are in the way."""

import resource

from bench.errors import BadInput

LEAST_FILES = 64
"""Open files that any command may need at once."""

FILES_OF_VEHICLE = 8
"""Open files that a run needs for each vehicle: pipes to its ECUs, and its bus."""

USUAL_FILES = 1024
"""Open files to which the soft limit is raised where the hard one permits it."""

LEAST_ADDRESS_SPACE = 1 << 30
"""Address space in bytes that any command may need; mostly compiled libraries, little of it memory."""

LEAST_STACK = 1 << 20
"""Stack in bytes that a thread needs."""


def require_files(count: int) -> None:
    """Permit this process and its children so many open files.

    Raises:
        BadInput: the system does not.
    """
    soft, hard = resource.getrlimit(resource.RLIMIT_NOFILE)
    most = max(soft, USUAL_FILES, count) if hard == resource.RLIM_INFINITY else min(hard, max(USUAL_FILES, count))
    if soft != resource.RLIM_INFINITY and soft < most:
        resource.setrlimit(resource.RLIMIT_NOFILE, (most, hard))
        soft = most
    if soft != resource.RLIM_INFINITY and soft < count:
        raise BadInput(f"this needs up to {count} open files, but {soft} are permitted; permit more: ulimit -n {count}")


def require_memory() -> None:
    """Check the limits on address space and stack.

    Raises:
        BadInput: they are too low for any command.
    """
    needs = {
        "address space": (resource.RLIMIT_AS, LEAST_ADDRESS_SPACE, "v"),
        "stack": (resource.RLIMIT_STACK, LEAST_STACK, "s"),
    }
    for name, (which, least, option) in needs.items():
        soft, _ = resource.getrlimit(which)
        if soft != resource.RLIM_INFINITY and soft < least:
            raise BadInput(
                f"this needs {least >> 10} KiB of {name}, but {soft >> 10} KiB are permitted; "
                f"permit more: ulimit -{option} {least >> 10}"
            )
