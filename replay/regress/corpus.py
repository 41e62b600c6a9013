"""Which logs a run works on, and what is declared of them in the `corpus.toml` beside them.

A corpus is a folder (with everything below it), a glob, a text file with one path on each line, or an object store
(`s3://bucket/prefix`). A log's name is its path within the corpus without the suffix, such as `full/open_01`; results,
baseline and reports know it by that name. A `corpus.toml` is about the logs of its own folder alone, not of those below
it. In it, all of it optional:

    methods = ["ddp", "shortcut+scp"]   # what is run here, instead of all methods

    [logs.bay_01]                       # by the file's name without suffix
    class = "bay"
    expect = "improved"                 # or "kept", or the code of the error with which it is refused, as E_NO_MAP
    tags = ["grid"]
    methods = ["ddp"]               # other keys are notes, unless they look like one of these misspelt

    [[known]]                           # a known issue: does not fail the run, and is told when it has gone
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
import tomllib
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, field
from typing import Any

from replay.base.errors import ReplayError, printable

CORPUS_ERROR = "E_CORPUS"
LIST_NAME = "corpus.toml"
SCHEMA = "replay.corpus/1"
SUFFIX = ".mcap"
STORES = ("s3://",)
"""Object stores that can hold a corpus."""
_LARGEST_LIST = 64 * 2**20  # [bytes]


@dataclass(frozen=True, kw_only=True)
class Known:
    """A known issue: where it shows, as patterns, and what is known of it."""

    log: str
    method: str = "*"
    key: str = "*"
    note: str = ""

    def concerns(self, log: str) -> bool:
        """Whether it may show on a log of that name."""
        return fnmatch.fnmatchcase(log, self.log)

    def covers(self, log: str, method: str, key: str) -> bool:
        """Whether a finding of that place is this issue."""
        pairs = ((log, self.log), (method, self.method), (key, self.key))
        return all(fnmatch.fnmatchcase(word, pattern) for word, pattern in pairs)


@dataclass(frozen=True, kw_only=True)
class Log:
    """One log of a corpus and what is declared of it."""

    name: str
    path: str
    """Of the file, or its address in an object store."""
    kind: str = ""
    """Its class."""
    expect: str = ""
    """improved, kept, or an error's code; empty where nothing is declared."""
    tags: tuple[str, ...] = ()
    methods: tuple[str, ...] = ()
    """Those to be run; empty for all."""
    declared: str = ""
    """Where its expectation, or else the log, is declared, as path:line; empty where it is not."""


@dataclass(frozen=True, kw_only=True)
class Corpus:
    """The logs of a corpus, by name, and its known issues."""

    path: str
    logs: tuple[Log, ...]
    known: tuple[Known, ...] = ()
    baseline: str | None = None
    """Where its baseline is kept, if it is a folder."""


def find_corpus(where: str) -> Corpus:
    """The corpus at a place. ReplayError (E_CORPUS), one line, where there is none or its list is wrong."""
    if where.startswith(STORES):
        from replay.regress.stores import find_objects  # fsspec is in the extra `s3`

        found = find_objects(where, SUFFIX)
        return Corpus(path=where, logs=_named({name: _Declared().log(name, path) for name, path in found}, where))
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


def _folder(place: pathlib.Path) -> Corpus:
    """All logs below a folder, and those that its lists name although they are not there."""
    logs: dict[str, Log] = {}
    known: list[Known] = []
    for folder, below, files in os.walk(place):
        below[:] = sorted(name for name in below if not name.startswith("."))
        here = pathlib.Path(folder)
        declared = read_list(here / LIST_NAME)
        prefix = "" if here == place else here.relative_to(place).as_posix() + "/"
        stems = {pathlib.PurePath(name).stem for name in files if name.endswith(SUFFIX) and not name.startswith(".")}
        for stem in stems | declared.logs.keys():
            logs[prefix + stem] = declared.log(stem, str(here / (stem + SUFFIX)), prefix)
        known += declared.issues(prefix)
    baseline = str(place / "baseline.json")
    return Corpus(path=str(place), logs=_named(logs, str(place)), known=tuple(known), baseline=baseline)


def _gathered(where: str, root: pathlib.Path, paths: Iterable[pathlib.Path]) -> Corpus:
    """Single logs, with what the list beside each declares."""
    lists: dict[pathlib.Path, _Declared] = {}
    logs: dict[str, Log] = {}
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
    return Corpus(path=where, logs=_named(logs, where), known=tuple(known))


def _named(logs: Mapping[str, Log], where: str) -> tuple[Log, ...]:
    if not logs:
        raise ReplayError(CORPUS_ERROR, f"{where}: holds no log (*{SUFFIX})")
    return tuple(logs[name] for name in sorted(logs))


def _listed(path: pathlib.Path) -> list[pathlib.Path]:
    """Paths in a file, relative to its folder; empty lines and those that begin with # are left out."""
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
    """What one `corpus.toml` says."""

    logs: Mapping[str, Mapping[str, Any]] = field(default_factory=dict)
    known: Sequence[Known] = ()
    methods: tuple[str, ...] = ()
    path: str = ""
    lines: Mapping[str, int] = field(default_factory=dict)
    """Of each log's expectation, or else of its table."""

    def log(self, stem: str, path: str, prefix: str = "") -> Log:
        entry = self.logs.get(stem, {})
        return Log(
            name=prefix + stem,
            path=path,
            kind=entry.get("class", ""),
            expect=entry.get("expect", ""),
            tags=tuple(entry.get("tags", ())),
            methods=tuple(entry.get("methods", self.methods)),
            declared=f"{self.path}:{self.lines.get(stem, 1)}" if stem in self.logs else "",
        )

    def issues(self, prefix: str) -> list[Known]:
        """The known issues, with patterns of names within the whole corpus."""
        escaped = glob.escape(prefix)
        return [Known(log=escaped + k.log, method=k.method, key=k.key, note=k.note) for k in self.known]


_TOP = ("schema", "methods", "logs", "known")
_ALIKE = 0.7
"""Likeness from which a key is taken for another one misspelt [-]."""
_ENTRY: Mapping[str, type] = {"class": str, "expect": str, "tags": list, "methods": list}
_KNOWN: Mapping[str, type] = {"log": str, "method": str, "key": str, "note": str}


def read_list(path: pathlib.Path) -> _Declared:
    """What a `corpus.toml` declares; nothing where there is none. ReplayError (E_CORPUS) for one that is wrong."""
    try:
        content = path.read_bytes()
    except (FileNotFoundError, NotADirectoryError):
        return _Declared()
    except OSError as error:
        raise ReplayError(CORPUS_ERROR, f"{path}: {error.strerror}") from error
    try:
        text = content.decode("utf-8")
        return _declared(tomllib.loads(text), str(path), _lines(text))
    except (tomllib.TOMLDecodeError, UnicodeDecodeError) as error:
        raise ReplayError(CORPUS_ERROR, f"{path}: not TOML: {error}") from error
    except ValueError as error:
        raise ReplayError(CORPUS_ERROR, f"{path}: {error}") from error


def _lines(text: str) -> dict[str, int]:
    """By the names of logs, the number of the line that says what is expected of it, or else of its table."""
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


def _declared(document: Mapping[str, Any], path: str, lines: Mapping[str, int]) -> _Declared:
    _no_slips(document, _TOP, "")
    if document.get("schema", SCHEMA) != SCHEMA:
        raise ValueError(f"schema is {printable(document['schema'], 60)!r}, expected {SCHEMA!r}")
    logs = _typed(document, "logs", dict, {})
    for name, entry in logs.items():
        if not isinstance(entry, dict):
            raise ValueError(f"logs.{name} is a {type(entry).__name__}, expected a table")
        if "/" in name:
            folder, _, stem = name.rpartition("/")
            where = f"[logs.{stem}] in {folder}/{LIST_NAME}"
            raise ValueError(f"logs.{name!r}: this file is about the logs of its own folder alone; expected {where}")
        _no_slips(entry, _ENTRY, f"logs.{name}.")
        for key, kind in _ENTRY.items():
            _words(_typed(entry, key, kind, kind(), f"logs.{name}."), f"logs.{name}.{key}")
    methods = _typed(document, "methods", list, [])
    _words(methods, "methods")
    known = [_issue(entry) for entry in _typed(document, "known", list, [])]
    return _Declared(logs=logs, known=known, methods=tuple(methods), path=path, lines=lines)


def _no_slips(table: Mapping[str, Any], keys: Iterable[str], where: str) -> None:
    """Refuse a key that is one of these misspelt; all others are notes for people."""
    for key in table:
        nearest = difflib.get_close_matches(key, keys, n=1, cutoff=_ALIKE)
        if nearest and key not in keys:
            raise ValueError(f"unknown key {where}{key}. Did you mean {nearest[0]!r}? There are: {', '.join(keys)}")


def _issue(entry: Any) -> Known:
    if not isinstance(entry, dict) or "log" not in entry:
        raise ValueError("a known issue has no log: expected [[known]] with log, and method, key, note where needed")
    for key, value in entry.items():
        if key not in _KNOWN or not isinstance(value, str):
            raise ValueError(f"known.{key} = {value!r}: expected texts for {', '.join(_KNOWN)}")
    return Known(**entry)


def _typed(data: Mapping[str, Any], key: str, kind: type, default: Any, where: str = "") -> Any:
    value = data.get(key, default)
    if not isinstance(value, kind):
        raise ValueError(f"{where}{key} is a {type(value).__name__}, expected a {kind.__name__}")
    return value


def _words(value: Any, where: str) -> None:
    if isinstance(value, list) and not all(isinstance(word, str) for word in value):
        raise ValueError(f"{where} holds what is no text")
