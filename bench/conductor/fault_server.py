"""The socket of a running bench on which `platoon fault` asks for faults, served by threads: no cycle waits for it.

Whoever connects sends one request and gets one answer, within one deadline: which bench this is, at once, or the answer
of the conductor, which takes a request when a cycle begins. However many connect, send slowly or never read: each
occupies one of a few places for a short time, and connections are accepted at a limited rate.
"""

import socket
import threading
import time
from collections import deque
from collections.abc import Mapping
from contextlib import suppress
from typing import Any

from bench.conductor.fault_socket import WHO, address_of, drain, is_trusted, line_of, parsed, receive_line, send_line

REQUEST_S = 1.0
"""Wall-clock time in s from connecting to the end of the request."""

ANSWER_S = 8.0
"""Wall-clock time in s from request to answer, since a run may be waiting; shorter than the client's patience."""

GOODBYE_S = 1.0
"""Wall-clock time in s that an answer may take to be sent, and all of them at the end of the run."""

MOST_CONNECTIONS = 16
ACCEPT_S = 0.005
"""Wall-clock time in s between two accepted connections, so that a flood of them takes little time from the run."""

_SHORT_OF_FILES_S = 0.5


class Request:
    """A request of somebody who waits for the answer.

    Attributes:
        content: the request.
    """

    def __init__(self, content: dict[str, Any]) -> None:
        """Begin without an answer."""
        self.content = content
        self._answer: Mapping[str, Any] = {}
        self._answered = threading.Event()

    def answer(self, answer: Mapping[str, Any]) -> None:
        """Give the answer."""
        self._answer = answer
        self._answered.set()

    def wait(self, timeout_s: float | None) -> Mapping[str, Any] | None:
        """Return the answer, None if there is none within `timeout_s` s."""
        return self._answer if self._answered.wait(timeout_s) else None


class FaultServer:
    """Listens from `start` to `stop`; the conductor asks for the `next` request."""

    def __init__(self, name: str, introduction: Mapping[str, Any]) -> None:
        """Serve the bench of this name (`fault_socket.bench_name`); `introduction` is the answer to `WHO`."""
        self._name = name
        self._introduction = introduction
        self._waiting: deque[Request] = deque()
        self._places = threading.BoundedSemaphore(MOST_CONNECTIONS)
        self._threads: set[threading.Thread] = set()
        self._listener: socket.socket | None = None
        self._over = False

    def start(self) -> None:
        """Listen.

        Raises:
            OSError: that is not possible.
            RuntimeError: the system permits no thread.
        """
        listener = socket.socket(socket.AF_UNIX, socket.SOCK_STREAM)
        try:
            listener.bind(address_of(self._name))
            listener.listen(MOST_CONNECTIONS)
            self._begin(self._accept, listener)
        except (OSError, RuntimeError):
            listener.close()
            raise
        self._listener = listener

    def stop(self) -> None:
        """Tell those who wait that the run has ended, and end."""
        if self._listener is None:
            return
        self._over = True
        # Ends the thread's waiting, too.
        with suppress(OSError):
            self._listener.shutdown(socket.SHUT_RDWR)
        while request := self.next():
            request.answer({"error": "the run has ended"})
        deadline = time.monotonic() + GOODBYE_S
        for thread in list(self._threads):
            thread.join(max(0.0, deadline - time.monotonic()))
        self._listener.close()
        self._listener = None

    def next(self) -> Request | None:
        """Return the request that has waited longest, None if there is none; it must be answered."""
        try:
            return self._waiting.popleft()
        except IndexError:
            return None

    def _begin(self, work: Any, argument: socket.socket) -> None:
        def run() -> None:
            try:
                work(argument)
            finally:
                self._threads.discard(thread)

        thread = threading.Thread(target=run, name="faults", daemon=True)
        self._threads.add(thread)
        try:
            thread.start()
        except RuntimeError:
            self._threads.discard(thread)
            raise

    def _accept(self, listener: socket.socket) -> None:
        while not self._over:
            try:
                connection, _ = listener.accept()
            except OSError:
                # The end, or no more file descriptors.
                time.sleep(0.0 if self._over else _SHORT_OF_FILES_S)
                continue
            if not (is_trusted(connection) and self._places.acquire(blocking=False)):
                connection.close()
            else:
                try:
                    self._begin(self._serve, connection)
                except RuntimeError:
                    connection.close()
                    self._places.release()
            time.sleep(ACCEPT_S)

    def _serve(self, connection: socket.socket) -> None:
        try:
            with connection, suppress(OSError):
                self._converse(connection)
        finally:
            self._places.release()

    def _converse(self, connection: socket.socket) -> None:
        line = receive_line(connection, time.monotonic() + REQUEST_S)
        try:
            request = parsed(line)
            answer = self._introduction if request == WHO else self._answer_to(request)
        except ValueError as error:
            answer = {"error": f"the request is {error}"}
        deadline = time.monotonic() + GOODBYE_S
        send_line(connection, line_of(answer), deadline)
        drain(connection, deadline)

    def _answer_to(self, content: dict[str, Any]) -> Mapping[str, Any]:
        request = Request(content)
        self._waiting.append(request)
        if self._over:
            return {"error": "the run has ended"}
        answer = request.wait(ANSWER_S)
        if answer is not None:
            return answer
        try:
            self._waiting.remove(request)
        except ValueError:
            # The conductor has just taken it.
            return request.wait(GOODBYE_S) or {"error": "the run has ended"}
        return {"error": f"the run has begun no cycle for {ANSWER_S:g} s"}
