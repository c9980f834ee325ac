"""The wheels in the paper's order, the only one there is: 1 front left, 2 rear left, 3 rear right, 4 front right.

No dependencies, so that a controller may know the order without the model.
"""

from typing import NamedTuple


class Wheel(NamedTuple):
    """One wheel.

    Attributes:
        name: what its variables end with.
        label: its name in words.
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
"""The places of the wheels in whatever has a value for each."""
