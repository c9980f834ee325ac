"""A campaign's folder: rows are written whole or not at all, each is there once, and only the same campaign goes on."""

import shutil
import subprocess

import pandas as pd
import polars as pl
import pyarrow.parquet
import pytest
from polars.testing import assert_frame_equal

from bench.campaign import store as stores
from bench.campaign.jobs import Made
from bench.campaign.results import read
from bench.campaign.statuses import OK
from bench.campaign.store import opened
from bench.campaign.study import load_study
from bench.errors import BadInput, RunFailed
from tests.campaign.commands import PLATOON, logs, makings, parts, table, write_study

MONTE_CARLO = {
    "sampling": "monte-carlo",
    "runs": 6,
    "inputs": [{"key": "seed", "distribution": {"kind": "integers", "low": 1, "high": 900}}],
}


@pytest.fixture
def study(tmp_path):
    return load_study(write_study(tmp_path, range(1, 301)))


@pytest.fixture
def folder(tmp_path):
    return tmp_path / "out"


def row(store, number, *, log=None):
    values = {"seed": number + 1}
    made = Made(number, OK, metrics={"final_speed_error_mps": number / 7, "frames_lost": 0}, log=log)
    return made, store.row(made, store.key(number, values), values)


def add(store, numbers):
    for number in numbers:
        store.add([row(store, number)[1]])


def expected(store, numbers):
    return pl.DataFrame([row(store, number)[1] for number in numbers], stores.schema(store.study), orient="row")


def test_parts_are_joined_as_they_become_many(study, folder, monkeypatch):
    monkeypatch.setattr(stores, "MOST_PARTS", 4)
    with opened(folder, study, resume=False) as store:
        add(store, reversed(range(100)))
        assert len(list((folder / "parts").iterdir())) < 4 * 4
        assert store.done()["number"].to_list() == list(reversed(range(100)))
        store.finish()
        whole = expected(store, range(100))
    assert_frame_equal(pl.read_parquet(folder / "runs.parquet"), whole)
    with opened(folder, study, resume=True) as store:
        assert_frame_equal(store.done().sort("number"), whole)


def test_each_row_is_there_once_if_killed_between_joining_parts_and_removing_them(study, folder, monkeypatch):
    monkeypatch.setattr(stores, "MOST_PARTS", 4)
    with opened(folder, study, resume=False) as store:
        add(store, range(3))
        shutil.copytree(folder / "parts", folder / "before")
        add(store, [3])
        assert [path.name for path in (folder / "parts").iterdir()] == ["1-00000004.parquet"]
        whole = expected(store, range(5))
    for path in (folder / "before").iterdir():
        shutil.move(path, folder / "parts")
    (folder / "before").rmdir()
    assert read(folder).rows["number"].to_list() == [0, 1, 2, 3]
    with opened(folder, study, resume=True) as store:
        assert sorted(store.done()["number"]) == [0, 1, 2, 3]
        add(store, [4])
        store.finish()
    assert_frame_equal(pl.read_parquet(folder / "runs.parquet"), whole)


def test_what_a_killed_campaign_left_half_written_goes_and_counts_for_nothing(study, folder):
    with opened(folder, study, resume=False) as store:
        made, kept = row(store, 0, log=b"a log")
        store.keep(made, {"seed": 1})
        store.add([kept])
        # The log was written and the row was not.
        made, _ = row(store, 1, log=b"another")
        store.keep(made, {"seed": 2})
        assert logs(folder) == {0, 1}
    rests = ["parts/.0-00000001.1.part.parquet", "logs/.run-000002.1.part.mcap", ".runs.1.part.parquet"]
    for rest in rests:
        (folder / rest).write_bytes(b"half")
    assert read(folder).rows["number"].to_list() == [0]
    with opened(folder, study, resume=True) as store:
        assert store.done()["number"].to_list() == [0]
        assert not any((folder / rest).exists() for rest in rests)
        assert logs(folder) == {0}


def test_a_table_of_all_runs_goes_as_soon_as_there_are_more(study, folder):
    with opened(folder, study, resume=False) as store:
        add(store, [0])
        store.finish()
        add(store, [1])
    assert not (folder / "runs.parquet").exists()
    assert read(folder).rows["number"].to_list() == [0, 1]


def test_the_table_opens_in_polars_pandas_and_arrow(study, folder):
    with opened(folder, study, resume=False) as store:
        add(store, range(3))
        table = store.finish()
        whole = expected(store, range(3))
    assert_frame_equal(pl.read_parquet(table), whole)
    assert pd.read_parquet(table)["metric.final_speed_error_mps"].tolist() == [0.0, 1 / 7, 2 / 7]
    assert pyarrow.parquet.read_table(table).column("in.seed").to_pylist() == [1, 2, 3]
    assert "req.frames_lost == 0" in pyarrow.parquet.read_schema(table).names


def test_logs_that_were_asked_for_are_remembered(study, folder):
    with opened(folder, study, resume=False) as store:
        assert store.asked(()) == set()
        assert not (folder / "keep.txt").exists()
        assert store.asked({7, 3}) == {3, 7}
    with opened(folder, study, resume=True) as store:
        assert store.asked({1}) == {1, 3, 7}
        assert store.asked(None) is None
    with opened(folder, study, resume=True) as store:
        assert store.asked({1}) is None


def test_a_folder_in_use_is_refused_and_left_as_it_is(study, folder):
    with opened(folder, study, resume=False):
        before = {path: path.read_bytes() for path in folder.rglob("*") if path.is_file()}
        with pytest.raises(BadInput, match="is in use by another platoon campaign"), opened(folder, study, resume=True):
            pass
        with pytest.raises(BadInput, match="already exists; go on with it by --resume"):
            stores.check(folder, study, "", resume=False)
        assert {path: path.read_bytes() for path in folder.rglob("*") if path.is_file()} == before


def test_a_folder_that_is_no_campaign_is_refused(study, folder):
    folder.mkdir()
    with pytest.raises(BadInput, match="already exists, and is no campaign"):
        stores.check(folder, study, "", resume=False)
    with pytest.raises(BadInput, match="is no campaign"):
        stores.check(folder, study, "", resume=True)
    with pytest.raises(BadInput, match="is no campaign"):
        stores.check(folder / "nowhere", study, resume=True)
    assert list(folder.iterdir()) == []


def test_other_code_is_refused(study, folder):
    with opened(folder, study, resume=False):
        pass
    code = folder / "code.txt"
    code.write_text("0123456789ab" + code.read_text()[12:])
    with pytest.raises(BadInput, match=r"were made by other code \(0123456789ab\) than this"):
        stores.check(folder, study, "", resume=True)


@pytest.mark.parametrize("changed", ["base.toml", "steered.py"])
def test_an_edited_file_of_the_users_is_refused(changed, tmp_path, study, folder):
    with opened(folder, study, resume=False):
        pass
    stores.check(folder, study, "", resume=True)
    with (tmp_path / changed).open("a") as file:
        file.write("# edited\n")
    with pytest.raises(BadInput, match=rf"{changed} has changed since the runs"):
        stores.check(folder, study, "", resume=True)


@pytest.mark.parametrize(
    ("sampling", "change", "is_same"),
    [
        ("monte-carlo", {"runs": 9}, True),
        ("sobol", {"runs": 16}, True),
        ("latin-hypercube", {"runs": 9}, False),
        ("monte-carlo", {"description": "said otherwise", "time_limit_s": 7.0, "name": "another"}, True),
        ("monte-carlo", {"seed": 2}, False),
        ("monte-carlo", {"requirements": ["frames_lost == 0"]}, False),
        ("monte-carlo", {"inputs": [{"key": "seed", "distribution": {"kind": "choice", "values": [1, 2]}}]}, False),
    ],
)
def test_only_the_same_study_goes_on(sampling, change, is_same, tmp_path, folder):
    keys = MONTE_CARLO | {"sampling": sampling, "runs": 8}
    with opened(folder, load_study(write_study(tmp_path, [], **keys)), resume=False):
        pass
    other = load_study(write_study(tmp_path, [], **keys | change))
    if is_same:
        stores.check(folder, other, "", resume=True)
    else:
        with pytest.raises(BadInput, match="holds another study"):
            stores.check(folder, other, "", resume=True)


def test_a_study_that_cannot_be_read_is_another_one(study, folder):
    with opened(folder, study, resume=False):
        pass
    (folder / "study.toml").write_text("base = ")
    with pytest.raises(BadInput, match="holds another study"):
        stores.check(folder, study, "", resume=True)


@pytest.fixture
def small_disk(tmp_path):
    """A file system that can be full: `small_disk(kibibytes)` makes it larger or smaller."""
    place = tmp_path / "disk"
    place.mkdir()

    def mount(*words):
        done = subprocess.run(["mount", *words, str(place)], capture_output=True, text=True, check=False)
        if done.returncode:
            pytest.skip(f"needs the right to mount a file system (root): {done.stderr.strip()}")

    if shutil.which("mount") is None:
        pytest.skip("needs the command mount")
    mount("-t", "tmpfs", "-o", "size=64k", "tmpfs")
    try:
        yield place, lambda kibibytes: mount("-o", f"remount,size={kibibytes}k")
    finally:
        subprocess.run(["umount", str(place)], check=True)


def test_rows_that_were_written_stay_on_a_full_disk(study, small_disk):
    place, _ = small_disk
    with opened(place / "out", study, resume=False) as store:
        with pytest.raises(RunFailed, match=r"out/parts/\S+ cannot be written: .*no space left"):
            add(store, range(300))
        written = store.done()["number"].to_list()
    assert 0 < len(written) < 300
    assert written == list(range(len(written)))
    assert parts(place / "out")["number"].to_list() == written


def test_a_campaign_on_a_full_disk_stops_and_goes_on_when_there_is_room(tmp_path, begin, small_disk):
    write_study(tmp_path, [1, 2, 3, 4, 5, 6])
    (tmp_path / "go").touch()
    place, resize = small_disk
    resize(600)
    again = [*PLATOON, "campaign", "study.toml", "--out", "disk/out", "--keep", "all", "--workers", "1"]
    command = begin(again)
    assert command.code() == 1
    assert "cannot be written: " in command.said
    assert "no space left" in command.said
    assert command.said.count("platoon: ") == 1
    assert "Traceback" not in command.said, command.said
    go_on = "platoon campaign study.toml --out disk/out --keep all --workers 1 --resume"
    assert command.said.splitlines()[-1].endswith(f"go on with: {go_on}")
    done = parts(place / "out").height
    assert done < 6

    resize(50_000)
    command = begin([*again, "--resume"])
    assert command.code() == 0, command.said
    assert table(place / "out")["in.seed"].to_list() == [1, 2, 3, 4, 5, 6]
    assert logs(place / "out") == set(range(6))
    # What was in the middle is made again, what had its row is not.
    assert sorted(map(len, makings(tmp_path).values()))[:done] == [1] * done


def test_a_full_disk_of_a_worker_is_no_failure_of_its_runs(tmp_path, begin, small_disk):
    write_study(tmp_path, [1, 2, 3])
    place, resize = small_disk
    resize(1500)
    (place / "filling").write_bytes(bytes(900_000))
    words = [*PLATOON, "campaign", "study.toml", "--workers", "1", "--out", "out"]
    command = begin(words, TMPDIR=str(place))
    assert command.code() == 1, command.said
    assert "a worker cannot make runs: the worker tcp://" in command.said
    assert "No space left" in command.said
    (place / "filling").unlink()
    resize(50_000)
    command = begin([*words, "--resume"], TMPDIR=str(place))
    assert command.code() == 0, command.said
    assert table(tmp_path / "out")["status"].to_list() == ["ok", "ok", "ok"]


def test_a_folder_that_cannot_be_created_is_refused(tmp_path, study):
    (tmp_path / "file").touch()
    with pytest.raises(BadInput, match="cannot create"), opened(tmp_path / "file" / "out", study, resume=False):
        pass
