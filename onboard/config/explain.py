"""Pydantic's errors as messages for the author of a file: place, key, remedy, the nearest known name."""

import difflib
import json
import tomllib
from collections.abc import Iterator, Mapping, Sequence
from types import UnionType
from typing import Annotated, Any, Literal, Union, get_args, get_origin

from pydantic import AliasChoices, BaseModel, ValidationError
from pydantic.fields import FieldInfo

from onboard.config.errors import Origin

UNIONS = (Union, UnionType)
_OTHERS = "; a kind of another package is known where that package is installed"
_MOST_TOLD = 20  # errors of one file
_MOST_SHOWN = 200  # characters of a value
_WANTED = {
    "bool": "true or false is wanted here",
    "dict": "a table is wanted here",
    "finite_number": "a finite number is wanted here",
    "float": "a number is wanted here",
    "greater_than": "more than {gt:.12g} is wanted here",
    "greater_than_equal": "{ge:.12g} or more is wanted here",
    "int": "a whole number is wanted here",
    "int_from_float": "a whole number is wanted here",
    "less_than": "less than {lt:.12g} is wanted here",
    "less_than_equal": "{le:.12g} or less is wanted here",
    "list": "a list is wanted here, like [1, 2]",
    "model": "a table is wanted here",
    "model_attributes": "a table is wanted here",
    "string": "a text in quotes is wanted here",
    "too_long": "{max_length} values at the most are wanted here",
    "too_short": "{min_length} values at least are wanted here",
    "tuple": "a list is wanted here, like [1, 2]",
}


_GONE = {"estimation.scales": "errors of gains are estimated beside the load of every arm that stands"}  # of heft 0.2


def explained(
    error: ValidationError,
    tree: Mapping[str, Any],
    model: type[BaseModel],
    origins: Sequence[Origin],
    under: Sequence[str] = (),
) -> Iterator[str]:
    """A sentence for each thing that is wrong, of the first twenty.

    Args:
        error: pydantic's.
        tree: what was read.
        model: the class that reads the whole of it.
        origins: the files that it is from, each laid over those before it.
        under: where the tree stands in them.
    """
    told: list[dict[str, Any]] = [dict(one) for one in error.errors(include_url=False)]
    found = [(_place([str(part) for part in one["loc"]], tree), one) for one in told]
    for where, one in found[:_MOST_TOLD]:
        if one["type"] == "too_short" and any(where == other[: len(where)] != other for other, _ in found):
            continue  # the list is too short only without its wrong items
        tag = [one["ctx"]["discriminator"].strip("'")] if one["type"].startswith("union_tag") else []
        full = [*under, *where, *tag]
        yield f"{_origin(origins, full).place(full)}: {_explain('.'.join(full), where, tree, one, model)}"
    if len(found) > _MOST_TOLD:
        yield f"and {len(found) - _MOST_TOLD} more like these"


def _origin(origins: Sequence[Origin], where: list[str]) -> Origin:
    """The last of the files that contain the longest part of a place."""
    return max(reversed(origins), key=lambda origin: _depth(origin, where))


def _depth(origin: Origin, where: list[str]) -> int:
    if not origin.text:
        return 0  # a label, of what stands in none of the files
    node: Any = tomllib.loads(origin.text)
    for depth, part in enumerate(where):
        if isinstance(node, dict) and part in node:
            node = node[part]
        elif isinstance(node, list) and part.isdigit() and int(part) < len(node):
            node = node[int(part)]
        else:
            return depth or -1
    return len(where)


def _explain(
    name: str, where: list[str], tree: Mapping[str, Any], error: dict[str, Any], model: type[BaseModel]
) -> str:
    kind, context = str(error["type"]), error.get("ctx", {})
    if kind == "extra_forbidden" and name in _GONE:
        return f"{name!r} is gone, as {_GONE[name]}: delete it"
    if kind == "extra_forbidden":
        known = list(_model_at(where[:-1], tree, model).model_fields)
        near = difflib.get_close_matches(where[-1], known, 1, 0.5)
        remedy = f"did you mean {near[0]!r}? Units are in the key" if near else f"known here: {', '.join(known)}"
        return f"unknown key {name!r}; {remedy}"
    if kind in ("missing", "union_tag_not_found"):
        return f"{name!r} is missing; add it"
    if kind in ("literal_error", "union_tag_invalid"):
        other = _OTHERS if name.startswith("device.") and name.endswith(".kind") else ""
        return f"{name!r}: {_one_of(context, error['input'])}{other}"
    wanted = _WANTED.get(kind, _WANTED.get(kind.removesuffix("_type").removesuffix("_parsing")))
    why = wanted.format(**context) if wanted else str(error["msg"]).removeprefix("Value error, ")
    return f"{name!r}: {why} (given: {_shown(error['input'])})" if where else why  # of all tables: it names its keys


def _one_of(context: dict[str, Any], given: Any) -> str:
    """What a word has to be, the nearest first."""
    known = [part.strip("' ") for part in str(context.get("expected", context.get("expected_tags"))).split(",")]
    known = [word for part in known for word in (part.split("' or '") if "' or '" in part else [part])]
    said = str(context.get("tag", given))
    near = difflib.get_close_matches(said, known, 1)
    meant = f"did you mean {near[0]!r}? " if near else ""
    return f"{_shown(said)} is none of {', '.join(known)}; {meant}".rstrip("; ")


def _shown(value: Any) -> str:
    text = json.dumps(value, ensure_ascii=False, default=str)
    return text if len(text) <= _MOST_SHOWN else f"{text[:_MOST_SHOWN]}..."


def _place(loc: list[str], tree: Mapping[str, Any]) -> list[str]:
    """The path of a key in the file; pydantic adds the kind of a table to ``loc``."""
    where: list[str] = []
    node: Any = tree
    for part in loc[:-1]:
        if isinstance(node, dict) and part in node:
            node = node[part]
        elif isinstance(node, list) and part.isdigit():
            node = node[int(part)]
        else:
            continue
        where.append(part)
    return [*where, *loc[-1:]]


def _model_at(where: list[str], tree: Mapping[str, Any], model: type[BaseModel]) -> type[BaseModel]:
    """The class that reads the table at ``where``, where ``model`` reads the whole."""
    said: Any = model  # of the value that is looked at
    node: Any = tree
    for part in where:
        said = _field(model, part).annotation if said is model else _of_items(said)
        node = node[int(part)] if isinstance(node, list) else node[part]
        found = _model_of(said, node)
        if found is not None:
            said = model = found
    return model


def _field(model: type[BaseModel], key: str) -> FieldInfo:
    """The field that reads ``key``, by its name or by one that older files have for it."""
    for field in model.model_fields.values():
        if isinstance(field.validation_alias, AliasChoices) and key in field.validation_alias.choices:
            return field
    return model.model_fields[key]


def _of_items(annotation: Any) -> Any:
    """Annotation of the values of a dict or the items of a tuple."""
    while get_origin(annotation) is Annotated:
        annotation = get_args(annotation)[0]
    for one in get_args(annotation) if get_origin(annotation) in UNIONS else [annotation]:
        if get_origin(one) is dict:
            return get_args(one)[1]
        if get_origin(one) in (tuple, list):
            return get_args(one)[0]
    return Any


def _model_of(annotation: Any, value: Any) -> type[BaseModel] | None:
    """The class in an annotation that reads a table: of several, the one whose literals (a kind) the table has."""
    if (section_of := getattr(annotation, "section_of", None)) is not None:  # by its kind
        named: type[BaseModel] | None = section_of(value)
        return named
    if isinstance(annotation, type) and issubclass(annotation, BaseModel):
        literals = {
            k: get_args(f.annotation) for k, f in annotation.model_fields.items() if get_origin(f.annotation) is Literal
        }
        fits = isinstance(value, dict) and all(value[k] in said for k, said in literals.items() if k in value)
        return annotation if fits else None
    if get_origin(annotation) is Annotated or get_origin(annotation) in UNIONS:
        found = (_model_of(one, value) for one in get_args(annotation))
        return next((model for model in found if model is not None), None)
    return None
