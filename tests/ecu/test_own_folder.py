"""What an ECU file imports from its own folder, and what nothing else sees of it."""

import sys
from pathlib import Path

import pytest

from bench.ecu.loading import load_class
from bench.errors import BadInput


def ecu(folder: Path, imports: str, what: str = "None", name: str = "my_ecu") -> object:
    """The class of an ECU file with these import statements, called for what is evaluated in a step."""
    folder.mkdir(exist_ok=True, parents=True)
    (folder / f"{name}.py").write_text(f"{imports}\nclass Mine:\n    def step(self):\n        return {what}\n")
    return load_class(f"{folder}/{name}.py:Mine")().step()


def write(folder: Path, **files: str) -> None:
    folder.mkdir(exist_ok=True, parents=True)
    for name, text in files.items():
        (folder / f"{name}.py").write_text(text)


@pytest.mark.parametrize(
    ("imports", "what"),
    [
        ("import helper", "helper.GAIN"),
        ("import helper as h", "h.GAIN"),
        ("from helper import GAIN", "GAIN"),
        ("from helper import *", "GAIN"),
        ("from . import helper", "helper.GAIN"),
        ("from .helper import GAIN", "GAIN"),
        ("import tools", "tools.gain()"),
        ("import tools.deep.value", "tools.deep.value.GAIN"),
        ("import tools.deep.value as value", "value.GAIN"),
        ("from tools.deep import value", "value.GAIN"),
        ("import plain.value", "plain.value.GAIN"),
        ("", "__import__('helper').GAIN"),
        ("import lazy", "lazy.gain()"),
    ],
)
def test_files_and_packages_beside_it_are_found(imports: str, what: str, tmp_path: Path) -> None:
    write(tmp_path, helper="GAIN = 3", lazy="def gain():\n    import helper\n    return helper.GAIN")
    write(tmp_path / "tools", __init__="def gain():\n    from .deep.value import GAIN\n    return GAIN")
    write(tmp_path / "tools" / "deep", __init__="", value="from helper import GAIN")
    write(tmp_path / "plain", value="from helper import GAIN")
    before, path = set(sys.modules), list(sys.path)
    assert ecu(tmp_path, imports, what) == 3
    assert sys.path == path
    # Under names that no import statement of the bench has.
    assert all(name.startswith("ecu_folder_") for name in set(sys.modules) - before)


def test_a_file_in_a_package_has_the_package_and_what_is_beside_both(tmp_path: Path) -> None:
    write(tmp_path, beside="VALUE = 1")
    write(tmp_path / "mine", __init__="START = 2", other="VALUE = 4")
    imports = "from . import START, other\nfrom mine.other import VALUE\nimport beside, other as same\n"
    assert ecu(tmp_path / "mine", imports, "(START, VALUE, beside.VALUE, same is other)") == (2, 4, 1, True)


def test_two_folders_in_one_process_have_helpers_of_the_same_name(tmp_path: Path) -> None:
    write(
        tmp_path / "a", helper="VALUE = 'a'\ndef late():\n    import later\n    return later.VALUE", later="VALUE = 'a'"
    )
    write(tmp_path / "b", helper="VALUE = 'b'", later="VALUE = 'B'")
    for _ in range(2):
        assert ecu(tmp_path / "a", "import helper", "helper.VALUE + helper.late()") == "aa"
        assert ecu(tmp_path / "b", "import helper", "helper.VALUE + __import__('later').VALUE") == "bB"


@pytest.mark.parametrize("name", ["bench", "platoon_fmu", "numpy", "json", "select", "builtins", "typing"])
def test_no_file_beside_an_ecu_takes_the_place_of_another_module(name: str, tmp_path: Path) -> None:
    write(tmp_path, **{name: "raise SystemError('imported')"})
    __import__(name)
    module = sys.modules[name]
    assert ecu(tmp_path, f"import {name}", name) is module
    # Not even one that nobody has imported yet.
    write(tmp_path, antigravity="raise SystemError", this="raise SystemError", nturl2path="raise SystemError")
    assert ecu(tmp_path, "import nturl2path", "nturl2path.__file__", name="other") == __import__("nturl2path").__file__


def test_an_import_that_found_another_module_says_so(tmp_path: Path) -> None:
    write(tmp_path, json="GAIN = 3")
    with pytest.raises(BadInput) as refused:
        ecu(tmp_path, "from json import GAIN")
    assert f"{tmp_path}/json.py is not used, as another module has that name; rename it" in str(refused.value)


@pytest.mark.parametrize("name", ["my-ecu", "2nd try", "v1.2", "été"])
def test_a_file_may_have_any_name(name: str, tmp_path: Path) -> None:
    write(tmp_path, helper="GAIN = 3")
    assert ecu(tmp_path, "from . import helper", "helper.GAIN", name=name) == 3


def test_nothing_of_the_working_directory_is_imported(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    write(tmp_path / "here", helper="GAIN = 3")
    monkeypatch.chdir(tmp_path / "here")
    with pytest.raises(BadInput, match="No module named 'helper'"):
        ecu(tmp_path / "there", "import helper")


def test_classes_of_a_helper_are_known_by_their_module(tmp_path: Path) -> None:
    text = "from __future__ import annotations\nimport dataclasses\n@dataclasses.dataclass\nclass D:\n    x: int = 3\n"
    write(tmp_path, helper=text)
    imports = "import pickle\nfrom helper import D"
    assert ecu(tmp_path, imports, "pickle.loads(pickle.dumps(D(4))).x") == 4
