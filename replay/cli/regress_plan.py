"""What `replay regress` is to do, from its flags."""

import math

from optim.methods import METHODS
from replay.cli.options import UsageError
from replay.cli.settings import MOST_JOBS, RUN, Layer, settled
from replay.regress.corpus import Corpus
from replay.regress.settings import Recordings, Settings


def check_flags(time_limit: float, jobs: int) -> None:
    """Raises UsageError for a value out of range."""
    if not 0.0 < time_limit < math.inf:
        raise UsageError(f"--time-limit is {time_limit:g}, expected more than 0 s")
    if not 1 <= jobs <= MOST_JOBS:
        raise UsageError(f"--jobs is {jobs}, expected 1 to {MOST_JOBS}")


def settings_of(layers: list[Layer], corpus: Corpus, recordings: Recordings) -> tuple[Settings, tuple[str, ...]]:
    """The settings of a run, and the methods that were asked for: else those that the corpus names, else all."""
    made = settled(layers)
    named = made.run.method or ()
    if not named:
        wanted = dict.fromkeys(name for log in corpus.logs for name in log.methods or METHODS)
        made = settled([*layers, {RUN: {"method": tuple(wanted)}}])
    settings = Settings(
        methods=made.methods,
        read=made.read,
        weights=made.weights,
        seed=made.run.seed,
        time_limit=made.run.time_limit,
        memory_limit=made.run.memory_limit,
        recordings=recordings,
    )
    return settings, named
