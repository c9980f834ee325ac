"""The commit that a log names."""

import shutil
import subprocess
from pathlib import Path

import pytest

from bench.conductor import checkout
from bench.conductor.checkout import Checkout


@pytest.fixture
def repository(tmp_path, monkeypatch):
    """A repository that tracks a copy of the module; the module asks there."""
    package = tmp_path / "bench"
    package.mkdir()
    shutil.copy(checkout.__file__, package)
    git(package, "init", "--quiet")
    monkeypatch.setattr(checkout, "__file__", str(package / "checkout.py"))
    return package


def git(folder: Path, *arguments: str) -> str:
    identity = ("-c", "user.name=A", "-c", "user.email=a@b.example")
    return subprocess.run(
        ["git", *identity, *arguments], cwd=folder, check=True, capture_output=True, text=True
    ).stdout.strip()


def test_it_is_the_commit_of_the_checkout_with_a_mark_if_files_have_changed(repository):
    assert Checkout().commit() == ""
    git(repository, "add", ".")
    assert Checkout().commit() == ""
    git(repository, "commit", "--quiet", "-m", "one")
    (repository / "new.py").touch()
    head = git(repository, "rev-parse", "HEAD")
    assert Checkout().commit() == head
    (repository / "checkout.py").write_text("pass\n")
    assert Checkout().commit() == f"{head}+"
    git(repository, "commit", "--quiet", "-am", "two")
    assert Checkout().commit() == git(repository, "rev-parse", "HEAD") != head


def test_another_repository_around_an_installed_copy_has_no_say(repository):
    (repository / "other.py").touch()
    git(repository, "add", "other.py")
    git(repository, "commit", "--quiet", "-m", "one")
    assert Checkout().commit() == ""


def test_without_git_there_is_none(monkeypatch):
    monkeypatch.setenv("PATH", "")
    assert Checkout().commit() == ""
