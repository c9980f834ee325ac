"""The paper's control, section by section: numbers in, numbers out; no clock, no CAN.

Its only file access keeps numba's compiled code up to date with its sources.
"""

from pathlib import Path

from bench.control.stale_code import drop_stale

drop_stale(Path(__file__).parent)
