"""Output of `replay regress` for people: verdict on a run, changes of a baseline, times, commands to paste."""

import sys
from collections.abc import Iterator, Sequence

from rich.table import Table

from replay.base.errors import printable
from replay.base.numbers import count, shown
from replay.base.schemas.run import Commands
from replay.base.schemas.timing import TimeRatio, TimingDocument
from replay.base.schemas.verdicts import Comparison
from replay.cli.console import Voice
from replay.cli.invoked import recordings_to_paste, to_paste
from replay.regress.folder import RunFolder
from replay.regress.plan import Plan
from replay.regress.timing import ALARM, LEAST_PAIRS
from replay.report.conclusion import Conclusion

_PARTIAL = ("--method", "--tag", "--only")
"""Flags that leave a part of the corpus out."""
_FIRST_BASELINE = "baseline.json"
"""Name proposed for the first baseline of a corpus that is not a folder."""
_MOST_HINTS = 5
_LONGEST = 60


def show_conclusion(voice: Voice, folder: RunFolder, found: Conclusion) -> None:
    """Show the verdict on a run and its reasons."""
    voice.show(found.headline)
    voice.show(*(f"  {line}" for line in found.failing))
    if found.failing_more:
        voice.show(f"  and {found.failing_more} more")
    voice.show(*(f"  known: {line}" for line in found.known), *(f"  {line}" for line in found.passing))
    for line in (*found.unread, *(f"left out: {line}" for line in found.damaged)):
        voice.error(line)
    for line in filter(None, (found.other_options, found.unwritten, found.equal)):
        voice.note(line)
    voice.show(f"report: {folder.path / 'report.html'}")


def show_advice(voice: Voice, plan: Plan, folder: RunFolder, found: Conclusion) -> None:
    """Show what to do about a run."""
    for line in found.against_corpus[:_MOST_HINTS]:
        voice.note(f"{line}: if the result is correct, change `expect` there; accepting the run does not help")
    if found.state == "unjudged" or found.acceptable:
        voice.note(_advice(plan, folder, found.state))


def commands(plan: Plan, folder: RunFolder) -> Commands:
    """Command lines that the reports of a run give to paste."""
    return Commands(accept=_accept(plan, folder), view=recordings_to_paste(folder.path / "recordings"))


def _accept(plan: Plan, folder: RunFolder) -> str:
    """The command that makes a run the baseline; empty for a partial one."""
    if plan.partial:
        return ""
    words = ["regress", "accept", str(folder.path)]
    return to_paste(*words) if plan.baseline is not None else to_paste(*words, "--baseline", _FIRST_BASELINE)


def _advice(plan: Plan, folder: RunFolder, state: str) -> str:
    if plan.partial:
        return f"a partial run ({plan.partial}) cannot become the baseline; the whole: {_whole()}"
    why = "if this is intended" if state == "failed" else "there is no baseline yet; to make this run the baseline"
    named = "" if plan.baseline is not None else f" (and give it to later runs: --baseline {_FIRST_BASELINE})"
    return f"{why}{named}: {_accept(plan, folder)}"


def _whole() -> str:
    """This command without the flags that make its run partial."""
    kept, words = list[str](), iter(sys.argv[1:])
    for word in words:
        flag, sign, _ = word.partition("=")
        if flag in _PARTIAL and not sign:
            next(words, "")
        if flag not in (*_PARTIAL, "--resume"):
            kept.append(word)
    return to_paste(*kept)


def again() -> str:
    """The command that does the rest of this run."""
    return to_paste(*(word for word in sys.argv[1:] if word != "--resume"), "--resume")


def changes_of_baseline(changes: Sequence[Comparison]) -> Iterator[Table | str]:
    """Every changed figure as a row; counts of what is new, whose figures are lines of the baseline."""
    changed = [change for change in changes if change.verdict != "new"]
    if changed:
        yield _changes(changed)
    new = [change for change in changes if change.verdict == "new"]
    if new:
        results = {(change.case, change.method) for change in new if change.method}
        refused = [change for change in new if not change.method]
        words = [count(len(results), "result")] if results else []
        words += [f"{count(len(refused), 'log')} that cannot be read"] if refused else []
        logs = count(len({change.log for change in new}), "log")
        yield f"new: {' and '.join(words)}, in {count(len(new), 'figure')} of {logs}"


def _changes(changed: Sequence[Comparison]) -> Table:
    table = Table(box=None, pad_edge=False)
    for heading in ("verdict", "case", "method", "figure", "before", "after"):
        is_number = heading in ("before", "after")
        table.add_column(heading, justify="right" if is_number else "left", overflow="fold")
    for change in changed:
        values = (shown(change.before, 7), shown(change.after, 7))
        words = (change.verdict, change.case or change.log, change.method, change.key, *values)
        table.add_row(*(printable(word, _LONGEST) for word in words))
    return table


def show_timing(voice: Voice, found: TimingDocument) -> None:
    """Show the ratios of times by method, and what they amount to."""
    table = Table(box=None, pad_edge=False)
    for heading in ("method", "new / old", "95 % interval", "logs"):
        table.add_column(heading, justify="left" if heading == "method" else "right", no_wrap=True)
    for method, each in found.compared.items():
        interval = "–" if each.low is None else f"{each.low:.3f} to {each.high:.3f}"
        table.add_row(printable(method, _LONGEST), f"{each.ratio:.3f}", interval, str(each.pairs))
    voice.show(table, f"timed against {found.against}: {_slower(found.compared)}")


def _slower(found: dict[str, TimeRatio]) -> str:
    slower = [method for method, each in found.items() if each.alarm]
    if not found:
        return "both versions have nothing in common that can be timed"
    if slower:
        return f"slower: {', '.join(slower)} (the whole interval lies above {ALARM})"
    if all(each.low is None for each in found.values()):
        return f"no verdict: at least {LEAST_PAIRS} logs are needed"
    return f"not slower (no interval lies above {ALARM})"
