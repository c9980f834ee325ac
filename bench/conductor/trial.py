"""Tries out a user's ECUs before a run starts: each is created once, in a process that then ends.

So whatever is wrong with one is reported before anything is started or written, and the conductor runs no code of an
ECU, which may end its process, take its time, or print.
"""

import json
import os
import signal
import sys
from collections.abc import Iterable, Mapping
from typing import NoReturn

from bench.bus.codec import Codec, load_codecs
from bench.bus.network import EcuSlot
from bench.conductor.linux import die_with_parent
from bench.ecu.checks import created
from bench.ecu.loading import DEFAULT_ECUS, load_class
from bench.ecu.user_code import described
from bench.errors import BadInput
from bench.scenario import Scenario


def try_ecus(ecus: Mapping[str, str], slots: Iterable[EcuSlot], scenario: Scenario) -> None:
    """Create the ECU of each slot, but for the built-in ones, and discard it.

    Args:
        ecus: class of each role's ECU.
        slots: the ECUs that the bench starts.
        scenario: the scenario of the run.

    Raises:
        BadInput: an ECU cannot be loaded or created.
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
    with open(reader, "rb") as file:  # noqa: PTH123 - a descriptor, not a path
        reports = [json.loads(line) for line in file]
    _, status = os.waitpid(child, 0)
    last = reports[-1]
    if last["problem"] is not None:
        raise BadInput(last["problem"])
    if not last["done"]:
        code = os.waitstatus_to_exitcode(status)
        how = f"was killed by {signal.Signals(-code).name}" if code < 0 else f"ended with exit code {code}"
        raise BadInput(f"ECU {last['spec']!r}: while it was loaded and created, its process {how}")


def _try(
    ecus: Mapping[str, str], slots: Iterable[EcuSlot], scenario: Scenario, codecs: Mapping[str, Codec], writer: int
) -> NoReturn:
    """Create the ECUs in this process, which then ends; report each one before, and the first problem."""

    def report(spec: str, problem: str | None = None, *, done: bool = False) -> None:
        os.write(writer, json.dumps({"spec": spec, "problem": problem, "done": done}).encode() + b"\n")

    spec = ""
    # What an ECU prints is not the result of the command.
    os.dup2(2, 1)
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
        sys.stdout.flush()
        sys.stderr.flush()
        os._exit(0)
