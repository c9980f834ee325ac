# cython: boundscheck=False, wraparound=False, cdivision=True, initializedcheck=False
"""The robust MPC's optimum without a semidefinite program: a search for the best multiplier of `riccati`.

The cost `f(E) = z'W(E)z` is convex in the multiplier E, which has four free numbers, or six for lambda_f = lambda_r.
Newton's method finds its least value on log f, in coordinates that suit a matrix which is positive definite and almost
singular: `E = J J'` moves to `J M M' J'` with M lower triangular, the exponential of a number on its diagonal. It
starts from the last step's multiplier, and ends when the model of f that its gradient and curvature give promises less
than `_TOLERANCE`.

The input bounds (54) are left out. If the gain found keeps them all the same, it is the optimum with them; the
certificate decides that.
"""

import cython
import numpy as np
from numpy.typing import NDArray

from bench.control.outcome import GainSource, SolverStatus
from bench.control.program import Answer
from bench.control.vehicle_model import LinearModel

if cython.compiled:
    from cython.cimports.bench.control.matrices import eigen, invert
    from cython.cimports.bench.control.riccati import GameRiccati
    from cython.cimports.libc.math import exp, fabs, sqrt
else:
    from math import exp, fabs, sqrt

    from bench.control.matrices import eigen, invert
    from bench.control.riccati import GameRiccati

Vector = NDArray[np.float64]

_TOLERANCE = cython.declare(cython.double, 2e-5)
"""Newton decrement at which the search ends: of log f, about half of it is left to gain."""
_DIFFERENCE = cython.declare(cython.double, 1e-4)
"""Step of the differences that give the curvature."""
_FLATTEST = cython.declare(cython.double, 1e-6)
"""Least curvature of log f that is believed."""
_ITERATIONS = cython.declare(cython.int, 40)
_SHORTEST = cython.declare(cython.double, 1e-6)
"""Shortest step tried, as a fraction of Newton's."""
_LEAST = cython.declare(cython.int, -10)
_MOST = cython.declare(cython.int, 6)
"""Without a start that proves a finite cost, the best of `E = exp(k) I` for integers k from `_LEAST` to `_MOST`."""


@cython.cclass
class RiccatiProgram:
    """Finds the gain of one step; results depend on the steps before within the tolerance.

    Args:
        m: number of inputs.
        input_weight: rho.
        independent: lambda_f and lambda_r vary independently; otherwise lambda_f = lambda_r as in the paper.
    """

    source = GainSource.RICCATI

    _riccati: GameRiccati
    _rows: cython.Py_ssize_t[::1]
    _columns: cython.Py_ssize_t[::1]
    _count: cython.Py_ssize_t
    _started: cython.bint
    _rho: cython.double
    _J: cython.double[:, ::1]
    _tried: cython.double[:, ::1]
    _H: cython.double[:, ::1]
    _N1: cython.double[:, ::1]
    _N2: cython.double[:, ::1]
    _slope: cython.double[::1]
    _other: cython.double[::1]
    _move: cython.double[::1]
    _values: cython.double[::1]
    _hessian: cython.double[:, ::1]
    _axes: cython.double[:, ::1]
    iterations = cython.declare(cython.int, visibility="public")
    evaluations = cython.declare(cython.int, visibility="public")

    def __init__(self, m: int, input_weight: float, *, independent: bool) -> None:
        # E commutes with Lambda if it couples only components scaled by the same lambda.
        pairs = [(i, j) for i in range(3) for j in range(i + 1) if not independent or (i == 2) == (j == 2)]
        self._riccati = GameRiccati(input_weight)
        self._rho = input_weight
        self._rows, self._columns = (np.array(part, dtype=np.intp) for part in zip(*pairs, strict=True))
        self._count = count = len(pairs)
        self._started = False
        self._J, self._tried, self._H, self._N1 = (np.zeros((3, 3)) for _ in range(4))
        self._N2 = np.zeros((3, m))
        self._slope, self._other, self._move, self._values = (np.zeros(count) for _ in range(4))
        self._hessian, self._axes = (np.zeros((count, count)) for _ in range(2))
        self.iterations = self.evaluations = 0

    def solve(self, model: LinearModel, z: Vector, room: Vector) -> Answer:  # noqa: ARG002 - of the protocol
        """See `Program.solve`; the input bounds are ignored."""
        m = self._N2.shape[1]
        A: cython.double[:, ::1] = model.A
        B: cython.double[:, ::1] = model.B
        self._balance(model.H, model.N1, model.N2)
        self._riccati.set_model(A, B, self._H, self._N1, self._N2)
        self.evaluations = 0
        status = self._search(z)
        P, Y = np.zeros((3, 3)), np.zeros((m, 3))
        if status is not SolverStatus.SOLVED:
            return Answer(P, Y, 0.0, status, self.iterations)
        cost = self._cost(self._J, z)
        self._ellipsoid(P, Y, B, cost)
        return Answer(P, Y, cost, status, self.iterations)

    @cython.cfunc
    def _balance(self, H: cython.double[:, ::1], N1: cython.double[:, ::1], N2: cython.double[:, ::1]) -> cython.void:
        """H and N can be scaled against each other; with columns and rows of equal length, E is near one."""
        i: cython.Py_ssize_t
        k: cython.Py_ssize_t
        column: cython.double
        row: cython.double
        share: cython.double
        for k in range(3):
            column = H[0, k] ** 2 + H[1, k] ** 2 + H[2, k] ** 2
            row = N1[k, 0] ** 2 + N1[k, 1] ** 2 + N1[k, 2] ** 2
            for i in range(N2.shape[1]):
                row += N2[k, i] ** 2
            share = sqrt(max(sqrt(row), 1e-12) / max(sqrt(column), 1e-12))
            for i in range(3):
                self._H[i, k] = H[i, k] * share
                self._N1[k, i] = N1[k, i] / share
            for i in range(N2.shape[1]):
                self._N2[k, i] = N2[k, i] / share

    @cython.cfunc
    def _cost(self, J: cython.double[:, ::1], z: cython.double[::1]) -> cython.double:
        self.evaluations += 1
        return self._riccati.cost(J, z)

    @cython.cfunc
    def _search(self, z: cython.double[::1]) -> object:
        """Move J to the least cost, and return how that went."""
        cost: cython.double = -1.0
        found: cython.double
        value: cython.double
        share: cython.double
        decrement: cython.double
        self.iterations = 0
        if self._started:
            cost = self._cost(self._J, z)
        if not cost > 0.0:
            cost = self._scan(z)
        if not cost > 0.0:
            self._started = False
            # That none of these multipliers proves a cost does not mean that there is none.
            return SolverStatus.NUMERICAL_ERROR
        self._started = True
        while self.iterations < _ITERATIONS:
            self._differentiate(self._slope)
            value = self._riccati.value
            self._bend(z)
            decrement = self._newton()
            if decrement < _TOLERANCE:
                return SolverStatus.SOLVED
            self.iterations += 1
            share = 1.0
            while True:
                self._go(self._tried, share)
                found = self._cost(self._tried, z)
                if found > 0.0 and self._riccati.value <= value - 1e-4 * share * decrement:
                    break
                share *= 0.3
                if share < _SHORTEST:
                    return SolverStatus.NUMERICAL_ERROR
            self._J, self._tried = self._tried, self._J
        return SolverStatus.MAX_ITERATIONS

    @cython.cfunc
    def _scan(self, z: cython.double[::1]) -> cython.double:
        """Set J to the best multiple of the identity and return its cost; -1 if none proves a finite cost."""
        i: cython.Py_ssize_t
        k: cython.int
        best: cython.double = -1.0
        best_root: cython.double = 1.0
        self._tried[:, :] = 0.0
        for k in range(_LEAST, _MOST + 1):
            for i in range(3):
                self._tried[i, i] = exp(0.5 * k)
            cost: cython.double = self._cost(self._tried, z)
            if cost > 0.0 and (best < 0.0 or cost < best):
                best, best_root = cost, self._tried[0, 0]
        self._J[:, :] = 0.0
        for i in range(3):
            self._J[i, i] = best_root
        if best > 0.0:
            best = self._cost(self._J, z)
        return best

    @cython.cfunc
    def _differentiate(self, slope: cython.double[::1]) -> cython.void:
        """Set the derivatives of log f where the Riccati equation was last solved."""
        k: cython.Py_ssize_t
        for k in range(self._count):
            slope[k] = 2.0 * self._riccati.gradient[self._rows[k], self._columns[k]]

    @cython.cfunc
    def _bend(self, z: cython.double[::1]) -> cython.void:
        """Set the second derivatives of log f at J, from differences of its first ones."""
        i: cython.Py_ssize_t
        k: cython.Py_ssize_t
        near: cython.double
        step: cython.double
        for k in range(self._count):
            for i in range(self._count):
                self._move[i] = 0.0
            self._move[k] = step = _DIFFERENCE
            self._go(self._tried, 1.0)
            near = self._cost(self._tried, z)
            if not near > 0.0:
                step = -_DIFFERENCE
                self._go(self._tried, -1.0)
                near = self._cost(self._tried, z)
            # Where neither side proves a cost, the slope's own size stands for the curvature.
            if near > 0.0:
                self._differentiate(self._other)
            else:
                self._other[:] = self._slope
            for i in range(self._count):
                self._hessian[k, i] = (self._other[i] - self._slope[i]) / step
        for i in range(self._count):
            for k in range(i):
                self._hessian[i, k] = self._hessian[k, i] = 0.5 * (self._hessian[i, k] + self._hessian[k, i])

    @cython.cfunc
    def _newton(self) -> cython.double:
        """Set Newton's step and return its decrement: twice what it promises to gain of log f.

        Along each axis of the curvature the decrease may be that of an exponential, towards a multiplier that is
        infinite or 0: its gain is the slope itself. So a curvature below half the slope is not believed.
        """
        i: cython.Py_ssize_t
        k: cython.Py_ssize_t
        along: cython.double
        bend: cython.double
        decrement: cython.double = 0.0
        eigen(self._values, self._axes, self._hessian)
        for i in range(self._count):
            self._move[i] = 0.0
        for k in range(self._count):
            along = 0.0
            for i in range(self._count):
                along += self._axes[i, k] * self._slope[i]
            bend = max(self._values[k], _FLATTEST, 0.5 * fabs(along))
            decrement += along * along / bend
            for i in range(self._count):
                self._move[i] -= self._axes[i, k] * along / bend
        return decrement

    @cython.cfunc
    def _go(self, out: cython.double[:, ::1], share: cython.double) -> cython.void:
        """Set `out = J M`, with M where this share of the present move leads from the identity."""
        i: cython.Py_ssize_t
        k: cython.Py_ssize_t
        row: cython.Py_ssize_t
        column: cython.Py_ssize_t
        factor: cython.double
        out[:, :] = 0.0
        for k in range(self._count):
            row, column = self._rows[k], self._columns[k]
            factor = exp(share * self._move[k]) if row == column else share * self._move[k]
            for i in range(row, 3):
                out[i, column] += self._J[i, row] * factor

    @cython.cfunc
    def _ellipsoid(
        self, P: cython.double[:, ::1], Y: cython.double[:, ::1], B: cython.double[:, ::1], cost: cython.double
    ) -> cython.void:
        """Set `P = cost W^-1` and `Y = K P`."""
        i: cython.Py_ssize_t
        j: cython.Py_ssize_t
        k: cython.Py_ssize_t
        gain: cython.double
        invert(P, self._riccati.W)
        for i in range(3):
            for j in range(i + 1):
                P[i, j] = P[j, i] = 0.5 * cost * (P[i, j] + P[j, i])
        for i in range(Y.shape[0]):
            for j in range(3):
                gain = 0.0
                for k in range(3):
                    gain -= B[k, i] * self._riccati.costate[k, j] + self._N2[k, i] * self._riccati.multiplier[k, j]
                gain /= self._rho
                for k in range(3):
                    Y[i, k] += gain * P[j, k]
