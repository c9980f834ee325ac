"""Labels of runs: one readable line, whatever was typed or stands in a log."""

import pytest

from bench.errors import BadInput
from bench.label import MAX_LABEL, checked_label, cleaned, shortened


@pytest.mark.parametrize(
    ("text", "shown"),
    [
        ("soft gains", "soft gains"),
        ("  soft \t\n gains\r\n", "soft gains"),
        ("Dämpfung ½, 軟 😀", "Dämpfung ½, 軟 😀"),
        ("\x1b[31mred\x1b[0m", "red"),
        ("\x9b31mred", "red"),
        ("\x1b]0;title\x07text\x1b]8;;https://x\x1b\\link", "textlink"),
        ("\x1b", ""),
        ("a\x00b\x7fc\x85d", "a b c d"),
        ("a\u202eb\u2066c\u200bd\ufeff", "abcd"),
        ("a\u2028b\u00a0c", "a b c"),
        ("\ud800x", "x"),
    ],
)
def test_a_text_becomes_one_line_without_what_controls_a_terminal(text: str, shown: str) -> None:
    assert cleaned(text) == shown


def test_a_label_is_neither_empty_nor_long() -> None:
    assert checked_label("x" * MAX_LABEL) == "x" * MAX_LABEL
    assert checked_label(f" \x1b[1m{'x' * MAX_LABEL} ") == "x" * MAX_LABEL
    with pytest.raises(BadInput, match=f"--label: {MAX_LABEL + 1} characters; allowed: at most {MAX_LABEL}"):
        checked_label("x" * (MAX_LABEL + 1))
    for text in ("", "  ", "\x1b[31m", "\u202e"):
        with pytest.raises(BadInput, match=r"--label .*: nothing to read in it"):
            checked_label(text)


def test_a_long_text_ends_in_an_ellipsis() -> None:
    assert [shortened("abc def", most) for most in (7, 6, 5, 4)] == ["abc def", "abc d…", "abc…", "abc…"]
