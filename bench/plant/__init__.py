"""The vehicle FMUs on the bus: sensor frames out, actuator frames in."""
