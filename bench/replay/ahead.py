"""Reads ahead: a log is unpacked in a separate process, so that reading never delays sending."""

from __future__ import annotations

import multiprocessing
import signal
from collections.abc import Iterable, Iterator
from contextlib import contextmanager
from itertools import islice
from multiprocessing.connection import Connection
from typing import TypeVar

from bench.conductor.linux import die_with_parent, enlarge_pipe
from bench.errors import BenchError, RunFailed

T = TypeVar("T")

# Frames that go through the pipe at once; taking them takes as long as sending a few of them.
_BATCH = 100


@contextmanager
def read_ahead(items: Iterable[T]) -> Iterator[Iterator[T]]:
    """Yield an iterator over the same items, read ahead by as many as a pipe holds.

    A `BenchError` that `items` raises is raised where they are taken.
    """
    # Forked, to inherit the open log.
    context = multiprocessing.get_context("fork")
    receiver, sender = context.Pipe(duplex=False)
    enlarge_pipe(sender.fileno())
    process = context.Process(target=_read, args=(items, receiver, sender), name="replay reader", daemon=True)
    process.start()
    sender.close()
    try:
        yield _taken(receiver)
    finally:
        receiver.close()
        process.terminate()
        process.join()


def _read(items: Iterable[T], receiver: Connection, sender: Connection) -> None:
    die_with_parent()
    # Ctrl-C is for the process that sends.
    signal.signal(signal.SIGINT, signal.SIG_IGN)
    receiver.close()
    source = iter(items)
    try:
        while batch := list(islice(source, _BATCH)):
            sender.send(batch)
        sender.send(None)
    except BenchError as error:
        sender.send(error)
    except BrokenPipeError:
        return


def _taken(receiver: Connection) -> Iterator[T]:
    while True:
        try:
            batch: list[T] | BenchError | None = receiver.recv()
        except EOFError:
            raise RunFailed("the process that reads the log ended unexpectedly") from None
        if batch is None:
            return
        if isinstance(batch, BenchError):
            raise batch
        yield from batch
