"""The command line: `main` puts the commands together, each other file is one group of them.

Whatever of this package is imported first, Python searches for garbage less often from then on: what an import makes
and what waits to be recorded are many objects, but no garbage.
"""

import gc

_NEW_OBJECTS = 50_000
"""Number of new objects, more than have been freed, after which garbage is searched for; Python's own is 700."""

gc.set_threshold(_NEW_OBJECTS)
