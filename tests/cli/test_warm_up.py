"""The controllers are compiled once, before an installed package runs them first."""

from bench.cli.warm_up import warm_up_once


def test_it_is_done_and_said_once_for_the_same_controllers(tmp_path, monkeypatch):
    said = []
    warm_up_once(tmp_path, said.append)
    assert len(said) == 1
    assert "compiling" in said[0]
    warm_up_once(tmp_path, said.append)
    assert len(said) == 1
    (tmp_path / "control").mkdir()
    monkeypatch.setattr("bench.cli.warm_up._CONTROL", tmp_path / "control")
    warm_up_once(tmp_path, said.append)
    assert len(said) == 2
