# cython: boundscheck=False, wraparound=False, cdivision=True, initializedcheck=False
"""The robust MPC's optimum without a semidefinite program: a search for the best multiplier of `riccati`.

The cost `f(E) = z'W(E)z` is convex in the multiplier E, which has four free numbers, or six for lambda_f = lambda_r.
Newton's method finds its least value on log f, in coordinates that suit a matrix which is positive definite and almost
singular: `E = J J'` moves to `J M M' J'` with M lower triangular, the exponential of a number on its diagonal. It
starts from the last step's multiplier and curvature, and ends when the model of f that its gradient and curvature give
promises less than `_TOLERANCE`. The curvature is that of differences of the gradient where nothing is known of it or
where the search is slow; otherwise each move corrects it (BFGS), so that most steps need two or three solutions of the
Riccati equation.

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
    from cython.cimports.bench.control.flat_matrices import copy, eigen, form, invert
    from cython.cimports.bench.control.riccati import GameRiccati
    from cython.cimports.libc.math import exp, fabs, sqrt
else:
    from math import exp, fabs, sqrt

    from bench.control.flat_matrices import blank, copy, eigen, form, invert
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
_SHORTEST_UNPROVEN = cython.declare(cython.double, 0.2)
"""The same while the curvature is an earlier step's."""
_SLOW = cython.declare(cython.double, 0.6)
"""If a move leaves more of the decrement than this, the curvature is found anew."""
_NEAR = cython.declare(cython.double, 0.5)
"""Square of the cosine of the angle within which deviations have similar curvatures."""
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

    Attributes:
        iterations: Newton's steps of the last search.
        evaluations: solutions of the Riccati equation in the last search.
    """

    source = GainSource.RICCATI

    def __init__(self, m: int, input_weight: float, *, independent: bool) -> None:
        # E commutes with Lambda if it couples only components scaled by the same lambda.
        pairs = [(i, j) for i in range(3) for j in range(i + 1) if not independent or (i == 2) == (j == 2)]
        self._riccati = GameRiccati(input_weight)
        self._rho = input_weight
        self._count = len(pairs)
        self._started = self._bent = False
        self._value = 0.0
        self._H, self._N1, self._N2 = np.zeros((3, 3)), np.zeros((3, 3)), np.zeros((3, m))
        self.iterations = self.evaluations = 0
        if not cython.compiled:
            # Compiled, they are arrays in the object.
            self._rows, self._columns = [0] * 6, [0] * 6
            self._J, self._tried, self._P, self._z, self._z_bent = blank(5)
            self._slope, self._other, self._move, self._values, self._pulled = blank(5)
            self._hessian, self._axes, self._turned = blank(3, 36)
        for place, (row, column) in enumerate(pairs):
            self._rows[place], self._columns[place] = row, column

    def solve(self, model: LinearModel, z: Vector, room: Vector) -> Answer:  # noqa: ARG002 - of the protocol
        """See `Program.solve`; the input bounds are ignored."""
        i: cython.Py_ssize_t
        B: cython.double[:, ::1] = model.B
        direction: cython.double[::1] = z
        for i in range(3):
            self._z[i] = direction[i]
        self._balance(model.H, model.N1, model.N2)
        self._riccati.set_model(model.A, B, self._H, self._N1, self._N2)
        self.evaluations = 0
        status = self._search()
        P, Y = np.zeros((3, 3)), np.zeros((B.shape[1], 3))
        if status is not SolverStatus.SOLVED:
            return Answer(P, Y, 0.0, status, self.iterations)
        cost: cython.double = form(self._z, self._riccati.W)
        self._set_ellipsoid(P, Y, B, cost)
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
    def _cost(self, J: cython.p_double) -> cython.double:
        self.evaluations += 1
        return self._riccati.cost(J, self._z)

    @cython.cfunc
    def _search(self) -> object:
        """Move J to the least cost and solve the Riccati equation there; return how that went."""
        decrement: cython.double
        last: cython.double = 1e300
        fresh: cython.bint
        self.iterations = 0
        if not self._start():
            # That none of these multipliers proves a cost does not mean that there is none.
            return SolverStatus.NUMERICAL_ERROR
        fresh = not (self._bent and self._is_near_last())
        while True:
            if fresh:
                self._bend()
            decrement = self._newton()
            if decrement < _TOLERANCE:
                break
            if self.iterations == _ITERATIONS:
                return SolverStatus.MAX_ITERATIONS
            self.iterations += 1
            if self._descend(decrement, _SHORTEST if fresh else _SHORTEST_UNPROVEN):
                fresh = decrement > _SLOW * last
                last = decrement
            elif fresh:
                self._bent = False
                return SolverStatus.NUMERICAL_ERROR
            else:
                fresh = True
        # The differences have left the solution at another multiplier.
        return SolverStatus.SOLVED if not fresh or self._cost(self._J) > 0.0 else SolverStatus.NUMERICAL_ERROR

    @cython.cfunc
    @cython.exceptval(check=False)
    def _start(self) -> cython.bint:
        """Solve the Riccati equation at the last step's multiplier, or at the best multiple of the identity."""
        if not (self._started and self._cost(self._J) > 0.0):
            self._bent = False
            self._started = self._scan()
        self._value = self._riccati.value
        self._differentiate(self._slope)
        return self._started

    @cython.cfunc
    @cython.exceptval(check=False)
    def _is_near_last(self) -> cython.bint:
        """Whether the deviation has about the direction for which the curvature was found; z has length one."""
        i: cython.Py_ssize_t
        along: cython.double = 0.0
        for i in range(3):
            along += self._z[i] * self._z_bent[i]
        return along * along > _NEAR

    @cython.cfunc
    @cython.exceptval(check=False)
    def _descend(self, decrement: cython.double, shortest: cython.double) -> cython.bint:
        """Move J along Newton's step as far as the value falls, and correct slope and curvature; False if nowhere."""
        share: cython.double = 1.0
        while True:
            self._go(self._tried, share)
            if self._cost(self._tried) > 0.0 and self._riccati.value <= self._value - 1e-4 * share * decrement:
                break
            share *= 0.3
            if share < shortest:
                return False
        copy(self._J, self._tried)
        self._value = self._riccati.value
        self._correct(share)
        return True

    @cython.cfunc
    @cython.exceptval(check=False)
    def _correct(self, share: cython.double) -> cython.void:
        """Take over the slope here, and correct the curvature by how it has changed (BFGS)."""
        i: cython.Py_ssize_t
        k: cython.Py_ssize_t
        n: cython.Py_ssize_t = self._count
        change: cython.double = 0.0
        expected: cython.double = 0.0
        self._differentiate(self._other)
        for i in range(n):
            self._pulled[i] = 0.0
            for k in range(n):
                self._pulled[i] += share * self._hessian[n * i + k] * self._move[k]
            self._slope[i] = self._other[i] - self._slope[i]
            change += share * self._move[i] * self._slope[i]
            expected += share * self._move[i] * self._pulled[i]
        if change > 0.0 and expected > 0.0:
            for i in range(n):
                for k in range(n):
                    self._hessian[n * i + k] += (
                        self._slope[i] * self._slope[k] / change - self._pulled[i] * self._pulled[k] / expected
                    )
        for i in range(n):
            self._slope[i] = self._other[i]

    @cython.cfunc
    @cython.exceptval(check=False)
    def _scan(self) -> cython.bint:
        """Set J to the best multiple of the identity and solve there; False if none proves a finite cost."""
        i: cython.Py_ssize_t
        k: cython.int
        cost: cython.double
        best: cython.double = -1.0
        best_root: cython.double = 1.0
        for i in range(9):
            self._J[i] = 0.0
        for k in range(_LEAST, _MOST + 1):
            for i in range(3):
                self._J[4 * i] = exp(0.5 * k)
            cost = self._cost(self._J)
            if cost > 0.0 and (best < 0.0 or cost < best):
                best, best_root = cost, self._J[0]
        for i in range(3):
            self._J[4 * i] = best_root
        return best > 0.0 and self._cost(self._J) > 0.0

    @cython.cfunc
    @cython.exceptval(check=False)
    def _differentiate(self, slope: cython.p_double) -> cython.void:
        """Set the derivatives of log f where the Riccati equation was last solved."""
        k: cython.Py_ssize_t
        for k in range(self._count):
            slope[k] = 2.0 * self._riccati.gradient[3 * self._rows[k] + self._columns[k]]

    @cython.cfunc
    @cython.exceptval(check=False)
    def _bend(self) -> cython.void:
        """Set the second derivatives of log f at J, from differences of its first ones."""
        i: cython.Py_ssize_t
        k: cython.Py_ssize_t
        n: cython.Py_ssize_t = self._count
        step: cython.double
        for k in range(n):
            for i in range(n):
                self._move[i] = 0.0
            self._move[k] = step = _DIFFERENCE
            self._go(self._tried, 1.0)
            if not self._cost(self._tried) > 0.0:
                step = -_DIFFERENCE
                self._go(self._tried, -1.0)
                if not self._cost(self._tried) > 0.0:
                    step = 0.0
            # Where neither side proves a cost, the slope's own size stands for the curvature.
            self._differentiate(self._other)
            for i in range(n):
                self._hessian[n * k + i] = (self._other[i] - self._slope[i]) / step if step != 0.0 else 0.0
        for i in range(n):
            for k in range(i):
                self._hessian[n * i + k] = 0.5 * (self._hessian[n * i + k] + self._hessian[n * k + i])
                self._hessian[n * k + i] = self._hessian[n * i + k]
        self._bent = True
        for i in range(3):
            self._z_bent[i] = self._z[i]

    @cython.cfunc
    @cython.exceptval(check=False)
    def _newton(self) -> cython.double:
        """Set Newton's step and return its decrement: twice what it promises to gain of log f.

        Along each axis of the curvature the decrease may be that of an exponential, towards a multiplier that is
        infinite or 0: its gain is the slope itself. So a curvature below half the slope is not believed.
        """
        i: cython.Py_ssize_t
        k: cython.Py_ssize_t
        n: cython.Py_ssize_t = self._count
        along: cython.double
        bend: cython.double
        decrement: cython.double = 0.0
        for i in range(n * n):
            self._turned[i] = self._hessian[i]
        eigen(self._values, self._axes, self._turned, n)
        for i in range(n):
            self._move[i] = 0.0
        for k in range(n):
            along = 0.0
            for i in range(n):
                along += self._axes[n * i + k] * self._slope[i]
            bend = max(self._values[k], _FLATTEST, 0.5 * fabs(along))
            decrement += along * along / bend
            for i in range(n):
                self._move[i] -= self._axes[n * i + k] * along / bend
        return decrement

    @cython.cfunc
    @cython.exceptval(check=False)
    def _go(self, out: cython.p_double, share: cython.double) -> cython.void:
        """Set `out = J M`, with M where this share of the present move leads from the identity."""
        i: cython.Py_ssize_t
        k: cython.Py_ssize_t
        row: cython.Py_ssize_t
        column: cython.Py_ssize_t
        factor: cython.double
        for i in range(9):
            out[i] = 0.0
        for k in range(self._count):
            row, column = self._rows[k], self._columns[k]
            factor = exp(share * self._move[k]) if row == column else share * self._move[k]
            for i in range(row, 3):
                out[3 * i + column] += self._J[3 * i + row] * factor

    @cython.cfunc
    def _set_ellipsoid(
        self, P: cython.double[:, ::1], Y: cython.double[:, ::1], B: cython.double[:, ::1], cost: cython.double
    ) -> cython.void:
        """Set `P = cost W^-1` and `Y = K P`."""
        i: cython.Py_ssize_t
        j: cython.Py_ssize_t
        k: cython.Py_ssize_t
        gain: cython.double
        invert(self._P, self._riccati.W)
        for i in range(3):
            for j in range(3):
                P[i, j] = 0.5 * cost * (self._P[3 * i + j] + self._P[3 * j + i])
        for i in range(Y.shape[0]):
            for j in range(3):
                gain = 0.0
                for k in range(3):
                    gain -= B[k, i] * self._riccati.costate[3 * k + j]
                    gain -= self._N2[k, i] * self._riccati.multiplier[3 * k + j]
                gain /= self._rho
                for k in range(3):
                    Y[i, k] += gain * P[j, k]
