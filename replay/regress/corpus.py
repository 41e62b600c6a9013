"""The logs of a corpus, and what the `corpus.toml` beside them declares about them.

A corpus is a folder (with everything below it), a glob, a text file with one path on each line, or an object store
(`s3://bucket/prefix`). A log's name is its path within the corpus without the suffix, such as `full/open_01`; results,
baseline and reports use that name. A `corpus.toml` is about the logs of its own folder alone, not of those below it.
In it, all of it optional:

    methods = ["ddp", "shortcut+scp"]   # methods to run here, instead of all

    [logs.bay_01]                       # by the file's name without suffix
    class = "bay"
    expect = "improved"                 # or "kept", or the code of the error with which it is refused, as E_NO_MAP
    tags = ["grid"]
    methods = ["ddp"]               # other keys are notes, unless they look like one of these misspelt

    [[known]]                           # a known issue: does not fail the run, and is reported once it has gone
    log = "bay_*"
    method = "scp"                      # all when absent, as is the key
    key = "objective"
    note = "why, and where it is being looked at"
"""

import difflib
import fnmatch
import glob
import os
import pathlib
import re
from collections.abc import Collection, Iterable, Mapping, Sequence
from dataclasses import dataclass, field
from typing import Any, Final

import msgspec

from replay.base.documents import DocumentError, convert, parse_toml
from replay.base.errors import ReplayError, printable
from replay.base.schemas.corpus import CorpusList, Known, LogDeclaration
from replay.base.strict_json import JsonError, read_text
from replay.regress.sources import STORES, find_objects

CORPUS_ERROR = "E_CORPUS"
LIST_NAME = "corpus.toml"
SUFFIX = ".mcap"
_LARGEST_LIST: Final = 64 * 2**20  # [bytes]
_ALIKE: Final = 0.7
"""Similarity from which a key is taken for another one misspelt [-]."""


@dataclass(frozen=True, kw_only=True)
class CorpusLog:
    """One log of a corpus and what is declared about it."""

    name: str
    path: str
    """Path of the file, or its address in an object store."""
    kind: str = ""
    """Class of the log."""
    expect: str = ""
    """improved, kept, or an error's code; empty where nothing is declared."""
    tags: tuple[str, ...] = ()
    methods: tuple[str, ...] = ()
    """Methods to run; all when empty."""
    declared: str = ""
    """Where its expectation, or else the log, is declared, as path:line; empty where it is not."""


@dataclass(frozen=True, kw_only=True)
class Corpus:
    """The logs of a corpus, by name, and its known issues."""

    path: str
    logs: tuple[CorpusLog, ...]
    known: tuple[Known, ...] = ()
    baseline: str | None = None
    """File of its baseline; None unless the corpus is a folder."""


def find_corpus(where: str) -> Corpus:
    """Find the corpus at a place. Raises ReplayError (E_CORPUS), one line, where there is none or its list is wrong."""
    if where.startswith(STORES):
        logs = {name: CorpusLog(name=name, path=path) for name, path in find_objects(where, SUFFIX)}
        return Corpus(path=where, logs=_sorted(logs, where))
    place = pathlib.Path(where)
    try:
        if place.is_dir():
            return _folder(place)
        if place.is_file() and place.suffix != SUFFIX:
            return _gathered(where, place.parent, _listed(place))
        if place.is_file():
            return _gathered(where, place.parent, [place])
        if glob.has_magic(where):
            paths = [path for path in map(pathlib.Path, sorted(glob.glob(where, recursive=True))) if path.is_file()]  # noqa: PTH207
            return _gathered(where, _root(where), paths)
    except (OSError, ValueError) as error:
        reason = getattr(error, "strerror", None) or str(error)
        raise ReplayError(CORPUS_ERROR, f"{where}: {reason}") from error
    expected = "expected a folder, a glob, a list of paths, a log, or s3://bucket/prefix"
    raise ReplayError(CORPUS_ERROR, f"{where}: no such corpus; {expected}")


def select(
    corpus: Corpus, methods: Sequence[str], tags: Sequence[str], patterns: Sequence[str]
) -> tuple[tuple[CorpusLog, ...], str]:
    """Select the logs that fit all that is asked for; the selection in words is empty for the whole corpus.

    A log that has methods of its own is left out where none of them is among `methods`. Raises ReplayError (E_CORPUS)
    where no log is left.
    """
    logs = [log for log in corpus.logs if _fits(log, methods, tags, patterns)]
    named = {"methods": methods, "tags": tags, "logs": patterns}
    words = "; ".join(f"{kind} {', '.join(values)}" for kind, values in named.items() if values)
    if not logs:
        known = sorted({word for log in corpus.logs for word in (log.kind, *log.tags) if word})
        there = f"; tags and classes there are: {', '.join(known) or 'none, corpus.toml gives them'}" if tags else ""
        raise ReplayError(CORPUS_ERROR, f"{corpus.path}: no log is left of {len(corpus.logs)} with {words}{there}")
    return tuple(logs), words


def _fits(log: CorpusLog, methods: Sequence[str], tags: Sequence[str], patterns: Sequence[str]) -> bool:
    if methods and log.methods and not set(methods) & set(log.methods):
        return False
    if tags and not set(tags) & {log.kind, *log.tags}:
        return False
    return not patterns or any(fnmatch.fnmatchcase(log.name, pattern) for pattern in patterns)


def _folder(place: pathlib.Path) -> Corpus:
    """All logs below a folder, and those that its lists name although they are not there."""
    logs: dict[str, CorpusLog] = {}
    known: list[Known] = []
    for folder, below, files in os.walk(place):
        below[:] = sorted(name for name in below if not name.startswith("."))
        here = pathlib.Path(folder)
        declared = read_list(here / LIST_NAME)
        prefix = "" if here == place else here.relative_to(place).as_posix() + "/"
        stems = {pathlib.PurePath(name).stem for name in files if name.endswith(SUFFIX) and not name.startswith(".")}
        for stem in stems | declared.content.logs.keys():
            logs[prefix + stem] = declared.log(stem, str(here / (stem + SUFFIX)), prefix)
        known += declared.issues(prefix)
    baseline = str(place / "baseline.json")
    return Corpus(path=str(place), logs=_sorted(logs, str(place)), known=tuple(known), baseline=baseline)


def _gathered(where: str, root: pathlib.Path, paths: Iterable[pathlib.Path]) -> Corpus:
    """Single logs, with what the list beside each declares."""
    lists: dict[pathlib.Path, _Declared] = {}
    logs: dict[str, CorpusLog] = {}
    known: dict[Known, None] = {}
    for path in paths:
        try:
            relative = path.relative_to(root)
        except ValueError:
            relative = pathlib.Path(path.name)
        name = relative.with_suffix("").as_posix()
        if name in logs and logs[name].path != str(path):
            raise ValueError(f"{logs[name].path} and {path} would both be called {name}")
        if path.parent not in lists:
            lists[path.parent] = read_list(path.parent / LIST_NAME)
        prefix = name.removesuffix(path.stem)
        logs[name] = lists[path.parent].log(path.stem, str(path), prefix)
        known |= dict.fromkeys(lists[path.parent].issues(prefix))
    return Corpus(path=where, logs=_sorted(logs, where), known=tuple(known))


def _sorted(logs: Mapping[str, CorpusLog], where: str) -> tuple[CorpusLog, ...]:
    if not logs:
        raise ReplayError(CORPUS_ERROR, f"{where}: holds no log (*{SUFFIX})")
    return tuple(logs[name] for name in sorted(logs))


def _listed(path: pathlib.Path) -> list[pathlib.Path]:
    """Paths in a file, relative to its folder; empty lines and lines that begin with # are ignored."""
    if path.stat().st_size > _LARGEST_LIST:
        raise ValueError(f"larger than {_LARGEST_LIST} bytes")
    lines = [line.strip() for line in path.read_text("utf-8").splitlines()]
    paths = [path.parent / line for line in lines if line and not line.startswith("#")]
    if paths and not any(file.is_file() for file in paths):
        raise ValueError(f"none of its lines ({len(paths)}) is the path of a file, as {printable(paths[0])}")
    return paths


def _root(pattern: str) -> pathlib.Path:
    """The part of a glob before its first wildcard."""
    parts = pathlib.PurePath(pattern).parts
    plain = next(i for i, part in enumerate(parts) if glob.has_magic(part))
    return pathlib.Path(*parts[:plain])


@dataclass(frozen=True, kw_only=True)
class _Declared:
    """One `corpus.toml`, and where in it the logs are declared."""

    content: CorpusList = field(default_factory=CorpusList)
    path: str = ""
    lines: Mapping[str, int] = field(default_factory=dict)
    """Line of each log's expectation, or else of its table."""

    def log(self, stem: str, path: str, prefix: str = "") -> CorpusLog:
        """A log of the list's folder; its name within the corpus begins with `prefix`."""
        entry = self.content.logs.get(stem)
        declared = f"{self.path}:{self.lines.get(stem, 1)}" if entry is not None else ""
        entry = entry or LogDeclaration()
        return CorpusLog(
            name=prefix + stem,
            path=path,
            kind=entry.kind,
            expect=entry.expect,
            tags=entry.tags,
            methods=self.content.methods if entry.methods is None else entry.methods,
            declared=declared,
        )

    def issues(self, prefix: str) -> list[Known]:
        """The known issues, with patterns of names within the whole corpus."""
        escaped = glob.escape(prefix)
        return [msgspec.structs.replace(issue, log=escaped + issue.log) for issue in self.content.known]


def read_list(path: pathlib.Path) -> _Declared:
    """Read a `corpus.toml`; an empty one where there is none. Raises ReplayError (E_CORPUS), one line."""
    if not path.exists():
        return _Declared()
    try:
        text = read_text(path, _LARGEST_LIST)
        return _Declared(content=_list(parse_toml(text)), path=str(path), lines=_lines(text))
    except (JsonError, DocumentError, ValueError) as error:
        raise ReplayError(CORPUS_ERROR, f"{path}: {error}") from error


def _lines(text: str) -> dict[str, int]:
    """Line numbers by the names of logs: of the expectation, or else of the log's table."""
    found: dict[str, int] = {}
    name = ""
    for number, line in enumerate(text.splitlines(), 1):
        if head := re.match(r"""\s*\[\s*logs\s*\.\s*["']?(.*?)["']?\s*\]""", line):
            name = head[1]
            found[name] = number
        elif line.lstrip().startswith("["):
            name = ""
        elif name and re.match(r"\s*expect\s*=", line):
            found[name] = number
    return found


def _list(data: Mapping[str, Any]) -> CorpusList:
    """The list that a TOML document holds. Raises DocumentError, ValueError."""
    _check_keys(data, _keys(CorpusList), "")
    found = convert(data, CorpusList)
    for name in found.logs:
        if "/" in name:
            folder, _, stem = name.rpartition("/")
            where = f"[logs.{stem}] in {folder}/{LIST_NAME}"
            raise ValueError(f"logs.{name!r}: this file is about the logs of its own folder alone; expected {where}")
        _check_keys(data["logs"][name], _keys(LogDeclaration), f"logs.{name}.")
    return found


def _keys(kind: type[msgspec.Struct]) -> list[str]:
    return [field.encode_name for field in msgspec.structs.fields(kind)]


def _check_keys(table: Iterable[str], keys: Collection[str], where: str) -> None:
    """Refuse a key that looks like one of these misspelt; all others are notes for people."""
    for key in table:
        nearest = difflib.get_close_matches(key, keys, n=1, cutoff=_ALIKE)
        if nearest and key not in keys:
            raise ValueError(f"unknown key {where}{key}. Did you mean {nearest[0]!r}? There are: {', '.join(keys)}")
