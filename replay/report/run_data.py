"""A regression run as its reports need it: the documents of its folder, put together."""

from collections.abc import Sequence
from dataclasses import dataclass

from replay.base.schemas.log import MethodResult, Recorded
from replay.base.schemas.run import RunHead
from replay.base.schemas.summary import Change, MethodTiming, UnreadLog
from replay.base.schemas.verdicts import FAILING


@dataclass(frozen=True, kw_only=True)
class ResultRow:
    """The result of one method on one case."""

    log: str
    case: str
    kind: str
    """Class of the log."""
    tags: tuple[str, ...]
    sha256: str
    recorded: Recorded
    result: MethodResult
    recording: str | None
    """Path of the case's recording within the run's folder, where the file exists."""
    recording_error: str
    """Reason why the recording could not be written; empty where it could, or was not wanted."""

    @property
    def method(self) -> str:
        """Name of the method."""
        return self.result.name


@dataclass(frozen=True, kw_only=True)
class RunData:
    """One regression run. All texts are safe to print: invisible characters escaped, long ones cut."""

    name: str
    """Name of its folder."""
    head: RunHead
    methods: tuple[str, ...]
    """Methods that the head names, and others that have results."""
    rows: tuple[ResultRow, ...]
    errors: tuple[UnreadLog, ...]
    changes: tuple[Change, ...]
    """All comparisons, those that say "same" too."""
    compared: bool
    """Whether the run was compared with a baseline."""
    against: str
    """Version that this one was timed against; empty where it was not."""
    timing: tuple[MethodTiming, ...]
    damaged: tuple[str, ...]
    """Files of the run that cannot be read, one line each."""

    @property
    def logs(self) -> list[str]:
        """Names of the logs that were worked on, unread ones included."""
        return sorted({row.log for row in self.rows} | {error.log for error in self.errors})

    @property
    def unexpected(self) -> Sequence[UnreadLog]:
        """Logs that could not be read although nothing announces it."""
        return [error for error in self.errors if not error.expected]

    @property
    def unwritten(self) -> dict[str, str]:
        """Reasons why recordings could not be written, by case."""
        return {row.case: row.recording_error for row in self.rows if row.recording_error}

    @property
    def slower(self) -> list[str]:
        """Methods that are slower for certain than in the other version; "all" is one."""
        return [each.method for each in self.timing if each.slower]

    @property
    def failing(self) -> list[Change]:
        """Changes with which the run fails."""
        return [change for change in self.changes if change.verdict in FAILING]
