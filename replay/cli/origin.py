"""The earlier run that `replay optimize --from RESULTS` repeats: its log, its request, the program that made it."""

import dataclasses
import pathlib
from collections.abc import Sequence

from replay.base.errors import LogError, UsageError
from replay.base.schemas.results import ResultsDocument, ToolDocument
from replay.run.case import Case
from replay.run.results import program


@dataclasses.dataclass(frozen=True, kw_only=True)
class Origin:
    """The earlier run that is repeated."""

    source: str
    """The results file."""
    sha256: str
    """Digest of its log."""
    case: str
    """Its request, as STEM/0."""
    tool: ToolDocument
    """The program that made it."""

    @classmethod
    def of(cls, document: ResultsDocument, source: pathlib.Path) -> "Origin":
        """Make the origin from a results document."""
        return cls(source=str(source), sha256=document.log.sha256, case=document.log.case, tool=document.tool)

    def chosen(self, cases: Sequence[Case]) -> list[Case]:
        """The same request of the same log. Raises ReplayError where it is another log, or has no such request."""
        first = cases[0]
        if first.sha256 != self.sha256:
            found = f"its digest is {first.sha256[:12]}…, and {self.source} was made from {self.sha256[:12]}…"
            raise LogError("E_OTHER_LOG", first.log, f"{found}: another log")
        number = self.case.rpartition("/")[2]
        same = [case for case in cases if case.name.rpartition("/")[2] == number]
        if not same:
            raise LogError("E_OTHER_LOG", first.log, f"it has no request {number}, which {self.source} is of")
        return same

    @property
    def differences(self) -> list[str]:
        """Programs of another version than then: numbers may differ."""
        now = program()
        then = {"replay": self.tool.version, **self.tool.packages}
        here = {"replay": now.version, **now.packages}
        return [f"{name} {then[name]} then, {here[name]} now" for name in here if then.get(name) != here[name]]


def same_log(logs: list[pathlib.Path], document: ResultsDocument, source: pathlib.Path) -> pathlib.Path:
    """The log of a results file: the one that was given, else where it was then, else beside the results file."""
    if len(logs) > 1:
        raise UsageError(f"--from repeats the run of one log, and {len(logs)} logs are given")
    if logs:
        return logs[0]
    then = pathlib.Path(document.log.path)
    for path in (then, source.parent / then, source.parent / then.name):
        if path.is_file():
            return path
    raise UsageError(f"--from {source}: its log {then} is missing; give the path of the log as well")
