"""Formats an FMU's description and the findings about it for a terminal or a file."""

from collections.abc import Callable, Iterable, Sequence

import typer
from rich.cells import cell_len
from rich.console import ConsoleOptions, Group, RenderableType
from rich.table import Table
from rich.text import Text

from bench.cli.output import one_line, shown
from bench.cli.terminal import Terminal
from platoon_fmu.checks.findings import Check, Outcome
from platoon_fmu.info import CAUSALITIES, VARIABILITIES, FmuInfo, Value, VariableInfo

# Wider than any line: a file has no width at which lines must be wrapped.
_NO_WIDTH = 100_000
# Nobody reads a description wrapped into more lines than this.
_LEAST_WIDTH = 15
_LONGEST_FLAG = len("recommendedIntermediateInputSmoothness 1,")
_PLURALS = {
    "input": "inputs",
    "output": "outputs",
    "parameter": "parameters",
    "calculatedParameter": "calculated parameters",
    "structuralParameter": "structural parameters",
    "local": "local variables",
    "independent": "independent variables",
}
_STYLES = {Outcome.PASSED: "green", Outcome.SKIPPED: "yellow", Outcome.PROBLEM: "bold red"}
_KINDS = {"Model Exchange": "ME", "Co-Simulation": "CS"}
MOST_VARIABLES = 1000
"""Variables shown of each causality and variability."""
_WIDEST_NAME = len("directional derivatives")


def show_info(info: FmuInfo) -> None:
    """Print an FMU's head and its variables, a table for each causality and variability, on standard output."""
    _show(Group(_title(info), "", _head(info)))
    for causality in CAUSALITIES:
        for variability in VARIABILITIES:
            chosen = [v for v in info.variables if (v.causality, v.variability) == (causality, variability)]
            if chosen:
                _show(_heading(causality, variability, len(chosen)))
                _show(_variables(chosen[:MOST_VARIABLES]))
            if len(chosen) > MOST_VARIABLES:
                _show(Text(f"and {len(chosen) - MOST_VARIABLES} more; --json lists all"))


def show_check(check: Check) -> None:
    """Print a finding on standard output: one line in a file, wrapped on a terminal."""
    line = Table.grid(padding=(0, 2, 0, 0))
    line.add_column(width=len(Outcome.PASSED) + 1)
    line.add_column(width=2)
    line.add_column(width=_WIDEST_NAME + 1)
    line.add_column()
    kind = _KINDS.get(check.kind, check.kind)
    line.add_row(Text(check.outcome, style=_STYLES[check.outcome]), kind, check.name, Text(shown(check.text)))
    _show(line)


def _show(content: RenderableType) -> None:
    console = Terminal()
    if console.is_terminal:
        # If no column can shrink further, the terminal wraps the line; nothing is cut.
        width = max(console.width, console.measure(content, options=_unlimited(console)).minimum)
        console.print(content, width=width, crop=False)
        return
    plain = Terminal(width=_NO_WIDTH)
    with plain.capture() as capture:
        plain.print(content)
    for line in capture.get().split("\n")[:-1]:
        typer.echo(line.rstrip())


def _unlimited(console: Terminal) -> ConsoleOptions:
    return console.options.update(max_width=_NO_WIDTH)


def _title(info: FmuInfo) -> Text:
    kinds = " and ".join(info.interface_types)
    title = Text(shown(f"{info.model_name}, FMI {info.fmi_version}, {kinds}"), style="bold")
    return title.append(f"\n{shown(info.description)}", style="not bold") if info.description else title


def _head(info: FmuInfo) -> Table:
    table = Table.grid(padding=(0, 2, 0, 0))
    table.add_column(no_wrap=True)
    table.add_column(min_width=_LONGEST_FLAG)
    for subject, text in _facts(info):
        table.add_row(subject, text)
    return table


def _facts(info: FmuInfo) -> Iterable[tuple[str, str]]:
    if info.model_version:
        yield "model version", info.model_version
    if info.generation_tool:
        yield "made with", f"{info.generation_tool}{f' ({info.generation_time})' if info.generation_time else ''}"
    yield "binaries", ", ".join(info.platforms) or "none"
    yield "source code", "yes" if info.has_sources else "no"
    if info.default_experiment:
        yield "default experiment", ", ".join(f"{name} {_text(v)}" for name, v in info.default_experiment.items())
    for kind, flags in info.interface_types.items():
        yield kind, ", ".join(_claims(flags.items())) or "no capability flags set"


def _claims(flags: Iterable[tuple[str, Value]]) -> Iterable[str]:
    for name, value in flags:
        if value is True:
            yield name
        elif value is not False and name != "modelIdentifier":
            yield f"{name} {value}"


_Cell = Callable[[VariableInfo], str]
_COLUMNS: tuple[tuple[str, _Cell], ...] = (
    ("start", lambda v: _start(v)),
    ("min", lambda v: _text(v.minimum)),
    ("max", lambda v: _text(v.maximum)),
    ("nominal", lambda v: _text(v.nominal)),
)


def _heading(causality: str, variability: str, count: int) -> Text:
    name = _PLURALS[causality] if count > 1 else _PLURALS[causality].removesuffix("s")
    return Text(f"\n{count} {name}, {variability}", style="bold")


def _variables(variables: Sequence[VariableInfo]) -> Table:
    """A table of variables without empty columns; only descriptions are wrapped."""
    unit = "unit" if all(map(_usual, variables)) else "type, unit"
    columns = [(heading, cell) for heading, cell in _COLUMNS if any(cell(v) for v in variables)]
    table = Table(box=None, padding=(0, 2, 0, 0))
    for heading, cell in (("name", lambda v: v.name), (unit, _type_and_unit), *columns):
        width = max(cell_len(one_line(text)) for text in (heading, *map(cell, variables)))
        table.add_column(heading, justify="right" if (heading, cell) in columns else "left", min_width=width)
    table.add_column("description", min_width=_LEAST_WIDTH)
    for v in variables:
        cells = [v.name, _type_and_unit(v), *(cell(v) for _, cell in columns), " ".join((v.description or "").split())]
        table.add_row(*map(one_line, cells))
    return table


def _type_and_unit(v: VariableInfo) -> str:
    shape = f"[{','.join(map(str, v.shape))}]" if v.shape else ""
    type_name = "" if _usual(v) else f"{v.type}{shape}"
    unit = "" if v.unit in (None, "1") else f"{v.unit} ({v.display_unit})" if v.display_unit else v.unit
    return " ".join(filter(None, (type_name, unit)))


def _usual(v: VariableInfo) -> bool:
    return v.type in ("Real", "Float64") and not v.shape


def _start(v: VariableInfo) -> str:
    text = _text(v.start)
    return f"{text} ({v.items[text]})" if text in v.items else text


def _text(value: Value | list[Value] | None) -> str:
    if value is None:
        return ""
    if isinstance(value, list):
        return " ".join(map(_text, value))
    if isinstance(value, bool):
        return str(value).lower()
    return f"{value:.7g}" if isinstance(value, float) else str(value)
