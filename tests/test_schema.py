"""The JSON Schemas of files that people write: every key is explained, limits are the program's."""

from collections.abc import Iterator
from functools import cache
from typing import Any

import numpy as np
import pytest
from jsonschema import Draft202012Validator as Schema
from pydantic import BaseModel, ValidationError, create_model

from deltaid.recording.mapping import ColumnMapping
from deltaid.robot.description import RobotDescription
from deltaid.sensors.planning.offers import Offers

WRITTEN = (RobotDescription, ColumnMapping, Offers)
# One of each part whose own check refuses what no single type does: to try its keys in.
IN_CONTEXT: dict[str, dict[str, Any]] = {
    "Body": {"prior": [{"shape": "point_mass", "mass": 1.0, "centre": [0, 0, 0]}], "free": ["m"]},
    "Telescope": {"stroke": [0.5, 0.9]},
    "H4Platform": {"kind": "h4", "half_length": 0.1, "angle_deg": [-90, 90]},
    "Par4Platform": {"kind": "par4", "length": 0.1, "angle_deg": [-90, 90]},
    "I4Platform": {"kind": "i4", "ratio": 40.0, "angle_deg": [-90, 90]},
    "ColumnMapping": {},
}


def parts(model: type[BaseModel]) -> Iterator[type[BaseModel]]:
    """A model and all models that its schema refers to."""
    named = {model.__name__, *model.model_json_schema().get("$defs", {})}
    yield from {model for model in models(BaseModel) if model.__name__ in named}


def models(base: type[BaseModel]) -> Iterator[type[BaseModel]]:
    for subclass in base.__subclasses__():
        if subclass.__module__.startswith("deltaid."):
            yield subclass
        yield from models(subclass)


PARTS = sorted({part for model in WRITTEN for part in parts(model)}, key=lambda part: part.__name__)


@pytest.mark.parametrize("model", WRITTEN, ids=lambda model: model.__name__)
def test_every_key_is_described(model: type[BaseModel]) -> None:
    schema = model.model_json_schema()
    found = {model.__name__: schema, **schema.get("$defs", {})}
    bare = [
        f"{name}.{key}"
        for name, part in found.items()
        for key, described in part.get("properties", {}).items()
        if len(described.get("description", "")) < 1 and len(description_of(described, schema)) < 1
    ]
    assert bare == []
    assert sum(len(part.get("properties", {})) for part in found.values()) > 20


def description_of(own: dict[str, Any], schema: dict[str, Any]) -> str:
    """What a named type says, where a key is of that type alone."""
    target = schema["$defs"][own["$ref"].rpartition("/")[2]] if "$ref" in own else {}
    return "" if "properties" in target else target.get("description", "")


def bounds(node: object) -> Iterator[float]:
    """All limits of numbers in a schema."""
    if isinstance(node, dict):
        for key, value in node.items():
            if key in ("minimum", "maximum", "exclusiveMinimum", "exclusiveMaximum", "const"):
                if isinstance(value, int | float):
                    yield float(value)
            else:
                yield from bounds(value)
    elif isinstance(node, list):
        for entry in node:
            yield from bounds(entry)


def tried(schema: dict[str, Any], rng: np.random.Generator) -> Iterator[Any]:
    """Numbers at and beside all limits and of all sizes, alone and in lists and mappings."""
    near = [b * f for b in {*bounds(schema), 1.0, 4.0} for f in (1 - 1e-9, 1, 1 + 1e-9, 1.5, -1)]
    wide = np.exp(rng.uniform(np.log(1e-15), np.log(1e15), 12)) * rng.choice([-1, 1], 12)
    whole = [int(x) for x in range(-1, 6)]
    sizes = (int(x) if x == int(x) else float(x) for x in (*near, *wide))
    for x in (*whole, *sizes):
        yield from (x, [x], [x, x], [x, x, x], [1, x], [0.1, x], [x, 0.1, 0.1], {"drive1": x})
    yield from ([], [1, 2], [2, 1, 3], ["m", "m"], ["m", "mcx"], "outwards", None, "")


@cache
def alone(part: type[BaseModel], key: str) -> type[BaseModel]:
    """A model of this one key."""
    field = part.model_fields[key]
    return create_model("Alone", __config__=part.model_config, **{key: (field.annotation, field)})  # pyright: ignore[reportCallIssue, reportArgumentType, reportUnknownVariableType]


def refused(model: type[BaseModel], data: dict[str, Any]) -> bool:
    """Whether the program refuses this, as it reads it from a file."""
    import json

    try:
        model.model_validate_json(json.dumps(data), strict=True)
    except ValidationError:
        return True
    return False


@pytest.mark.parametrize("part", PARTS, ids=lambda part: part.__name__)
def test_schema_and_program_have_the_same_limits(part: type[BaseModel]) -> None:
    rng = np.random.default_rng(0)
    for key in part.model_fields:
        model = alone(part, key)
        schema = Schema(model.model_json_schema())
        for value in tried(schema.schema, rng):
            outside = not schema.is_valid({key: value})
            by_type = refused(model, {key: value})
            if (key, value) == ("always", 1):  # which pydantic takes for true
                continue
            if outside and not by_type and part.__name__ in IN_CONTEXT:
                context = IN_CONTEXT[part.__name__] | {key: value}
                assert refused(part, context), (key, value)
                continue
            # A schema knows neither a norm nor the order of two numbers.
            falls = isinstance(value, list) and len(value) == 2 and value[0] >= value[1]
            if not (by_type and (key == "gravity" or falls)):
                assert outside == by_type, (key, value)
    assert part.__name__ not in IN_CONTEXT or not refused(part, IN_CONTEXT[part.__name__])


@pytest.mark.parametrize(
    ("name", "key", "wrong", "right"),
    [
        ("H4Platform", "first", [1, 1], [1, 3]), ("Par4Platform", "first", [1, 5], [1, 4]),
        ("I4Platform", "first", [1], [3, 4]), ("I4Platform", "ratio", 0, -40),
        ("Telescope", "stroke", [0, 1], [0.5, 1]), ("Telescope", "stroke", [-1, 1], [1e-3, 1]),
        ("Body", "free", ["m", "m"], []), ("ColumnMapping", "data_row", 1, 2),
    ],
)  # fmt: skip
def test_what_a_part_refuses_as_a_whole(name: str, key: str, wrong: Any, right: Any) -> None:
    part = next(kind for kind in PARTS if kind.__name__ == name)
    for value, outside in ((wrong, True), (right, False)):
        data = IN_CONTEXT[name] | {key: value}
        assert refused(part, data) == outside
        assert Schema(part.model_json_schema()).is_valid(data) != outside


def test_limits_bite() -> None:
    """The comparison sees limits at all: how many values each side refuses."""
    counted = 0
    for part in PARTS:
        for key in part.model_fields:
            schema = alone(part, key).model_json_schema()
            counted += len(set(bounds(schema)))
    assert counted > 150
