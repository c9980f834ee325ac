"""The paper's control, section by section: numbers in, numbers out; no clock, no CAN.

The only thing that it does with files is to keep numba's compiled code in step with its sources.
"""

from pathlib import Path

from bench.control.stale_code import drop_stale

drop_stale(Path(__file__).parent)
