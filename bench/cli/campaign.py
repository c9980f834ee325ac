"""`platoon campaign`: many runs of a scenario over its uncertainties, and what they say."""

from __future__ import annotations

import dataclasses
import re
import shlex
import sys
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from importlib.util import find_spec
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from bench.cli.fmu import vehicle_fmu
from bench.cli.help import App, HelpGroup
from bench.cli.machine_code import use_machine_code
from bench.cli.options import LOGS
from bench.cli.output import message
from bench.errors import BadInput, RunFailed
from bench.files import check_directory, check_report

if TYPE_CHECKING:
    from distributed import Client

    from bench.campaign.campaign import Count, Options
    from bench.campaign.study import Study

EXIT_CODES = (
    "Exit codes: 0 all runs are made, however they ended, 1 the campaign could not go on (its rows stay: --resume), "
    "2 bad input."
)
PACKAGES = {"distributed": "distributed", "cmaes": "cmaes", "SALib": "salib"}
"""Modules of the extra `campaign`, with the packages that have them."""
PLAIN_STEP_S = 10.0
"""Time in s between lines of progress if there is no terminal for a bar."""

Folder = Annotated[Path, typer.Argument(metavar="DIR", help="The folder of a campaign.")]


class _StudyFirst(HelpGroup):
    """A group whose first argument may be a study in place of a command."""

    def parse_args(self, ctx: Any, args: list[str]) -> list[str]:
        if args and args[0] not in self.commands and args[0] not in ctx.help_option_names:
            args = ["run", *args]
        return super().parse_args(ctx, args)


campaign_app = App(
    name="campaign",
    cls=_StudyFirst,
    help="Make many runs of a scenario over its uncertainties, and say what they show: "
    "platoon campaign STUDY.toml is short for platoon campaign run STUDY.toml.",
    epilog=EXIT_CODES,
)


@campaign_app.command(epilog=EXIT_CODES)
def run(
    study: Annotated[
        str | None, typer.Argument(metavar="STUDY", help="A study's TOML file, or a shipped study.", show_default=False)
    ] = None,
    workers: Annotated[
        int | None,
        typer.Option(metavar="N", min=1, max=1024, help="Processes on this machine; one per core if not given."),
    ] = None,
    cluster: Annotated[
        str | None, typer.Option(metavar="tcp://HOST:8786", help="A Dask scheduler, whose workers make the runs.")
    ] = None,
    scheduler_file: Annotated[
        Path | None, typer.Option(metavar="FILE", help="The file in which a Dask scheduler says where it is.")
    ] = None,
    runs: Annotated[int | None, typer.Option(metavar="N", help="Number of runs in place of the study's.")] = None,
    out: Annotated[
        Path | None, typer.Option(metavar="DIR", help="The folder for the results; logs/NAME if not given.")
    ] = None,
    resume: Annotated[bool, typer.Option("--resume", help="Make the runs that a folder does not have yet.")] = False,
    keep: Annotated[
        str | None,
        typer.Option(metavar="NUMBERS|all", help="Runs whose logs are kept in any case: --keep 0,17,40-49"),
    ] = None,
    worst: Annotated[
        int | None,
        typer.Option(
            metavar="K",
            min=0,
            max=1000,
            help="How many of the worst runs by each requirement keep a log, 5 if not given.",
        ),
    ] = None,
    search: Annotated[
        str | None,
        typer.Option(
            metavar="METRIC",
            help="Search for the worst by a requirement's metric in place of the study's sampling; --runs is the most.",
        ),
    ] = None,
    rare: Annotated[
        str | None,
        typer.Option(
            metavar="METRIC",
            help="Estimate a small probability of missing its requirement (subset simulation); --runs is a level's.",
        ),
    ] = None,
    dashboard: Annotated[
        bool, typer.Option("--dashboard", help="Serve Dask's dashboard on this machine, and print its address.")
    ] = False,
    example: Annotated[bool, typer.Option("--example", help="Print a study that explains itself.")] = False,
) -> None:
    """Make the runs of a study, and show what they say.

    Examples:
      platoon campaign --example > mine.toml
      platoon campaign mine.toml --workers 2
      platoon campaign mine.toml --runs 1000 --resume
      platoon campaign mine.toml --search least_clearance_m --runs 300
      platoon campaign robustness --cluster tcp://10.0.0.1:8786
    """
    from bench.campaign.study import MOST_RUNS, load_study, shipped_studies
    from bench.campaign.study import example as example_study

    if example:
        typer.echo(example_study(), nl=False)
        return
    if study is None:
        raise BadInput(f"give a study: a TOML file, or a shipped one: {', '.join(shipped_studies())}")
    if cluster and scheduler_file:
        raise BadInput("--cluster and --scheduler-file: give one of them")
    if workers and (cluster or scheduler_file):
        raise BadInput("--workers is for this machine; a cluster has the workers that were started for it")
    if search and rare:
        raise BadInput("--search and --rare: give one of them")
    seeks = bool(search or rare)
    if seeks and runs is not None and not 1 <= runs <= MOST_RUNS:
        raise BadInput(f"--runs {runs} is not allowed; allowed: 1 to {MOST_RUNS}")
    _require_packages()
    loaded = load_study(study, None if seeks else runs)
    what = f"-search-{search}" if search else f"-rare-{rare}" if rare else ""
    folder = out or LOGS / re.sub(r"[^A-Za-z0-9_.-]+", "-", f"{loaded.name}{what}")
    use_machine_code()
    from bench.campaign.campaign import Options
    from bench.campaign.cluster import Place
    from bench.campaign.results import WORST

    options = Options(
        folder,
        vehicle_fmu(),
        Place(workers, cluster, scheduler_file, dashboard),
        resume=resume,
        worst=WORST if worst is None else worst,
        asked=_numbers(keep),
        connected=_say_dashboard if dashboard else lambda _: None,
    )
    try:
        if search:
            _search(loaded, search, options, runs)
        elif rare:
            _rare(loaded, rare, options, runs)
        else:
            _sample(loaded, options)
    except RunFailed as error:
        again = shlex.join(["platoon", *sys.argv[1:], *([] if resume else ["--resume"])])
        there = f"\nWhat is made, stays; go on with: {again}" if (folder / "parts").is_dir() else ""
        raise type(error)(f"The campaign was stopped: {error}{there}") from error


def _require_packages() -> None:
    """Check that the packages of the extra `campaign` are there.

    Raises:
        BadInput: some are missing.
    """
    missing = [name for module, name in PACKAGES.items() if find_spec(module) is None]
    if missing:
        raise BadInput(f"campaigns need {' and '.join(missing)}; install it with: pip install {' '.join(missing)}")


def _sample(study: Study, options: Options) -> None:
    """Make the runs of a study's sampling, and show what they say."""
    from bench.campaign.campaign import begun
    from bench.campaign.sampling import each_sample
    from bench.cli.campaign_summary import show as show_summary

    with (
        _following(study) as follow,
        begun(study, dataclasses.replace(options, follow=follow), study.runs) as campaign,
    ):
        campaign.run(each_sample(study))
    show_summary(options.folder)
    _say_where(options.folder)


def _search(study: Study, metric: str, options: Options, runs: int | None) -> None:
    """Search for the worst run, and show it."""
    from bench.campaign.seeking import SEARCH_RUNS, search_worst

    found = search_worst(study, metric, options, runs or SEARCH_RUNS, _say)
    typer.echo("\n".join(found.lines(options.folder)))
    _say_where(options.folder)


def _rare(study: Study, metric: str, options: Options, samples: int | None) -> None:
    """Estimate a small probability, and show it."""
    from bench.campaign.rare import SAMPLES
    from bench.campaign.seeking import estimate_lines, rare_failures

    requirement, estimate = rare_failures(study, metric, options, samples or SAMPLES, _say)
    typer.echo("\n".join(estimate_lines(requirement, estimate)))
    _say_where(options.folder)


def _say(text: str) -> None:
    typer.echo(text, err=True)


def _say_where(folder: Path) -> None:
    typer.echo(f"results: {folder}\nreport:  platoon campaign report {folder}")


@campaign_app.command()
def show(
    folder: Folder,
    metrics: Annotated[bool, typer.Option("--metrics", help="Show the distribution of every metric too.")] = False,
) -> None:
    """Show what the runs of a campaign say, also while it goes on.

    Example:
      platoon campaign show logs/seed-paper
    """
    from bench.cli.campaign_summary import show as show_summary

    show_summary(folder, metrics=metrics)


@campaign_app.command()
def report(
    folder: Folder,
    output: Annotated[
        Path | None,
        typer.Option("-o", metavar="PAGE", help="The page to write, .html or .md; DIR/report.html if not given."),
    ] = None,
) -> None:
    """Write a page with what the runs of a campaign say: failures, what drives them, the worst runs.

    Example:
      platoon campaign report logs/seed-paper
    """
    page = output or folder / "report.html"
    if page.suffix == ".md":
        from bench.campaign import markdown

        check_directory(page)
        markdown.write(folder, page)
    else:
        from bench.campaign.page import report as write_page

        check_report(page)
        write_page(folder, page)
    typer.echo(f"report: {page}")


@campaign_app.command()
def scenario(
    folder: Folder,
    number: Annotated[int, typer.Argument(metavar="NUMBER", min=0, help="The number of the run.")],
) -> None:
    """Print the scenario of a run of a campaign, with which platoon run makes the same run again.

    Example:
      platoon campaign scenario logs/seed-paper 17 > run-17.toml
      platoon run run-17.toml --can direct
    """
    from bench.campaign.store import scenario_of

    typer.echo(scenario_of(folder, number).toml(), nl=False)


def _say_dashboard(client: Client) -> None:
    typer.echo(message(f"Dask's dashboard: {client.dashboard_link}"), err=True)


@contextmanager
def _following(study: Study) -> Iterator[Callable[[Count], None]]:
    """Show the progress of a campaign on standard error."""
    if not sys.stderr.isatty():
        yield _plain(study)
        return
    from rich.progress import BarColumn, TaskProgressColumn, TextColumn

    from bench.cli.terminal import progress

    columns = (TextColumn("{task.description}"), BarColumn(), TaskProgressColumn(), TextColumn("{task.fields[said]}"))
    with progress(*columns) as bars:
        task = bars.add_task(study.name, total=None, said="starting workers")

        def follow(count: Count) -> None:
            bars.update(task, total=count.total, completed=count.done, said=_said(count))

        yield follow


def _plain(study: Study) -> Callable[[Count], None]:
    told = time.monotonic()

    def follow(count: Count) -> None:
        nonlocal told
        if time.monotonic() - told >= PLAIN_STEP_S or count.done == count.total:
            told = time.monotonic()
            typer.echo(f"{study.name}: {_said(count)}", err=True)

    return follow


def _said(count: Count) -> str:
    """Return how far a campaign is, in words."""
    of = f"{count.done} runs" if count.total is None else f"{count.done} of {count.total} runs"
    left = "" if count.left_s is None else f", {_duration(count.left_s)} to go"
    return f"{of}, {count.failures} failed, {count.rate:.2f} a second{left}"


def _duration(seconds: float) -> str:
    minutes, rest = divmod(round(seconds), 60)
    hours, minutes = divmod(minutes, 60)
    return f"{hours} h {minutes} min" if hours else f"{minutes} min {rest} s" if minutes else f"{rest} s"


def _numbers(text: str | None) -> set[int] | None:
    """Return the numbers of runs in a text such as `0,17,40-49`; None for all.

    Raises:
        BadInput: it is none.
    """
    if text == "all":
        return None
    found: set[int] = set()
    for part in text.split(",") if text else []:
        match = re.fullmatch(r"\s*(\d{1,7})(?:-(\d{1,7}))?\s*", part)
        first, last = (int(match[1]), int(match[2] or match[1])) if match else (1, 0)
        if first > last:
            raise BadInput(f"--keep {text}: {part} is no run; allowed: numbers and ranges such as 0,17,40-49, or all")
        found.update(range(first, last + 1))
    return found
