"""A Dask worker's part of a campaign: it has runs made by processes of its own, which stay warm."""

from __future__ import annotations

import pickle
import tempfile
from collections.abc import Mapping
from contextlib import suppress
from dataclasses import replace
from pathlib import Path
from typing import Any, cast

from distributed import Worker, WorkerPlugin, get_worker

from bench.campaign.jobs import MOST_TRIES, Job, Made, Setup
from bench.campaign.keeping import is_wanted
from bench.campaign.run_process import Crashed, NotStarted, RunProcesses, TooLong
from bench.campaign.statuses import CRASHED, OK, REFUSED, SHORT, TIMEOUT
from bench.campaign.version import difference, versions
from bench.errors import BadInput, RunFailed, shortage


class Runner(WorkerPlugin):
    """Makes the runs of a campaign on one worker; Dask sends it to all workers, also to those that join later."""

    def __init__(self, setup: Setup) -> None:
        """Take what the campaign's runs need."""
        self._setup = setup
        self.name = setup.name
        self._worker: Worker | None = None
        self._processes: RunProcesses | None = None
        self._problem = "is not prepared"

    def setup(self, worker: Worker) -> None:
        """Check this worker, and prepare its folder.

        Raises:
            BadInput: it has other code or packages than the client.
            OSError: its folder cannot be written.
        """
        try:
            check_versions(self._setup.versions, worker.address)
            self._prepare(worker)
        except (BadInput, OSError) as error:
            # Dask goes on with a worker that has joined later, whatever its setup says.
            self._problem = str(error) if isinstance(error, BadInput) else f"the worker {worker.address}: {error}"
            raise

    def _prepare(self, worker: Worker) -> None:
        self._worker = worker
        # A worker that is ended in the middle of a run has it killed, and what it writes vanishes under it.
        self._place = tempfile.TemporaryDirectory(
            prefix="platoon-", dir=worker.local_directory, ignore_cleanup_errors=True
        )
        self._folder = Path(self._place.name)
        places = {place: self._place_of(place, content) for place, content in self._setup.files.items()}
        study = self._setup.study.with_files(places)
        (self._folder / "study.pickle").write_bytes(pickle.dumps(study))
        (self._folder / "Vehicle.fmu").write_bytes(self._setup.fmu)
        self._processes = RunProcesses(self._folder / "study.pickle", self._folder / "Vehicle.fmu")

    def teardown(self, worker: Worker) -> None:  # noqa: ARG002 - Dask's interface
        """End the processes, also those that are making a run: nobody waits for it any more."""
        if self._processes is not None:
            self._processes.end()
            self._place.cleanup()

    def made(self, job: Job) -> Made:
        """Make a run, a second time if it did not reach its end.

        Raises:
            RunFailed: this worker cannot make runs.
            Ended: the campaign has ended meanwhile.
        """
        if self._worker is None or self._processes is None:
            raise RunFailed(self._problem)
        log = self._folder / f"run-{job.number}.mcap"
        try:
            tries, answer = 1, self._answer(self._processes, job, log)
            while answer["status"] not in (OK, REFUSED) and tries < MOST_TRIES:
                log.unlink(missing_ok=True)
                tries, answer = tries + 1, self._answer(self._processes, job, log)
            if answer["status"] == SHORT:
                raise RunFailed(f"the worker {self._worker.address}: {answer['words']}")
            made = Made(number=job.number, tries=tries, worker=self._worker.address, **answer)
            wanted = job.keep or is_wanted(made, self._setup.study.requirements, job.worst)
            if wanted and made.status != REFUSED:
                made = replace(made, log=log.read_bytes() if log.is_file() else None)
        finally:
            log.unlink(missing_ok=True)
        return made

    def _place_of(self, place: str, content: bytes) -> str:
        """Return where this machine has a file of the user's, with what lies beside it if it has the user's folder."""
        with suppress(OSError):
            if Path(place).read_bytes() == content:
                return place
        # Two files may have the same name.
        copy = Path(tempfile.mkdtemp(dir=self._folder), Path(place).name)
        copy.write_bytes(content)
        return str(copy)

    def _answer(self, processes: RunProcesses, job: Job, log: Path) -> dict[str, Any]:
        limit_s = self._setup.study.time_limit_s
        try:
            with processes.one() as process:
                return process.ask(job.number, dict(job.values), log, limit_s)
        except NotStarted as error:
            return {"status": SHORT, "words": f"cannot start a process that makes runs: {error}"}
        except Crashed as error:
            return {"status": CRASHED, "words": str(error)}
        except TooLong as error:
            return {"status": TIMEOUT, "words": str(error), "wall_s": limit_s}
        except OSError as error:
            return {"status": SHORT, "words": f"cannot start a process that makes runs: {shortage(error) or error}"}


def make(name: str, job: Job) -> Made:
    """Make a run on the worker that this is called on.

    Args:
        name: of the campaign's plugin.
        job: the run.
    """
    runner = cast(Runner, get_worker().plugins[name])
    return runner.made(job)


def check_versions(wanted: Mapping[str, str], where: str) -> None:
    """Compare the versions of this process with those of the client.

    Raises:
        BadInput: they differ.
    """
    problem = difference(wanted, versions())
    if problem:
        raise BadInput(f"the worker {where} {problem}; install the same state of the project there, and start it again")
