"""What the buses and processes are called, and how a node's name tells its vehicle."""

CONDUCTOR = "conductor"
"""Name of the process that owns the clock and records."""

PLANT = "plant"
"""Name of the process that all vehicles' FMUs run in."""

V2V = "v2v"
"""Name of the radio between the vehicles; vehicle i's own bus is `veh<i>`."""


def vehicle_bus(vehicle: int) -> str:
    """Name of vehicle `vehicle`'s own bus (vehicles count from 1)."""
    return f"veh{vehicle}"


def vehicle_of(name: str) -> int | None:
    """Number of the vehicle whose bus or process `name` is (veh3, veh3.planner), None where it is no vehicle's."""
    number = name.partition(".")[0].removeprefix("veh")
    return int(number) if name.startswith("veh") and number.isdecimal() else None
