"""Runs jobs in processes of their own, as many at a time as there are cores: what crashes takes nobody with it."""

import multiprocessing
import os
import signal
from collections.abc import Iterator, Sequence
from multiprocessing.connection import Connection, wait
from multiprocessing.process import BaseProcess

from bench.resim.job import Job, Outcome, work

# The log's frames are in memory already and need not be sent: a child forked from here has them.
_FORK = multiprocessing.get_context("fork")


def run_all(jobs: Sequence[Job]) -> Iterator[Outcome]:
    """Run all jobs; give what comes of them in their order, each as soon as it and those before it are done."""
    todo = list(enumerate(jobs))
    running: dict[Connection, tuple[int, BaseProcess]] = {}
    done: dict[int, Outcome] = {}
    given = 0
    try:
        while given < len(jobs):
            while todo and len(running) < _cores():
                number, job = todo.pop(0)
                ours, theirs = _FORK.Pipe(duplex=False)
                process: BaseProcess = _FORK.Process(target=_child, args=(job, theirs), daemon=True)
                process.start()
                theirs.close()
                running[ours] = number, process
            ready_now = wait(list(running))
            for ready in [connection for connection in running if connection in ready_now]:
                number, process = running.pop(ready)
                done[number] = _outcome(jobs[number], ready, process)
            while given in done:
                yield done.pop(given)
                given += 1
    finally:
        for connection, (_, process) in running.items():
            process.kill()
            process.join()
            connection.close()


def _child(job: Job, connection: Connection) -> None:
    # Ctrl-C comes to the parent too, which sees to the end of this process.
    signal.signal(signal.SIGINT, signal.SIG_IGN)
    connection.send(work(job))


def _outcome(job: Job, connection: Connection, process: BaseProcess) -> Outcome:
    try:
        outcome: Outcome = connection.recv()
    except EOFError:
        process.join()
        code = process.exitcode or 0
        how = f"by {signal.Signals(-code).name}" if code < 0 else f"with exit code {code}"
        return Outcome(job.name, job.spec, error=f"its process ended {how}")
    finally:
        connection.close()
    process.join()
    return outcome


def _cores() -> int:
    return len(os.sched_getaffinity(0)) if hasattr(os, "sched_getaffinity") else os.cpu_count() or 1
