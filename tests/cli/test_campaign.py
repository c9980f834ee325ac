"""`platoon campaign` as a user calls it: what it refuses, and what it says of a campaign it has made."""

import sys

import pytest

from bench.campaign.study import load_study
from tests.campaign.commands import PLATOON, Command, parts, until, write_study

MINE = ["campaign", "study.toml"]


@pytest.mark.parametrize(
    ("words", "message"),
    [
        (["campaign", "run"], "give a study: a TOML file, or a shipped one"),
        (["campaign", "robustnes"], "No study 'robustnes': not a file"),
        ([*MINE, "--runs", "0"], "--runs 0 is not allowed; allowed: 1 to 1000000"),
        ([*MINE, "--runs", "many"], "Invalid value for '--runs'"),
        ([*MINE, "--workers", "0"], "Invalid value for '--workers'"),
        ([*MINE, "--workers", "2", "--cluster", "tcp://127.0.0.1:1"], "--workers is for this machine"),
        ([*MINE, "--cluster", "tcp://127.0.0.1:1", "--scheduler-file", "a.json"], "give one of them"),
        ([*MINE, "--keep", "1,last"], "--keep 1,last: last is no run; allowed: numbers and ranges"),
        ([*MINE, "--keep", "9-3"], "--keep 9-3: 9-3 is no run"),
        ([*MINE, "--worst", "-1"], "Invalid value for '--worst'"),
        ([*MINE, "--out", "."], ". already exists, and is no campaign; give another --out"),
        ([*MINE, "--out", "nowhere", "--resume"], "--resume: nowhere is no campaign"),
        (["campaign", "base.toml"], "base.toml"),
        (["campaign", "show", "nowhere"], "nowhere has no study.toml"),
    ],
)
def test_bad_input_ends_with_2_before_anything_starts(words, message, tmp_path, refused):
    write_study(tmp_path, [1, 2])
    assert message in refused(*words, cwd=tmp_path)


def test_the_example_is_a_study(tmp_path):
    command = Command([*PLATOON, "campaign", "--example"], tmp_path)
    try:
        assert (command.code(), command.said) == (0, "")
        (tmp_path / "example.toml").write_text(command.out, encoding="utf-8")
    finally:
        command.end()
    study = load_study(tmp_path / "example.toml")
    assert (study.name, study.base, study.runs, study.sampling) == ("example", "formation", 16, "sobol")
    assert "road.lambda_f" in study.keys


def test_a_campaign_shows_what_it_found_and_how_to_go_on(tmp_path, begin):
    write_study(tmp_path, [1, 900, 2])
    command = begin([*PLATOON, *MINE, "--workers", "1", "--out", "out", "--worst", "1"])
    assert command.code() == 0, command.said
    # No terminal, so there is no bar: lines, the last of them at the end.
    assert command.said.splitlines()[-1].startswith("study: 3 of 3 runs, 1 failed, ")
    assert command.said.endswith(" a second, 0 s to go\n")
    assert "results: out\n" in command.out
    assert "platoon campaign report out" in command.out
    assert "1 of 3 runs failed" in command.out
    shown = begin([*PLATOON, "campaign", "show", "out"])
    assert shown.code() == 0, shown.said
    assert shown.out in command.out
    until(lambda: not command.all(), "the end of all its processes")

    again = begin([*PLATOON, *MINE, "--out", "out"])
    assert again.code() == 2
    assert again.said.splitlines() == ["platoon: out already exists; go on with it by --resume, or give another --out"]
    done = begin([*PLATOON, *MINE, "--workers", "1", "--out", "out", "--worst", "1", "--resume"])
    assert done.code() == 0, done.said
    assert done.out == command.out
    assert parts(tmp_path / "out").height == 3


def test_a_missing_package_is_named_before_anything_starts(tmp_path, refused, monkeypatch):
    write_study(tmp_path, [1, 2])
    # As if it were not installed: Python takes a None here for a module that is known not to exist.
    monkeypatch.setitem(sys.modules, "cmaes", None)
    assert "campaigns need cmaes; install it with: pip install cmaes" in refused(*MINE, cwd=tmp_path)
