"""The frequency weighting W_d of ISO 2631-1, for horizontal vibration at the seat, from its transfer functions.

Annex A of the standard has it as a product: band limitation by two Butterworth filters of order 2, then the transition
from acceleration to velocity; for W_d the upward step is 1. The product is applied in the frequency domain, where no
discretisation bends it: the gain is the standard's at every frequency below half the sampling rate, 50 Hz for a log,
where W_d has fallen to 4 % of its maximum.
"""

from __future__ import annotations

import math

import numpy as np
import numpy.typing as npt

Array = npt.NDArray[np.float64]

# Table A.1, in Hz: corners of high pass and low pass, then of the transition, with its Q.
HIGH_PASS_HZ, LOW_PASS_HZ = 0.4, 100.0
TRANSITION_HZ, TRANSITION_Q = 2.0, 0.63

SETTLED_S = 10.0
"""Zeros after the signal, s: what is left of its response by then, below 1e-7, is what reaches its beginning."""


def response(frequency_hz: npt.ArrayLike) -> npt.NDArray[np.complex128]:
    """Return W_d, complex, at frequencies (n,) in Hz."""
    # s over 2 pi: all corners are in Hz.
    p: npt.NDArray[np.complex128] = 1j * np.asarray(frequency_hz, np.complex128)
    high = p**2 / (p**2 + math.sqrt(2.0) * HIGH_PASS_HZ * p + HIGH_PASS_HZ**2)
    low = LOW_PASS_HZ**2 / (p**2 + math.sqrt(2.0) * LOW_PASS_HZ * p + LOW_PASS_HZ**2)
    x = p / TRANSITION_HZ
    product: npt.NDArray[np.complex128] = high * low * (1.0 + x) / (1.0 + x / TRANSITION_Q + x**2)
    return product


def weighted(acceleration: Array, step_s: float) -> Array:
    """Return an acceleration (n,) m/s^2, sampled every `step_s`, weighted with W_d, (n,) m/s^2; it was 0 before."""
    n = len(acceleration)
    padded = n + round(SETTLED_S / step_s)
    spectrum = np.fft.rfft(acceleration, padded) * response(np.fft.rfftfreq(padded, step_s))
    values: Array = np.fft.irfft(spectrum, padded)[:n]
    return values
