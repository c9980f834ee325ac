"""Each hot module can be loaded in both forms in one process, without either disturbing the other."""

import sys

import pytest

from bench.compiled.modules import COMPILED
from tests.plain import compiled, plain


@pytest.mark.parametrize("name", COMPILED)
def test_both_forms_of_a_module_are_loaded(name: str) -> None:
    before = dict(sys.modules)
    interpreted, machine_code = plain(name), compiled(name)
    assert interpreted is not machine_code
    assert interpreted is plain(name)
    assert sys.modules[name] is machine_code
    assert all(sys.modules[each] is module for each, module in before.items())
