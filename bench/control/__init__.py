"""The paper's control, section by section: numbers in, numbers out; no clock, no CAN."""
