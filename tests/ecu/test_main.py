"""An ECU in a process of its own."""

import pytest

from bench.bus.link.address import Address
from bench.bus.network import EcuSlot
from bench.ecu.loading import DEFAULT_ECUS
from bench.ecu.main import serve_ecu
from bench.errors import BadInput
from bench.scenario import load


def test_a_vehicle_that_is_not_there_is_refused() -> None:
    with pytest.raises(BadInput, match="--vehicle 4: the scenario formation has vehicles 1 to 3"):
        serve_ecu(None, DEFAULT_ECUS["tracker"], EcuSlot("tracker", 4), load("formation"), Address.parse("udp:61000"))
