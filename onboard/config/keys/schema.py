"""vehicle.toml as JSON Schema, for editors that complete keys and show what they mean."""

import json
from functools import cache
from typing import Any

from pydantic import AliasChoices

from onboard.config.keys.meanings import MEANINGS
from onboard.config.vehicle import VehicleFile

FILE = "vehicle.schema.json"
FIRST_LINE = f"#:schema ./{FILE}"  # of a vehicle.toml beside it


@cache
def as_text() -> str:
    """The schema, as the file beside a vehicle.toml holds it."""
    return json.dumps(json_schema(), indent=1) + "\n"


def json_schema() -> dict[str, Any]:
    """The schema (draft 2020-12), each key with what it means and when to change it."""
    made = VehicleFile.model_json_schema()
    for section, keys in MEANINGS.items():
        properties = made["$defs"].get(section.__name__, {}).get("properties", {})
        for key, meaning in keys.items():
            when = f" Change it when: {meaning.change}." if meaning.change else ""
            properties[key]["description"] = meaning.what + when
            older = section.model_fields[key].validation_alias
            for name in older.choices[1:] if isinstance(older, AliasChoices) else ():
                properties[str(name)] = {**properties[key], "deprecated": True}
    return {"$schema": "https://json-schema.org/draft/2020-12/schema", **made, "title": "heft vehicle file"}
