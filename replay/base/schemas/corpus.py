"""Declarations of a folder of logs about itself, schema `replay.corpus/1`: its `corpus.toml`."""

import fnmatch
from typing import Final, Literal

from msgspec import Struct, field

CORPUS_SCHEMA: Final = "replay.corpus/1"


class Known(Struct, frozen=True, kw_only=True, forbid_unknown_fields=True):
    """A known issue: patterns of where it shows, and a note."""

    log: str
    method: str = "*"
    key: str = "*"
    note: str = ""

    def concerns(self, log: str) -> bool:
        """Whether the issue may show on a log of that name."""
        return fnmatch.fnmatchcase(log, self.log)

    def covers(self, log: str, method: str, key: str) -> bool:
        """Whether a comparison of that log, method and key is this issue."""
        pairs = ((log, self.log), (method, self.method), (key, self.key))
        return all(fnmatch.fnmatchcase(word, pattern) for word, pattern in pairs)


class LogDeclaration(Struct, frozen=True, kw_only=True):
    """A table `[logs.NAME]`; other keys are notes."""

    kind: str = field(default="", name="class")
    expect: str = ""
    """improved, kept, or the code of the error with which the log is refused."""
    tags: tuple[str, ...] = ()
    methods: tuple[str, ...] | None = None
    """Methods to run on this log, instead of those of the folder."""


class CorpusList(Struct, frozen=True, kw_only=True):
    """The content of a `corpus.toml`; every part is optional."""

    schema: Literal["replay.corpus/1"] = CORPUS_SCHEMA
    methods: tuple[str, ...] = ()
    """Methods to run on the logs of this folder; all when empty."""
    logs: dict[str, LogDeclaration] = {}
    """Entries by the file's name without `.mcap`."""
    known: tuple[Known, ...] = ()
