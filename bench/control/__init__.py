"""The paper's control, section by section: pure numpy, no I/O, no clock, no CAN."""
