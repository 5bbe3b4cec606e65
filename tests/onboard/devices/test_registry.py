"""Kinds of devices are found in their modules and by entry points; what cannot be used is kept with the reason."""

import inspect
import sys
from importlib.metadata import EntryPoint
from pathlib import Path

import pytest

from onboard import config
from onboard.config import loader
from onboard.devices import net_ft, recorded, registry, ur_rtde
from onboard.devices.base import BusDevice, DeviceSection
from onboard.devices.can import canopen
from onboard.devices.registry import DEVICES, GROUP, from_elsewhere, kind_of

VANE = """
from typing import Literal
from onboard.devices.recorded import RecordedDevice, SCALAR

class Vane(RecordedDevice):
    records = SCALAR
    kind: Literal["wind_vane"]
"""


@pytest.fixture
def modules(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    monkeypatch.syspath_prepend(str(tmp_path))
    yield tmp_path
    for path in tmp_path.glob("*.py"):
        sys.modules.pop(path.stem, None)


def point(kind: str, value: str) -> EntryPoint:
    return EntryPoint(kind, value, GROUP)


def test_every_kind_stands_in_a_module_of_its_name_but_for_those_of_one_family() -> None:
    families = {"canopen_sync": canopen, **{kind: recorded for kind in DEVICES if kind.startswith("recorded_")}}
    families |= {"onrobot_hex": net_ft, **{kind: ur_rtde for kind in DEVICES if kind.startswith("ur_")}}
    assert len(DEVICES) >= 19
    for kind, section in DEVICES.items():
        assert section.__module__.startswith("onboard.devices.")
        module = section.__module__.removeprefix("onboard.devices.").rpartition(".")[2]
        assert module == (families[kind].__name__.rpartition(".")[2] if kind in families else kind)
        assert kind_of(section) == kind


def test_bases_are_no_kinds() -> None:
    for base in (DeviceSection, BusDevice, canopen.CanopenNodeDevice, recorded.RecordedDevice):
        assert kind_of(base) is None
    assert kind_of("nimu") is None
    assert kind_of(int) is None


def test_a_kind_of_another_package_is_found(modules: Path) -> None:
    (modules / "vanes.py").write_text(VANE)
    found, broken = from_elsewhere([point("wind_vane", "vanes:Vane")], DEVICES)
    assert broken == {}
    assert [(kind, section.__name__) for kind, section in found.items()] == [("wind_vane", "Vane")]


@pytest.mark.parametrize(
    ("kind", "value", "why"),
    [
        (
            "wind_vane",
            "no_such_module:Vane",
            "cannot be imported (ModuleNotFoundError: No module named",
        ),
        ("wind_vane", "faulty_vanes:Vane", "cannot be imported (ZeroDivisionError: division by zero)"),
        ("wind_vane", "good_vanes:Wane", "cannot be imported (AttributeError"),
        ("wind_cock", "good_vanes:Vane", 'is no DeviceSection with kind: Literal["wind_cock"]'),
        ("wind_vane", "good_vanes:SCALAR", "is no DeviceSection"),
        ("wind_vane", "good_vanes:RecordedDevice", "is no DeviceSection"),
        ("mpu6050", "good_vanes:Vane", "has the name of a kind that there is already"),
    ],
)
def test_what_cannot_be_used_is_named_with_the_remedy(modules: Path, kind: str, value: str, why: str) -> None:
    (modules / "good_vanes.py").write_text(VANE)
    (modules / "faulty_vanes.py").write_text("1 / 0")
    found, broken = from_elsewhere([point(kind, value)], DEVICES)
    assert found == {}
    assert why in broken[kind]
    assert value in broken[kind]


def test_two_packages_with_one_kind_do_not_hide_each_other(modules: Path) -> None:
    (modules / "vanes.py").write_text(VANE)
    found, broken = from_elsewhere([point("wind_vane", "vanes:Vane"), point("wind_vane", "others:Vane")], DEVICES)
    assert list(found) == ["wind_vane"]
    assert "others:Vane" in broken["wind_vane"]


def test_a_vehicle_with_a_broken_kind_is_refused_and_any_other_flies(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setitem(loader.BROKEN, "wind_vane", "vanes:Vane of vanes cannot be imported: mend it")
    path = config.packaged("rocksat")
    text = path.read_text()
    config.parse(text, path)
    text += '\n[device.vane]\nperiod_ms = 10\nkind = "wind_vane"\n'
    with pytest.raises(config.ConfigError) as caught:
        config.parse(text, path)
    line = len(text.splitlines())
    assert str(caught.value) == f"{path}:{line}: 'device.vane': kind 'wind_vane': {loader.BROKEN['wind_vane']}"


def test_no_shared_module_of_the_flight_app_names_a_kind() -> None:
    """A new kind touches nothing shared: no other module may know one by its class."""
    root = Path(inspect.getfile(registry)).parents[1]
    classes = {section.__name__ for section in DEVICES.values()}
    assert len(classes) == len(DEVICES)
    for path in root.rglob("*.py"):
        if root / "devices" not in path.parents:
            text = path.read_text(encoding="utf-8")
            assert [name for name in classes if name in text] == [], path
