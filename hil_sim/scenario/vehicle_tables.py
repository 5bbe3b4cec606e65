"""Tables of the scenario of any vehicle, made from its vehicle.toml and URDF.

What stands here is what a scenario file may say over the defaults; ``hil_sim.devices.vehicle_file`` adds sensors,
clocks, buses and devices.
"""
# ruff: noqa: N815 - field names are the file's keys, and a key ends in its SI symbol

from math import isclose
from typing import Annotated, Any, Literal

from pydantic import Field, PositiveFloat, PositiveInt, PrivateAttr, model_validator

from hil_sim.scenario.bus_tables import BusTable, DeviceTable
from hil_sim.scenario.parabolic_tables import Parabolas
from hil_sim.scenario.part_tables import AirTable, ConingTable, DragTable, ServoTable, StopTable, Vibration
from hil_sim.scenario.sensor_tables import ClockTable, Fraction, NonNegative, SensorTable, Table, Vector
from hil_sim.scenario.tables import Files, ScenarioHeader

PhaseCode = Annotated[int, Field(ge=0, le=255)]


class VehicleTable(Table):
    """``[vehicle]``: taken from the vehicle file; ``urdf`` is the text of the drawing, ``label`` its name."""

    urdf: str
    label: str
    base: Literal["free", "prescribed", "fixed", "planar", "pivot"]
    base_link: str
    payload_link: str | None = None


class WorldPhysics(Table):
    """``[physics]``: steps of the sensors' grid, how many the integration takes at a time, and how many are released.

    ``gravity_m_s2``: in the axes of the world, which are the base's at the start; a free base falls with it.
    """

    step_us: PositiveInt = 500
    integration_steps: PositiveInt = 8
    chunk_steps: PositiveInt = 40
    gravity_m_s2: Vector = (0.0, 0.0, 0.0)


class Tolerance(Table):
    """``[as_built.LINK]``, ``[as_built.default]``: standard deviations about the drawing; inertia of half its trace.

    ``density_relative``: of mass and inertia together, of material and thickness; ``mass_relative`` of the mass alone.

    ``place_mm``: of the link's frame in the link before it, each coordinate; of an IMU's frame too.

    What is surely not as drawn: ``mass_factor`` (of mass and inertia), ``inertia_factor`` (of this besides),
    ``centre_off_mm``; the deviations are about that.
    """

    mass_relative: NonNegative = 0.01
    centre_mm: NonNegative = 1.0
    inertia_relative: NonNegative = 0.01
    density_relative: NonNegative = 0.0
    place_mm: NonNegative = 0.0
    mass_factor: PositiveFloat = 1.0
    inertia_factor: PositiveFloat = 1.0
    centre_off_mm: Vector = (0.0, 0.0, 0.0)


class LetGo(Table):
    """``[release]``: motion of a free or planar base at the start; each component within +- these, but for ``spin``.

    ``spin_rad_s``: of a spinning body, added to the rate drawn, in base axes.
    """

    rate_rad_s: NonNegative = 0.05
    velocity_m_s: NonNegative = 0.01
    spin_rad_s: Vector = (0.0, 0.0, 0.0)


class PayloadTable(Table):
    """``[payload]``: a solid box in the frame of the payload link. What is not given is drawn by seed.

    ``mass_kg``: two equal numbers are that mass. ``density_kg_m3`` gives the box its size where ``size_mm`` does not.
    """

    mass_kg: tuple[PositiveFloat, PositiveFloat]
    density_kg_m3: PositiveFloat = 1000.0
    size_mm: Vector | None = None
    centre_of_mass_mm: Vector | None = None
    roll_pitch_yaw_deg: Vector | None = None


class CaptureWindow(Table):
    """``[capture]``: when the payload is caught; without it, it is held from the start. Sigmas of its relative motion.

    ``phase``: at the start of the first step with this phase, and not in the window.

    ``contact_Hz``: the grip holds the payload by a spring first, on which it swings against the gripper at a frequency
    drawn between these; the grip closes when that has settled. Without it the grip closes at once.
    """

    earliest_s: NonNegative = 0.0
    latest_s: NonNegative = 0.0
    phase: PhaseCode | None = None
    velocity_sigma_m_s: NonNegative = 0.005
    rate_sigma_rad_s: NonNegative = 0.01
    contact_Hz: tuple[PositiveFloat, PositiveFloat] | None = None
    contact_damping_ratio: PositiveFloat = 0.5


class EjectionTable(Table):
    """``[ejection]``: the payload is let go at the start of the first step with ``phase``, if any, or at ``at_s``.

    ``velocity_m_s``: of the payload against the gripper afterwards, axes of the payload link. ``duration_ms``: of the
    spring that gives it this velocity, by a half-sine of force on the link from the start of the ejection on, when the
    payload is off already; joints with servos feel it. Without, it happens at once.
    """

    phase: PhaseCode | None = None
    at_s: NonNegative | None = None
    velocity_m_s: Vector = (0.0, 0.0, 0.0)
    duration_ms: PositiveFloat | None = None

    @model_validator(mode="after")
    def _one_of_two(self) -> "EjectionTable":
        if (self.phase is None) == (self.at_s is None):
            raise ValueError("give either phase or at_s")
        return self


class LostPartTable(Table):
    """``[lost_part]``: a part of the payload comes off, as if it had lain in a point, and takes its momentum along.

    ``centre_m``: where it was, in the payload link. A negative ``mass_kg``: it is added, and moves with the payload.
    """

    at_s: NonNegative
    mass_kg: float
    centre_m: Vector = (0.0, 0.0, 0.0)


class SequenceStep(Table):
    """``[[sequence]]``: the arm keeps its posture (``hold``), or every joint swings about it (``swing``).

    ``sweep``: the joints named in ``rates`` go out and back ``strokes`` times, at that speed (rad/s or m/s, the sign is
    the way out), which they reach within ``ramp_s``, or a quarter of a stroke.

    ``strokes``: the joints named in ``amplitude`` (rad or m) go from side to side by minimum-jerk strokes of
    ``stroke_s``, each followed by ``pause_s``; to the first side and back from the last within ``transfer_s``.

    ``push``: the joints named in ``to`` (rad or m off the posture) are commanded there within ``approach_s``, stay for
    ``hold_s``, and come back within ``retreat_s``: what a servo does that runs into a stop. The ``duration_s`` of these
    two is the sum of their parts.

    ``asked``: it keeps its posture, and plays the segments of ``motion.segments`` that the flight computer asks for.
    ``swing``: rms amplitude of a joint, of the way to its nearer end (a third of a radian at most of one that turns
    freely or far); the motion grows from rest and dies down within ``ramp_s``.
    """

    phase: PhaseCode
    action: Literal["hold", "swing", "sweep", "strokes", "push", "asked"]
    duration_s: PositiveFloat
    ramp_s: PositiveFloat = 2.0
    swing: Fraction = 0.35
    tones: PositiveInt = 3
    band_Hz: tuple[PositiveFloat, PositiveFloat] = (0.1, 0.6)
    rates: dict[str, float] = Field(default_factory=dict)
    strokes: PositiveInt = 1
    amplitude: dict[str, float] = Field(default_factory=dict)
    stroke_s: PositiveFloat = 1.0
    pause_s: NonNegative = 0.0
    transfer_s: PositiveFloat = 1.0
    to: dict[str, float] = Field(default_factory=dict)
    approach_s: PositiveFloat = 1.5
    hold_s: PositiveFloat = 0.5
    retreat_s: PositiveFloat = 1.0

    @model_validator(mode="before")
    @classmethod
    def _of_its_parts(cls, table: Any) -> Any:
        """The duration of strokes and pushes."""
        if not isinstance(table, dict):
            return table
        own = {name: table.get(name, field.default) for name, field in cls.model_fields.items()}
        try:
            sums = {
                "strokes": 2.0 * own["transfer_s"] + own["strokes"] * (own["stroke_s"] + own["pause_s"]),
                "push": own["approach_s"] + own["hold_s"] + own["retreat_s"],
            }
        except TypeError:  # reported by the field itself
            return table
        found = sums.get(str(table.get("action")))
        if found is None:
            return table
        if not isclose(table.get("duration_s", found), found):
            raise ValueError(f"its parts last {found:g} s together: leave duration_s out")
        return {**table, "duration_s": round(found, 9)}

    @model_validator(mode="after")
    def _ramps_fit(self) -> "SequenceStep":
        for action, named in {"strokes": self.amplitude, "push": self.to}.items():
            if (self.action == action) != bool(named):
                key = "amplitude" if action == "strokes" else "to"
                raise ValueError(f'{key} and action = "{action}" need each other')
        if (self.action == "sweep") != bool(self.rates):
            raise ValueError('rates and action = "sweep" need each other')
        if self.action == "swing" and 2.0 * self.ramp_s > self.duration_s:
            raise ValueError("duration_s must hold two ramps of ramp_s")
        return self


class MotionTable(Table):
    """``[motion]``: of the joints. ``posture``: by joint, rad or m; drawn near the middle of its range where not given.

    ``posture_spread``: a posture that is given is drawn within +- this, rad or m.

    ``csv``: a file of ``time_s`` and a column for each joint, rad or m, in place of the swings of the sequence; beside
    the scenario. The first posture holds before it, the last after it. ``segments``: a file of motions that the flight
    computer may ask for; their posture is the arm's.
    """

    posture: dict[str, float] = Field(default_factory=dict)
    posture_spread: NonNegative = 0.0
    spread: Fraction = 0.3
    csv: str | None = None
    segments: str | None = None


class BaseSway(Table):
    """``[base_motion]`` of a prescribed base: rms of its rate and of its acceleration by axis, as tones of a band.

    ``still_s``: up to then it coasts without turning; the motion then grows within ``ramp_s``.
    """

    still_s: NonNegative = 0.0
    ramp_s: PositiveFloat = 2.0
    rate_rad_s: NonNegative = 0.05
    acceleration_m_s2: NonNegative = 0.1
    tones: PositiveInt = 4
    band_Hz: tuple[PositiveFloat, PositiveFloat] = (0.05, 0.5)


class JointFriction(Table):
    """``[friction]``: of each joint's drive, drawn per seed within a factor of two about these shares of ``effort``.

    ``effort_N_m``: of a joint whose URDF gives none. Rotor inertia: of the largest inertia that the joint turns.
    """

    coulomb: Fraction = 0.02
    viscous_s_rad: NonNegative = 0.02
    rotor: NonNegative = 0.05
    effort_N_m: PositiveFloat = 10.0


class Flexibility(Table):
    """``[flexibility]``: every joint gives way between its drive, which has the encoder, and its link.

    ``frequency_Hz``: of each joint's bend at the start, drawn between; a harmonic drive with its load has 2 to 5 Hz.
    """

    frequency_Hz: tuple[PositiveFloat, PositiveFloat] = (2.0, 5.0)
    damping_ratio: NonNegative = 0.02


class BacklashTable(Table):
    """``[backlash]``: play of a joint between its drive, which has the encoder, and its link; it grows in the mission.

    ``gap_mrad``: at the start and at the end. The joints then have springs of 20 Hz where none are given.
    """

    joint: str
    gap_mrad: tuple[NonNegative, NonNegative]


class SloshTable(Table):
    """``[slosh]``: a part of the base's mass that swings about its centre of mass; on a table, along the table."""

    mass_kg: PositiveFloat
    frequency_Hz: PositiveFloat
    damping_ratio: NonNegative = 0.005


class BurnTable(Table):
    """``[[burn]]``: the thruster at a frame of the URDF is on. Without ``force_N``: it gives the vehicle 10 mm/s^2."""

    frame: str
    at_s: NonNegative
    duration_s: PositiveFloat
    force_N: PositiveFloat | None = None


class WrenchTable(Table):
    """``[[wrench]]``: what pushes a free base unknown on board: drag, a leak, gravity gradient, light.

    ``force_N`` at the base frame's origin and ``torque_N_m``, in the base's axes (a leak turns with it), or in those
    of space, which are the base's at the start (drag does not). From ``at_s``, to the end without ``duration_s``.
    """

    axes: Literal["base", "space"]
    force_N: Vector = (0.0, 0.0, 0.0)
    torque_N_m: Vector = (0.0, 0.0, 0.0)
    at_s: NonNegative = 0.0
    duration_s: PositiveFloat | None = None


class AttitudeTable(Table):
    """``[attitude]``: the wheels hold the base's attitude by a spring and a damper, ``torque_N_m`` each at most.

    They are those joints whose speed alone is measured. ``start_rad_s``: of each at the start.
    """

    spring_N_m_rad: NonNegative
    damper_N_m_s: NonNegative
    torque_N_m: PositiveFloat
    start_rad_s: float = 0.0


class TableTop(Table):
    """``[table]`` of a planar base: sigmas of its tilt; drag of a puck is drawn between none and these."""

    tilt_sigma_m_s2: NonNegative = 0.002
    viscous_N_s_m: NonNegative = 0.5
    coulomb_N: NonNegative = 0.05
    pucks: tuple[str, ...] = ()


class BearingTable(Table):
    """``[bearing]`` of a base on a pivot: drag of the air, and what its jets turn it by, about the vertical."""

    viscous_N_m_s: NonNegative = 0.0
    turning_N_m: float = 0.0


class Scenario(Table):
    """A whole mission.

    ``device`` tables are read by ``hil_sim.devices``, and ``fault`` tables by ``hil_sim.faults``, where a mission is
    made of them.
    """

    scenario: ScenarioHeader
    sensor: dict[str, SensorTable]
    clock: dict[str, ClockTable]
    bus: dict[str, BusTable]
    device: Annotated[dict[str, DeviceTable], Field(min_length=1)]
    fault: tuple[dict[str, Any], ...] = ()
    _files: Files = PrivateAttr(default=())
    vehicle: VehicleTable
    physics: WorldPhysics = Field(default_factory=WorldPhysics.model_construct)
    as_built: dict[str, Tolerance] = Field(default_factory=dict)
    release: LetGo = Field(default_factory=LetGo.model_construct)
    payload: PayloadTable | None = None
    capture: CaptureWindow | None = None
    lost_part: LostPartTable | None = None
    ejection: EjectionTable | None = None
    motion: MotionTable = Field(default_factory=MotionTable.model_construct)
    base_motion: BaseSway = Field(default_factory=BaseSway.model_construct)
    friction: JointFriction = Field(default_factory=JointFriction.model_construct)
    table: TableTop = Field(default_factory=TableTop.model_construct)
    bearing: BearingTable | None = None
    flexibility: Flexibility | None = None
    backlash: BacklashTable | None = None
    slosh: SloshTable | None = None
    parabolas: Parabolas | None = None
    burn: tuple[BurnTable, ...] = ()
    wrench: tuple[WrenchTable, ...] = ()
    attitude: AttitudeTable | None = None
    servo: dict[str, ServoTable] = Field(default_factory=dict)
    stop: tuple[StopTable, ...] = ()
    coning: ConingTable | None = None
    vibration: Vibration | None = None
    air: AirTable | None = None
    drag: tuple[DragTable, ...] = ()
    sequence: Annotated[tuple[SequenceStep, ...], Field(min_length=1)]

    @property
    def files(self) -> Files:
        """That it was made of."""
        return self._files

    def of(self, files: Files) -> "Scenario":
        """The same, made of these files."""
        self._files = files
        return self

    @model_validator(mode="before")
    @classmethod
    def _of_parabolas(cls, tables: Any) -> Any:
        """The sequence that ``[parabolas]`` makes."""
        given = tables.get("parabolas")
        return tables if given is None else {**tables, "sequence": Parabolas.model_validate(given).sequence()}

    @model_validator(mode="after")
    def _payload_is_there(self) -> "Scenario":
        if self.parabolas is not None and self.vehicle.base != "free":
            raise ValueError('parabolas are flown with base = "free"')
        if self.parabolas is not None and (self.capture is not None or self.ejection is not None):
            raise ValueError("in parabolas the payload is held from the start: leave capture and ejection out")
        if self.slosh is not None and (self.vehicle.base not in ("free", "planar") or self.parabolas is not None):
            raise ValueError("slosh needs a base that floats all the time, free or planar")
        if (self.flexibility or self.backlash) and self.vehicle.base == "prescribed":
            raise ValueError("flexibility and backlash are for a base that floats or stands")
        if self.payload is not None and self.vehicle.payload_link is None:
            raise ValueError("payload: the vehicle file names no payload_link to hold it; name it, or leave it out")
        if (self.burn or self.wrench) and (self.vehicle.base != "free" or self.parabolas is not None):
            raise ValueError('burn, wrench: they push a base = "free" that is not let go by hand')
        if self.attitude is not None and (self.vehicle.base != "free" or self.parabolas or self.flexibility):
            raise ValueError('attitude: wheels hold a base = "free", with stiff joints, that is not let go by hand')
        if self.payload is None and (self.capture is not None or self.ejection is not None):
            raise ValueError("capture and ejection need a [payload]")
        if self.capture is not None and self.capture.contact_Hz is not None and self.vehicle.base != "free":
            raise ValueError('capture.contact_Hz: a payload is held by a spring first with base = "free" alone')
        self._parts_fit()
        if any(step.action == "asked" for step in self.sequence) != (self.motion.segments is not None):
            raise ValueError('motion.segments and a step with action = "asked" need each other')
        if self.motion.segments is not None and self.motion.csv is not None:
            raise ValueError("motion.csv and motion.segments: give either")
        end_s = sum(step.duration_s for step in self.sequence)
        caught = self.capture
        if caught and caught.phase is None and not 0.0 < caught.earliest_s <= caught.latest_s < end_s:
            raise ValueError(f"capture must lie between earliest_s and latest_s, and both before the end, {end_s:g} s")
        return self

    def _parts_fit(self) -> None:
        """Servos and stops, and what carries the base."""
        base, physics = self.vehicle.base, self.physics
        if self.lost_part is not None and (self.payload is None or base != "free" or self.parabolas):
            raise ValueError('lost_part needs a [payload] and a base = "free" that is not let go by hand')
        if self.bearing is not None and base != "pivot":
            raise ValueError('bearing: of a base = "pivot"; take it out')
        if self.servo and base not in ("prescribed", "fixed"):
            raise ValueError('servo: joints have servos with base = "prescribed" or "fixed"; take it out')
        if self.servo and (self.flexibility or self.backlash or (self.capture and self.capture.contact_Hz)):
            raise ValueError("servo: leave flexibility, backlash and capture.contact_Hz out")
        if not self.servo:
            needing = {
                "stop": bool(self.stop),
                "drag": bool(self.drag),
                "ejection.duration_ms": self.ejection is not None and self.ejection.duration_ms is not None,
                'action = "push"': any(step.action == "push" for step in self.sequence),
            }
            if any(needing.values()):
                named = ", ".join(key for key, is_there in needing.items() if is_there)
                raise ValueError(f"{named}: joints that move as planned do not give way; add [servo.default]")
        parts = {"coning": self.coning, "vibration": self.vibration, "air": self.air}
        if base != "prescribed" and any(parts.values()):
            named = ", ".join(key for key, part in parts.items() if part is not None)
            raise ValueError(f'{named}: of what carries a base = "prescribed"; take it out')
        if self.drag and self.air is None:
            raise ValueError("drag needs the air of [air]; add it")
        step_us = physics.step_us * (1 if self.servo else physics.integration_steps)
        if self.vibration is not None and self.vibration.highest_Hz * step_us > 2.5e5:
            raise ValueError(
                f"vibration up to {self.vibration.highest_Hz:g} Hz needs four steps a cycle, a step takes {step_us} "
                "us: give [physics] fewer integration_steps, or a smaller step_us"
            )

    def start_of(self, phase: int) -> float:
        """Mission time at which the first step with this phase begins, s; the end where there is none."""
        at_s = 0.0
        for step in self.sequence:
            if step.phase == phase:
                return at_s
            at_s += step.duration_s
        return at_s
