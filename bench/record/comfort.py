"""The acceleration that the occupants of a vehicle feel, as the standards of comfort take it, from the ground truth.

Accelerations are those of the centre of mass in the vehicle's axes (ISO 8855), as the FMU gives them:
a_x = dv_x/dt - gamma v_y, a_y = dv_y/dt + gamma v_x. The seat is taken as fixed there; the road's slope and the roll
angle add nothing.
"""

from __future__ import annotations

import numpy as np
import numpy.typing as npt

from bench.control.comfort import JERK_WINDOW_S
from bench.cycle import CYCLE_S
from bench.mcap.time_span import NS
from bench.record.columns import Columns
from bench.record.weighting import weighted

Array = npt.NDArray[np.float64]


# A log can be of anybody.
@np.errstate(invalid="ignore", over="ignore")
def felt(truth: Columns, where: str) -> Columns:
    """Return what is felt in a vehicle over time; see `Run.comfort`.

    Args:
        truth: ground truth of a vehicle.
        where: what to call the result in an error message.

    Raises:
        BadInput: the ground truth has no accelerations.
    """
    rows = in_order(truth)
    a_x, a_y = rows["a_x"], rows["a_y"]
    return Columns(
        where,
        {
            "t": rows["t"],
            "a_x": a_x,
            "a_y": a_y,
            "jerk_x": mean_jerk(rows.time_ns, a_x),
            "jerk_y": mean_jerk(rows.time_ns, a_y),
            # Rows that a damaged log lacks are left out.
            "weighted_x": weighted(a_x, CYCLE_S),
            "weighted_y": weighted(a_y, CYCLE_S),
        },
    )


def in_order(truth: Columns) -> Columns:
    """Return ground truth in the order of time, one row for each time: a damaged log may have some twice."""
    return truth.select(np.unique(truth.time_ns, return_index=True)[1])


def mean_jerk(time_ns: npt.NDArray[np.int64], acceleration: Array) -> Array:
    """Return the jerk averaged over the last 0.5 s, (n,) m/s^3: (a(t) - a(t - 0.5 s)) / 0.5 s (ISO 11270).

    NaN where there is no value 0.5 s before.

    Args:
        time_ns: (n,) times, ascending, ns.
        acceleration: (n,) m/s^2.
    """
    begin = time_ns - round(JERK_WINDOW_S * NS)
    before = np.searchsorted(time_ns, begin)
    known = time_ns[before] == begin
    jerk: Array = np.where(known, (acceleration - acceleration[before]) / JERK_WINDOW_S, np.nan)
    return jerk
