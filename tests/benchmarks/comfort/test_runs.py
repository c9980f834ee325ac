"""Runs are made once, in any number of processes, and continued where they were stopped."""

import json

import pytest

from bench.benchmarks.comfort import command
from bench.benchmarks.comfort.limits import LIMITS
from bench.benchmarks.comfort.results import read
from bench.benchmarks.comfort.runs import Job, results
from bench.campaign.version import code_version
from bench.errors import BadInput

SHORT = [Job("random:0", ("duration_s=1.0",)), Job("formation", ("duration_s=1.0",))]


@pytest.fixture(scope="module")
def made(tmp_path_factory):
    folder = tmp_path_factory.mktemp("kept") / "results"
    said = []
    return results(SHORT, folder, 2, said.append), folder, said


def test_each_job_has_its_result(made):
    found, _, said = made
    assert [each.scenario for each in found] == ["random-0", "formation"]
    for each in found:
        assert each.failure == ""
        assert each.formed_s is None
        assert each.comfort is not None
        assert each.comfort.keys() == LIMITS.keys()
        assert 0.0 < each.comfort["longitudinal_acceleration_mps2"] < 10.0
        assert each.clearance_m > 1.0
        assert sum(each.limits.values()) == 100 * each.vehicles
        assert each.events["state_change"] > 0
        assert each.problems[0] == "not formed"
    assert {line.partition(" of 2: ")[2].partition(":")[0] for line in said} == {"random", "formation duration_s=1.0"}


def test_what_is_kept_is_not_run_again(made):
    _, folder, _ = made
    file = SHORT[0].file(folder)
    changed = json.loads(file.read_text()) | {"formed_s": 0.5}
    file.write_text(json.dumps(changed))
    said = []
    found = results([SHORT[0]], folder, 1, said.append)
    assert (found[0].formed_s, said) == (0.5, [])
    assert read(file) == found[0]


def test_what_has_failed_is_run_again(made):
    _, folder, _ = made
    file = SHORT[1].file(folder)
    file.write_text(json.dumps(json.loads(file.read_text()) | {"failure": "no memory"}))
    said = []
    found = results([SHORT[1]], folder, 1, said.append)
    assert (found[0].failure, len(said)) == ("", 1)


def test_other_scenarios_have_other_files(tmp_path):
    files = {job.file(tmp_path) for job in (*SHORT, Job("random:0"), Job("random:1"), Job("formation"))}
    assert len(files) == 5


def test_the_code_has_a_version():
    assert code_version() == code_version()
    assert len(code_version()) == 12


def test_a_page_needs_all_parts(tmp_path):
    parser = command.argparse.ArgumentParser()
    command.add_arguments(parser)
    for place, words in ((tmp_path / "p.md", "leave out --only front"), (tmp_path / "p.txt", "p.txt")):
        only = ["--only", "front"] if place.suffix == ".md" else []
        with pytest.raises(BadInput, match=words):
            list(command.measured(parser.parse_args(["--write", str(place), *only])))
    with pytest.raises(SystemExit):
        parser.parse_args(["--scenarios", "0"])
