# cython: boundscheck=False, wraparound=False, cdivision=True, initializedcheck=False
"""The worst-case cost of the robust MPC for a given multiplier, from a Riccati equation.

Without input bounds, (51)-(53) is guaranteed-cost control (Petersen and McFarlane 1994). For a multiplier E > 0 that
commutes with Lambda, the least W with `chi'W chi` an upper bound of the cost for all cornering stiffnesses solves

    W = min over K of  Q + K'RK + (A + BK)'(W^-1 - HEH')^-1 (A + BK) + (N1 + N2 K)'E^-1 (N1 + N2 K)

which is the Riccati equation of a game between theta and the uncertainty. With Q = I, R = rho I and
`M = (rho E + N2 N2')^-1` it has no inverse of E, and matrices of 3 rows and columns only, for any number of inputs:

    W = Q^ + A^' W (I + G W)^-1 A^,          A^ = A - B N2' M N1,    Q^ = I + rho N1' M N1,
                                             G = (B B' - B N2' M N2 B') / rho - H E H'.

It is solved by structured doubling (Chu, Fan, Lin, Wang 2004), which needs about ten steps. W proves the cost only if
`S = I - J'H'WH J` is positive definite, E = J J'. The best multiplier can be at the edge of that, mostly at small rho,
so what is minimised is `log z'Wz` and a barrier, a small multiple of `-log det S`.
"""

import cython

if cython.compiled:
    from cython.cimports.bench.control.flat_matrices import (
        add,
        add_symmetric,
        cholesky,
        complement,
        congruence,
        copy,
        form,
        invert,
        multiply,
        multiply_transposed,
        trace,
        transposed_multiply,
    )
    from cython.cimports.libc.math import fabs, log
else:
    from math import fabs, log

    from bench.control.flat_matrices import (
        add,
        add_symmetric,
        blank,
        cholesky,
        complement,
        congruence,
        copy,
        form,
        invert,
        multiply,
        multiply_transposed,
        trace,
        transposed_multiply,
    )

_DOUBLINGS = cython.declare(cython.int, 40)
"""Limit on doubling steps: 2^40 steps of the closed loop."""
_CONVERGED = cython.declare(cython.double, 1e-7)
"""Relative change in a doubling step below which a sum has converged: the next one's is about its square."""
_LARGEST = cython.declare(cython.double, 1e9)
"""W above this counts as unbounded."""
_ROUNDING = cython.declare(cython.double, 1e-9)
"""W may be less than Q by this much."""
_BARRIER = cython.declare(cython.double, 1e-5)
"""Weight of the barrier: at the edge, it costs at most thrice as much of log z'Wz."""


@cython.cclass
class GameRiccati:
    """The Riccati equation of one step; after `cost` has returned a cost, the attributes describe its solution.

    Attributes:
        W: (3, 3) cost-to-go.
        costate: (3, 3) W times the closed loop under the worst uncertainty: the costate of a state.
        multiplier: (3, 3) `E^-1 (N1 + N2 K)`, the multiplier of a state; `K = -(B' costate + N2' multiplier) / rho`.
        value: `log z'Wz` with the barrier.
        gradient: (3, 3) derivative of the value: `E = J (I + D)(I + D)' J'` changes it by `2 sum gradient * D`.
    """

    def __init__(self, rho: cython.double) -> None:
        """Set the input weight, R = rho I."""
        self.rho = rho
        self.S_determinant = self.value = 0.0
        if not cython.compiled:
            # Compiled, they are arrays in the object.
            self.W, self.costate, self.multiplier, self.gradient = blank(4)
            self.A, self.H, self.N1, self.BB, self.NB, self.NN = blank(6)
            self.HJ, self.M, self.a, self.g, self.w, self.G, self.A_hat = blank(7)
            self.closed, self.T, self.X, self.step, self.S_inverse = blank(5)
            self.one, self.two, self.three = blank(3)

    @cython.cfunc
    @cython.exceptval(check=False)
    def set_model(
        self,
        A: cython.double[:, ::1],
        B: cython.double[:, ::1],
        H: cython.double[:, ::1],
        N1: cython.double[:, ::1],
        N2: cython.double[:, ::1],
    ) -> cython.void:
        """Take over a model: A, H, N1 (3, 3), B and N2 (3, m)."""
        i: cython.Py_ssize_t
        j: cython.Py_ssize_t
        k: cython.Py_ssize_t
        for i in range(3):
            for j in range(3):
                self.A[3 * i + j], self.H[3 * i + j], self.N1[3 * i + j] = A[i, j], H[i, j], N1[i, j]
                self.BB[3 * i + j] = self.NB[3 * i + j] = self.NN[3 * i + j] = 0.0
                for k in range(B.shape[1]):
                    self.BB[3 * i + j] += B[i, k] * B[j, k]
                    self.NB[3 * i + j] += N2[i, k] * B[j, k]
                    self.NN[3 * i + j] += N2[i, k] * N2[j, k]

    @cython.cfunc
    @cython.exceptval(check=False)
    def cost(self, J: cython.p_double, z: cython.p_double) -> cython.double:
        """Return the cost `z'Wz` (z (3,)) for `E = J J'`, J (3, 3); -1 if E proves no finite cost."""
        if not (self._set_equation(J) and self._double() and self._is_proven()):
            return -1.0
        value: cython.double = form(z, self.W)
        if not value > 0.0:
            return -1.0
        self.value = log(value) - _BARRIER * log(self.S_determinant)
        # The closed loop under the worst uncertainty, (I + G W)^-1 A^, and what the Lagrangian gives along it.
        multiply(self.closed, self.T, self.A_hat)
        multiply(self.costate, self.W, self.closed)
        multiply(self.one, self.NB, self.costate)
        self._subtract_from(self.one, self.N1, self.rho)
        multiply(self.multiplier, self.M, self.one)
        self._set_gradient(J, z, value)
        return value

    @cython.cfunc
    @cython.exceptval(check=False)
    def _set_gradient(self, J: cython.p_double, z: cython.p_double, value: cython.double) -> cython.void:
        """Weigh what H E H' gains against what E^-1 costs, over all states X that the loop runs through."""
        i: cython.Py_ssize_t
        j: cython.Py_ssize_t
        # What W is weighed by in the value: z z' / z'Wz, and in the barrier HJ S^-1 (HJ)'.
        congruence(self.X, self.HJ, self.S_inverse, self.three)
        for i in range(3):
            for j in range(3):
                self.X[3 * i + j] = _BARRIER * self.X[3 * i + j] + z[i] * z[j] / value
        self._accumulate()
        transposed_multiply(self.one, self.HJ, self.costate)
        congruence(self.gradient, self.one, self.X, self.three)
        transposed_multiply(self.one, J, self.multiplier)
        congruence(self.two, self.one, self.X, self.three)
        for i in range(9):
            self.gradient[i] += _BARRIER * self.S_inverse[i] - self.two[i]
        for i in range(3):
            self.gradient[4 * i] -= _BARRIER

    @cython.cfunc
    @cython.exceptval(check=False)
    def _subtract_from(self, out: cython.p_double, a: cython.p_double, factor: cython.double) -> cython.void:
        """Set `out = factor a - out`."""
        i: cython.Py_ssize_t
        for i in range(9):
            out[i] = factor * a[i] - out[i]

    @cython.cfunc
    @cython.exceptval(check=False)
    def _set_equation(self, J: cython.p_double) -> cython.bint:
        """Set A^, G and Q^ (in w); False if E is too small for its inverse."""
        i: cython.Py_ssize_t
        multiply(self.HJ, self.H, J)
        # M = (rho E + N2 N2')^-1
        multiply_transposed(self.one, J, J)
        for i in range(9):
            self.one[i] = self.NN[i] + self.rho * self.one[i]
        if not invert(self.M, self.one) > 0.0:
            return False
        # A^ = A - (N2 B')' M N1 and Q^ = I + rho N1' M N1
        multiply(self.one, self.M, self.N1)
        transposed_multiply(self.A_hat, self.NB, self.one)
        self._subtract_from(self.A_hat, self.A, 1.0)
        transposed_multiply(self.w, self.N1, self.one)
        # G = (B B' - (N2 B')' M N2 B') / rho - H E H'
        multiply(self.one, self.M, self.NB)
        transposed_multiply(self.two, self.NB, self.one)
        multiply_transposed(self.one, self.HJ, self.HJ)
        for i in range(9):
            self.w[i] *= self.rho
            self.G[i] = (self.BB[i] - self.two[i]) / self.rho - self.one[i]
        for i in range(3):
            self.w[4 * i] += 1.0
        return True

    @cython.cfunc
    @cython.exceptval(check=False)
    def _is_proven(self) -> cython.bint:
        """Whether E^-1 - H'WH > 0, in coordinates in which E is the identity, and W >= Q."""
        i: cython.Py_ssize_t
        multiply(self.one, self.W, self.HJ)
        transposed_multiply(self.two, self.HJ, self.one)
        complement(self.one, self.two)
        if not cholesky(self.two, self.one):
            return False
        self.S_determinant = invert(self.S_inverse, self.one)
        copy(self.two, self.W)
        for i in range(3):
            self.two[4 * i] -= 1.0 - _ROUNDING
        return self.S_determinant > 0.0 and cholesky(self.one, self.two)

    @cython.cfunc
    @cython.exceptval(check=False)
    def _double(self) -> cython.bint:
        """Solve for W by doubling the horizon from Q^; False if it does not converge. T is `(I + G W)^-1`."""
        change: cython.double
        doubling: cython.int
        copy(self.a, self.A_hat)
        copy(self.g, self.G)
        for doubling in range(_DOUBLINGS):  # noqa: B007 - typed
            if not self._invert_loop(self.g, self.w):
                return False
            # w + a' w T a
            multiply(self.one, self.T, self.a)
            multiply(self.two, self.w, self.one)
            transposed_multiply(self.step, self.a, self.two)
            change = self._grow()
            if not change >= 0.0:
                return False
            if change < _CONVERGED:
                copy(self.W, self.w)
                return self._invert_loop(self.G, self.W)
            # g + a T g a', and a T a
            multiply(self.two, self.a, self.T)
            multiply(self.three, self.two, self.g)
            multiply_transposed(self.step, self.three, self.a)
            add_symmetric(self.g, self.step)
            multiply(self.three, self.a, self.one)
            copy(self.a, self.three)
        return False

    @cython.cfunc
    @cython.exceptval(check=False)
    def _invert_loop(self, g: cython.p_double, w: cython.p_double) -> cython.bint:
        """Set `T = (I + g w)^-1`; False beyond the point at which the uncertainty makes the cost infinite."""
        i: cython.Py_ssize_t
        multiply(self.three, g, w)
        for i in range(3):
            self.three[4 * i] += 1.0
        return invert(self.T, self.three) > 0.0

    @cython.cfunc
    @cython.exceptval(check=False)
    def _grow(self) -> cython.double:
        """Add the step to w and return its relative size; -1 if w has become too large."""
        i: cython.Py_ssize_t
        change: cython.double = 0.0
        # W is at least Q.
        largest: cython.double = 1.0
        add_symmetric(self.w, self.step)
        for i in range(9):
            change = max(change, fabs(self.step[i]))
            largest = max(largest, fabs(self.w[i]))
        return change / largest if largest < _LARGEST else -1.0

    @cython.cfunc
    @cython.exceptval(check=False)
    def _accumulate(self) -> cython.void:
        """Sum X over all states that the closed loop runs through from there, by doubling."""
        doubling: cython.int
        copy(self.a, self.closed)
        for doubling in range(_DOUBLINGS):  # noqa: B007 - typed
            congruence(self.step, self.a, self.X, self.three)
            add(self.X, self.step, 1.0)
            if trace(self.step) < _CONVERGED * trace(self.X):
                break
            multiply(self.one, self.a, self.a)
            copy(self.a, self.one)
