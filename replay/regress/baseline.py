"""The baseline: what a run is compared with; one file beside the corpus, written only by `replay regress accept`."""

import json
import os
import pathlib
from collections.abc import Mapping
from dataclasses import dataclass, field
from types import NoneType
from typing import Any

from replay.base.documents import plain
from replay.base.errors import ReplayError
from replay.base.files import atomic_write
from replay.base.numbers import count
from replay.base.strict_json import JsonError, read_json
from replay.regress.corpus import Corpus

BASELINE_ERROR = "E_BASELINE"
SCHEMA = "replay.baseline/1"
_FIGURES: Mapping[str, tuple[tuple[type, ...], str]] = {
    "status": ((str,), "a text"),
    "audit": ((bool,), "true or false"),
}
"""Types of figures that are no numbers."""
_LARGEST = 512 * 2**20  # [bytes]


@dataclass(frozen=True, kw_only=True)
class Baseline:
    """The figures of a run that was accepted."""

    created: str = ""
    revision: str = ""
    options: str = ""
    """Fingerprint of the options with which it was made."""
    settings: Mapping[str, Any] = field(default_factory=dict)
    """These options, as `Settings.plain` gives them; empty where the file does not hold them."""
    logs: Mapping[str, Mapping[str, Any]] = field(default_factory=dict)
    """By the log's name, as `compare.baseline_entry` gives them."""


def read_baseline(path: str | os.PathLike[str]) -> Baseline:
    """The baseline in a file. ReplayError (E_BASELINE), one line, for what is none."""
    try:
        document = read_json(path, _LARGEST)
    except JsonError as error:
        raise ReplayError(BASELINE_ERROR, f"{os.fspath(path)}: {error}") from None
    wrong = _wrong(document)
    if wrong:
        hint = "move it away, and make it anew with `replay regress accept`"
        raise ReplayError(BASELINE_ERROR, f"{os.fspath(path)}: no {SCHEMA} file: {wrong}; {hint}")
    words = {key: str(document.get(key) or "") for key in ("created", "revision", "options")}
    return Baseline(**words, settings=document.get("settings") or {}, logs=document["logs"])


def _wrong(document: Any) -> str:
    """What is wrong with a document; empty for a baseline."""
    if not isinstance(document, dict) or document.get("schema") != SCHEMA:
        found = document.get("schema") if isinstance(document, dict) else None
        return "it has no schema" if found is None else f"its schema is {str(found)[:60]!r}"
    if not isinstance(document.get("settings"), (dict, NoneType)):
        return "settings is no object"
    logs = document.get("logs")
    if not isinstance(logs, dict):
        return "logs is missing"
    for name, entry in logs.items():
        cases = entry.get("cases") if isinstance(entry, dict) else None
        if not isinstance(cases, dict):
            return f"logs.{name[:60]}.cases is missing"
        for methods in cases.values():
            if not isinstance(methods, dict) or not all(isinstance(figures, dict) for figures in methods.values()):
                return f"logs.{name[:60]} holds no figures by case and method"
        if wrong := _wrong_value(entry):
            return f"logs.{name[:60]}.{wrong}"
    return ""


def _wrong_value(entry: Mapping[str, Any]) -> str:
    """The first value of a log's entry that cannot be compared with; empty where all can."""
    for key in ("sha256", "error"):
        if not isinstance(entry.get(key), (str, NoneType)):
            return f"{key} is {str(entry[key])[:40]!r}, expected a text or null"
    for number, methods in entry["cases"].items():
        for method, figures in methods.items():
            for key, value in figures.items():
                kinds, expected = _FIGURES.get(key, ((int, float), "a number"))
                if not isinstance(value, (*kinds, NoneType)) or (isinstance(value, bool) and bool not in kinds):
                    return f"cases.{number}.{method}.{key} is {str(value)[:40]!r}, expected {expected}"
    return ""


def check_baseline(path: pathlib.Path | None, corpus: Corpus) -> None:
    """Raises ReplayError (E_BASELINE) where the file is no baseline, or that of quite another corpus."""
    if path is None or not path.exists():
        return
    logs = read_baseline(path).logs.keys()
    if logs and logs.isdisjoint(log.name for log in corpus.logs):
        none = f"none of its {count(len(logs), 'log')} is in {corpus.path}"
        raise ReplayError(
            BASELINE_ERROR, f"{path}: is the baseline of another corpus: {none}; name another: --baseline"
        )


def write_baseline(path: str | os.PathLike[str], baseline: Baseline) -> None:
    """Write a baseline, whole or not at all, each result on a line of its own so that changes can be reviewed."""
    head = {"created": baseline.created, "revision": baseline.revision, "options": baseline.options, "schema": SCHEMA}
    lines = ["{"] + [f" {json.dumps(key)}: {json.dumps(value)}," for key, value in sorted(head.items())]
    if baseline.settings:
        groups = [f"  {json.dumps(key)}: {_settings(value)}" for key, value in sorted(plain(baseline.settings).items())]
        lines += [' "settings": {', ",\n".join(groups), " },"]
    lines.append(' "logs": {')
    logs = [_log_lines(name, plain(baseline.logs[name])) for name in sorted(baseline.logs)]
    lines += [",\n".join(logs), " }", "}"]
    content = "\n".join(lines).encode("utf-8", "backslashreplace") + b"\n"
    with atomic_write(path) as temporary:
        temporary.write_bytes(content)


def _settings(value: Any) -> str:
    """One group of options: those of each method on a line of their own."""
    if not isinstance(value, dict) or not any(isinstance(options, dict) for options in value.values()):
        return json.dumps(value, sort_keys=True)
    return "{\n" + ",\n".join(f"   {json.dumps(k)}: {json.dumps(v, sort_keys=True)}" for k, v in value.items()) + "}"


def _log_lines(name: str, entry: Mapping[str, Any]) -> str:
    about = {key: value for key, value in sorted(entry.items()) if key != "cases"}
    cases = [
        f"    {json.dumps(number)}: {{"
        + ",".join(f"\n     {json.dumps(m)}: {json.dumps(f, sort_keys=True)}" for m, f in sorted(methods.items()))
        + "}"
        for number, methods in sorted(entry["cases"].items())
    ]
    fields = [f"   {json.dumps(key)}: {json.dumps(value)}," for key, value in about.items()]
    fields.append('   "cases": {' + ("\n" + ",\n".join(cases) if cases else "") + "}")
    return "\n".join([f"  {json.dumps(name)}: {{", *fields, "  }"])


def default_baseline(given: pathlib.Path | None, corpus: str | None) -> pathlib.Path | None:
    """The file that a run is compared with: the given one, which must be there, else the corpus's, if there is one."""
    if given is not None:
        if not given.is_file():
            hint = "leave --baseline out, and accept the run with it"
            raise ReplayError(BASELINE_ERROR, f"--baseline {given}: no such file; for a first baseline {hint}")
        return given
    return pathlib.Path(corpus) if corpus is not None else None
