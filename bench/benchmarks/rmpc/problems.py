"""The set of problems, and the file that holds it.

A problem is one step of the robust MPC in scaled units, so that `Q = I`, `R = rho I` and the deviation has length one:

    chi+ = (A + H Lambda N1) chi + (B + H Lambda N2) theta,  Lambda = diag(lambda_f, lambda_f, lambda_r),
    |lambda_f|, |lambda_r| <= 1, changing at any time;  |theta_j| <= room_j;  chi(0) = z.

Wanted is the gain `theta = K chi` with the least bound tau of the worst-case cost `sum chi'Q chi + theta'R theta`.
"""

import json
from collections.abc import Iterator, Mapping
from dataclasses import dataclass, fields, replace
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from bench.control.vehicle_model import LinearModel

Vector = NDArray[np.float64]
Array = NDArray[Any]

FILE = Path(__file__).parent / "problems.npz"

PIECE = 20
"""Recorded problems come in runs of this many consecutive steps."""

MODEL = ("A", "B", "H", "N1", "N2")
_SHAPES = {**dict.fromkeys(MODEL, (3, 3)), "z": (3,), "room": (3,)}


@dataclass(frozen=True)
class Problem:
    """One problem; see the module's docstring.

    Attributes:
        model: A, B, H, N1, N2, each (3, 3).
        z: (3,) deviation, of length one.
        room: (3,) bound of each input.
        rho: input weight.
        independent: whether lambda_f and lambda_r vary independently; otherwise they are equal.
        group: the kind of point.
        run: problems of the same run are consecutive steps of one tracker; -1 if it has no neighbours.
        tau: the optimum that cvxpy finds; infinite if it is infeasible.
    """

    model: LinearModel
    z: Vector
    room: Vector
    rho: float
    independent: bool
    group: str
    run: int
    tau: float

    @property
    def feasible(self) -> bool:
        """Whether there is a gain."""
        return bool(np.isfinite(self.tau))


@dataclass(frozen=True)
class Problems:
    """A set of n problems as arrays; the attributes are those of `Problem`.

    Attributes:
        A, B, H, N1, N2: (n, 3, 3).
        z, room: (n, 3).
        rho, independent, group, run, tau: (n,).
        about: how tau was found: versions and tolerance.
    """

    A: Array
    B: Array
    H: Array
    N1: Array
    N2: Array
    z: Array
    room: Array
    rho: Array
    independent: Array
    group: Array
    run: Array
    tau: Array
    about: Mapping[str, str]

    def __len__(self) -> int:
        """Return the number of problems."""
        return len(self.tau)

    def __iter__(self) -> Iterator[Problem]:
        """Yield the problems in order."""
        return map(self.at, range(len(self)))

    def at(self, index: int) -> Problem:
        """Return one problem, in double precision."""
        numbers = {name: np.array(getattr(self, name)[index], dtype=np.float64) for name in _SHAPES}
        return Problem(
            LinearModel(*(numbers[name] for name in MODEL)),
            numbers["z"],
            numbers["room"],
            float(self.rho[index]),
            bool(self.independent[index]),
            str(self.group[index]),
            int(self.run[index]),
            float(self.tau[index]),
        )

    def sample(self, count: int) -> "Problems":
        """Return at most `count` problems from all over the set, in pieces that keep consecutive steps together."""
        pieces = -(-len(self) // PIECE)
        wanted = max(1, min(pieces, count // PIECE))
        starts = PIECE * np.unique(np.linspace(0, pieces - 1, wanted).round().astype(int))
        places = np.concatenate([np.arange(start, min(start + PIECE, len(self))) for start in starts])
        return self.chosen(places[:count])

    def chosen(self, which: Array) -> "Problems":
        """Return the problems at these indices, or where a mask is true."""
        arrays = {each.name: getattr(self, each.name)[which] for each in fields(self) if each.name != "about"}
        return replace(self, **arrays)


def problems_of(problems: list[Problem], about: Mapping[str, str]) -> Problems:
    """Return a set of problems; the numbers of each are rounded to single precision, so that the file is small."""
    numbers = {
        name: np.array([getattr(each.model if name in MODEL else each, name) for each in problems], dtype=np.float32)
        for name in _SHAPES
    }
    return Problems(
        **numbers,
        rho=np.array([each.rho for each in problems]),
        independent=np.array([each.independent for each in problems]),
        group=np.array([each.group for each in problems]),
        run=np.array([each.run for each in problems], dtype=np.int32),
        tau=np.array([each.tau for each in problems]),
        about=about,
    )


def save(problems: Problems, file: Path) -> None:
    """Write a set of problems as a compressed npz file."""
    arrays = {each.name: getattr(problems, each.name) for each in fields(problems) if each.name != "about"}
    np.savez_compressed(file, **arrays, about=np.array(json.dumps(dict(problems.about))))


def load(file: Path = FILE) -> Problems:
    """Read a set of problems."""
    with np.load(file, allow_pickle=False) as data:
        arrays = {each.name: data[each.name] for each in fields(Problems) if each.name != "about"}
        return Problems(**arrays, about=json.loads(str(data["about"])))
