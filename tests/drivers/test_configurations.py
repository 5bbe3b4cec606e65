"""Configurations that a device cannot have are refused, with the remedy."""

import math
from functools import partial

import pytest

from drivers.bota_ft import BotaFtConfig
from drivers.canopen_pdo import CanopenBus, Cia404Config, Cia406Config, SyncConfig
from drivers.dsc_load_cell import DscLoadCellConfig
from drivers.dynamixel import DynamixelConfig
from drivers.errors import ConfigurationError
from drivers.hx711 import Hx711Config
from drivers.i2c.as5048 import As5048Config
from drivers.i2c.as5600 import As5600Config
from drivers.i2c.nau7802 import Nau7802Config
from drivers.inertial.bmi088 import Bmi088Config
from drivers.inertial.icm20948 import Icm20948Config
from drivers.modbus_load_cell import ModbusLoadCell, ModbusLoadCellConfig
from drivers.mpu6050 import Mpu6050Config
from drivers.net_ft import NetFt, NetFtChannel, NetFtConfig
from drivers.nimu import Nimu, NimuConfig
from drivers.node_frame import NodeFrameConfig
from drivers.odrive import OdriveAxis
from drivers.qsb import QsbConfig
from drivers.robotous_rft import RftConfig
from drivers.sync_pulse import PulseGeneratorConfig
from drivers.ur_rtde import RtdeConfig
from tests.drivers.serial_script import ScriptedSerial

WRONG = {
    As5048Config: [{"counts_per_revolution": 0}, {"sample_period_ms": 0.0}],
    As5600Config: [{"slow_filter": 3}, {"counts_per_revolution": 0}, {"sample_period_ms": 0.0}],
    Bmi088Config: [
        *({"address": 0x68}, {"gyro_address": 0x18}, {"accel_range_g": 4}, {"gyro_range_deg_s": 300}),
        *({"filter_code": 4}, {"sample_period_ms": 0.0}),
    ],
    BotaFtConfig: [{"rate_hz": hz} for hz in (0.0, -100.0, 24.9, 51_200 / 63, 51_200 / 2049, 300.0, math.nan)],
    DscLoadCellConfig: [
        *({"station": 0}, {"station": 1000}, {"command": "sout"}, {"command": "TOOLONG"}, {"unit": "kilogramm"}),
        {"timeout_ms": 49.0},
    ],
    Hx711Config: [{"sample_rate_hz": 40}, {"amplifier": 1}, {"poll_period_ms": 7.0}, {"poll_period_ms": 0.05}],
    Icm20948Config: [
        *({"address": 0x6A}, {"sample_rate_hz": 1000.0}, {"accel_range_g": 3}, {"gyro_range_deg_s": 300}),
        *({"filter_code": 7}, {"poll_period_ms": 33.0}, {"max_transfer_bytes": 13}),
    ],
    ModbusLoadCellConfig: [
        *({"address": 0}, {"address": 248}, {"values": ()}, {"values": ("gross", "gross")}, {"values": ("peak",)}),
        *({"scale": 1.0}, {"unit": "N"}, {"scale": 1.0, "unit": "kilogramm"}, {"sign": "bcd"}, {"baud": 0}),
    ],
    Mpu6050Config: [
        *({"address": 0x6A}, {"accel_range_g": 3}, {"gyro_range_deg_s": 300}, {"filter_code": 7}, {"filter_code": -1}),
        *({"sample_rate_hz": hz} for hz in (300, 2, 0)),
        *({"poll_period_ms": ms} for ms in (37.0, 0.0, math.nan)),
        *({"max_transfer_bytes": 13}, {"max_transfer_bytes": 8193}),
    ],
    Nau7802Config: [{"sample_rate_hz": 100}, {"amplifier": 3}, {"supply_V": 5.0}, {"poll_period_ms": 7}],
    NetFtConfig: [{"rate_hz": hz} for hz in (0.5, 8001.0, math.nan)],
    NimuConfig: [
        *({"accel_range_g": 0.0}, {"gyro_scale_deg_s": -1.0}, {"magnetometer_scale_gauss": 0.0}),
        {"checksum_span": "all"},
    ],
    NodeFrameConfig: [{"channels": ()}, {"channels": ("a", "a")}, {"channels": ("a",), "node": 256}],
    PulseGeneratorConfig: [{"sync_period_ms": 1.0}, {"width_ms": 0.0}, {"width_ms": 5.0}],
    QsbConfig: [
        *({"counts_per_revolution": 0}, {"counting": 3}, {"interval_ticks": 0}, {"interval_ticks": 0xFFFF}),
        *({"tick_jitter": -1}, {"reply_timeout_ms": 0.0}, {"sync_edge": "both"}),
    ],
    RftConfig: [{"rate_hz": hz} for hz in (0.0, -100.0, 300.0, 2000.0, math.nan)],
    RtdeConfig: [{"rate_hz": 0.5}, {"rate_hz": 501.0}],
    partial(DynamixelConfig, "a"): [{"id": 253}, {"id": -1}, {"counts_per_revolution": 0}, {"ampere_per_count": 0.0}],
    partial(OdriveAxis, "knee"): [
        *({"node": 64}, {"node": -1}, {"counts_per_revolution": 0}, {"rate_hz": 0.5}, {"rate_hz": 1001.0}),
    ],
}


@pytest.mark.parametrize(
    ("config", "wrong"), [(config, one) for config, many in WRONG.items() for one in many], ids=str
)
def test_what_a_device_has_not_is_refused_by_its_name_or_with_the_remedy(config, wrong):
    with pytest.raises(ConfigurationError, match="|".join([*wrong, ": "])):
        config(**wrong)


@pytest.mark.parametrize(
    "make",
    [
        lambda: Cia404Config("x", 3, 0.0),
        lambda: Cia404Config("x", 3, math.nan),
        lambda: Cia406Config("x", 3, 0),
        lambda: CanopenBus(None, [Cia406Config("x", 0, 1)], SyncConfig()),
        lambda: CanopenBus(None, [Cia406Config("x", 128, 1)], SyncConfig()),
        lambda: CanopenBus(None, [Cia406Config("x", 1, 1), Cia406Config("x", 2, 1)], SyncConfig()),
        lambda: CanopenBus(None, [Cia406Config("can_sync", 1, 1)], SyncConfig()),
    ],
)
def test_nodes_that_cannot_be_are_refused(make):
    with pytest.raises(ConfigurationError, match=":"):
        make()


@pytest.mark.parametrize("wrong", [{"poll_period_ms": -1.0}, {"silence_ms": 0.0}])
def test_times_of_a_stream_that_cannot_be_are_refused(clock, wrong):
    with pytest.raises(ConfigurationError, match="poll_period_ms is 0 or more"):
        Nimu("imu", ScriptedSerial().open, clock, NimuConfig(**wrong))


@pytest.mark.parametrize("wrong", [{"timeout_ms": 0.0}, {"sample_period_ms": -1.0}])
def test_times_of_a_poll_that_cannot_be_are_refused(clock, wrong):
    with pytest.raises(ConfigurationError):
        ModbusLoadCell("cell", ScriptedSerial().open, clock, ModbusLoadCellConfig(**wrong))


@pytest.mark.parametrize("channels", [(), (NetFtChannel("fx", 0, 1.0, "N"),) * 2])
def test_channels_of_a_stream_need_different_names(clock, channels):
    with pytest.raises(ConfigurationError, match="channels"):
        NetFt("wrist", channels, ScriptedSerial().open, clock)
