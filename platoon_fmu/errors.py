"""The errors of this package."""


class FmuError(Exception):
    """The FMU cannot be built, found or used; the text says what is wrong and how to mend it."""


class UnknownPlatform(FmuError):
    """An FMU was asked for a platform that there is no compiler for."""


class ProcessDied(FmuError):
    """A process that an FMU's binary was called in crashed, ended, or did not come back."""
