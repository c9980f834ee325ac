"""A Dask worker's part of a campaign: it has runs made by processes of its own, which stay warm."""

from __future__ import annotations

import pickle
import tempfile
from collections.abc import Mapping
from contextlib import suppress
from dataclasses import replace
from pathlib import Path
from queue import Empty, LifoQueue
from typing import Any, cast

from distributed import Worker, WorkerPlugin, get_worker

from bench.campaign.jobs import CRASHED, MOST_TRIES, OK, REFUSED, TIMEOUT, Job, Made, Setup
from bench.campaign.keeping import is_wanted
from bench.campaign.run_process import Crashed, RunProcess, TooLong
from bench.campaign.version import difference, versions
from bench.errors import BadInput, shortage


class Runner(WorkerPlugin):
    """Makes the runs of a campaign on one worker; Dask sends it to all workers, also to those that join later."""

    def __init__(self, setup: Setup) -> None:
        """Take what the campaign's runs need."""
        self._setup = setup
        self.name = setup.name
        self._worker: Worker | None = None

    def setup(self, worker: Worker) -> None:
        """Check this worker, and prepare its folder.

        Raises:
            BadInput: it has other code or packages than the client.
        """
        check_versions(self._setup.versions, worker.address)
        self._worker = worker
        self._idle: LifoQueue[RunProcess] = LifoQueue()
        self._place = tempfile.TemporaryDirectory(prefix="platoon-", dir=worker.local_directory)
        self._folder = Path(self._place.name)
        places = {place: self._place_of(place, content) for place, content in self._setup.files.items()}
        study = self._setup.study.with_files(places)
        (self._folder / "study.pickle").write_bytes(pickle.dumps(study))
        (self._folder / "Vehicle.fmu").write_bytes(self._setup.fmu)

    def teardown(self, worker: Worker) -> None:  # noqa: ARG002 - Dask's interface
        """End the processes."""
        with suppress(Empty):
            while True:
                self._idle.get_nowait().close()
        self._place.cleanup()

    def made(self, job: Job) -> Made:
        """Make a run, a second time if it did not reach its end."""
        log = self._folder / f"run-{job.number}.mcap"
        try:
            tries, answer = 1, self._answer(job, log)
            while answer["status"] not in (OK, REFUSED) and tries < MOST_TRIES:
                log.unlink(missing_ok=True)
                tries, answer = tries + 1, self._answer(job, log)
            address = "" if self._worker is None else self._worker.address
            made = Made(number=job.number, tries=tries, worker=address, **answer)
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
        copy = self._folder / Path(place).name
        copy.write_bytes(content)
        return str(copy)

    def _answer(self, job: Job, log: Path) -> dict[str, Any]:
        try:
            process = self._process()
            answer = process.ask(job.number, dict(job.values), log, self._setup.study.time_limit_s)
        except Crashed as error:
            return {"status": CRASHED, "words": str(error)}
        except TooLong as error:
            return {"status": TIMEOUT, "words": str(error), "wall_s": self._setup.study.time_limit_s}
        except OSError as error:
            return {"status": CRASHED, "words": shortage(error) or str(error)}
        self._idle.put(process)
        return answer

    def _process(self) -> RunProcess:
        with suppress(Empty):
            return self._idle.get_nowait()
        return RunProcess(self._folder / "study.pickle", self._folder / "Vehicle.fmu")


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
