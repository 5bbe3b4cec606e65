"""A whole vehicle file: its sections, and the file as it was read."""

from functools import cached_property
from pathlib import Path
from typing import Literal

from pydantic import BaseModel, ConfigDict, Field

from onboard.config.devices import BusDevice, Device, RecordedDevice
from onboard.config.estimation import Estimation
from onboard.config.free_body import FreeBody
from onboard.config.types import Positive, Section


class VehicleSection(Section):
    """What flies. ``base``: what is known of the base's motion and of the wrench on it."""

    name: str
    urdf: str
    base: Literal["free", "prescribed", "fixed"]
    base_link: str
    payload_link: str | None = None


class Bus(Section):
    """A bus by URL; ``drivers.transports`` says which there are."""

    url: str


class Recording(Section):
    """Where flights go."""

    directory: str = "flights"
    sync_period_ms: Positive = 200


class VehicleFile(Section):
    """A whole vehicle.toml."""

    vehicle: VehicleSection
    bus: dict[str, Bus] = Field(default_factory=dict)
    device: dict[str, Device]
    estimation: Estimation = Estimation()
    free_body: FreeBody | None = None
    recording: Recording = Recording()


class Vehicle(BaseModel):
    """A vehicle file that has been read: its text, its directory, its objects."""

    model_config = ConfigDict(frozen=True)

    path: Path
    text: str
    file: VehicleFile

    @cached_property
    def urdf_path(self) -> Path:
        """The URDF beside the vehicle file."""
        return self.path.parent / self.file.vehicle.urdf

    def devices_on(self, bus: str) -> dict[str, BusDevice]:
        """Devices by channel name on one bus, in the order of the file."""
        return {
            name: device
            for name, device in self.file.device.items()
            if not isinstance(device, RecordedDevice) and device.bus == bus
        }

    def with_urls(self, urls: dict[str, str]) -> "Vehicle":
        """The same vehicle with other bus URLs."""
        buses = {name: Bus(url=urls.get(name, bus.url)) for name, bus in self.file.bus.items()}
        return self.model_copy(update={"file": self.file.model_copy(update={"bus": buses})})
