"""numba's `njit`, without the settings that numba takes from the working directory.

numba reads `.numba_config.yaml` there whenever it compiles. That file may name a folder for compiled code, and compiled
code is pickled: whoever can write to the working directory could run anything.
"""

import os
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path


@contextmanager
def _elsewhere() -> Iterator[None]:
    """Work in this package's folder while the context lasts."""
    before = os.open(os.curdir, getattr(os, "O_PATH", os.O_RDONLY))
    os.chdir(Path(__file__).parent)
    try:
        yield
    finally:
        os.fchdir(before)
        os.close(before)


with _elsewhere():
    import numba.core.config
    from numba import njit

numba.core.config._config_fname = os.devnull

__all__ = ["njit"]
