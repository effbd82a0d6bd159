"""The page on fleets names every key of a manifest and every column of the tables."""

import re

import pytest

from deltaid.fleets.known import RECORDINGS_SCHEMA
from deltaid.fleets.manifest import Manifest
from deltaid.fleets.steps import TABLES as STEPS
from sessions import ROOT

PAGE = (ROOT / "docs" / "fleet.md").read_text(encoding="utf-8")
TABLES = {"recordings": RECORDINGS_SCHEMA, **STEPS}


def test_all_keys_of_a_manifest_are_named() -> None:
    schema = Manifest.model_json_schema()
    for part in (schema, *schema["$defs"].values()):
        for key in part["properties"]:
            assert re.search(rf"^\| `{key}` \|", PAGE, re.M), key


@pytest.mark.parametrize("name", sorted(TABLES))
def test_all_columns_of_the_tables_are_named(name: str) -> None:
    text = PAGE.partition(f"\n`{name}.parquet`, ")[2] or PAGE.partition("\n`types.parquet`, ")[2]
    rows = text.partition("\n\n")[2].partition("\n\n")[0]
    named = set(re.findall(r"`(\w+)`", rows))
    assert set(TABLES[name]) - {"key"} <= named
