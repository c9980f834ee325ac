"""Runs of scenarios within worker processes, several at a time, at low priority; their results are kept."""

import hashlib
import multiprocessing
import os
import re
import signal
import tempfile
from collections.abc import Callable, Iterator, Sequence
from concurrent.futures import Future, ProcessPoolExecutor, as_completed
from dataclasses import dataclass
from pathlib import Path

from bench.benchmarks.comfort.results import Result, read, result_of, write
from bench.bus.link.address import Address
from bench.conductor.interrupts import Interrupted
from bench.conductor.options import RunOptions
from bench.conductor.run import run
from bench.errors import RunFailed
from bench.record import Run
from bench.scenario import load

ROOT = Path(__file__).parents[3]
NICE = 10


@dataclass(frozen=True)
class Job:
    """A run to make.

    Attributes:
        scenario: name of the scenario.
        overrides: `KEY=VALUE` each.
    """

    scenario: str
    overrides: Sequence[str] = ()

    def file(self, folder: Path) -> Path:
        """Return where its result is kept; another text of the scenario has another."""
        text = load(self.scenario, self.overrides).toml()
        name = re.sub(r"[^A-Za-z0-9]+", "-", self.scenario)
        return folder / f"{name}-{hashlib.sha256(text.encode()).hexdigest()[:12]}.json"


def results(jobs: Sequence[Job], folder: Path, processes: int, say: Callable[[str], None]) -> list[Result]:
    """Return the result of each job; those kept in a folder are not run again, but for failed ones.

    Args:
        jobs: what to run.
        folder: where results are kept; it is created.
        processes: how many run at a time.
        say: told of each run that has ended.
    """
    folder.mkdir(parents=True, exist_ok=True)
    files = [job.file(folder) for job in jobs]
    # A run that has failed may have lacked time or memory.
    missing = [job for job, file in zip(jobs, files, strict=True) if not file.exists() or read(file).failure]
    for number, (job, result) in enumerate(_made(missing, folder, processes), 1):
        say(f"{number} of {len(missing)}: {' '.join([job.scenario, *job.overrides])}: {_in_words(result)}")
    return [read(file) for file in files]


def _in_words(result: Result) -> str:
    formed = "not formed" if result.formed_s is None else f"formed at {result.formed_s:.2f} s"
    return f"{formed}; {'; '.join(result.problems) or 'no problem'}"


def _made(jobs: Sequence[Job], folder: Path, processes: int) -> Iterator[tuple[Job, Result]]:
    """Yield each job with its result as soon as it has run."""
    # Forked, a process would have the signal handlers and the threads of this one.
    context = multiprocessing.get_context("spawn")
    pool = ProcessPoolExecutor(processes, mp_context=context, initializer=_prepare)
    try:
        futures: dict[Future[Result], Job] = {pool.submit(made, job, folder): job for job in jobs}
        for future in as_completed(futures):
            yield futures[future], future.result()
    finally:
        pool.shutdown(cancel_futures=True)


def _prepare() -> None:
    os.nice(NICE)
    # Ctrl-C ends the run that is being made, which handles it itself, and this process with its parent.
    signal.signal(signal.SIGINT, signal.SIG_IGN)


def made(job: Job, folder: Path) -> Result:
    """Run a job, keep its result in a folder, and return it.

    Raises:
        Interrupted: a signal has come; nothing is kept.
    """
    scenario = load(job.scenario, job.overrides)
    with tempfile.TemporaryDirectory(prefix="platoon-bench-") as place:
        log = Path(place) / "run.mcap"
        options = RunOptions(
            scenario, Address.parse("direct"), log, ["bench.benchmarks", "comfort", job.scenario, *job.overrides]
        )
        try:
            run(options)
            result = result_of(Run(log))
        except Interrupted:
            raise
        except RunFailed as error:
            failure = str(error).partition("\n")[0]
            result = Result(scenario.name, len(scenario.vehicles), scenario.description, failure)
    write(result, job.file(folder))
    return result
