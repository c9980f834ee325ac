"""Tries out a user's ECUs before a run starts: each is created once, in a process that then ends.

So whatever is wrong with one is reported before anything is started or written, and the conductor runs no code of an
ECU, which may end its process, take its time, or print.
"""

import json
import os
import select
import signal
import sys
from collections.abc import Iterable, Mapping
from functools import partial
from typing import Any, NoReturn

from bench.bus.codec import Codec, load_codecs
from bench.bus.network import EcuSlot
from bench.conductor.linux import die_with_parent, processor_time
from bench.conductor.patience import PERIOD_S, Patience, Say
from bench.ecu.checks import created
from bench.ecu.loading import DEFAULT_ECUS, load_class
from bench.ecu.user_code import described
from bench.errors import BadInput, RunFailed
from bench.scenario import Scenario

HANGS_S = 60.0
"""Wall-clock time in s without a sign of progress after which an ECU hangs."""


def try_ecus(ecus: Mapping[str, str], slots: Iterable[EcuSlot], scenario: Scenario, say: Say | None = None) -> None:
    """Create the ECU of each slot, but for the built-in ones, and discard it.

    Args:
        ecus: class of each role's ECU.
        slots: the ECUs that the bench starts.
        scenario: the scenario of the run.
        say: called while it takes long, see `Patience`.

    Raises:
        BadInput: an ECU cannot be loaded or created, or it takes far too long.
    """
    own = [slot for slot in slots if ecus[slot.role] != DEFAULT_ECUS.get(slot.role)]
    if not own:
        return
    # Here, so that the run has it too.
    codecs = load_codecs(len(scenario.vehicles))
    reader, writer = os.pipe()
    sys.stdout.flush()
    sys.stderr.flush()
    parent = os.getpid()
    child = os.fork()
    if child == 0:
        os.close(reader)
        signal.signal(signal.SIGINT, signal.SIG_DFL)
        die_with_parent()
        if os.getppid() != parent:
            os._exit(1)
        _try(ecus, own, scenario, codecs, writer)
    os.close(writer)
    try:
        last = _last_report(reader, child, say)
    except BaseException:
        os.kill(child, signal.SIGKILL)
        raise
    finally:
        os.close(reader)
        _, status = os.waitpid(child, 0)
    if last["problem"] is not None:
        raise BadInput(last["problem"])
    if not last["done"]:
        code = os.waitstatus_to_exitcode(status)
        how = f"was killed by {signal.Signals(-code).name}" if code < 0 else f"ended with exit code {code}"
        raise BadInput(f"ECU {last['spec']!r}: while it was loaded and created, its process {how}")


def _last_report(reader: int, child: int, say: Say | None) -> dict[str, Any]:
    """Read the reports of the process to their end, and return the last one.

    Raises:
        BadInput: an ECU hangs.
    """
    data, last = b"", {"spec": "", "problem": None, "done": False}
    patience = Patience(HANGS_S, say)
    while True:
        if select.select([reader], [], [], PERIOD_S)[0]:
            read = os.read(reader, 65536)
            if not read:
                return last
            data += read
            *lines, data = data.split(b"\n")
            last = json.loads(lines[-1]) if lines else last
        try:
            doing = f"it is being loaded and created once, to check it (process {child})"
            patience.look(f"ECU {last['spec']!r}", doing, partial(processor_time, child))
        except RunFailed as error:
            raise BadInput(str(error)) from error


def _try(
    ecus: Mapping[str, str], slots: Iterable[EcuSlot], scenario: Scenario, codecs: Mapping[str, Codec], writer: int
) -> NoReturn:
    """Create the ECUs in this process, which then ends; report each one before, and the first problem."""

    def report(spec: str, problem: str | None = None, *, done: bool = False) -> None:
        os.write(writer, json.dumps({"spec": spec, "problem": problem, "done": done}).encode() + b"\n")

    spec = ""
    # What an ECU prints is not the result of the command; this stream keeps no line back if the process is killed.
    os.dup2(2, 1)
    sys.stdout = sys.stderr
    try:
        for slot in slots:
            spec = ecus[slot.role]
            report(spec)
            created(load_class(spec, slot.role), spec, slot, scenario, codecs)
        report(spec, done=True)
    except BadInput as error:
        report(spec, str(error))
    except BaseException as error:  # noqa: BLE001 - the process ends here, whatever happened
        report(spec, f"ECU {spec!r}: it cannot be created: {described(error)}")
    finally:
        sys.stderr.flush()
        os._exit(0)
