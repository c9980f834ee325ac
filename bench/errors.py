"""The bench's errors: what the command line turns into one message and an exit code."""


class BenchError(Exception):
    """Base of all errors a user can cause or meet; its text is shown as it stands.

    Attributes:
        exit_code: the exit code of `platoon` when this error ends it.
    """

    exit_code = 1


class RunFailed(BenchError):
    """A run started and did not end as it should (an ECU died, a bus fell silent)."""

    exit_code = 1


class BadInput(BenchError):
    """What the user gave cannot be used; nothing was started and nothing written."""

    exit_code = 2
