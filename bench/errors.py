"""The bench's errors, which the command line turns into one message and an exit code."""


class BenchError(Exception):
    """Base of all errors shown to a user; its text is shown unchanged.

    Attributes:
        exit_code: the exit code of `platoon` when this error ends it.
    """

    exit_code = 1


class RunFailed(BenchError):
    """A run started and failed (an ECU died, a bus fell silent)."""

    exit_code = 1


class BadInput(BenchError):
    """Invalid input; nothing was started or written."""

    exit_code = 2


class EcuError(RunFailed):
    """An ECU's own code failed, or its step returned something that cannot be sent."""
