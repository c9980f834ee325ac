"""The wheels in the paper's order, used everywhere: 1 front left, 2 rear left, 3 rear right, 4 front right.

No dependencies, so that a controller may know the order without the model.
"""

from typing import NamedTuple


class Wheel(NamedTuple):
    """One wheel.

    Attributes:
        name: suffix of its variables.
        label: its name for display.
        side: +1 left, -1 right.
        front: whether it is on the front axle, which steers.
    """

    name: str
    label: str
    side: int
    front: bool


WHEELS = (
    Wheel("fl", "front left", +1, True),
    Wheel("rl", "rear left", +1, False),
    Wheel("rr", "rear right", -1, False),
    Wheel("fr", "front right", -1, True),
)

WHEEL_NAMES = tuple(wheel.name for wheel in WHEELS)

FL, RL, RR, FR = range(len(WHEELS))
"""The wheels' indices in arrays with a value per wheel."""
