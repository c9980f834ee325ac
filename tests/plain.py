"""The interpreted form of compiled modules beside the machine code, in one process: both must give the same bits."""

import importlib
import os
import sys
from collections.abc import Iterator
from contextlib import contextmanager
from functools import cache
from importlib.machinery import SourceFileLoader
from types import ModuleType
from unittest.mock import patch

import numpy as np

from bench.compiled.finder import INTERPRETED, is_wanted

_OWN = ("bench", "platoon_fmu")
_modules: dict[str, ModuleType] = {}
"""All modules of the packages a second time, interpreted."""


@cache
def plain(name: str) -> ModuleType:
    """Return a module that is interpreted, as are all of the packages' modules that it imports."""
    with _second_packages():
        found = importlib.import_module(name)
    assert isinstance(found.__loader__, SourceFileLoader), f"{name} is not interpreted"
    return found


@contextmanager
def _second_packages() -> Iterator[None]:
    """Let imports find the packages' second modules."""
    first = {name: module for name, module in sys.modules.items() if name.partition(".")[0] in _OWN}
    finders = [finder for finder in sys.meta_path if type(finder).__module__ != "bench.compiled.finder"]
    for name in first:
        del sys.modules[name]
    sys.modules.update(_modules)
    try:
        with patch.dict(os.environ, {INTERPRETED: "1"}), patch.object(sys, "meta_path", finders):
            yield
    finally:
        for name in [name for name in sys.modules if name.partition(".")[0] in _OWN]:
            _modules[name] = sys.modules.pop(name)
        sys.modules.update(first)


def compiled(name: str) -> ModuleType:
    """Return the module as the bench runs it; machine code, unless all is to be interpreted."""
    module = importlib.import_module(name)
    if is_wanted():
        assert type(module.__loader__).__name__ == "_Loader", f"{name} is interpreted"
    return module


def bits(value: object) -> object:
    """Return a result in a form in which only the same bits are equal: numbers as text, objects as what they hold."""
    if isinstance(value, float | np.floating):
        return "nan" if value != value else float(value).hex()
    if isinstance(value, np.ndarray):
        return value.shape, value.dtype.str, [bits(each) for each in value.ravel().tolist()]
    if isinstance(value, dict):
        return {key: bits(each) for key, each in value.items()}
    if isinstance(value, list | tuple):
        return [bits(each) for each in value]
    if isinstance(value, bool | int | str | bytes | None):
        return value
    fields = getattr(value, "__dataclass_fields__", None)
    if fields is None:
        raise TypeError(f"{type(value).__name__} has no plain form")
    return [type(value).__name__, {name: bits(getattr(value, name)) for name in fields}]
