"""What was odd about a file, told once each and not without end."""

from collections import Counter

from replay.base.errors import printable
from replay.logs.container.records import Finding

REPORTED_PER_CODE = 5
"""Findings with the same code that are told one by one; the others are counted."""


class Findings:
    """Collects findings in the order in which they are made."""

    def __init__(self) -> None:
        self._items: list[Finding] = []
        self._per_code: Counter[str] = Counter()
        self._losing: set[str] = set()

    def add(self, code: str, text: str, *, lost: bool = False) -> None:
        """Note a finding; `lost`: messages of the recording are missing because of it."""
        self._per_code[code] += 1
        if self._per_code[code] <= REPORTED_PER_CODE or (lost and code not in self._losing):
            self._items.append(Finding(code, printable(text, 400), lost))
        if lost:
            self._losing.add(code)

    def all(self) -> tuple[Finding, ...]:
        """The findings, and a line for each code of which some were only counted."""
        told = Counter(finding.code for finding in self._items)
        more = {code: count - told[code] for code, count in self._per_code.items() if count > told[code]}
        rest = [Finding(code, f"and {count} more of the same kind", False) for code, count in more.items()]
        return (*self._items, *rest)
