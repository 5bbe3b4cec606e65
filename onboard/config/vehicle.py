"""The vehicle file: its sections, and the parsed file."""

from functools import cache, cached_property
from importlib import metadata
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any, Literal, Union
from urllib.parse import parse_qs, urlsplit

import tomli_w
from pydantic import BaseModel, ConfigDict, Field, GetCoreSchemaHandler, GetJsonSchemaHandler, TypeAdapter
from pydantic_core.core_schema import CoreSchema, no_info_plain_validator_function

from drivers.play.player import PlayerConfig
from onboard.config.bases.free_body import FreeBody
from onboard.config.bases.parabola import Parabola
from onboard.config.bases.pivot import Pivot
from onboard.config.bases.table import Body, Planar
from onboard.config.drive import Drive
from onboard.config.driving import Played, player_of
from onboard.config.errors import Origin
from onboard.config.estimation import Estimation
from onboard.config.methods import Prediction
from onboard.config.mission import MissionKeys
from onboard.config.segments import Library
from onboard.config.segments import read as read_segments
from onboard.config.telemetry import Telemetry
from onboard.config.text import read_urdf
from onboard.devices.base import BusDevice, Channels, DeviceSection
from onboard.devices.registry import DEVICES, from_elsewhere
from onboard.devices.roles import STANDARD_GRAVITY_M_S2
from onboard.dynamics.model.bases import BASES, BaseKind
from onboard.section import Positive, Section, Vector3, Vector6

Core = Annotated[int, Field(ge=0, le=1023)]
_ELSEWHERE, BROKEN_BASES = from_elsewhere(
    metadata.entry_points(group="heft.bases"),
    BASES,
    lambda kind: kind.name if isinstance(kind, BaseKind) else None,
    "BaseKind of name",
)
BASES.update(_ELSEWHERE)
UNSTATED_BAUD = 1e9  # bit/s of a line whose URL gives no speed: its transmission time counts as none


@cache
def _sections(only: type[DeviceSection] | None) -> TypeAdapter[DeviceSection]:
    """Reads tables of one kind; None: of every kind, with an error that lists the kinds."""
    which = DEVICES.values() if only is None else [only]
    return TypeAdapter(Annotated[Union[tuple(which)], Field(discriminator="kind")])  # type: ignore[arg-type]  # noqa: UP007


class _OfItsKind:
    """A device's table, by the module of its kind: the others are not imported."""

    @staticmethod
    def section_of(table: Any) -> type[DeviceSection] | None:
        """The class that reads it; None: none does."""
        kind = table.get("kind") if isinstance(table, dict) else getattr(table, "kind", None)
        return DEVICES.get(kind) if isinstance(kind, str) else None

    @classmethod
    def read(cls, table: Any) -> DeviceSection:
        """A table as its section."""
        return _sections(cls.section_of(table)).validate_python(table)

    @classmethod
    def __get_pydantic_core_schema__(cls, source: Any, handler: GetCoreSchemaHandler) -> CoreSchema:
        return no_info_plain_validator_function(cls.read)

    @classmethod
    def __get_pydantic_json_schema__(cls, schema: CoreSchema, handler: GetJsonSchemaHandler) -> dict[str, Any]:
        return handler(_sections(None).core_schema)


if TYPE_CHECKING:
    AnyDevice = DeviceSection
    BaseName = str
else:  # the kinds that the registry finds
    AnyDevice = Annotated[Any, _OfItsKind]
    BaseName = Literal[tuple(BASES)]


class VehicleSection(Section):
    """The vehicle. ``base``: kind of base (motion and wrench known or unknown).

    ``gravity_m_s2``: in base axes; counts on a table, and where the base is fixed: an IMU there tells its direction,
    and has to read as much.
    ``essential``: devices without which a flight has failed: ``heft fly`` ends with 1 if one of them never said a word.
    """

    name: str
    urdf: str
    base: BaseName
    base_link: str
    payload_link: str | None = None
    essential: list[str] = Field(default_factory=list)
    gravity_m_s2: Vector3 = (0.0, 0.0, -STANDARD_GRAVITY_M_S2)

    @property
    def base_kind(self) -> BaseKind:
        """What its base does."""
        return BASES[self.base]


class BusSection(Section):
    """A bus by URL; ``drivers.transports`` lists them."""

    url: str


class LinkSection(Section):
    """A link as it was weighed, balanced and swung, in place of the URDF's values; link axes.

    ``inertia_kg_m2``: XX, XY, YY, XZ, YZ, ZZ about its own centre of mass.
    """

    mass_kg: Positive | None = None
    centre_of_mass_m: Vector3 | None = None
    inertia_kg_m2: Vector6 | None = None
    calibrated: str = ""


class RecordingSection(Section):
    """Recording of flights.

    ``sync_period_ms``: longest time until recorded data are on the medium. ``segment_s``, ``segment_mib``: a log
        continues in a new file after this time or size. ``min_free_mib``: while less is free, the oldest segments of
        earlier flights are removed; 0 keeps them all. ``reserve_mib``: reserved for events and gaps when the disk is
        full. ``resume_s``: a start goes on with a flight that lost its power no longer ago than this; 0 never does.
    """

    directory: str = "flights"
    sync_period_ms: Annotated[float, Field(ge=1, le=60_000)] = 200
    segment_s: Annotated[float, Field(ge=0.1, le=86_400)] = 60
    segment_mib: Annotated[float, Field(ge=0.1, le=1e6)] = 64
    min_free_mib: Annotated[float, Field(ge=0, le=1e9)] = 0
    reserve_mib: Annotated[float, Field(ge=0, le=1e5)] = 16
    resume_s: Annotated[float, Field(ge=0, le=1e7)] = 3600


class Realtime(Section):
    """What is asked of the system for acquisition and recording; a refusal is reported and does not stop a flight.

    ``..._priority``: of SCHED_FIFO, 0 for none. ``..._cpus``: numbers of the cores that it may run on, all where empty.
        ``lock_memory``: their memory is never swapped out. ``freeze_gc``: workers' garbage collectors leave alone what
        was there at the start.
    """

    acquisition_priority: Annotated[int, Field(ge=0, le=99)] = 50
    acquisition_cpus: list[Core] = Field(default_factory=list, max_length=64)
    recording_priority: Annotated[int, Field(ge=0, le=99)] = 0
    recording_cpus: list[Core] = Field(default_factory=list, max_length=64)
    lock_memory: bool = False
    freeze_gc: bool = True


class VehicleFile(Section):
    """A whole vehicle.toml."""

    vehicle: VehicleSection
    bus: dict[str, BusSection] = Field(default_factory=dict)
    device: dict[str, AnyDevice]
    link: dict[str, LinkSection] = Field(default_factory=dict)
    estimation: Estimation = Field(default_factory=Estimation.model_construct)
    free_body: FreeBody | None = None
    planar: Planar | None = None
    pivot: Pivot | None = None
    body: Body | None = None
    parabola: Parabola | None = None
    recording: RecordingSection = Field(default_factory=RecordingSection.model_construct)
    realtime: Realtime = Field(default_factory=Realtime.model_construct)
    telemetry: Telemetry = Field(default_factory=Telemetry.model_construct)
    drive: Drive | None = None
    mission: MissionKeys | None = None


class Vehicle(BaseModel):
    """A parsed vehicle file: its origin, tree and sections.

    ``path``: the file, or the one it replaces; other files are found beside it. ``tree``: as it was written. ``arm``:
    the operator has armed the drives for this flight. It is made by ``model_construct`` from checked
    parts, so that no table is validated twice.
    """

    model_config = ConfigDict(frozen=True, defer_build=True)

    path: Path
    origin: Origin
    tree: dict[str, Any]
    file: VehicleFile
    urdf: Path | None = None  # in place of the one that the file names
    arm: bool = False
    own_motion: Path | None = None  # in place of that of [drive]
    own_segments: Path | None = None  # in place of those of [mission]
    hand_over: Path | None = None  # URDF that the flight writes while its answers are good

    @property
    def text(self) -> str:
        """Of the vehicle file, or of its tables where others were laid over them."""
        return self.origin.text or tomli_w.dumps(self.tree)

    @property
    def label(self) -> str:
        """What messages call it."""
        return self.origin.label

    @cached_property
    def urdf_path(self) -> Path:
        """The URDF beside the vehicle file."""
        return self.path.parent / self.file.vehicle.urdf if self.urdf is None else self.urdf

    @property
    def is_recorded(self) -> bool:
        """Whether each device is a recorded one: the vehicle does not fly."""
        return all(device.kind.startswith("recorded_") for device in self.file.device.values())

    @property
    def prediction(self) -> Prediction:
        """By what its flights are estimated."""
        file = self.file
        if not file.estimation.predicts:
            return Prediction.ROWS
        if file.body is not None:
            return Prediction.BODY
        return Prediction.PARABOLAS if file.parabola is not None else Prediction(file.vehicle.base)

    @property
    def urdf_text(self) -> str:
        """The URDF.

        Raises:
            ConfigError: it cannot be read, or is too long.
        """
        return read_urdf(self.urdf_path)

    @property
    def motion(self) -> Path | None:
        """The motion that drives are to play, beside the vehicle file; None: there is none."""
        if self.own_motion is not None or self.file.drive is None or self.file.drive.motion is None:
            return self.own_motion
        return self.path.parent / self.file.drive.motion

    @property
    def segments_path(self) -> Path | None:
        """The file of segments that the flight may ask for, beside the vehicle file; None: it asks for none."""
        if self.file.mission is None:
            return None
        return self.path.parent / self.file.mission.segments if self.own_segments is None else self.own_segments

    @cached_property
    def segments(self) -> Library | None:
        """The segments that the flight may ask for.

        Raises:
            ConfigError: they cannot be read.
        """
        return None if self.segments_path is None else read_segments(self.segments_path)

    def play(self, bus: str) -> PlayerConfig[Any] | None:
        """What is played on a bus, if it is armed; see :func:`onboard.config.driving.player_of`."""
        drive = self.file.drive
        if drive is None or not drive.armed or not (self.arm or drive.phase is not None):
            return None
        played = Played(self.label, drive, self.file.device, self.motion, self.segments, self.urdf_text)
        return player_of(self, played, bus)

    @property
    def channels(self) -> Channels:
        """Channels of all devices and their records, in the order of the file."""
        return {c: records for name, device in self.file.device.items() for c, records in device.channels(name).items()}

    def devices_on(self, bus: str) -> dict[str, BusDevice]:
        """Devices by name on one bus, in the order of the file."""
        devices = self.file.device.items()
        return {name: device for name, device in devices if isinstance(device, BusDevice) and device.bus == bus}

    @property
    def buses(self) -> list[str]:
        """Names of all buses."""
        return list(self.file.bus)

    def url(self, bus: str) -> str:
        """URL of a bus."""
        return self.file.bus[bus].url

    def baud(self, bus: str) -> float:
        """Of a serial line or a CAN bus, by the file as it was written: a replay has no other, wherever it flew."""
        url = self.tree["bus"][bus]["url"]
        told = parse_qs(urlsplit(url).query)
        return float(next((told[key][0] for key in ("bitrate", "baud") if key in told), UNSTATED_BAUD))

    def rate_hz(self, device: str) -> float:
        """Nominal rate of a device's samples."""
        return self.file.device[device].rate_on(self)

    def with_sections(self, **sections: object) -> "Vehicle":
        """The same vehicle with other sections of its file, by their names; they are not checked again."""
        return self.model_copy(update={"file": self.file.model_copy(update=sections)})

    def with_row_rate(self, rate_Hz: float) -> "Vehicle":
        """The same vehicle with other ticks: a tick's mean has as many more samples, and the same information."""
        return self.with_sections(estimation=self.file.estimation.model_copy(update={"row_rate_hz": rate_Hz}))

    def with_urls(self, urls: dict[str, str]) -> "Vehicle":
        """The same vehicle with other bus URLs."""
        buses = {name: BusSection(url=urls.get(name, bus.url)) for name, bus in self.file.bus.items()}
        return self.with_sections(bus=buses)
