"""How fast campaigns are: their rate beside that of single runs, and what a run costs besides; rows by the 100,000."""

from __future__ import annotations

import argparse
import json
import os
import pickle
import subprocess
import sys
import tempfile
import time
from collections.abc import Iterator, Sequence
from concurrent.futures import ThreadPoolExecutor
from contextlib import closing
from dataclasses import replace
from pathlib import Path

import numpy as np
from rich.table import Table

from bench.benchmarks.figures import in_turns
from bench.benchmarks.sheet import Sheet
from bench.campaign.campaign import Options, begun
from bench.campaign.cluster import Place
from bench.campaign.jobs import Job, Made
from bench.campaign.requirements import METRIC_NAMES, metric_type
from bench.campaign.run_process import RunProcess
from bench.campaign.sampling import Sample, each_sample, samples
from bench.campaign.study import Study, load_study
from platoon_fmu.build import default_fmu
from platoon_fmu.interpreter import python

STUDY = "seed-paper"
RUNS, ROUNDS, ROWS = 24, 3, 100_000
LIMIT_S = 600.0


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Add the options of `campaign`."""
    parser.add_argument("--runs", type=int, default=RUNS, metavar="N", help="runs per core and round (%(default)s)")
    parser.add_argument("--rounds", type=int, default=ROUNDS, metavar="N", help="rounds (%(default)s)")
    parser.add_argument("--rows", type=int, default=ROWS, metavar="N", help="simulated runs (%(default)s)")


def tables() -> Iterator[Table | str]:
    """Yield the tables with the default options."""
    yield from measured(argparse.Namespace(runs=RUNS, rounds=ROUNDS, rows=ROWS))


def measured(options: argparse.Namespace) -> Iterator[Table | str]:
    """Yield the tables."""
    yield _rates(options.runs, options.rounds).table()
    yield _many(options.rows).table()


def _rates(runs: int, rounds: int) -> Sheet:
    """Return the time of a run in one process, in a process a core without Dask, and in a campaign, in turns."""
    cores = os.cpu_count() or 1
    study = load_study(STUDY, runs * cores * (rounds + 1))
    fmu = default_fmu()
    first = samples(study)
    sampled = iter(first)
    with tempfile.TemporaryDirectory(prefix="platoon-bench-") as place:
        folder = Path(place)
        (folder / "study").write_bytes(pickle.dumps(study))
        processes = [RunProcess(folder / "study", fmu) for _ in range(cores)]
        options = Options(folder / "campaign", fmu, Place(cores))
        with begun(study, options, study.runs) as campaign:
            # A run before anything is measured, so that all are warm.
            for process in processes:
                _in_process(process, first[:1], folder)

            def one() -> float:
                return _in_process(processes[0], first[:runs], folder)

            def each() -> float:
                with ThreadPoolExecutor(cores) as pool:
                    began = time.perf_counter()
                    list(pool.map(lambda process: _in_process(process, first[:runs], folder), processes))
                    return (time.perf_counter() - began) / (runs * cores)

            def whole() -> float:
                part = [next(sampled) for _ in range(runs * cores)]
                began = time.perf_counter()
                campaign.run(part)
                return (time.perf_counter() - began) / len(part)

            found = in_turns({"one": one, "each": each, "campaign": whole}, rounds)
        for process in processes:
            with closing(process):
                pass
    single, bare, all_of_it = (float(np.median(found[name])) for name in ("one", "each", "campaign"))
    rows = [
        ["a run in one process", f"{single:.3f} s", ""],
        [f"a run in {cores} processes, without Dask", f"{bare:.3f} s", ""],
        [f"a run of a campaign on {cores} workers", f"{all_of_it:.3f} s", ""],
        ["rate of a campaign over that of one process, per core", f"{single / all_of_it / cores:.3f}", "at least 0.9"],
        ["the same without Dask: what the machine can do", f"{single / bare / cores:.3f}", ""],
        ["what a campaign adds to a run", f"{1000.0 * cores * (all_of_it - bare):.0f} ms", "below 30 ms"],
    ]
    title = f"campaigns of {STUDY}: medians of {rounds} rounds of {runs} runs per core"
    return Sheet(title, ["what", "found", "wanted"], rows)


def _in_process(process: RunProcess, runs: Sequence[Sample], folder: Path) -> float:
    """Make runs in a process, and return the seconds per run."""
    began = time.perf_counter()
    log = folder / f"{id(process)}.mcap"
    for sample in runs:
        process.ask(sample.number, sample.values, log, LIMIT_S)
        log.unlink()
    return (time.perf_counter() - began) / len(runs)


def _many(rows: int) -> Sheet:
    """Return what a campaign of simulated runs costs its client, in a process of its own."""
    with tempfile.TemporaryDirectory(prefix="platoon-bench-") as place:
        folder = Path(place) / "campaign"
        with python("bench.benchmarks.campaign", str(folder), str(rows), stdout=subprocess.PIPE) as client:
            told = json.loads(client.communicate()[0])
        began = time.perf_counter()
        with python("bench.cli.main", "campaign", "show", str(folder), stdout=subprocess.DEVNULL) as show:
            show.wait()
        shown = time.perf_counter() - began
    found = [
        ["sampling, sending, result and row of a run", f"{1000.0 * told['seconds'] / rows:.2f} ms", "below 30 ms"],
        ["the client's peak memory", f"{told['peak_mb']:.0f} MB", "below 300 MB"],
        ["platoon campaign show", f"{shown:.2f} s", "below 2 s"],
    ]
    return Sheet(f"a campaign of {rows} simulated runs", ["what", "found", "wanted"], found)


def simulated(plugin: str, job: Job) -> Made:  # noqa: ARG001 - what a worker is called with
    """Return a run that is none: its metrics are random."""
    random = np.random.default_rng(job.number)
    metrics = {name: metric_type(name)(abs(random.normal())) for name in METRIC_NAMES}
    return Made(job.number, "ok", wall_s=1.0, worker="simulated", metrics=metrics)


def main() -> None:
    """Make a campaign of `sys.argv[2]` simulated runs in the folder `sys.argv[1]`; print seconds and memory as JSON."""
    import resource

    folder, rows = Path(sys.argv[1]), int(sys.argv[2])
    study: Study = replace(load_study(STUDY), runs=rows)
    with begun(study, Options(folder, default_fmu(), Place(2)), rows) as campaign:
        campaign.task = simulated
        began = time.perf_counter()
        campaign.run(each_sample(study))
        seconds = time.perf_counter() - began
    peak_mb = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 1024.0
    sys.stdout.write(json.dumps({"seconds": seconds, "peak_mb": peak_mb}))
