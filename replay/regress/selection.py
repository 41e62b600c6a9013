"""Which logs of a corpus a run works on, and how that is said."""

import fnmatch
from collections.abc import Sequence

from replay.base.errors import ReplayError
from replay.regress.corpus import CORPUS_ERROR, Corpus, Log


def select(
    corpus: Corpus, methods: Sequence[str], tags: Sequence[str], patterns: Sequence[str]
) -> tuple[tuple[Log, ...], str]:
    """The logs that fit all that is asked for, and the selection in words (empty for the whole corpus).

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


def _fits(log: Log, methods: Sequence[str], tags: Sequence[str], patterns: Sequence[str]) -> bool:
    if methods and log.methods and not set(methods) & set(log.methods):
        return False
    if tags and not set(tags) & {log.kind, *log.tags}:
        return False
    return not patterns or any(fnmatch.fnmatchcase(log.name, pattern) for pattern in patterns)
