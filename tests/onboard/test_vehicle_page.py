"""docs/vehicle.md and the JSON Schema say what the reader of vehicle.toml knows, and nothing else."""

import json
import tomllib
from pathlib import Path

import jsonschema
import pytest

from onboard import cli, config
from onboard.config.keys import schema
from onboard.config.keys.meanings import MEANINGS
from onboard.config.vehicle import VehicleFile
from tests.onboard.vehicle_page import TABLES, page

PAGE = Path(__file__).parents[2] / "docs" / "vehicle.md"
VEHICLES = sorted(path.parent.name for path in config.packaged("rocksat").parents[1].glob("*/vehicle.toml"))


def test_the_page_is_as_the_reader_is() -> None:
    assert PAGE.read_text(encoding="utf-8") == page(), f"write it again: python -m tests.onboard.vehicle_page {PAGE}"


def test_every_key_of_every_table_has_a_meaning_and_no_other() -> None:
    assert set(MEANINGS) == set(TABLES.values())
    for section, keys in MEANINGS.items():
        assert set(keys) == set(section.model_fields), section
        assert all(len(said.what) > 8 or said.what == "Weighed." for said in keys.values())


def test_no_table_of_the_file_is_left_out() -> None:
    told = {section.__name__ for section in TABLES.values()}
    own = {name for name in VehicleFile.model_json_schema()["$defs"] if not name.endswith(("Device", "Channel"))}
    assert own - told <= {
        "RecordedImu",
        "RecordedAngle",
        "RecordedRate",
        "RecordedLoadCell",
        "RecordedTorque",
        "RecordedPose",
        "RecordedThruster",
        "RecordedValue",
    }


@pytest.fixture(scope="module")
def validator() -> jsonschema.Draft202012Validator:
    return jsonschema.Draft202012Validator(schema.json_schema())


@pytest.mark.parametrize("name", VEHICLES)
def test_packaged_vehicles_are_valid_by_the_schema(name: str, validator: jsonschema.Draft202012Validator) -> None:
    tree = tomllib.loads(config.packaged(name).read_text(encoding="utf-8"))
    assert list(validator.iter_errors(tree)) == []


@pytest.mark.parametrize(
    ("where", "key", "value"),
    [
        (("estimation",), "smothing_ms", 3),
        (("estimation",), "method", "magic"),
        (("vehicle",), "base", "floating"),
        (("device", "joint_1"), "counts_per_revolution", 0),
        (("device", "imu_base"), "kind", "mpu9999"),
    ],
)
def test_the_schema_refuses_what_the_reader_refuses(where: tuple[str, ...], key: str, value: object) -> None:
    tree = tomllib.loads(config.packaged("rocksat").read_text(encoding="utf-8"))
    table = tree
    for part in where:
        table = table[part]
    table[key] = value
    with pytest.raises(jsonschema.ValidationError):
        jsonschema.Draft202012Validator(schema.json_schema()).validate(tree)


def test_the_command_writes_it_with_meanings(tmp_path: Path) -> None:
    assert cli.main(["schema", "-o", str(tmp_path / "s.json")]) == cli.OK
    made = json.loads((tmp_path / "s.json").read_text())
    jsonschema.Draft202012Validator.check_schema(made)
    assert "Change it when" in made["$defs"]["Estimation"]["properties"]["smoothing_ms"]["description"]
