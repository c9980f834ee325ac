"""Runs jobs in separate processes, as many at a time as there are cores, so that a crash affects only one."""

import multiprocessing
import os
import signal
import sys
from collections.abc import Iterator, Sequence
from multiprocessing.connection import Connection, wait
from multiprocessing.process import BaseProcess

from bench.conductor.linux import die_with_parent
from bench.resim.job import Job, Outcome, work
from bench.resim.step_limit import StepLimit

# The log's frames are in memory already and need not be sent: a child forked from here has them.
_FORK = multiprocessing.get_context("fork")


def run_all(jobs: Sequence[Job], step_limit_s: float) -> Iterator[Outcome]:
    """Run all jobs; yield their outcomes in order, each as soon as it and those before it are done.

    Args:
        jobs: the jobs.
        step_limit_s: wall-clock limit of a step (s); an ECU that takes longer has failed.
    """
    todo = list(enumerate(jobs))
    running: dict[Connection, tuple[int, BaseProcess, StepLimit]] = {}
    done: dict[int, Outcome] = {}
    given = 0
    try:
        while given < len(jobs):
            while todo and len(running) < _cores():
                number, job = todo.pop(0)
                ours, theirs = _FORK.Pipe(duplex=False)
                limit = StepLimit(step_limit_s)
                arguments = (job, theirs, limit, os.getpid())
                process: BaseProcess = _FORK.Process(target=_child, args=arguments, daemon=True)
                process.start()
                theirs.close()
                running[ours] = number, process, limit
            ready_now = wait(list(running))
            for ready in [connection for connection in running if connection in ready_now]:
                number, process, limit = running[ready]
                done[number] = _outcome(jobs[number], ready, process, limit)
                del running[ready]
            while given in done:
                yield done.pop(given)
                given += 1
    finally:
        for connection, (_, process, _) in running.items():
            process.kill()
            process.join()
            connection.close()


def _child(job: Job, connection: Connection, limit: StepLimit, parent: int) -> None:
    # Ctrl-C also reaches the parent, which ends this process.
    signal.signal(signal.SIGINT, signal.SIG_IGN)
    signal.signal(signal.SIGALRM, signal.SIG_DFL)
    for number in (signal.SIGTERM, signal.SIGHUP):
        # Signals ignored on entry, as under nohup, stay ignored.
        if signal.getsignal(number) != signal.SIG_IGN:
            signal.signal(number, signal.SIG_DFL)
    die_with_parent()
    if os.getppid() != parent:
        # It died before it could receive that.
        return
    outcome = work(job, limit)
    # The parent ends this process as soon as it has the outcome.
    sys.stdout.flush()
    sys.stderr.flush()
    connection.send(outcome)


def _outcome(job: Job, connection: Connection, process: BaseProcess, limit: StepLimit) -> Outcome:
    try:
        outcome: Outcome = connection.recv()
    except EOFError:
        process.join()
        code = process.exitcode or 0
        how = f"by {signal.Signals(-code).name}" if code < 0 else f"with exit code {code}"
        error = str(limit) if code == -signal.SIGALRM else f"its process ended {how}"
        return Outcome(job.name, job.spec, error=error, failed=True)
    finally:
        connection.close()
    # It would wait for threads that the class left behind.
    process.kill()
    process.join()
    return outcome


def _cores() -> int:
    return len(os.sched_getaffinity(0)) if hasattr(os, "sched_getaffinity") else os.cpu_count() or 1
