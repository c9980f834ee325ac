"""What a DBC file says is kept between runs, and only a whole file of the same content is believed."""

import sys
from pathlib import Path

import pytest

from bench.bus import kept_description
from bench.bus.codec import DBC_DIR, Codec
from bench.bus.dbc import describe
from bench.bus.description import BusDescription, as_json, from_json
from bench.bus.kept_description import description_of
from bench.errors import BadInput

FILES = ["vehicle.dbc", "v2v.dbc"]
DBC = (DBC_DIR / "vehicle.dbc").read_bytes()


@pytest.fixture
def folder(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """Where files are kept: not there yet."""
    monkeypatch.setattr(kept_description, "library_folder", lambda: tmp_path / "compiled")
    return tmp_path / "dbc"


def is_read_anew(monkeypatch: pytest.MonkeyPatch, dbc: bytes) -> bool:
    """Whether the DBC is read again; None in place of the module makes its import fail."""
    with monkeypatch.context() as patch:
        patch.setitem(sys.modules, "bench.bus.dbc", None)
        try:
            description_of(dbc, True)
        except ImportError:
            return True
        return False


@pytest.mark.parametrize("file", FILES)
def test_the_kept_text_says_all_that_the_file_says(file):
    bus = describe((DBC_DIR / file).read_bytes())
    assert len(bus.messages) > 5
    assert from_json(as_json(bus)) == bus
    assert hash(from_json(as_json(bus)))


@pytest.mark.parametrize("file", FILES)
def test_a_description_has_what_cantools_reads(file):
    codec = Codec(DBC_DIR / file)
    for name in codec.names:
        message, described = codec.message(name), codec.described(name)
        assert set(described.receivers) == message.receivers
        assert list(described.senders) == message.senders
        assert (described.cycle_time_ms or None) == message.cycle_time
        assert described.comment == message.comment
        for signal in message.signals:
            own = described.signal(signal.name)
            assert (own.start_bit, own.length, own.low, own.high) == (
                signal.start,
                signal.length,
                signal.minimum,
                signal.maximum,
            )
            assert own.texts == {number: str(text) for number, text in (signal.choices or {}).items()}


@pytest.mark.usefixtures("folder")
def test_the_second_time_the_file_is_not_read(monkeypatch):
    assert is_read_anew(monkeypatch, DBC)
    first = description_of(DBC, True)
    assert not is_read_anew(monkeypatch, DBC)
    assert description_of(DBC, True) == first
    assert is_read_anew(monkeypatch, DBC + b"\n")


def test_the_dbc_of_a_log_leaves_no_file(folder):
    assert isinstance(description_of(DBC, False), BusDescription)
    assert not folder.exists()


@pytest.mark.parametrize("damage", [b"", b"{}", b"half", b"other", b"\xff\x00"])
def test_a_damaged_or_foreign_file_is_written_anew(folder, monkeypatch, damage):
    whole = description_of(DBC, True)
    (file,) = folder.iterdir()
    content = file.read_bytes()
    if damage == b"half":
        damage = content[: len(content) // 2]
    if damage == b"other":
        # Whole, but that of another DBC.
        description_of((DBC_DIR / "v2v.dbc").read_bytes(), True)
        (other,) = set(folder.iterdir()) - {file}
        damage = other.read_bytes()
    file.write_bytes(damage)
    assert is_read_anew(monkeypatch, DBC)
    assert description_of(DBC, True) == whole
    assert file.read_bytes() == content


def test_without_a_place_nothing_is_kept_and_nothing_said(tmp_path, monkeypatch, capfd):
    (tmp_path / "file").touch()
    monkeypatch.setattr(kept_description, "library_folder", lambda: tmp_path / "file" / "compiled")
    assert description_of(DBC, True) == describe(DBC)
    assert capfd.readouterr() == ("", "")


@pytest.mark.parametrize("attribute", ["E2EDataId", "GenMsgTimeoutTime"])
def test_an_attribute_that_is_no_number_is_named(attribute):
    text = f"""VERSION ""
BU_: A
BO_ 1 M: 1 A
 SG_ S : 0|8@1+ (1,0) [0|255] "" A
BA_DEF_ BO_ "{attribute}" STRING ;
BA_DEF_DEF_ "{attribute}" "";
BA_ "{attribute}" BO_ 1 "soon";
"""
    with pytest.raises(BadInput, match=rf"message M: attribute {attribute} = 'soon' is not a number"):
        describe(text.encode())
