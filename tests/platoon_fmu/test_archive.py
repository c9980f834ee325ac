"""Files that are no FMU: one clear line, and nothing of them is used."""

from __future__ import annotations

import struct
import subprocess
import sys
import zipfile
from pathlib import Path

import pytest

from platoon_fmu import archive
from platoon_fmu.checks.validate import validate
from platoon_fmu.errors import FmuError
from platoon_fmu.importer import opened
from platoon_fmu.info import info

HEAD = '<fmiModelDescription fmiVersion="{}" modelName="M" guid="g">{}</fmiModelDescription>'
UNREADABLE = "<ModelVariables><ScalarVariable name='a' valueReference='0'><Real declaredType='T'/></ScalarVariable>"


def zipped(path: Path, **members: str | bytes) -> Path:
    """A zip file; an underscore in a member's name stands for a dot."""
    with zipfile.ZipFile(path, "w", zipfile.ZIP_DEFLATED) as file:
        for name, content in members.items():
            file.writestr(name.replace("_", "."), content)
    return path


def described(path: Path, xml: str) -> Path:
    return zipped(path, modelDescription_xml=xml)


def patched(path: Path, signature: bytes, offset: int, content: bytes) -> Path:
    """A zip file with other bytes in each of its headers of a kind."""
    data = bytearray(path.read_bytes())
    start = data.find(signature)
    while start >= 0:
        data[start + offset : start + offset + len(content)] = content
        start = data.find(signature, start + 4)
    path.write_bytes(data)
    return path


def encrypted(path: Path) -> Path:
    patched(described(path, HEAD.format("2.0", "")), b"PK\x01\x02", 8, b"\x01\x00")
    return patched(path, b"PK\x03\x04", 6, b"\x01\x00")


BAD_FILES = {
    "missing": (lambda path: path, "no such file"),
    "directory": (lambda path: path.mkdir() or path, "is a directory"),
    "no zip": (lambda path: path.write_bytes(b"no zip") and path, "not a zip file"),
    "empty": (lambda path: path.touch() or path, "not a zip file"),
    "cut off": (lambda path: path.write_bytes(b"PK\x03\x04" + bytes(40)) and path, "not a zip file"),
    "no description": (lambda path: zipped(path, readme="nothing here"), "it has no modelDescription.xml"),
    "no XML": (lambda path: described(path, "This is no XML."), "is not XML: syntax error: line 1"),
    "unfinished XML": (lambda path: described(path, "<fmiModelDescription>"), "is not XML: no element found"),
    "another root": (lambda path: described(path, "<foo/>"), "has the root <foo>"),
    "no version": (lambda path: described(path, "<fmiModelDescription/>"), "has no fmiVersion"),
    "FMI 1.0": (lambda path: described(path, HEAD.format("1.0", "")), "FMI 1.0 is not supported; allowed: 2.0 and 3.0"),
    "FMI 4.0": (lambda path: described(path, HEAD.format("4.0", "")), "FMI 4.0 is not supported"),
    "no variables": (lambda path: described(path, HEAD.format("2.0", "")), "its modelDescription.xml is invalid: "),
    "an unknown type": (
        lambda path: described(path, HEAD.format("2.0", f"{UNREADABLE}</ModelVariables>")),
        "its modelDescription.xml is invalid: ",
    ),
    "encrypted": (encrypted, "is damaged: .* is encrypted"),
    "upwards": (lambda path: zipped(path, **{"../../evil": "x"}), "would be unpacked outside its folder"),
    "absolute": (lambda path: zipped(path, **{"/tmp/evil": "x"}), "would be unpacked outside its folder"),
    "backslash": (
        lambda path: zipped(path, **{"..\\evil": "x"}),
        "has a character that is not allowed in an FMU's paths",
    ),
    "drive": (lambda path: zipped(path, **{"C:evil": "x"}), "has a character that is not allowed in an FMU's paths"),
    "too large": (
        lambda path: patched(zipped(path, a="x"), b"PK\x01\x02", 24, struct.pack("<I", 2**32 - 16)),
        "its unpacked size is 4.0 GiB; allowed: up to 2 GiB",
    ),
}


@pytest.fixture(params=BAD_FILES)
def bad_file(request, tmp_path) -> tuple[Path, str]:
    make, said = BAD_FILES[request.param]
    return make(tmp_path / "bad.fmu"), said


def test_what_is_no_fmu_is_refused_with_one_line(bad_file):
    path, said = bad_file
    for use in (lambda: list(validate(path)), lambda: info(path), lambda: opened(path).__enter__()):
        with pytest.raises(FmuError, match=said) as caught:
            use()
        assert str(path) in str(caught.value)
        assert "\n" not in str(caught.value)
    assert sorted(p.name for p in path.parent.iterdir()) in ([], ["bad.fmu"])


@pytest.mark.parametrize("command", ["validate", "info"])
def test_the_commands_end_with_2_and_one_line(command, tmp_path):
    path = described(tmp_path / "old.fmu", HEAD.format("1.0", ""))
    done = subprocess.run(
        [sys.executable, "-m", "bench.cli", "fmu", command, str(path)], capture_output=True, text=True, check=False
    )
    assert (done.returncode, done.stdout) == (2, "")
    assert done.stderr == f"platoon: {path}: FMI 1.0 is not supported; allowed: 2.0 and 3.0\n"


def test_a_damaged_member_is_refused_when_it_is_unpacked(fmu_path, tmp_path):
    path = tmp_path / "damaged.fmu"
    data = bytearray(fmu_path.read_bytes())
    with zipfile.ZipFile(fmu_path) as file:
        member = next(m for m in file.infolist() if m.filename.startswith("binaries/"))
    middle = member.header_offset + len(member.filename) + 30 + member.compress_size // 2
    data[middle : middle + 8] = bytes(b ^ 0xFF for b in data[middle : middle + 8])
    path.write_bytes(data)
    with pytest.raises(FmuError, match=rf"its member {member.filename} is damaged"):
        list(validate(path))


def test_a_sound_fmu_is_unpacked_and_removed(fmu_path):
    archive.check_archive(fmu_path)
    with opened(fmu_path) as fmu:
        assert (fmu.folder / "modelDescription.xml").read_bytes() == archive.description_text(fmu_path)
        folder = fmu.folder
    assert not folder.exists()


def test_platforms_are_those_with_a_library():
    names = ["binaries/linux64/a.so", "binaries/win64/a.dll", "binaries/empty/", "binaries/x/readme.txt", "a.so"]
    assert archive.platforms(names) == ("linux64", "win64")
