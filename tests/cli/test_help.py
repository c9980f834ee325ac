"""Help pages and usage errors: all of what they are to say, at any width."""

import inspect
import os
import re
import subprocess
import sys
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import pytest
import typer

from bench.cli.main import app

ROOT = Path(__file__).parents[2]
EXAMPLE = re.compile(r"^ +(platoon .*)$", re.MULTILINE)


def commands(command: Any = None, path: tuple[str, ...] = ()) -> Iterator[tuple[tuple[str, ...], Any]]:
    """All commands and groups, each with its path."""
    command = command or typer.main.get_command(app)
    yield path, command
    for name, each in getattr(command, "commands", {}).items():
        yield from commands(each, (*path, name))


COMMANDS = dict(commands())


def run(*arguments: str, width: int = 80) -> subprocess.CompletedProcess[str]:
    environment = {**os.environ, "COLUMNS": str(width), "NO_COLOR": "1"}
    script = "from bench.cli.main import main; main()"
    return subprocess.run(
        [sys.executable, "-P", "-c", script, *arguments], capture_output=True, text=True, check=False, env=environment
    )


def page(path: tuple[str, ...], width: int, monkeypatch: pytest.MonkeyPatch) -> str:
    monkeypatch.setenv("COLUMNS", str(width))
    root = typer.main.get_command(app)
    context = root.context_class(root, info_name="platoon", **root.context_settings)
    for name in path:
        command = context.command.commands[name]
        context = command.context_class(command, info_name=name, parent=context)
    return str(context.command.get_help(context))


def words(text: str | None) -> str:
    plain = (text or "").translate({0xA0: " ", 0x2011: "-", 8: None})
    # A line may end at a hyphen.
    return re.sub(r"(?<=\w)-\s+", "-", " ".join(plain.split()))


@pytest.mark.parametrize("width", [80, 100, 120, 200])
@pytest.mark.parametrize("path", COMMANDS, ids=" ".join)
def test_nothing_is_swallowed_or_cut(path: tuple[str, ...], width: int, monkeypatch: pytest.MonkeyPatch) -> None:
    command, shown = COMMANDS[path], page(path, width, monkeypatch)
    assert max(map(len, shown.splitlines())) <= width
    assert not re.search("[\xa0\u2011]", shown)
    flat = words(shown)
    for text in (command.help, command.epilog, *(parameter.help for parameter in command.params)):
        assert words(text) in flat
    for name, each in getattr(command, "commands", {}).items():
        assert f"{name} {words(each.help.partition(chr(10) * 2)[0])}" in flat


def examples() -> list[str]:
    return [line for _, command in COMMANDS.items() for line in EXAMPLE.findall(command.help or "")]


@pytest.mark.parametrize("width", [80, 100, 120])
def test_no_command_in_help_is_broken(width: int, monkeypatch: pytest.MonkeyPatch) -> None:
    assert len(examples()) >= 8
    for path, command in COMMANDS.items():
        lines = page(path, width, monkeypatch).splitlines()
        quoted = {
            q for text in (command.help, *(p.help for p in command.params)) for q in re.findall("`[^`]+`", text or "")
        }
        options = {o for p in command.params for o in re.findall(r"--[\w-]+\s[\w.]+[=:.]\S+", p.help or "")}
        for unbroken in (*EXAMPLE.findall(command.help or ""), *map(words, quoted | options)):
            assert any(unbroken in line for line in lines), (path, unbroken)


@pytest.mark.parametrize("line", examples())
def test_every_example_is_a_command_that_exists(line: str) -> None:
    words = line.partition("#")[0].partition(">")[0].split()[1:]
    command: Any = typer.main.get_command(app)
    while hasattr(command, "commands"):
        # A group may name the command itself: `platoon campaign STUDY.toml` is `platoon campaign run STUDY.toml`.
        context = command.make_context(command.name, words)
        _, command, words = command.resolve_command(context, [*context._protected_args, *context.args])
    command.make_context(command.name, words)


def test_what_looks_like_markup_is_shown() -> None:
    assert "[[faults]]" in run("fault", "--help").stdout


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        ("run --seed x", "'--seed': Input should be a valid integer, not 'x'"),
        ("run --seed 1.5", "'--seed': Input should be a valid integer, not '1.5'"),
        ("run --wait -1", "'--wait': Input should be greater than or equal to 0, not '-1'"),
        ("run --wait soon", "'--wait': Input should be a valid number, not 'soon'"),
        ("run --clok x", "No such option: --clok (Possible options: --clock)"),
        ("run --seed", "Option '--seed' requires an argument."),
        ("run five six", "extra argument"),
        ("ecu tracker --vehicle 0 --can udp:45000", "'--vehicle': Input should be greater than or equal to 1, not '0'"),
        ("ecu steward --vehicle 1 --can udp:45000", "'role': 'steward' is not one of 'planner', 'tracker'"),
        ("ecu tracker --can udp:45000", "Missing option '--vehicle'"),
        ("log export RUN.mcap --format xls", "'--format': 'xls' is not one of 'candump', 'asc'"),
        ("log export RUN.mcap --from a", "'--from': Input should be a valid number, not 'a'"),
        ("fmu build --fmi 4", "'--fmi': '4' is not one of '2', '3', 'all'"),
        ("vcan --memory much ls", "'--memory': Input should be a valid integer, not 'much'"),
        ("nonsense", "No such command 'nonsense'"),
        ("log nonsense", "No such command 'nonsense'"),
    ],
)
def test_a_wrong_option_is_said_in_plain_words(
    arguments: str, message: str, capsys: pytest.CaptureFixture[str]
) -> None:
    with pytest.raises(SystemExit) as ended:
        typer.main.get_command(app)(arguments.split(), prog_name="platoon")
    said = capsys.readouterr().err
    assert ended.value.code == 2
    assert message in said
    assert not re.search(r"unable to parse|Value error|pydantic|Traceback|<class", said)


def test_docstrings_of_commands_are_what_is_shown() -> None:
    for path, command in COMMANDS.items():
        if command.callback is not None and path:
            assert words(inspect.getdoc(command.callback)) == words(command.help)
