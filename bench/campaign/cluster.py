"""Where the runs of a campaign are made: on this machine, or on a Dask cluster of the user's."""

from __future__ import annotations

import json
import logging
import os
import signal
from collections.abc import Iterator, Mapping
from contextlib import contextmanager, suppress
from dataclasses import dataclass
from multiprocessing import resource_tracker
from pathlib import Path
from typing import TYPE_CHECKING

from bench.campaign.version import difference, versions
from bench.errors import BadInput, RunFailed

if TYPE_CHECKING:  # distributed takes half a second to import
    from distributed import Client

LOOPBACK = "127.0.0.1"
CONNECT_S = 10.0
"""Time in s in which a scheduler must answer."""
WORKERS_S = 30.0
"""Time in s in which the first worker must be there."""
MOST_WORKERS = 1024


@dataclass(frozen=True)
class Place:
    """Where runs are made.

    Attributes:
        workers: number of processes on this machine; None for one a core.
        address: of the scheduler of a cluster, `tcp://HOST:8786`; None for this machine.
        scheduler_file: the file with which a scheduler says its address; None likewise.
        dashboard: whether this machine's scheduler serves Dask's dashboard.
    """

    workers: int | None = None
    address: str | None = None
    scheduler_file: Path | None = None
    dashboard: bool = False


@contextmanager
def connected(place: Place) -> Iterator[Client]:
    """Yield a client of the scheduler; a cluster that was started for it ends with it.

    Raises:
        BadInput: the cluster cannot be reached, or its scheduler or a worker has other versions.
        RunFailed: this machine does not permit the processes.
    """
    import dask

    settings = {
        "distributed.comm.timeouts.connect": f"{CONNECT_S:g}s",
        # As in all processes of the bench: nothing is imported from the working directory, one thread each.
        "distributed.nanny.pre-spawn-environ": {
            **{f"{library}_NUM_THREADS": "1" for library in ("OMP", "MKL", "OPENBLAS")},
            "PYTHONSAFEPATH": "1",
        },
    }
    with dask.config.set(settings), _quiet():
        there = place.address or place.scheduler_file
        with _remote(place) if there else _local(place) as client:
            yield client


@contextmanager
def _local(place: Place) -> Iterator[Client]:
    from distributed import Client, LocalCluster

    count = place.workers or _cores()
    try:
        with _undisturbed(), _safe_path():
            cluster = LocalCluster(
                n_workers=count,
                threads_per_worker=1,
                processes=True,
                host=LOOPBACK,
                # Each has an HTTP server, with Dask's dashboard or without.
                dashboard_address=f"{LOOPBACK}:0",
                worker_dashboard_address=f"{LOOPBACK}:0",
                scheduler_kwargs={"dashboard": place.dashboard},
                # Runs are made by processes of their own; what a worker itself needs does not grow.
                memory_limit=0,
                silence_logs=logging.CRITICAL,
            )
    except (OSError, RuntimeError, TimeoutError) as error:
        raise RunFailed(f"{count} workers cannot be started on this machine: {error}; fewer with --workers") from error
    with cluster, Client(cluster, set_as_default=False) as client:
        yield client


@contextmanager
def _remote(place: Place) -> Iterator[Client]:
    from distributed import Client

    option = f"--scheduler-file {place.scheduler_file}" if place.scheduler_file else f"--cluster {place.address}"
    address = _address_in(place.scheduler_file, option) if place.scheduler_file else place.address
    try:
        client = Client(address, timeout=CONNECT_S, set_as_default=False)
    except (OSError, ValueError, TypeError, KeyError, ImportError) as error:
        raise BadInput(
            f"{option}: no scheduler answers there within {CONNECT_S:g} s ({error or type(error).__name__});"
            " start one with: dask scheduler --host 127.0.0.1"
        ) from error
    with client:
        check(client, option)
        yield client


def _address_in(file: Path, option: str) -> str:
    """Return the address that a scheduler has written to its file.

    Raises:
        BadInput: there is none.
    """
    mend = f"start a scheduler with: dask scheduler {option}"
    try:
        return str(json.loads(file.read_text(encoding="utf-8"))["address"])
    except OSError as error:
        raise BadInput(f"{option}: {error.strerror}; {mend}") from error
    except (ValueError, TypeError, KeyError) as error:
        raise BadInput(f"{option}: no scheduler has written its address there; {mend}") from error


def check(client: Client, option: str) -> None:
    """Check scheduler and workers of a cluster before anything is sent to them.

    Raises:
        BadInput: there is no worker, or one of them has other code or packages.
    """
    with suppress(TimeoutError):
        client.wait_for_workers(1, timeout=WORKERS_S)
    wanted = versions()
    told: dict[str, Mapping[str, str] | BaseException] = {}
    try:
        told["the scheduler"] = client.run_on_scheduler(versions)
    except Exception as error:  # noqa: BLE001 - whatever hinders it from answering
        told["the scheduler"] = error
    workers = client.run(versions, on_error="return")
    if not workers:
        raise BadInput(f"{option}: no worker within {WORKERS_S:g} s; start some: dask worker ADDRESS --nthreads 1")
    told |= {f"the worker {address}": answer for address, answer in workers.items()}
    for where, answer in told.items():
        if isinstance(answer, BaseException):
            problem = f"cannot import the bench ({type(answer).__name__}: {answer})"
        else:
            problem = difference(wanted, answer)
        if problem:
            raise BadInput(
                f"{option}: {where} {problem}; install the same state of the project and the same packages"
                " (constraints.txt) there, and start it again"
            )


def _cores() -> int:
    return min(MOST_WORKERS, len(os.sched_getaffinity(0)) if hasattr(os, "sched_getaffinity") else os.cpu_count() or 1)


@contextmanager
def _quiet() -> Iterator[None]:
    """Silence the logs of Dask and of what it is made of: the campaign says what goes wrong, once and in its words."""
    import distributed  # noqa: F401 - gives some of its loggers a level of their own

    noisy = ("distributed", "tornado", "asyncio")
    names = [name for name in logging.root.manager.loggerDict if name.partition(".")[0] in noisy]
    loggers = [logging.getLogger(name) for name in (*noisy, *names)]
    before = [logger.level for logger in loggers]
    for logger in loggers:
        logger.setLevel(logging.CRITICAL)
    try:
        yield
    finally:
        for logger, level in zip(loggers, before, strict=True):
            logger.setLevel(level)


@contextmanager
def _undisturbed() -> Iterator[None]:
    """Have threads and processes started meanwhile never see Ctrl-C: the terminal sends it to all of its processes.

    The command, which ends them, gets it at the end of the context at the latest.
    """
    # It is started with the first worker otherwise, and would undo what is done here.
    resource_tracker.ensure_running()
    before = signal.pthread_sigmask(signal.SIG_BLOCK, {signal.SIGINT})
    try:
        yield
    finally:
        signal.pthread_sigmask(signal.SIG_SETMASK, before)


@contextmanager
def _safe_path() -> Iterator[None]:
    """Keep the working directory off the path of processes started meanwhile."""
    before = os.environ.get("PYTHONSAFEPATH")
    os.environ["PYTHONSAFEPATH"] = "1"
    try:
        yield
    finally:
        if before is None:
            del os.environ["PYTHONSAFEPATH"]
        else:
            os.environ["PYTHONSAFEPATH"] = before
