"""The bench: ECUs on CAN around the vehicle FMU, run by a conductor and recorded to MCAP."""

import sys

from bench.compiled.finder import install

# If asammdf is installed, `import can` would import it, and pandas with it: half a second in every process of a run.
# `bench.record.exchange.formats` imports it when MF4 is needed.
if "can" not in sys.modules:
    sys.modules.setdefault("asammdf", None)  # type: ignore[arg-type]

install()
