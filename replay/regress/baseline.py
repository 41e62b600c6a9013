"""The baseline that runs are compared with: one file beside the corpus, written only by `replay regress accept`."""

import json
import os
import pathlib
from collections.abc import Collection
from typing import Any

from replay.base.documents import DocumentError, plain, read_json
from replay.base.errors import ReplayError
from replay.base.numbers import count
from replay.base.schemas.baseline import BASELINE_SCHEMA, LARGEST_BASELINE, Baseline
from replay.regress.folder import write_document

BASELINE_ERROR = "E_BASELINE"
EMPTY = Baseline(schema=BASELINE_SCHEMA, logs={})
"""The baseline of a corpus that has none yet."""


def read_baseline(path: str | os.PathLike[str] | None) -> Baseline:
    """Read a baseline from a file; an empty one for None. Raises ReplayError (E_BASELINE), one line."""
    if path is None:
        return EMPTY
    try:
        return read_json(path, Baseline, LARGEST_BASELINE)
    except DocumentError as error:
        hint = "expected a baseline: move the file away, and make it again with `replay regress accept`"
        raise ReplayError(BASELINE_ERROR, f"{os.fspath(path)}: {error}; {hint}") from None


def baseline_file(given: pathlib.Path | None, corpus: str | None) -> pathlib.Path | None:
    """The file that a run is compared with: the given one, which must exist, else the corpus's, which need not."""
    if given is not None:
        if not given.is_file():
            hint = "leave --baseline out, and accept the run with it"
            raise ReplayError(BASELINE_ERROR, f"--baseline {given}: no such file; for a first baseline {hint}")
        return given
    return pathlib.Path(corpus) if corpus is not None else None


def check_baseline(path: pathlib.Path | None, corpus: str, names: Collection[str]) -> None:
    """Check that a file, if it exists, is a baseline with some logs of these names. Raises ReplayError (E_BASELINE)."""
    if path is None or not path.exists():
        return
    logs = read_baseline(path).logs.keys()
    if logs and logs.isdisjoint(names):
        none = f"none of its {count(len(logs), 'log')} is in {corpus}"
        raise ReplayError(
            BASELINE_ERROR, f"{path}: is the baseline of another corpus: {none}; name another: --baseline"
        )


def write_baseline(path: str | os.PathLike[str], baseline: Baseline) -> None:
    """Write a baseline, whole or not at all, each result on a line of its own so that changes can be reviewed."""
    head: dict[str, Any] = plain(baseline)
    logs, options = head.pop("logs"), head.pop("settings")
    lines = ["{"] + [f" {json.dumps(key)}: {json.dumps(value)}," for key, value in sorted(head.items())]
    if options is not None:
        groups = [f"  {json.dumps(key)}: {_options_text(value)}" for key, value in sorted(options.items())]
        lines += [' "settings": {', ",\n".join(groups), " },"]
    lines.append(' "logs": {')
    lines += [",\n".join(_log_text(name, logs[name]) for name in sorted(logs)), " }", "}"]
    write_document(pathlib.Path(path), "\n".join(lines))


def _options_text(value: Any) -> str:
    """One group of options; those of each method on a line of their own."""
    if not isinstance(value, dict) or not any(isinstance(options, dict) for options in value.values()):
        return json.dumps(value, sort_keys=True)
    return "{\n" + ",\n".join(f"   {json.dumps(k)}: {json.dumps(v, sort_keys=True)}" for k, v in value.items()) + "}"


def _log_text(name: str, entry: dict[str, Any]) -> str:
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
