"""A campaign: the runs of a study, made by Dask's workers, and their rows, written as they come."""

from __future__ import annotations

import queue
import time
import uuid
from collections.abc import Callable, Collection, Iterable, Iterator, Sequence
from concurrent.futures import CancelledError
from contextlib import ExitStack, contextmanager, suppress
from dataclasses import dataclass, field
from pathlib import Path
from typing import TYPE_CHECKING, Any

from bench.campaign.cluster import Place, connected
from bench.campaign.distributions import Value
from bench.campaign.evaluating import Outcome
from bench.campaign.jobs import Job, Made, Setup
from bench.campaign.keeping import Keeping, failed
from bench.campaign.results import METRIC, WORST
from bench.campaign.sampling import Sample
from bench.campaign.statuses import CRASHED, OK, REFUSED
from bench.campaign.store import Store, check, log_name, opened
from bench.campaign.study import Study
from bench.campaign.version import versions
from bench.campaign.worker import Runner, make
from bench.conductor.interrupts import Interrupts
from bench.errors import BenchError, RunFailed

if TYPE_CHECKING:
    from distributed import Client
    from distributed import Future as DaskFuture

    Future = DaskFuture[Made]

AHEAD = 4
"""Runs that are sent ahead, for each thread of the workers."""
LEAST_AHEAD = 8
WAIT_S = 0.2
WITHOUT_WORKERS_S = 60.0
"""Time in s without any worker after which a campaign stops."""


@dataclass
class Count:
    """How far a campaign is.

    Attributes:
        total: number of runs; None while a search decides on them.
        before: runs that were there when it was resumed.
        made: runs that have been made since.
        failures: of all of them, those that did not end or missed a requirement.
        began: time.monotonic() of the start.
    """

    total: int | None
    before: int = 0
    made: int = 0
    failures: int = 0
    began: float = field(default_factory=time.monotonic)

    @property
    def done(self) -> int:
        """All runs there are."""
        return self.before + self.made

    @property
    def rate(self) -> float:
        """Runs made per second."""
        return self.made / max(time.monotonic() - self.began, 1e-9)

    @property
    def left_s(self) -> float | None:
        """Seconds to go at this rate; None if unknown."""
        return (self.total - self.done) / self.rate if self.total is not None and self.made else None


Follow = Callable[[Count], None]


class Campaign:
    """Makes runs on a cluster and writes their rows.

    Attributes:
        count: how far it is.
        task: makes a run on a worker, given the name of the plugin and the job.
    """

    def __init__(
        self,
        store: Store,
        client: Client,
        plugin: str,
        keeping: Keeping,
        total: int | None,
        interrupts: Interrupts,
        *,
        follow: Follow = lambda _: None,
    ) -> None:
        """Take note of the runs that are there.

        Args:
            store: where rows are written.
            client: of the cluster.
            plugin: name of the campaign's plugin, which the workers have.
            keeping: decides which logs stay.
            total: number of runs; None if it is not known.
            interrupts: signals that end it.
            follow: told after every part that was written.
        """
        self._store = store
        self._client = client
        self._plugin = plugin
        self._interrupts = interrupts
        self._keeping = keeping
        self.task: Callable[[str, Job], Made] = make
        self._follow = follow
        self.count = Count(total)
        # The keys of the rows there are, and of what is being made; keys of rows by the number of their run.
        self._keys: set[str] = set()
        self._numbers: dict[int, str] = {}
        self._outcomes: dict[str, Outcome] | None = None
        self._recall()

    def run(self, samples: Iterable[Sample]) -> None:
        """Make the runs that are missing, and write the rows of all.

        Raises:
            RunFailed: the cluster is gone, or rows cannot be written; those written before stay.
            Interrupted: a signal has come; likewise.
        """
        copies: list[tuple[Sample, str]] = []
        for _ in self._made_of(self._missing(samples, copies)):
            pass
        self._copy(copies)

    def threads(self) -> int:
        """Return how many runs the cluster makes at a time."""
        return max(1, int(sum(self._client.nthreads().values())))

    def evaluate(self, batch: Sequence[dict[str, Value]]) -> list[Outcome]:
        """Return what the runs with these values say, in their order; those that are there are not made again.

        Runs are numbered as they come, so that the study's base must be one scenario (`Study.by_number`).

        Raises:
            RunFailed: see `run`.
            Interrupted: see `run`.
        """
        if self._outcomes is None:
            self._outcomes = {row["key"]: _outcome(_as_made(row)) for row in self._store.done().iter_rows(named=True)}
        keys = [self._store.key(0, values) for values in batch]
        new = {key: values for key, values in zip(keys, batch, strict=True) if key not in self._outcomes}
        first = 1 + max(self._numbers, default=-1)
        samples = ((Sample(first + place, values), key) for place, (key, values) in enumerate(new.items()))
        for made in self._made_of(samples):
            self._outcomes[self._numbers[made.number]] = _outcome(made)
        return [self._outcomes[key] for key in keys]

    def _made_of(self, samples: Iterator[tuple[Sample, str]]) -> Iterator[Made]:
        """Yield runs as they are made, each with its row written; `samples` have their keys."""
        flight = _Flight(self._client)
        try:
            while True:
                self._fill(flight, samples)
                if not flight:
                    return
                self._interrupts.check()
                landed = flight.landed()
                if landed:
                    self._write(landed)
                    yield from (made for made, _, _ in landed)
        finally:
            flight.cancel()

    def _fill(self, flight: _Flight, samples: Iterator[tuple[Sample, str]]) -> None:
        limits = self._keeping.limits()
        while flight.has_room():
            sample, key = next(samples, (None, ""))
            if sample is None:
                return
            job = Job(sample.number, sample.values, self._keeping.is_asked(sample.number), limits)
            flight.start(self.task, self._plugin, job, key)

    def _write(self, landed: list[tuple[Made, Job, str]]) -> None:
        rows = []
        surplus: set[int] = set()
        for made, job, key in landed:
            if made.log is not None:
                self._store.keep(made, dict(job.values))
                surplus |= self._keeping.note(made)
            rows.append(self._store.row(made, key, dict(job.values)))
        self._store.add(rows)
        self._store.drop(surplus)
        for made, _, key in landed:
            self._numbers[made.number] = key
            self.count.made += 1
            self._count_failure(made)
        self._follow(self.count)

    def _count_failure(self, made: Made) -> None:
        if made.status != REFUSED and failed(made, self._store.study.requirements):
            self.count.failures += 1

    def _missing(self, samples: Iterable[Sample], copies: list[tuple[Sample, str]]) -> Iterator[tuple[Sample, str]]:
        """Yield samples without a row; those with the key of another run go to `copies`."""
        for sample in samples:
            key = self._store.key(sample.number, sample.values)
            if self._numbers.get(sample.number) == key:
                continue
            if key in self._keys:
                copies.append((sample, key))
            else:
                self._keys.add(key)
                yield sample, key

    def _copy(self, copies: list[tuple[Sample, str]]) -> None:
        """Write the rows of runs that are the same as others."""
        if not copies:
            return
        rows = {row["key"]: row for row in self._store.done().iter_rows(named=True)}
        same = [{**rows[key], "number": sample.number} for sample, key in copies]
        self._store.add(same)
        for row in same:
            self.count.made += 1
            self._count_failure(_as_made(row))
        self._follow(self.count)

    def _recall(self) -> None:
        """Take note of the rows there are, and of the logs kept."""
        for row in self._store.done().iter_rows(named=True):
            self._keys.add(row["key"])
            self._numbers[row["number"]] = row["key"]
            made = _as_made(row)
            self.count.before += 1
            self._count_failure(made)
            # The log of a run that is the same as another one is the other's.
            if row["log"] == log_name(made.number):
                self._store.drop(self._keeping.note(made))


@dataclass(frozen=True)
class Options:
    """How a campaign is made.

    Attributes:
        folder: where its results are written.
        fmu: the vehicle's FMU.
        place: where its runs are made.
        purpose: what chooses the values of runs, if not the study's sampling.
        resume: whether the folder has runs of it.
        worst: how many of the worst runs by each requirement keep their log.
        asked: numbers of runs that keep their log in any case; None for all.
        follow: told after every part that was written.
        connected: told once about the cluster.
    """

    folder: Path
    fmu: Path
    place: Place = field(default_factory=Place)
    purpose: str = ""
    resume: bool = False
    worst: int = WORST
    asked: Collection[int] | None = ()
    follow: Follow = lambda _: None
    connected: Callable[[Client], None] = lambda _: None


@contextmanager
def begun(study: Study, options: Options, total: int | None) -> Iterator[Campaign]:
    """Yield a campaign that is ready to make runs; at the end, the table of all its runs is written.

    Args:
        study: the study.
        options: how it is made.
        total: number of runs; None if it is not known.

    Raises:
        BadInput: the folder or the cluster cannot be used; nothing was started or written.
        RunFailed: the cluster is gone, or rows cannot be written; those written before stay.
        Interrupted: a signal has come; likewise.
    """
    check(options.folder, study, options.purpose, resume=options.resume)
    name = f"platoon-{study.name}-{uuid.uuid4().hex[:8]}"
    setup = Setup(name, study, study.files(), options.fmu.read_bytes(), versions())
    with ExitStack() as stack:
        interrupts = stack.enter_context(Interrupts())
        client = stack.enter_context(connected(options.place))
        stack.enter_context(_plugin(client, setup))
        options.connected(client)
        store = stack.enter_context(opened(options.folder, study, options.purpose, resume=options.resume))
        keeping = Keeping(study.requirements, options.worst, store.asked(options.asked))
        yield Campaign(store, client, name, keeping, total, interrupts, follow=options.follow)
        store.finish()


@contextmanager
def _plugin(client: Client, setup: Setup) -> Iterator[None]:
    """Give all workers what they need, as long as the context lasts."""
    try:
        try:
            client.register_plugin(Runner(setup))
        except OSError as error:
            raise RunFailed(f"a worker cannot be prepared for runs: {error}") from error
        yield
    finally:
        if client.status == "running":
            # Whatever a worker says that was refused.
            with suppress(Exception):
                client.unregister_worker_plugin(setup.name)


class _Flight:
    """The runs that are being made."""

    def __init__(self, client: Client) -> None:
        self._client = client
        self._jobs: dict[Future, tuple[Job, str]] = {}
        self._landed: queue.SimpleQueue[Future] = queue.SimpleQueue()
        self._most = LEAST_AHEAD
        self._seen = time.monotonic()
        self._count_threads()

    def __len__(self) -> int:
        return len(self._jobs)

    def has_room(self) -> bool:
        return len(self._jobs) < self._most

    def start(self, task: Callable[[str, Job], Made], plugin: str, job: Job, key: str) -> None:
        future = self._client.submit(task, plugin, job, key=f"{plugin}-{job.number}", pure=False)
        self._jobs[future] = job, key
        future.add_done_callback(self._landed.put)

    def landed(self) -> list[tuple[Made, Job, str]]:
        """Return the runs that have been made, after waiting a moment for one.

        Raises:
            RunFailed: scheduler or workers are gone.
        """
        found: list[Future] = []
        try:
            found.append(self._landed.get(timeout=WAIT_S))
            while True:
                found.append(self._landed.get_nowait())
        except queue.Empty:
            pass
        if not found:
            self._check()
            return []
        self._seen = time.monotonic()
        # All at once, because each request to the workers takes milliseconds.
        finished = [future for future in found if future.status == "finished"]
        try:
            results = dict(zip(finished, self._client.gather(finished), strict=True)) if finished else {}
        except (CancelledError, OSError, TimeoutError) as error:
            raise RunFailed(_GONE) from error
        return [(results.get(future) or self._failed(future), *self._jobs.pop(future)) for future in found]

    def cancel(self) -> None:
        """Give up what is being made."""
        if self._jobs and self._client.status == "running":
            self._client.cancel(list(self._jobs), force=True)
        self._jobs.clear()

    def _failed(self, future: Future) -> Made:
        """Return the row of a run that no worker has made.

        Raises:
            RunFailed: scheduler or workers are gone.
        """
        from distributed import KilledWorker

        if future.status in ("cancelled", "lost"):
            raise RunFailed(_GONE)
        error = future.exception()
        if isinstance(error, KilledWorker):
            job, _ = self._jobs[future]
            return Made(job.number, CRASHED, "the workers died that made it", tries=error.allowed_failures)
        words = error if isinstance(error, BenchError) else f"{type(error).__name__}: {error}"
        raise RunFailed(f"a worker cannot make runs: {words}")

    def _check(self) -> None:
        """Raise an error if nothing can be expected any more."""
        if self._client.status != "running":
            raise RunFailed(_GONE)
        if time.monotonic() - self._seen > WITHOUT_WORKERS_S / 4:
            threads = self._count_threads()
            if threads:
                self._seen = time.monotonic()
            elif time.monotonic() - self._seen > WITHOUT_WORKERS_S:
                raise RunFailed(f"there has been no worker for {WITHOUT_WORKERS_S:g} s")

    def _count_threads(self) -> int:
        try:
            threads = int(sum(self._client.nthreads().values()))
        except OSError as error:
            raise RunFailed(_GONE) from error
        self._most = max(LEAST_AHEAD, AHEAD * threads)
        return threads


_GONE = "the scheduler is gone"


def _outcome(made: Made) -> Outcome:
    return Outcome(made.number, made.metrics if made.status == OK else None, made.status, made.words)


def _as_made(row: dict[str, Any]) -> Made:
    metrics = {name.removeprefix(METRIC): value for name, value in row.items() if name.startswith(METRIC)}
    return Made(row["number"], row["status"], row["words"] or "", metrics=metrics)
