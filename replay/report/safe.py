"""Texts of documents made safe for every report: what files contribute cannot forge a line, hide text or flood a page.

Whoever writes a run's files may be somebody else, so this happens once, when they are read.
"""

import json
from typing import Any, TypeVar

import msgspec

from replay.base.documents import plain
from replay.base.errors import printable

LONGEST_NAME = 200
LONGEST_TEXT = 500
"""Characters of a reason or an error."""
LONGEST_COMMAND = 4000
"""Characters of a command: one that is cut cannot be pasted."""
_MOST_LINES = 40
_LONGEST: dict[str, int] = dict.fromkeys(
    ("reason", "message", "note", "recording_error", "other_options"), LONGEST_TEXT
)
_LONGEST |= dict.fromkeys(("accept", "view", "recording"), LONGEST_COMMAND)
"""Characters that the fields of documents may have, by name; others have `LONGEST_NAME`."""
_T = TypeVar("_T")


def safe(value: _T, limit: int = LONGEST_NAME) -> _T:
    """Copy a document, or a part of one, with every text made printable and cut."""
    copy: Any = value
    if isinstance(value, str):
        copy = printable(value, limit)
    elif isinstance(value, msgspec.Struct):
        fields = {name: getattr(value, name) for name in value.__struct_fields__}
        copy = type(value)(**{name: _field(name, entry) for name, entry in fields.items()})
    elif isinstance(value, dict):
        copy = {safe(key): safe(entry, limit) for key, entry in value.items()}
    elif isinstance(value, (list, tuple)):
        copy = type(value)(safe(entry, limit) for entry in value)
    return copy


def _field(name: str, value: Any) -> Any:
    if name == "traceback" and isinstance(value, str):
        return "\n".join(printable(line, LONGEST_NAME) for line in value.splitlines()[-_MOST_LINES:])
    return safe(value, _LONGEST.get(name, LONGEST_NAME))


def facts(data: object, prefix: str = "") -> dict[str, str]:
    """The values of an object as text, at whatever depth, by their keys joined with dots."""
    found: dict[str, str] = {}
    entries = plain(data)
    for key, value in entries.items() if isinstance(entries, dict) else ():
        name = prefix + printable(key, LONGEST_NAME)
        if isinstance(value, dict):
            found |= facts(value, f"{name}.")
        else:
            words = value if isinstance(value, str) else json.dumps(value, ensure_ascii=False)
            found[name] = printable("none" if value is None else words, LONGEST_TEXT)
    return found
