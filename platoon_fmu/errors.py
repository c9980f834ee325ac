"""The errors of this package."""


class FmuError(Exception):
    """The FMU cannot be built, found or used; the text names the problem and the remedy."""


class UnknownPlatform(FmuError):
    """An FMU was requested for a platform without a compiler."""


class ProcessDied(FmuError):
    """A process that called an FMU's binary crashed, ended, or timed out."""
