"""The error of this package."""


class FmuError(Exception):
    """The FMU cannot be built, found or used; the text says what is wrong and how to mend it."""
