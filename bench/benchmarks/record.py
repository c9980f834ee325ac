"""The cost of logs: recording as fast as possible, reading a long log, and the memory needed.

Long logs repeat a real run's chunks (`bench.benchmarks.long_log`) in a temporary folder. Our reader is compared with
the obvious alternative: `mcap.reader` and cantools, frame by frame.
"""

import subprocess
import tempfile
import time
from collections.abc import Iterator
from functools import partial
from pathlib import Path
from typing import Any

import cantools.database.can
import numpy as np
from mcap.reader import make_reader
from rich.table import Table

from bench.benchmarks.figures import Figure, in_turns, ratio_figure, seconds_text, table_of, time_figure
from bench.benchmarks.long_log import repeat
from bench.benchmarks.loop import record as make_run
from bench.bus.codec import load_codecs
from bench.bus.wire.timing import BusTimeline
from bench.mcap.time_span import NS, Span
from bench.record.can_frame import NAME, SCHEMA, Frame
from bench.record.layout import message_class
from bench.record.reader import Run
from bench.record.writer import RunWriter
from platoon_fmu.interpreter import interpreter

PERIOD_S = 10
"""Duration of the repeated run: that of the scenario `formation`."""

LONG_S = 600
BIG_BYTES = 1 << 30

PACED_S = 20
"""Duration of the real-time run."""

SIGNAL = "veh1.VehicleMotion.YawRate"
SLICE_S = 30
"""All signals are read slice by slice."""

ROUNDS = 7

# Uses of the big log, each in a separate process, which prints its peak memory in KiB.
_READ = {
    "one signal": "run.signal('veh1.VehicleMotion.YawRate')",
    "all signals, one by one": "[len(run.signal(name)[0]) for name in run.names()]",
    "all frames, one by one": "sum(1 for frame in run.frames())",
}
_CHILD = """
import re, sys
from pathlib import Path
from bench.record import Run
run = Run(sys.argv[1])
{}
print(re.search(r"VmHWM:\\s+(\\d+) kB", Path("/proc/self/status").read_text())[1])
"""


def tables() -> Iterator[Table]:
    """Yield each table as soon as it is measured."""
    with tempfile.TemporaryDirectory(prefix="platoon-bench-") as folder:
        run = make_run(Path(folder), "formation", [f"duration_s={PERIOD_S}"])
        yield recording(run.path, Path(folder))
        yield shares(make_run(Path(folder), "formation", [f"duration_s={PACED_S}"], bus="udp", realtime=True))
        # Chunks must be as large as in a real-time run; a slower run writes smaller ones, every half second.
        short = Path(folder) / "short.mcap"
        _record_again(run, short, 1)
        log = Path(folder) / "long.mcap"
        frames = repeat(short, log, period_ns=PERIOD_S * NS, duration_ns=LONG_S * NS)
        yield table_of(
            f"a log of {LONG_S / 60:g} minutes: {frames} frames, {log.stat().st_size / 1e6:.0f} MB", reading(short, log)
        )
        log.unlink()
        log = Path(folder) / "big.mcap"
        frames = repeat(short, log, period_ns=PERIOD_S * NS, size=BIG_BYTES)
        yield memory(log, frames)


def recording(source: Path, folder: Path, times: int = 8) -> Table:
    """Record the frames and truth of a run `times` times, as fast as possible."""
    run, log = Run(source), folder / "recorded.mcap"
    given, elapsed, used = _record_again(run, log, times)
    found = Run(log)
    logged = sum(found.log.count(f"/can/{bus}") for bus in found.buses)
    table = Table(title="recording as fast as possible", title_justify="left")
    for heading in ("frames", "in the log", "frames/s", "target", "per frame", "log"):
        table.add_column(heading, justify="right")
    size = f"{log.stat().st_size / given:.0f} bytes a frame"
    table.add_row(str(given), str(logged), f"{given / elapsed:.0f}", "50000", seconds_text(used / given), size)
    log.unlink()
    return table


def shares(run: Run) -> Table:
    """Return the share of a core used by recording in a real-time run, and by the whole conductor."""
    times_s, cpu_s = run.signal("processes.conductor.cpu_time")
    title = f"{run.vehicles} vehicles in real time: CPU time over wall-clock time"
    table = Table(title=title, title_justify="left")
    for heading in ("", "target", "of a core"):
        table.add_column(heading, justify="right" if heading else "left")
    recorded = float(run.result["recorder_cpu_s"]) / float(run.result["wall_s"])
    table.add_row("frames, signals, truth and events to the log", "4 %", f"{100 * recorded:.1f} %")
    # Its first sample is from before the run.
    whole = float((cpu_s[-1] - cpu_s[1]) / (times_s[-1] - times_s[1]))
    table.add_row("  with reception, E2E, deadlines: the conductor", "", f"{100 * whole:.1f} %")
    return table


def _record_again(run: Run, log: Path, times: int) -> tuple[int, float, float]:
    """Record a run's frames and truth `times` times; return the number of frames, wall-clock and CPU seconds."""
    codecs, cycles = load_codecs(run.vehicles), _cycles(run)
    period_ns = PERIOD_S * NS
    started, used = time.perf_counter(), time.process_time()
    with RunWriter(
        log,
        codecs=codecs,
        truth_names=[name for name in run.truth(1) if name != "t"],
        vehicles=run.vehicles,
        metadata={},
        attachments=run.attachments,
        timeline=BusTimeline(codecs, {}, realtime=False),
    ) as writer:
        for later_ns in range(0, times * period_ns, period_ns):
            for frames, truth in cycles:
                for frame in frames:
                    writer.frame(frame.bus, later_ns + frame.time_ns, frame.can_id, frame.data, frame.receive_ns)
                for vehicle, time_ns, row in truth:
                    writer.truth(vehicle, later_ns + time_ns, row)
    passed, worked = time.perf_counter() - started, time.process_time() - used
    return times * sum(len(frames) for frames, _ in cycles), passed, worked


def _cycles(run: Run) -> list[tuple[list[Frame], list[tuple[int, int, np.ndarray]]]]:
    """Return the frames and the truth rows (vehicle, time, values) of each cycle."""
    cycles: dict[int, tuple[list[Frame], list[tuple[int, int, np.ndarray]]]] = {}
    for frame in run.frames():
        cycles.setdefault(frame.time_ns, ([], []))[0].append(frame)
    for vehicle in range(1, run.vehicles + 1):
        truth = run.truth(vehicle)
        rows = np.stack([values for name, values in truth.items() if name != "t"], axis=1)
        for time_ns, row in zip(truth.time_ns.tolist(), rows, strict=True):
            cycles.setdefault(time_ns, ([], []))[1].append((vehicle, time_ns, row))
    return [cycles[time_ns] for time_ns in sorted(cycles)]


def reading(short: Path, log: Path, rounds: int = ROUNDS) -> list[Figure]:
    """Return the times of reading a signal and all signals of `log`, and of reading `short` frame by frame."""
    run = Run(log)
    topics = [topic for topic in run.topics if topic.startswith("/signals/")]
    end_ns = run.log.contents.chunks.places["end_ns"].max() + 1
    decoded = sum(run.log.count(topic) for topic in topics)

    def one_signal() -> float:
        started = time.perf_counter()
        Run(log).signal(SIGNAL)
        return time.perf_counter() - started

    def all_signals() -> float:
        started = time.perf_counter()
        count = 0
        for start_ns in range(0, int(end_ns), SLICE_S * NS):
            found = run.log.tables(topics, Span(start_ns, start_ns + SLICE_S * NS))
            count += sum(len(columns["t"]) for columns in found.values())
        if count != decoded:
            raise ValueError(f"{count} of {decoded} messages were read")
        return (time.perf_counter() - started) / count

    samples = in_turns({"one": one_signal, "all": all_signals, "plain": partial(_plain, short)}, rounds)
    return [
        time_figure(f"open it, read {SIGNAL}", "0.3 s", samples["one"]),
        time_figure("all signals, a frame", "1 µs", samples["all"]),
        time_figure("  mcap.reader and cantools, a frame", "", samples["plain"]),
        ratio_figure("  ratio", "at least 5", samples["plain"], samples["all"]),
    ]


def _plain(log: Path) -> float:
    """Return the seconds per frame of `log`, read with the usual packages from PyPI."""
    started = time.perf_counter()
    kind: Any = message_class(NAME, SCHEMA)
    databases = {name: cantools.database.can.Database() for name in ("vehicle.dbc", "v2v.dbc")}
    count = 0
    with log.open("rb") as stream:
        reader = make_reader(stream)
        files = {attachment.name: attachment.data for attachment in reader.iter_attachments()}
        for name, database in databases.items():
            database.add_dbc_string(files[name].decode())
        buses = [f"/can/{bus}" for bus in Run(log).buses]
        for _, channel, record in reader.iter_messages(topics=buses):
            frame = kind.FromString(record.data)
            database = databases["v2v.dbc" if channel.topic == "/can/v2v" else "vehicle.dbc"]
            database.decode_message(frame.id, frame.data, decode_choices=False)
            count += 1
    return (time.perf_counter() - started) / count


def memory(log: Path, frames: int) -> Table:
    """Return the peak memory of processes that read a log of `frames` frames."""
    title = f"memory while reading a log of {log.stat().st_size / 1e9:.2f} GB, {frames} frames"
    table = Table(title=title, title_justify="left")
    for heading in ("", "target", "peak", "time"):
        table.add_column(heading, justify="right" if heading else "left")
    for what, code in _READ.items():
        started = time.perf_counter()
        peak = memory_of(code, log)
        table.add_row(what, "300 MB", f"{peak / 1e6:.0f} MB", seconds_text(time.perf_counter() - started))
    return table


def memory_of(code: str, log: Path) -> int:
    """Return the peak memory in bytes of a process that opens `log` as `run` and runs `code`."""
    command = [*interpreter(), "-c", _CHILD.format(code), str(log)]
    done = subprocess.run(command, capture_output=True, text=True, check=True)
    return int(done.stdout.split()[-1]) * 1024
