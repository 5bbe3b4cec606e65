"""The pages of devices have what the vehicle file's reader knows, and nothing else."""

import dataclasses
import tomllib
from pathlib import Path

import pytest

from onboard.devices.base import BusDevice
from onboard.devices.registry import DEVICES
from onboard.devices.serial_line.node_channels import CHANNELS
from tests.onboard.device_page import example, flown_devices, meaning, pages

PAGE = Path(__file__).parents[2] / "docs" / "devices.md"


def test_the_pages_are_as_the_reader_is() -> None:
    written = {path.name: path.read_text(encoding="utf-8") for path in PAGE.parent.glob("devices*.md")}
    assert written == pages(), f"write them again: python -m tests.onboard.device_page {PAGE}"


def test_every_kind_has_an_example_that_is_flown() -> None:
    devices = flown_devices()
    for kind, model in DEVICES.items():
        name, block = example(kind)
        assert bool(block) is issubclass(model, BusDevice)
        if block:
            assert tomllib.loads(block)["device"][name].items() <= devices[name].items()


def test_every_key_says_what_it_is() -> None:
    for kind, model in [*DEVICES.items(), *(("node_frame", channel) for channel in CHANNELS.values())]:
        for key in model.model_fields:
            if key != "kind":
                assert len(meaning(model, key)) > 8, (kind, key)


CONFIGURED = [kind for kind, model in DEVICES.items() if issubclass(model, BusDevice) and model.driver_configs]


def test_drivers_have_configurations() -> None:
    assert len(CONFIGURED) >= 13


@pytest.mark.parametrize("kind", CONFIGURED)
def test_every_value_of_a_driver_can_be_set_or_is_known(kind: str) -> None:
    """A driver's configuration that grows a value shows here: make it a key, or name it."""
    told_otherwise = {
        "name",  # the device's
        "baud",  # stands in the bus URL
        "channels",  # [[device.NAME.channel]]
        "position",  # the device's name
        "status",  # NAME_status
        "sync_name",  # NAME_sync
    }
    if kind in ("reaction_wheel", "thruster"):  # rad/s, N, on every SYNC
        told_otherwise |= {"counter_subindex", "synchronous", "unit"}
    if kind in ("hx711", "nau7802"):  # by the cell's rated output
        told_otherwise |= {"scale"}
    if kind in ("net_ft", "onrobot_hex"):  # by the kind
        told_otherwise |= {"set_up", "errors"}
    if kind == "bmi088_spi":  # by the select lines
        told_otherwise |= {"address", "gyro_address"}
    model = DEVICES[kind]
    assert issubclass(model, BusDevice)
    for driver in model.driver_configs:
        missing = {field.name for field in dataclasses.fields(driver)} - set(model.model_fields)
        assert missing <= told_otherwise
