"""Settings of the tests of the buses."""

from hypothesis import settings

# No test asserts on wall-clock time, so none by Hypothesis' deadline either.
settings.register_profile("no_deadline", deadline=None)
settings.load_profile("no_deadline")
