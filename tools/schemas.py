"""Write the JSON Schemas of all documents to docs/schemas, or check that they are up to date.

Usage: python tools/schemas.py [--check]

Descriptions of fields are the docstrings under them. With --check nothing is written, and the exit status is 1 if a
file is not up to date.
"""

import argparse
import inspect
import json
import pathlib
from typing import Any

import msgspec
from docstring_parser import parse_from_object

from replay.base.schemas.baseline import BASELINE_SCHEMA, Baseline
from replay.base.schemas.corpus import CORPUS_SCHEMA, CorpusList
from replay.base.schemas.log import LOG_SCHEMA, LogResults
from replay.base.schemas.results import SCHEMA as RESULTS_SCHEMA
from replay.base.schemas.results import ResultsDocument
from replay.base.schemas.run import RUN_SCHEMA, RunHead
from replay.base.schemas.summary import SUMMARY_SCHEMA, Summary
from replay.base.schemas.timing import TIMING_SCHEMA, TimingDocument
from replay.base.schemas.verdicts import VERDICTS_SCHEMA, Verdicts
from tools.script import run

FOLDER = pathlib.Path(__file__).resolve().parent.parent / "docs" / "schemas"
DOCUMENTS: dict[str, type[msgspec.Struct]] = {
    RESULTS_SCHEMA: ResultsDocument,
    BASELINE_SCHEMA: Baseline,
    CORPUS_SCHEMA: CorpusList,
    RUN_SCHEMA: RunHead,
    LOG_SCHEMA: LogResults,
    VERDICTS_SCHEMA: Verdicts,
    SUMMARY_SCHEMA: Summary,
    TIMING_SCHEMA: TimingDocument,
}
"""Every document that the program reads or writes as a file, by its schema."""


def main() -> int:
    """Write or check the schemas; returns the exit status."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--check", action="store_true", help="write nothing; exit status 1 if a file is not up to date")
    options = parser.parse_args()
    FOLDER.mkdir(parents=True, exist_ok=True)
    stale = [name for name, text in schema_files().items() if _content(FOLDER / name) != text]
    for name in stale:
        if not options.check:
            (FOLDER / name).write_text(schema_files()[name])
        print(f"{name}: {'not up to date' if options.check else 'written'}")
    return int(options.check and bool(stale))


def schema_files() -> dict[str, str]:
    """The content of each file by its name: `replay.run.log/1` is in `replay.run.log.1.json`."""
    return {
        f"{name.replace('/', '.')}.json": json.dumps(schema_of(kind, name), indent=1, ensure_ascii=False) + "\n"
        for name, kind in DOCUMENTS.items()
    }


def schema_of(kind: type[msgspec.Struct], title: str) -> dict[str, Any]:
    """The JSON Schema of a document, with a description of each field that has a docstring."""
    (schema,), parts = msgspec.json.schema_components([kind], ref_template="#/$defs/{name}")
    for part in _structs(kind):
        described = parts[part.__name__]
        described["description"] = " ".join(inspect.cleandoc(part.__doc__ or "").split())
        encoded = {field.name: field.encode_name for field in msgspec.structs.fields(part)}
        for found in parse_from_object(part).params:
            if found.description:
                described["properties"][encoded[found.arg_name]]["description"] = " ".join(found.description.split())
    return {"$schema": "https://json-schema.org/draft/2020-12/schema", "title": title, **schema, "$defs": parts}


def _structs(kind: type[msgspec.Struct]) -> set[type[msgspec.Struct]]:
    """A struct and all structs that its fields lead to."""
    found, waiting = set[type[msgspec.Struct]](), [msgspec.inspect.type_info(kind)]
    while waiting:
        info: Any = waiting.pop()
        if isinstance(info, msgspec.inspect.StructType) and info.cls not in found:
            found.add(info.cls)
            waiting += [field.type for field in info.fields]
        waiting += [*getattr(info, "types", ()), *getattr(info, "item_types", ())]
        waiting += [getattr(info, name) for name in ("item_type", "key_type", "value_type") if hasattr(info, name)]
    return found


def _content(path: pathlib.Path) -> str:
    return path.read_text() if path.is_file() else ""


if __name__ == "__main__":
    run(main)
