"""Places of the files of a run: names that never collide and never overwrite an input."""

import dataclasses
import os
import pathlib
from collections.abc import Sequence

from replay.base.errors import UsageError
from replay.run.case import Case


@dataclasses.dataclass(frozen=True, kw_only=True)
class Names:
    """The files of one case."""

    results: pathlib.Path
    recording: pathlib.Path


class Outputs:
    """The folder of a command's files. Raises UsageError, before any work, where files could not be written."""

    def __init__(
        self, folder: pathlib.Path, inputs: Sequence[pathlib.Path], others: Sequence[pathlib.Path] = ()
    ) -> None:
        """`inputs` are the logs, which give files their names; `others` are read too, and not overwritten either."""
        self.folder = folder
        self._inputs = [path.resolve() for path in (*inputs, *others)]
        self._taken: set[str] = set()
        stems: dict[str, pathlib.Path] = {}
        for path in inputs:
            other = stems.setdefault(path.stem, path)
            if other is not path:
                raise UsageError(f"{other} and {path} would both be written as {path.stem}.*: give them one --out each")
        try:
            folder.mkdir(parents=True, exist_ok=True)
        except OSError as error:
            is_file = folder.exists() and not folder.is_dir()
            reason = "it is a file, expected a folder" if is_file else f"the folder cannot be made: {error.strerror}"
            raise UsageError(f"--out {folder}: {reason}; choose one that you may write to, as in --out out") from error
        if not os.access(folder, os.W_OK | os.X_OK):
            raise UsageError(f"--out {folder}: no permission to write there; choose another, as in --out out")

    def names(self, case: Case, num_cases: int) -> Names:
        """The files of one of a log's cases; the number of the request is in the name where there are several."""
        stem, _, number = case.name.rpartition("/")
        stem = f"{stem}-{number}" if num_cases > 1 else stem
        if stem in self._taken:
            raise UsageError(f"{case.name}: {stem}.* is already written for another log: give them one --out each")
        self._taken.add(stem)
        self._refuse_input(case.name, self.folder / f"{stem}.results.json", self.folder / f"{stem}.rrd")
        return Names(results=self.folder / f"{stem}.results.json", recording=self.folder / f"{stem}.rrd")

    def export(self, log: pathlib.Path) -> pathlib.Path:
        """The copy of a log with the paths of all of its cases: a file, or a folder as the log is one."""
        path = self.folder / (f"{log.name}.optimised" if log.is_dir() else f"{log.stem}.optimised.mcap")
        self._refuse_input(str(log), path)
        return path

    def _refuse_input(self, what: str, *paths: pathlib.Path) -> None:
        for path in paths:
            if path.resolve() in self._inputs:
                raise UsageError(f"{what}: {path} is an input and will not be overwritten: choose another --out")
