"""What may be on a line between `platoon fault` and a bench: anything else is refused, whoever wrote it."""

import json
from contextlib import suppress

import pytest
from hypothesis import given
from hypothesis import strategies as st

from bench.conductor.fault_socket import MOST_BYTES, parsed

SCALARS = st.none() | st.booleans() | st.integers(-(2**40), 2**40) | st.floats(allow_nan=False, allow_infinity=False)
TEXTS = st.text(st.characters(exclude_categories=["Cs"]), max_size=20)
VALUES = st.recursive(
    SCALARS | TEXTS, lambda v: st.lists(v, max_size=3) | st.dictionaries(TEXTS, v, max_size=3), max_leaves=9
)


@given(st.dictionaries(TEXTS, SCALARS | TEXTS, max_size=6))
def test_an_object_is_read_as_it_was_written(content: dict) -> None:
    line = json.dumps(content).encode()
    assert parsed(line) == content


@given(st.binary(max_size=200) | VALUES.map(lambda value: json.dumps(value).encode()))
def test_any_bytes_are_an_object_or_a_value_error(line: bytes) -> None:
    with suppress(ValueError):
        assert isinstance(parsed(line), dict)


@pytest.mark.parametrize(
    ("line", "words"),
    [
        (b"[" * 60_000, f"more than {MOST_BYTES} bytes"),
        (b"[" * MOST_BYTES, "nested more than 8 deep"),
        (b'{"a":' * 1000 + b"1" + b"}" * 1000, "nested more than 8 deep"),
        (b'{"a": "' + b"[" * 100 + b'", "b": ' + b"[" * 9, "nested more than 8 deep"),
        (b"\xff\xfe", "not UTF-8"),
        (b"", "not JSON"),
        (b"{", "not JSON"),
        (b"[]", "not an object"),
        (b"null", "not an object"),
        (b'{"a": NaN}', "NaN is not a finite number"),
        (b'{"a": -Infinity}', "-Infinity is not a finite number"),
        (b'{"a": 1e999}', "too large"),
        (b'{"a": ' + b"9" * 5000 + b"}", "more than 18 digits"),
        (b'{"a": 0.' + b"1" * 5000 + b"}", "too long a number"),
        (b'{"a": 1, "a": 2}', "a key occurs twice"),
        (b'{"a": "\\ud800"}', "half a surrogate pair"),
        (b'{"\\udc00": 1}', "half a surrogate pair"),
    ],
)
def test_what_is_refused_is_said(line: bytes, words: str) -> None:
    with pytest.raises(ValueError, match=words):
        parsed(line)


def test_brackets_in_text_are_no_nesting() -> None:
    assert parsed(b'{"a": "\\"[[[[[[[[[[{{{{{{{{{{"}') == {"a": '"[[[[[[[[[[{{{{{{{{{{'}
