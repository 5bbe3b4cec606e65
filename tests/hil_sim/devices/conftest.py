from contextlib import ExitStack

import pytest
from smbus2 import SMBus

from hil_sim.buses.i2c_dev import install_i2c
from tests.hil_sim.devices.circuitpython_i2c import SmbusI2c


@pytest.fixture
def on_bus():
    """Puts a twin on an I2C bus by this clock; all are taken away afterwards."""
    with ExitStack() as stack:

        def make(twin, clock) -> SmbusI2c:
            stack.callback(install_i2c("/dev/i2c-1", [twin], clock).uninstall)
            bus = SMBus(1)
            stack.callback(bus.close)
            return SmbusI2c(bus)

        yield make
