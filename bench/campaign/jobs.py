"""What passes between the client of a campaign and its workers."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field

from bench.campaign.distributions import Value
from bench.campaign.requirements import Metric
from bench.campaign.study import Study

MOST_TRIES = 2
"""How often a run is tried that did not reach its end."""


@dataclass(frozen=True)
class Setup:
    """What a worker needs for all runs of a campaign.

    Attributes:
        name: of the campaign's plugin, no two campaigns have the same.
        study: the study.
        files: contents of the user's files by path, which a worker on another machine may not have.
        fmu: the vehicle's FMU.
        versions: see `bench.campaign.version`.
    """

    name: str
    study: Study
    files: Mapping[str, bytes]
    fmu: bytes
    versions: Mapping[str, str]


@dataclass(frozen=True)
class Job:
    """A run to make.

    Attributes:
        number: of the run.
        values: of the study's inputs by key.
        keep: whether its log is asked for.
        worst: margin and number by requirement; a run before that is to keep its log (`bench.campaign.keeping`).
    """

    number: int
    values: Mapping[str, Value]
    keep: bool = False
    worst: Mapping[str, tuple[float, float]] = field(default_factory=dict)


@dataclass(frozen=True)
class Made:
    """A run that was made.

    Attributes:
        number: of the run.
        status: how it ended.
        words: why, if it did not reach its end.
        tries: how often it was tried.
        wall_s: wall-clock time of the last try, s.
        worker: address of the worker.
        metrics: its metrics by name; empty if it did not reach its end.
        log: the log's content if it is to be kept.
    """

    number: int
    status: str
    words: str = ""
    tries: int = 1
    wall_s: float = 0.0
    worker: str = ""
    metrics: Mapping[str, Metric] = field(default_factory=dict)
    log: bytes | None = None
