"""Logs damaged at random, and every command on each of them: python -m tests.record.damage [LOGS] [SEED] [PROCESSES].

A command must end with a clear error or a correct partial result: what it gives of a log are frames that the log had,
wherever the checksum of their chunk holds. No other exception, no hang, and no more memory than a small log takes.
"""

from __future__ import annotations

import multiprocessing
import random
import re
import resource
import signal
import struct
import sys
import tempfile
import traceback
import warnings
import zlib
from collections import Counter
from collections.abc import Callable, Iterator, Sequence
from concurrent.futures import ProcessPoolExecutor
from dataclasses import dataclass, field
from pathlib import Path

import zstandard
from click.testing import CliRunner
from mcap.opcode import Opcode
from typer.main import get_command

from bench.bus.link.address import Address
from bench.cli.main import app
from bench.conductor.options import RunOptions
from bench.conductor.run import run
from bench.errors import BenchError
from bench.mcap.container import MAGIC
from bench.mcap.scan import ScannedFile
from bench.record.reader import LogDamaged, Run
from bench.replay.order import in_order
from bench.replay.selection import Selection
from bench.resim.job import work
from bench.resim.plan import make_plan
from bench.resim.step_limit import StepLimit
from bench.scenario import load

GUARD_S = 60
"""Ends a command that hangs; nothing is said of how fast it must be."""

MORE_MEMORY = 512 * 1024 * 1024
"""Address space beyond what the imported modules take, bytes."""

_PARTS = 4
"""Parts of 25 logs that one process tries."""

_RECORD = struct.Struct("<BQ")
_CHUNK = struct.Struct("<QQQII4sQ")
_FOOTER_LENGTH = 20
# An error of a programme, not of the log, as `bench.resim.job` has it.
_FAILED = re.compile("^(it cannot be created|after .* s )")
_EDGES = (0, 1, 7, 2**16 - 1, 2**31 - 1, 2**31, 2**32 - 1, 2**40, 2**62, 2**63 - 1, 2**63, 2**64 - 1)

Random = random.Random


_SIMPLE = Path(__file__).parents[1] / "ecus" / "simple.py"
_ECUS = {"planner": f"{_SIMPLE}:CruisePlanner", "tracker": f"{_SIMPLE}:SpeedTracker"}


def make_log(path: Path, duration_s: float, seed: int) -> Path:
    """Run one vehicle for a moment, with simple ECUs, in one process."""
    scenario = load("formation", [f"duration_s={duration_s}"], seed)
    scenario = scenario.model_copy(update={"vehicles": scenario.vehicles[:1]})
    return run(
        RunOptions(scenario, address=Address.parse("direct"), out=path, command_line=["damage"], ecus=_ECUS)
    ).path


def records(data: bytes) -> Iterator[tuple[int, int, int]]:
    """Give opcode, place and length (both without the record's head) of each record of a whole file."""
    at = len(MAGIC)
    while at + _RECORD.size <= len(data) - len(MAGIC):
        opcode, length = _RECORD.unpack_from(data, at)
        yield opcode, at + _RECORD.size, length
        at += _RECORD.size + length


def cut_off(data: bytes, _: bytes, at_random: Random) -> bytes:
    """The file ends anywhere."""
    return data[: at_random.randrange(len(data))]


def flipped(data: bytes, _: bytes, at_random: Random) -> bytes:
    """Bits are wrong."""
    damaged = bytearray(data)
    for _count in range(at_random.choice([1, 1, 3, 30, 300])):
        damaged[at_random.randrange(len(damaged))] ^= 1 << at_random.randrange(8)
    return bytes(damaged)


def flipped_description(data: bytes, _: bytes, at_random: Random) -> bytes:
    """Bits are wrong in what is not a chunk: schemas, channels, metadata, attachments, indexes, summary."""
    damaged = bytearray(data)
    places = [(at, length) for opcode, at, length in records(data) if opcode != Opcode.CHUNK and length]
    for _count in range(at_random.choice([1, 3, 10])):
        at, length = at_random.choice(places)
        damaged[at + at_random.randrange(length)] ^= 1 << at_random.randrange(8)
    return bytes(damaged)


def wrong_lengths(data: bytes, _: bytes, at_random: Random) -> bytes:
    """Numbers at the begin of records, their lengths and sizes, are anything."""
    damaged = bytearray(data)
    places = [at for _, at, _ in records(data)]
    for _count in range(at_random.choice([1, 1, 4])):
        start = at_random.choice(places) - _RECORD.size + at_random.choice([1, 1, 9, 11, 15, 17, 25, 33, 37, 45])
        width = at_random.choice([4, 8])
        value = at_random.choice([*_EDGES, len(data), at_random.getrandbits(64)]) % (1 << 8 * width)
        damaged[start : start + width] = value.to_bytes(width, "little")
    return bytes(damaged)


def overwritten(data: bytes, _: bytes, at_random: Random) -> bytes:
    """A block is random, or zeros, as after a crash of the file system."""
    size = at_random.choice([1, 16, 512, 4096, 65536])
    start = at_random.randrange(len(data))
    block = bytes(size) if at_random.random() < 0.3 else at_random.randbytes(size)
    return (data[:start] + block + data[start + size :])[: len(data)]


def spliced(data: bytes, other: bytes, at_random: Random) -> bytes:
    """A block is missing, is there twice, or comes from another log."""
    source = at_random.choice([data, other])
    start, end = sorted(at_random.randrange(len(source)) for _ in range(2))
    at = at_random.randrange(len(data))
    return data[:at] + source[start : min(end, start + 200_000)] + data[at + at_random.choice([0, 0, end - start]) :]


def noise(data: bytes, _: bytes, at_random: Random) -> bytes:
    """Nothing but random bytes, with or without what a log begins with."""
    start = at_random.choice([b"", MAGIC, data[: at_random.randrange(200)]])
    return start + at_random.randbytes(at_random.choice([0, 1, 100, 10_000]))


def resealed_chunk(data: bytes, _: bytes, at_random: Random) -> bytes:
    """A chunk's records are wrong under a checksum that is right: who wrote them was out of his mind."""
    opcode, at, length = at_random.choice([each for each in records(data) if each[0] == Opcode.CHUNK])
    start_ns, end_ns, _, _, name_length, name, _ = _CHUNK.unpack_from(data, at)
    inside = bytearray(zstandard.decompress(data[at + _CHUNK.size : at + length]))
    for _count in range(at_random.choice([1, 10, 100])):
        place = at_random.randrange(len(inside))
        if at_random.random() < 0.3:
            inside[place : place + 8] = at_random.choice(_EDGES).to_bytes(8, "little")
        else:
            inside[place] = at_random.randrange(256)
    packed = zstandard.compress(bytes(inside))
    head = _CHUNK.pack(start_ns, end_ns, len(inside), zlib.crc32(inside), name_length, name, len(packed))
    record = _RECORD.pack(opcode, len(head) + len(packed)) + head + packed
    return data[: at - _RECORD.size] + record + data[at + length :]


def resealed_summary(data: bytes, _: bytes, at_random: Random) -> bytes:
    """The summary is wrong under a checksum that is right: it points anywhere."""
    footer = len(data) - len(MAGIC) - _FOOTER_LENGTH
    start, offsets = struct.unpack_from("<QQ", data, footer)
    damaged = bytearray(data)
    inside = [(at, length) for _, at, length in records(data) if start <= at < offsets]
    for _count in range(at_random.choice([1, 3, 20])):
        at, length = at_random.choice(inside)
        place = at + at_random.randrange(length)
        if at_random.random() < 0.5:
            damaged[place] = at_random.randrange(256)
        else:
            size = min(8, at + length - place)
            damaged[place : place + size] = at_random.choice(_EDGES).to_bytes(8, "little")[:size]
    crc = zlib.crc32(damaged[start : footer + 16])
    damaged[footer + 16 : footer + 20] = crc.to_bytes(4, "little")
    return bytes(damaged)


def with_bad_dbc(source: Path, target: Path) -> Path:
    """Write a log with attached DBC files that are none, under checksums that are right."""
    data = bytearray(source.read_bytes())
    for opcode, at, length in list(records(bytes(data))):
        if opcode == Opcode.ATTACHMENT:
            content = data[at : at + length - 4].replace(b"VERSION ", b"VERSIOM ")
            data[at : at + length] = content + zlib.crc32(content).to_bytes(4, "little")
    target.write_bytes(data)
    return target


KINDS: tuple[Callable[[bytes, bytes, Random], bytes], ...] = (
    cut_off,
    flipped,
    flipped_description,
    wrong_lengths,
    overwritten,
    spliced,
    noise,
    resealed_chunk,
    resealed_summary,
)


class Hanging(Exception):
    """A command took longer than `GUARD_S`."""


@dataclass
class Originals:
    """Two whole logs: that which is damaged, and another one for splicing and comparing."""

    path: Path
    other: Path
    data: bytes = b""
    other_data: bytes = b""
    frames: set[object] = field(default_factory=set)
    both: set[object] = field(default_factory=set)

    def __post_init__(self) -> None:
        self.data, self.other_data = self.path.read_bytes(), self.other.read_bytes()
        self.frames = set(Run(self.path).frames())
        self.both = self.frames | set(Run(self.other).frames())


@dataclass
class Tried:
    """What came of many damaged logs: how often each kind of command ended how, and all that should not have been."""

    logs: int = 0
    ends: Counter[str] = field(default_factory=Counter)
    failures: list[str] = field(default_factory=list)


def damage(originals: Originals, seed: int) -> tuple[str, bytes]:
    """Return the kind of damage number `seed`, and the damaged log."""
    at_random = Random(seed)
    kind = KINDS[seed % len(KINDS)]
    return kind.__name__, kind(originals.data, originals.other_data, at_random)


def commands(log: Path, originals: Originals, folder: Path) -> dict[str, list[str]]:
    """Return every command that reads a log, by name."""
    out = str(folder / "out")
    exports = {f"export {kind}": ["log", "export", str(log), "-o", f"{out}.{suffix}"] for kind, suffix in _EXPORTS}
    return {
        "metrics": ["metrics", str(log), "--json"],
        "report": ["report", str(log), "-o", f"{out}.html"],
        "report of two": ["report", str(originals.path), str(log), "-o", f"{out}2.html"],
        "diff": ["diff", str(originals.path), str(log)],
        "info": ["log", "info", str(log)],
        "signals": ["log", "signals", str(log), "--ranges"],
        "layout": ["log", "layout", str(log)],
        **exports,
        "recover": ["log", "recover", str(log), "-o", f"{out}.mcap"],
    }


_EXPORTS = (("candump", "log"), ("asc", "asc"), ("blf", "blf"), ("csv", "csv"), ("parquet", "parquet"))
SLOW = ("report", "report of two", "export csv", "export parquet")
"""Commands that only every tenth log goes through."""


def try_log(originals: Originals, seed: int, folder: Path, tried: Tried) -> None:
    """Damage a log and let every command have it."""
    kind, data = damage(originals, seed)
    log = folder / "damaged.mcap"
    log.write_bytes(data)
    tried.logs += 1
    before = len(tried.failures)
    _attempt("read", kind, tried, lambda: _read(log, originals, kind))
    _attempt("replay", kind, tried, lambda: sum(1 for _ in _replayed(log)))
    _attempt("resim", kind, tried, lambda: _run_again(log))
    runner, command = CliRunner(), get_command(app)
    for name, arguments in commands(log, originals, folder).items():
        if seed % 10 == 0 or name not in SLOW:
            _attempt(name, kind, tried, lambda arguments=arguments: _call(runner, command, arguments))
    clean = folder / "out.mcap"
    if clean.exists():
        _attempt("recovered", kind, tried, lambda: _compare(log, clean, kind))
    for path in folder.iterdir():
        if path.name.startswith("."):
            tried.failures.append(f"{kind}: {path} was left behind")
        path.unlink()
    tried.failures[before:] = [f"seed {seed}: {failure}" for failure in tried.failures[before:]]


def _attempt(name: str, kind: str, tried: Tried, action: Callable[[], object]) -> None:
    signal.alarm(GUARD_S)
    with warnings.catch_warnings(record=True) as caught:
        warnings.simplefilter("always")
        try:
            end = action()
            tried.ends[f"{name}: {end if isinstance(end, str) else 'done'}"] += 1
        except BenchError as error:
            tried.ends[f"{name}: exit code {error.exit_code}"] += 1
        except (Exception, Hanging) as error:  # noqa: BLE001 - whatever it is, it is what is looked for
            where = traceback.extract_tb(error.__traceback__)[-6:]
            places = " < ".join(f"{Path(frame.filename).name}:{frame.lineno}" for frame in reversed(where))
            tried.failures.append(f"{kind}: {name}: {type(error).__name__}: {str(error)[:200]} ({places})")
        finally:
            signal.alarm(0)
    odd = [warning for warning in caught if not issubclass(warning.category, LogDamaged)]
    logs = Counter(str(warning.message).partition(": ")[0] for warning in caught if warning not in odd)
    if odd or any(count > 1 for count in logs.values()):
        tried.failures.append(f"{kind}: {name}: warnings: {[str(warning.message) for warning in caught]}")


def _call(runner: CliRunner, command: object, arguments: Sequence[str]) -> str:
    result = runner.invoke(command, list(arguments))
    if result.exception is not None and not isinstance(result.exception, SystemExit):
        raise result.exception
    return f"exit code {result.exit_code}"


def _read(log: Path, originals: Originals, kind: str) -> None:
    run = Run(log)
    frames = set(run.frames())
    for bus in run.buses:
        for message in run.messages(bus):
            run.message(bus, message)
    _ = run.events, run.names(), run.metadata
    if kind == "resealed_chunk":
        return
    known = originals.both if kind == "spliced" else originals.frames
    if ScannedFile(log).walked is not None or kind == "resealed_summary":
        # Names of buses stand under no checksum but the summary's.
        frames, known = ({frame._replace(bus="") for frame in some} for some in (frames, known))
    if not frames <= known:
        raise AssertionError(f"{len(frames - known)} frames that never were: {next(iter(frames - known))}")


def _replayed(log: Path) -> Iterator[object]:
    run = Run(log)
    chosen = Selection.of(run, without=["veh1.tracker"])
    return in_order(frame for frame in run.frames() if chosen.has(frame.bus, frame.can_id))


def _run_again(log: Path) -> str:
    """Run the ECUs again on what the log says they saw; they never fail of themselves."""
    plan = make_plan(Run(log), (), every=True, classes=[f"{role}={spec}" for role, spec in _ECUS.items()])
    outcomes = [work(job, StepLimit(GUARD_S)) for job in plan.jobs]
    for outcome in outcomes:
        if _FAILED.search(outcome.error):
            raise AssertionError(outcome.error)
    if any(outcome.error for outcome in outcomes):
        return "not compared"
    return "same" if all(outcome.same for outcome in outcomes) else "different"


def _compare(log: Path, clean: Path, kind: str) -> None:
    """The recovered log is whole and has the frames of the damaged one.

    It may have more than a summary whose checksum is right tells of.
    """
    if ScannedFile(clean).walked is not None:
        raise AssertionError("the recovered log has no good summary")
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", LogDamaged)
        damaged = Run(log)
        # Nothing is recovered of which the time is none.
        before = [frame for frame in damaged.frames() if frame.time_ns >= 0]
    with warnings.catch_warnings():
        warnings.simplefilter("error", LogDamaged)
        after = list(Run(clean).frames())
    if kind == "resealed_summary":
        told = set(before)
        after = [frame for frame in after if frame in told]
    if before != after:
        raise AssertionError(f"{len(before)} frames in the damaged log, {len(after)} in the recovered one")


def guard() -> None:
    """Limit this process's memory, and end what hangs."""

    def hang(*_: object) -> None:
        raise Hanging(f"not done after {GUARD_S} s")

    signal.signal(signal.SIGALRM, hang)
    pages = int(Path("/proc/self/statm").read_text().split()[0])
    limit = pages * resource.getpagesize() + MORE_MEMORY
    resource.setrlimit(resource.RLIMIT_AS, (limit, limit))


def try_many(path: Path, other: Path, seeds: Sequence[int]) -> Tried:
    """Try damaged logs in this process, which `guard` has prepared."""
    originals, tried = Originals(path, other), Tried()
    with tempfile.TemporaryDirectory() as folder:
        for seed in seeds:
            try_log(originals, seed, Path(folder), tried)
    return tried


def _warm(path: Path, other: Path) -> None:
    """Import what commands import, before memory is limited."""
    with tempfile.TemporaryDirectory() as folder:
        for name, arguments in commands(path, Originals(path, other), Path(folder)).items():
            result = CliRunner().invoke(get_command(app), arguments)
            if result.exit_code:
                raise RuntimeError(f"{name} fails on a whole log: {result.exception} {result.output}")


def _begin(path: Path, other: Path) -> None:
    _warm(path, other)
    guard()


def _part(given: tuple[Path, Path, range]) -> Tried:
    return try_many(*given)


def in_children(path: Path, other: Path, seeds: range, processes: int) -> Iterator[Tried]:
    """Try damaged logs in processes of limited memory; give what came of each part."""
    parts = [(path, other, seeds[start : start + 25]) for start in range(0, len(seeds), 25)]
    # Not forked: the threads of polars would not be there, and waited for.
    spawn = multiprocessing.get_context("spawn")
    # In processes for some logs only: protobuf and polars never give back all that they have taken.
    for start in range(0, len(parts), _PARTS * processes):
        with ProcessPoolExecutor(processes, mp_context=spawn, initializer=_begin, initargs=(path, other)) as pool:
            yield from pool.map(_part, parts[start : start + _PARTS * processes])


def main(arguments: Sequence[str]) -> int:
    """Try as many logs as asked for, and print what came of it."""
    count, seed, processes = (int(text) for text in [*arguments, *("10000", "0", "2")[len(arguments) :]])
    total = Tried()
    out = sys.stdout
    with tempfile.TemporaryDirectory() as folder:
        path, other = make_log(Path(folder, "a.mcap"), 0.12, 1), make_log(Path(folder, "b.mcap"), 0.08, 2)
        for part in in_children(path, other, range(seed, seed + count), processes):
            total.logs += part.logs
            total.ends += part.ends
            total.failures += part.failures
            for failure in part.failures:
                out.write(f"{failure}\n")
            out.write(f"{total.logs} logs, {len(total.failures)} failures\n")
            out.flush()
    for end, times in sorted(total.ends.items()):
        out.write(f"{times:8} {end}\n")
    return 1 if total.failures else 0


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))
