"""Names of buses and processes, and the vehicle of a node's name."""

CONDUCTOR = "conductor"
"""Name of the process that owns the clock and writes the log."""

PLANT = "plant"
"""Name of the process that runs all vehicles' FMUs."""

ACTUATORS = "actuators"
"""The actuators of a vehicle, as in `veh3.actuators`: they have a state, and are part of the plant."""

V2V = "v2v"
"""Name of the radio between the vehicles; vehicle i's own bus is `veh<i>`."""


def vehicle_bus(vehicle: int) -> str:
    """Name of vehicle `vehicle`'s own bus (vehicles count from 1)."""
    return f"veh{vehicle}"


def vehicle_of(name: str) -> int | None:
    """Number of the vehicle of a bus or process (veh3, veh3.planner), None if it belongs to no vehicle."""
    number = name.partition(".")[0].removeprefix("veh")
    # A log of another origin may have names of any length.
    return int(number) if name.startswith("veh") and number.isdecimal() and len(number) < 10 else None
