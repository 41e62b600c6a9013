"""JSON Schemas in docs/ say what the program reads and writes."""

import importlib
import json
import pkgutil

import msgspec
import pytest

import replay.base.schemas
from tools.schemas import DOCUMENTS, FOLDER, schema_files

REMEDY = "run `python tools/schemas.py`"


@pytest.mark.parametrize("name", schema_files())
def test_a_schema_in_the_docs_is_up_to_date(name: str) -> None:
    assert (FOLDER / name).read_text() == schema_files()[name], REMEDY


def test_there_is_a_schema_for_every_document_and_no_other() -> None:
    assert {path.name for path in FOLDER.iterdir()} == set(schema_files()), REMEDY
    modules = [f"replay.base.schemas.{module.name}" for module in pkgutil.iter_modules(replay.base.schemas.__path__)]
    structs = {
        found
        for name in modules
        for found in vars(importlib.import_module(name)).values()
        if isinstance(found, type) and issubclass(found, msgspec.Struct) and "schema" in found.__struct_fields__
    }
    assert structs == set(DOCUMENTS.values())


def test_a_schema_names_its_document_and_explains_its_fields() -> None:
    for name, text in schema_files().items():
        schema = json.loads(text)
        first = schema["$defs"][schema["$ref"].rpartition("/")[2]]
        assert first["properties"]["schema"]["enum"] == [schema["title"]], name
        assert first["description"], name
    properties = json.loads(schema_files()["replay.run.log.1.json"])["$defs"]["LogResults"]["properties"]
    assert properties["class"]["type"] == "string"
    assert properties["declared"]["description"] == "Line of `corpus.toml` that says so, as path:line."
