"""docs/devices.md says what the vehicle file's reader knows, and nothing else."""

import tomllib
from pathlib import Path

import pytest

from onboard import config
from onboard.config.devices import CHANNELS
from tests.onboard.device_page import DRIVERS, MIXED, example, meaning, page

PAGE = Path(__file__).parents[2] / "docs" / "devices.md"


def test_the_page_is_as_the_reader_is() -> None:
    assert PAGE.read_text(encoding="utf-8") == page(), f"write it again: python -m tests.onboard.device_page {PAGE}"


def test_every_kind_has_an_example_that_is_flown() -> None:
    devices = tomllib.loads(MIXED.read_text(encoding="utf-8"))["device"]
    for kind, model in config.DEVICES.items():
        name, block = example(kind)
        assert bool(block) is issubclass(model, config.BusDevice)
        if block:
            assert tomllib.loads(block)["device"][name].items() <= devices[name].items()


def test_every_key_says_what_it_is() -> None:
    for kind, model in [*config.DEVICES.items(), *(("node_frame", channel) for channel in CHANNELS.values())]:
        for key in model.model_fields:
            if key != "kind":
                assert len(meaning(model, kind, key)) > 8, (kind, key)


@pytest.mark.parametrize("kind", sorted(DRIVERS))
def test_every_value_of_a_driver_can_be_set_or_is_known(kind: str) -> None:
    """A driver's configuration that grows a value shows here: make it a key, or name it."""
    told_otherwise = {
        "name",  # the device's
        "baud",  # stands in the bus URL
        "channels",  # [[device.NAME.channel]]
        "position",  # the device's name
        "sync_name",  # NAME_sync
    }
    for driver in DRIVERS[kind]:
        missing = set(driver.__dataclass_fields__) - set(config.DEVICES[kind].model_fields)
        assert missing <= told_otherwise
