"""The reference of vehicle.toml, made of what its reader knows.

``python -m tests.onboard.vehicle_page docs/vehicle.md`` writes it; ``test_vehicle_page.py`` holds the two together.
"""

import sys
from pathlib import Path

from pydantic import AliasChoices

from onboard.config import estimation
from onboard.config.bases.free_body import Carrier, FreeBody, Load
from onboard.config.bases.parabola import Parabola
from onboard.config.bases.pivot import Balance, Pivot
from onboard.config.bases.table import Body, Planar, Puck
from onboard.config.drive import Drive
from onboard.config.keys.meanings import MEANINGS
from onboard.config.mission import MissionKeys
from onboard.config.telemetry import Telemetry
from onboard.config.vehicle import BusSection, LinkSection, Realtime, RecordingSection, VehicleSection
from onboard.ground.log.tables.columns import unit_of
from onboard.section import LARGEST, Section
from tests.onboard.device_page import toml_of, type_of

TABLES: dict[str, type[Section]] = {
    "[vehicle]": VehicleSection,
    "[bus.NAME]": BusSection,
    "[link.NAME]": LinkSection,
    "[estimation]": estimation.Estimation,
    "[estimation.phases]": estimation.Phases,
    "[estimation.phases.resumed]": estimation.Resumed,
    "[estimation.zero]": estimation.Zero,
    "[estimation.gates]": estimation.Gates,
    "[estimation.prior]": estimation.Prior,
    "[estimation.prior.link.NAME]": estimation.Link,
    "[estimation.prior.joint.NAME]": estimation.JointKeys,
    "[estimation.masses]": estimation.Masses,
    "[estimation.motor.NAME]": estimation.MotorKeys,
    "[estimation.masses.drawing.NAME]": estimation.LinkTolerance,
    "[estimation.exiddm]": estimation.FreeFlyerKeys,
    "[estimation.disturbance]": estimation.DisturbanceKeys,
    "[estimation.useful]": estimation.UsefulKeys,
    "[estimation.imu_prior]": estimation.ImuPriorKeys,
    "[estimation.carried]": estimation.Carried,
    "[free_body]": FreeBody,
    "[free_body.carrier]": Carrier,
    "[[free_body.load]]": Load,
    "[parabola]": Parabola,
    "[planar]": Planar,
    "[[planar.puck]]": Puck,
    "[pivot]": Pivot,
    "[body]": Body,
    "[[pivot.balance]]": Balance,
    "[recording]": RecordingSection,
    "[realtime]": Realtime,
    "[telemetry]": Telemetry,
    "[drive]": Drive,
    "[mission]": MissionKeys,
}
HEAD = """# vehicle.toml

Every key outside `[device.NAME]`, whose keys are in `devices.md`. Written by
`python -m tests.onboard.vehicle_page docs/vehicle.md` from the classes that read the file.

`heft init DIR` writes a vehicle file to begin with, `heft init DIR --from rocksat` a copy of a packaged one.
`heft schema -o vehicle.schema.json` writes the JSON Schema that editors read where the file begins with
`#:schema ./vehicle.schema.json`. `heft preflight vehicle.toml` says what does not fit, with the line.

Units stand in the keys; **bold** keys have no default; a table may be left out where all of its keys have one, or where
the vehicle has no such thing.
"""


def page() -> str:
    """The document."""
    return HEAD + "".join(_table(title, section) for title, section in TABLES.items())


def _table(title: str, section: type[Section]) -> str:
    schema = section.model_json_schema()
    lines = ["| key | | unit | default | meaning | change it when |", "|---|---|---|---|---|---|"]
    for key, field in section.model_fields.items():
        said = MEANINGS[section][key]
        shown = schema["properties"][key]
        name = f"**`{key}`**" if field.is_required() else f"`{key}`"
        default = field.get_default(call_default_factory=True) if not field.is_required() else None
        plain = "" if default is None or isinstance(default, Section | dict | list) else f"`{toml_of(default)}`"
        lines.append(
            f"| {name} | {_kind(shown)} | {_unit(key)} | {plain} | {said.what} | {said.change} |".replace("  ", " ")
        )
        if isinstance(field.validation_alias, AliasChoices):
            assert field.validation_alias.choices[0] == key
    return f"\n## {title}\n" + "\n".join(lines) + "\n"


def _unit(key: str) -> str:
    return unit_of(key.lower()) if key not in ("segment_mib", "min_free_mib", "reserve_mib") else "MiB"


def _kind(schema: dict) -> str:  # type: ignore[type-arg]
    if "anyOf" in schema:
        return _kind(next(one for one in schema["anyOf"] if one.get("type") != "null"))
    if "$ref" in schema or schema.get("type") == "object":
        return "table"
    if schema.get("type") == "array" and "items" in schema and "$ref" in schema["items"]:
        return "tables"
    if schema.get("type") == "array" and schema.get("items", {}).get("type") == "array":
        return "list of lists of numbers"
    limits = schema.get("minimum"), schema.get("maximum")
    anything = {
        (1 / LARGEST, LARGEST): "number above 0",
        (0, LARGEST): "number at least 0",
        (-LARGEST, LARGEST): "number",
    }
    return anything.get(limits) or type_of(schema)


if __name__ == "__main__":
    Path(sys.argv[1]).write_text(page(), encoding="utf-8")
