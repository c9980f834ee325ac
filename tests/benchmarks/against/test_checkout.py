"""Another revision is built beside this one, once; what stands in the way is said in one message."""

import os
import subprocess
import sys
from pathlib import Path

import pytest

from bench.benchmarks.against.checkout import build, commit_of
from bench.errors import BadInput, RunFailed

ROOT = Path(__file__).parents[3]

SETUP = "setup:\n\tmkdir -p .venv/bin\n\ttouch .venv/bin/python .venv/bin/platoon\n\techo done >> build/times\n"


@pytest.fixture
def repository(tmp_path):
    """A repository of two commits: one that can be set up, and one that cannot."""
    root = tmp_path / "repository"
    root.mkdir()
    git(root, "init", "--quiet")
    for makefile in (SETUP, "setup:\n\t@echo no compiler; exit 1\n"):
        (root / "Makefile").write_text(makefile)
        git(root, "add", "Makefile")
        git(root, "-c", "user.name=A", "-c", "user.email=a@b.example", "commit", "--quiet", "-m", "another")
    return root


def git(root, *arguments):
    subprocess.run(["git", "-C", str(root), *arguments], check=True)


def run(*arguments, **settings):
    command = [sys.executable, "-m", "bench.benchmarks", "against", *arguments]
    return subprocess.run(
        command, capture_output=True, text=True, check=False, cwd=ROOT, env=os.environ | settings, timeout=60
    )


def test_a_revision_is_built_once(repository, tmp_path):
    builds, said = tmp_path / "builds", []
    commit = commit_of("HEAD~1", repository)
    first = build(commit, builds, said.append, repository)
    again = build(commit, builds, said.append, repository)
    assert first == again
    assert first.name == commit[:7]
    assert first.platoon.exists()
    assert len(said) == 1
    assert (builds / commit / "build" / "times").read_text() == "done\n"
    # The repository itself is as it was.
    assert (repository / "Makefile").read_text() != SETUP
    assert not subprocess.run(
        ["git", "-C", str(repository), "status", "--short"], capture_output=True, check=True
    ).stdout


def test_an_interrupted_build_is_completed(repository, tmp_path):
    commit = commit_of("HEAD~1", repository)
    folder = tmp_path / "builds" / commit
    folder.mkdir(parents=True)
    (folder / "Makefile").write_text("half of")
    assert build(commit, folder.parent, lambda _: None, repository).platoon.exists()


def test_an_edited_build_is_refused(repository, tmp_path):
    commit = commit_of("HEAD~1", repository)
    build(commit, tmp_path, lambda _: None, repository)
    (tmp_path / commit / "Makefile").write_text("edited")
    with pytest.raises(BadInput, match=r"has been edited \(Makefile\); remove it"):
        build(commit, tmp_path, lambda _: None, repository)


def test_a_file_in_the_way_is_named(repository, tmp_path):
    commit = commit_of("HEAD~1", repository)
    (tmp_path / commit).write_text("")
    with pytest.raises(BadInput, match=rf"{commit}: .* --builds"):
        build(commit, tmp_path, lambda _: None, repository)
    with pytest.raises(BadInput, match="--builds"):
        build(commit, tmp_path / commit, lambda _: None, repository)


def test_a_revision_that_cannot_be_set_up_says_why(repository, tmp_path):
    for _ in range(2):
        with pytest.raises(RunFailed, match=r"make setup of \w+ failed(.|\n)*no compiler"):
            build(commit_of("HEAD", repository), tmp_path, lambda _: None, repository)


@pytest.mark.parametrize("revision", ["nonsense", "HEAD~9", "--help", "", "HEAD:Makefile"])
def test_a_revision_that_does_not_exist_is_refused(revision, repository):
    with pytest.raises(BadInput, match="no such revision"):
        commit_of(revision, repository)


def test_without_a_repository_there_is_no_other_revision(tmp_path, monkeypatch):
    monkeypatch.setenv("GIT_CEILING_DIRECTORIES", str(tmp_path.parent))
    with pytest.raises(BadInput, match="not a git repository"):
        commit_of("HEAD", tmp_path)


def test_the_command_says_what_is_wrong_in_one_message():
    done = run("nonsense")
    assert done.returncode == 2
    assert done.stderr.startswith("bench.benchmarks: nonsense: no such revision in ")
    assert done.stderr.count("\n") == 1
    assert not done.stdout


def test_without_git_the_command_says_how_to_install_it(tmp_path):
    done = run("HEAD", PATH=str(tmp_path))
    assert done.returncode == 2
    assert "git is not installed" in done.stderr
    assert done.stderr.count("\n") == 1


@pytest.mark.parametrize(
    "arguments", [[], ["HEAD", "--pairs", "0"], ["HEAD", "--seconds", "-1"], ["HEAD", "--realtime", "nan"]]
)
def test_wrong_arguments_are_refused(arguments):
    assert run(*arguments).returncode == 2


def test_a_scenario_that_does_not_exist_is_refused_before_anything_is_built(tmp_path):
    done = run("HEAD", "--scenario", "nonsense", "--builds", str(tmp_path))
    assert done.returncode == 2
    assert "nonsense" in done.stderr
    assert not list(tmp_path.iterdir())
