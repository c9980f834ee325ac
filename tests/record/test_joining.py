"""Signals by name, joined on one time base, and cut out of a log by time."""

import json
import warnings

import numpy as np
import polars as pl
import pytest
from hypothesis import example, given, settings
from hypothesis import strategies as st
from mcap.reader import make_reader

from bench.errors import BadInput
from bench.record import LogDamaged, Run

from .conftest import TRUTH_NAMES, open_writer


@pytest.fixture(scope="module")
def run(recorded):
    return Run(recorded.path)


def test_names_are_bus_message_and_signal(run):
    assert run.names("veh?.VehicleMotion.YawRate") == ["veh1.VehicleMotion.YawRate", "veh2.VehicleMotion.YawRate"]
    assert run.names("truth.veh2.*") == [f"truth.veh2.{name}" for name in TRUTH_NAMES]
    assert run.names("*.Nothing.*") == []
    assert len(run.names()) == len(set(run.names())) > 300
    for new, old in zip(
        run.signal("veh1.VehicleMotion.YawRate"), run.signal("veh1", "VehicleMotion", "YawRate"), strict=True
    ):
        assert np.array_equal(new, old)
    assert np.array_equal(run.signal("truth.veh1.X")[1], run.truth(1)["X"])
    assert run.unit("veh1.VehicleMotion.YawRate") == "rad/s"
    assert run.unit("truth.veh1.psi") == "rad"


@pytest.mark.parametrize(
    ("ask", "answer"),
    [
        (lambda run: run.signal("veh1.VehicleMotoin.YawRate"), r"no signal .*; near are veh1\.VehicleMotion\.YawRate"),
        (lambda run: run.signal("yawrate"), r"no signal 'yawrate'; near are .*VehicleMotion\.YawRate"),
        (lambda run: run.table(["truth.veh1.X", "truth.veh3.*"]), r"no signal 'truth\.veh3\.\*'; near are truth\.veh"),
        (lambda run: run.message_table("veh1.Vehiclemotion"), r"no message .*; near are veh1\.VehicleMotion"),
        (lambda run: run.unit("qqq"), r"no signal 'qqq'; it has \d+, among them v2v\.BenchSync"),
        (lambda run: run.table([]), "no signal was asked for"),
        (lambda run: run.table("truth.veh1.X", every_s=0.0), "every_s 0.0: give a step in s, at least 1e-9"),
        (lambda run: run.table("truth.veh1.X", every_s=1e-9), "makes .* rows, more than"),
        (lambda run: run.table("truth.veh1.X", start_s=2.0, end_s=1.0), "from 2 s to 1 s is an empty range"),
        (lambda run: run.signal("truth.veh1.X", start_s=float("nan")), "--from / start_s nan: give a time in s"),
        (lambda run: run.signal(3), r"bus 3: give a name as text, for example 'veh1\.Veh"),
        (lambda run: run.signal("veh1", None), "message None: give a name"),
        (lambda run: run.message_table(None), "message None: give a name"),
        (lambda run: run.table(None), "names None: give a name"),
        (lambda run: run.table([3]), "names 3: give a name"),
        (lambda run: run.unit(3), "topic 3: give a name"),
        (lambda run: run.names(None), "pattern None: give a name"),
        (lambda run: run.event_table(start_s=2.0, end_s=1.0), "from 2 s to 1 s is an empty range"),
    ],
)
def test_a_slip_is_told_with_what_is_near(run, ask, answer):
    with pytest.raises(BadInput, match=answer) as told:
        ask(run)
    assert "\n" not in str(told.value)


times = st.lists(st.integers(0, 50), min_size=0, max_size=12).map(sorted)


@settings(deadline=None, max_examples=40)
@example(a=[1], b=[1], start=0, length=1, every=1)
@given(a=times, b=times, start=st.integers(0, 60), length=st.integers(1, 60), every=st.none() | st.integers(1, 7))
def test_a_joined_signal_has_the_last_value_it_had_and_never_a_later_one(
    a, b, start, length, every, codecs, tmp_path_factory
):
    path = tmp_path_factory.mktemp("joined") / "run.mcap"
    ms = 1_000_000
    with open_writer(path, codecs) as writer:
        given = sorted([(at, 1, n) for n, at in enumerate(a)] + [(at, 2, n) for n, at in enumerate(b)])
        for at, vehicle, value in given:
            writer.truth(vehicle, at * ms, [float(value)] * len(TRUTH_NAMES))
    if not (a and b):
        return
    joined = Run(path).table(
        "truth.*.X", start_s=start / 1e3, end_s=(start + length) / 1e3, every_s=every and every / 1e3
    )
    inside = range(start, start + length)
    base = [at for at in inside if at in a or at in b] if every is None else list(inside[::every])
    assert np.rint(joined["t"].to_numpy() * 1e3).tolist() == base
    for vehicle, own in ((1, a), (2, b)):
        # In `own` the value of an entry is its place.
        wanted = [max((n for n, at in enumerate(own) if at <= now), default=None) for now in base]
        assert joined[f"truth.veh{vehicle}.X"].to_list() == wanted


def test_without_a_start_the_steps_begin_where_the_signals_do(run):
    joined = run.table(["truth.veh1.X", "veh2.VehicleMotion.YawRate"], every_s=0.005)
    assert joined.columns == ["t", "truth.veh1.X", "veh2.VehicleMotion.YawRate"]
    assert joined["t"].to_list() == [n * 5 / 1e3 for n in range(79)]
    assert joined["truth.veh1.X"][::2].to_list() == run.truth(1)["X"].tolist()
    assert joined["truth.veh1.X"][1::2].to_list() == run.truth(1)["X"][:-1].tolist()


def test_states_come_as_numbers_or_by_name(run):
    name = "veh1.TrackerStatus.GainSource"
    numbers, names = (run.table(name, labels=labels)[name] for labels in (False, True))
    assert numbers.to_list() == run.signal(name)[1].tolist()
    labels = run.log.decoder("/signals/veh1/TrackerStatus").labels["GainSource"]
    assert names.to_list() == [labels.get(number, str(number)) for number in numbers]
    assert isinstance(names.dtype, pl.Enum)
    assert names.dtype.categories.to_list()[:4] == ["SDP", "PreviousGain", "LQR", "None"]
    message = run.message_table("veh1.TrackerStatus", labels=True)
    assert message["GainSource"].to_list() == names.to_list()
    assert list(message.columns) == ["t", *(field for field in run.message("veh1", "TrackerStatus") if field != "t")]


def test_what_is_known_of_signals(run):
    (row,) = run.signal_table("veh1.VehicleMotion.YawRate", ranges=True).to_dicts()
    values = run.signal("veh1.VehicleMotion.YawRate")[1]
    assert "Yaw rate" in row.pop("comment")
    assert row == {
        **{"name": "veh1.VehicleMotion.YawRate", "unit": "rad/s", "values": 40, "start_s": 0.0, "end_s": 0.39},
        **{"min": values.min(), "max": values.max()},
    }


def test_events_and_pandas(run, recorded):
    events = run.event_table()
    assert events["text"].to_list() == [event.text for _, event in recorded.events]
    assert events["kind"].to_list() == [event.kind for _, event in recorded.events]
    assert [json.loads(fields) for fields in events["fields"]] == [event.fields for _, event in recorded.events]
    assert events["t"].to_list() == [0.03, 0.13, 0.23, 0.33]
    table = run.table("truth.veh?.X")
    assert np.array_equal(table.to_pandas().to_numpy(), table.to_numpy())


@pytest.mark.parametrize(("start_s", "end_s"), [(None, None), (0.1, 0.2), (None, 0.05), (0.35, None), (5.0, 6.0)])
def test_a_slice_is_what_is_of_these_times(run, recorded, start_s, end_s):
    span = {"start_s": start_s, "end_s": end_s}
    start_ns, end_ns = (start_s or 0) * 1e9, (end_s or 10) * 1e9
    frames = [frame for frame in recorded.frames if start_ns <= frame[0] < end_ns]
    assert [(f.time_ns, f.bus, f.can_id, f.data, f.receive_ns) for f in run.frames(**span)] == frames
    assert run.frame_table("veh1", **span)["can_id"].tolist() == [frame[2] for frame in frames if frame[1] == "veh1"]
    # One run has read the whole topic before, and cuts it; the other reads the slice from the file.
    for reader in (run, Run(recorded.path)):
        truth = reader.truth(1, **span)
        rows = [(time_ns / 1e9, row[0]) for time_ns, row in recorded.truth[1] if start_ns <= time_ns < end_ns]
        assert list(zip(truth["t"].tolist(), truth["X"].tolist(), strict=True)) == rows
        assert reader.signal("truth.veh1.X", **span)[1].tolist() == [x for _, x in rows]
        events = [event.text for time_ns, event in recorded.events if start_ns <= time_ns < end_ns]
        assert reader.event_table(**span)["text"].to_list() == events


def damaged_but(recorded, path, keep):
    """Write the log with the records of all chunks destroyed but for those `keep` (index, its topics) holds for."""
    data = bytearray(recorded.path.read_bytes())
    with recorded.path.open("rb") as stream:
        summary = make_reader(stream).get_summary()
    kept = 0
    for index in summary.chunk_indexes:
        if keep(index, {summary.channels[number].topic for number in index.message_index_offsets}):
            kept += 1
        else:
            end = index.chunk_start_offset + index.chunk_length
            data[end - 200 : end] = bytes(200)
    assert 0 < kept < len(summary.chunk_indexes)
    path.write_bytes(data)
    return Run(path)


def test_only_the_chunks_with_a_signal_are_read(recorded, run, tmp_path):
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        log = damaged_but(recorded, tmp_path / "a.mcap", lambda _, topics: "/signals/veh1/VehicleMotion" in topics)
        found = log.signal("veh1.VehicleMotion.YawRate")
    assert np.array_equal(found[1], run.signal("veh1.VehicleMotion.YawRate")[1])
    with pytest.warns(LogDamaged, match=r"chunk from \d\.\d\d\d s to \d\.\d\d\d s is damaged"):
        assert not len(log.signal("veh2.VehicleMotion.YawRate")[0])


def test_only_the_chunks_that_overlap_are_read(make_log, tmp_path):
    recorded = make_log("long.mcap", cycles=200)
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        log = damaged_but(
            recorded, tmp_path / "a.mcap", lambda index, _: index.message_end_time >= 10**9 >= index.message_start_time
        )
        frames = list(log.frames(start_s=1.0, end_s=1.01))
    assert [f.data for f in frames] == [data for time_ns, _, _, data, _ in recorded.frames if time_ns == 1_000_000_000]


def test_a_log_that_is_still_written_is_read_as_far_as_it_goes(tmp_path, codecs):
    writer = open_writer(tmp_path / "run.mcap", codecs)
    values = codecs["veh1"].start_values("VehicleMotion")
    for cycle in range(20):
        writer.frame("veh1", cycle * 10_000_000, *codecs["veh1"].encode("VehicleMotion", values, cycle), 0)
        if cycle == 9:
            writer.flush()
    with pytest.warns(LogDamaged, match="ends before its summary"):
        run = Run(tmp_path / "run.mcap")
    assert run.signal("veh1.VehicleMotion.YawRate")[0].tolist() == [cycle / 100 for cycle in range(10)]
    writer.close({})
    assert len(Run(tmp_path / "run.mcap").table("veh1.VehicleMotion.YawRate")) == 20


def test_by_its_summary_and_record_by_record_a_log_is_the_same(recorded, run, tmp_path):
    path = tmp_path / "walked.mcap"
    data = bytearray(recorded.path.read_bytes())
    # The last byte of the summary's checksum: now the file is walked, and is whole.
    data[-9] ^= 1
    path.write_bytes(data)
    walked = Run(path)
    assert not walked.damage
    assert walked.names() == run.names()
    assert (walked.metadata, walked.attachments) == (run.metadata, run.attachments)
    assert walked.table("*").equals(run.table("*"), null_equal=True)
    assert {t: (walked.log.count(t), walked.log.span(t)) for t in walked.topics} == {
        t: (run.log.count(t), run.log.span(t)) for t in run.topics
    }
