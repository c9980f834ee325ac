"""A process that makes one run after the other, so that what each needs is imported once.

It is apart from its worker because a run can crash its process or hang. Requests and answers are lines of JSON on
standard input and output; what the run itself prints goes to standard error.
"""

from __future__ import annotations

import errno
import faulthandler
import gc
import json
import os
import pickle
import signal
import sys
import time
from pathlib import Path
from typing import Any

from bench.analysis.metrics import compute
from bench.bus.link.address import Address
from bench.campaign.requirements import flat_metrics
from bench.campaign.statuses import FAILED, OK, REFUSED, SHORT
from bench.campaign.study import Study
from bench.conductor.linux import die_with_parent, set_name
from bench.conductor.options import RunOptions
from bench.conductor.run import run
from bench.ecu.loading import DEFAULT_ECUS
from bench.errors import BadInput, BenchError, shortage
from bench.record import Run

NICE = 10


def main() -> None:
    """Say that this process is ready, then answer requests until standard input ends.

    `sys.argv[1]` is the pickled study, `sys.argv[2]` the FMU.
    """
    die_with_parent()
    set_name("campaign run")
    faulthandler.enable(all_threads=False)
    # Ctrl-C at the terminal is for the command, which ends this process.
    signal.signal(signal.SIGINT, signal.SIG_IGN)
    os.nice(NICE)
    answers = os.fdopen(os.dup(1), "w", encoding="utf-8")
    os.dup2(2, 1)
    study: Study = pickle.loads(Path(sys.argv[1]).read_bytes())
    fmu = Path(sys.argv[2])
    gc.freeze()
    answers.write("{}\n")
    answers.flush()
    for line in sys.stdin:
        request = json.loads(line)
        answer = answer_to(study, fmu, request["number"], request["values"], Path(request["log"]))
        answers.write(json.dumps(answer) + "\n")
        answers.flush()


def answer_to(study: Study, fmu: Path, number: int, values: dict[str, Any], log: Path) -> dict[str, Any]:
    """Make a run, and return its status, words, metrics and wall-clock time in s.

    Args:
        study: what it is a run of.
        fmu: the vehicle's FMU.
        number: of the run.
        values: of the study's inputs.
        log: where its log is written.
    """
    began = time.perf_counter()
    status, words, metrics = OK, "", {}
    try:
        loaded = study.scenario(number, values)
    except BadInput as error:
        status, words = REFUSED, str(error)
    else:
        command = ["platoon", "campaign", study.name, f"run {number}"]
        try:
            ecus = {**DEFAULT_ECUS, **study.ecus}
            run(RunOptions(loaded, Address.parse("direct"), log, command, ecus=ecus, fmu=fmu))
            metrics = flat_metrics(compute(Run(log)), loaded)
        except BenchError as error:
            # Where the log is, is another place for the user.
            status, words = _how(error), str(error).partition("\nThe log up to there is")[0]
        except Exception as error:  # noqa: BLE001 - one bad run is a row of the campaign, and never its end
            status, words = _how(error), shortage(error) or f"{type(error).__name__}: {error}"
    return {"status": status, "words": words, "metrics": metrics, "wall_s": time.perf_counter() - began}


def _how(error: BaseException) -> str:
    """Return the status of a run that has ended with an error; a full disk says nothing about the run."""
    cause: BaseException | None = error
    while cause is not None:
        if isinstance(cause, OSError) and cause.errno in (errno.ENOSPC, errno.EDQUOT, errno.EROFS):
            return SHORT
        cause = cause.__cause__ or cause.__context__
    return FAILED
