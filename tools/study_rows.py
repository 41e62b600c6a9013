"""The measured rows of the study by log and method, and what is asked of them."""

import math
from collections.abc import Iterable, Sequence
from typing import Any

import numpy as np

METHODS = ("shortcut", "cpo", "ddp", "scp", "nlp")
Row = dict[str, Any]


class Rows:
    """The measured rows by log and method."""

    def __init__(self, rows: Sequence[Row]) -> None:
        self.by = {(row["log"], row["method"]): row for row in rows if row["status"] != "unreadable"}
        self.unreadable = [row for row in rows if row["status"] == "unreadable"]
        self.logs = sorted({log for log, _ in self.by})
        self.classes = sorted({row["class"] for row in self.by.values()})

    def of(self, kind: str) -> list[str]:
        """Logs of a class."""
        return [log for log in self.logs if self.by[log, "recorded"]["class"] == kind]

    def value(self, log: str, method: str, key: str = "objective") -> float:
        """A metric of the path that a method ends with, which is the recorded one unless it improved."""
        return float(self.by[log, method]["metrics"][key])

    def ratio(self, logs: Iterable[str], method: str, before: str = "recorded", key: str = "objective") -> float:
        """Geometric mean over logs of a metric over that of another method; nan without logs."""
        ratios = [self.value(log, method, key) / self.value(log, before, key) for log in logs]
        return math.exp(float(np.mean(np.log(ratios)))) if ratios else math.nan

    def improved(self, logs: Iterable[str], method: str) -> int:
        """Number of logs on which a method ends `improved`."""
        return sum(self.by[log, method]["status"] == "improved" for log in logs)

    def median(self, logs: Iterable[str], method: str, key: str) -> float:
        """Median over logs of what a method's rows hold under a key, such as `wall_s`."""
        return float(np.median([self.by[log, method][key] for log in logs]))


def table(header: Sequence[str], lines: Iterable[Sequence[str]]) -> str:
    """A Markdown table, its first column to the left."""
    rule = "|---|" + "--:|" * (len(header) - 1)
    return "\n".join(["| " + " | ".join(header) + " |", rule, *("| " + " | ".join(line) + " |" for line in lines)])
