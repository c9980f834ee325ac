"""The vehicle: its 8-DOF dynamics and the FMU built from them."""
