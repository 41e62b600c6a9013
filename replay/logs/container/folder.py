"""A log that is a folder: what rosbag2 records, parts in MCAP and a `metadata.yaml` that lists them.

That file is a hint for the order of the parts and for parts that are missing; what counts is in the parts.
"""

import dataclasses
import hashlib
import os
import re
from collections import Counter
from collections.abc import Callable
from pathlib import Path
from typing import Final

from replay.base.errors import LogError, printable
from replay.logs.container.log import Channel, Finding, Log, Message, ReadLimits
from replay.logs.container.log_bytes import not_a_file
from replay.logs.container.scan import scan

METADATA: Final = "metadata.yaml"
MAX_METADATA: Final = 1 << 20
"""Longest `metadata.yaml` [bytes]."""
MAX_PARTS: Final = 1000
_ITEM = re.compile(r"\s*-\s+(.*)")


def open_log(path: str | os.PathLike[str], wanted: Callable[[Channel], bool], limits: ReadLimits | None = None) -> Log:
    """Read a log, a file or a folder of rosbag2's, and keep the messages of wanted channels.

    Raises:
        LogError: as `scan` does, or a folder that is not a bag.
    """
    path = Path(path)
    if not path.is_dir():
        return scan(path, wanted, limits)
    names, findings = parts_of(path)
    limits = limits or ReadLimits()
    logs: list[Log] = []
    errors: list[LogError] = []
    kept = 0
    for name in names:
        try:
            part = scan(path / name, wanted, dataclasses.replace(limits, kept=limits.kept - kept))
        except LogError as error:
            if error.code == "E_TOO_LARGE":
                raise
            errors.append(error)
            findings.append(Finding(error.code, f"part {printable(name, 100)} is lost: {error.message}", True))
            continue
        kept += sum(len(message.data) for message in part.messages)
        findings += [finding._replace(text=f"part {printable(name, 100)}: {finding.text}") for finding in part.findings]
        logs.append(part)
    if not logs:
        raise errors[0]
    return _joined(path, logs, findings)


def parts_of(folder: Path) -> tuple[list[str], list[Finding]]:
    """Names of the parts in their order, and what is odd about them. Raises LogError."""
    try:
        present = {each.name for each in folder.iterdir() if each.suffix == ".mcap" and each.is_file()}
    except OSError as error:
        raise LogError("E_UNREADABLE", folder, f"cannot be opened ({error.strerror})") from None
    listed = _listed(folder)
    if listed is None:
        form = re.compile(re.escape(folder.resolve().name) + r"_(\d{1,9})\.mcap")
        numbered = sorted((int(match[1]), match[0]) for match in map(form.fullmatch, present) if match)
        if not present or len(numbered) < len(present):
            raise LogError("E_NOT_A_FILE", folder, not_a_file(folder))
        names = [name for _, name in numbered]
        return names, [Finding("W_NO_METADATA", f"the folder has no {METADATA}; its parts are taken by number", False)]
    missing = [name for name in listed if name not in present]
    if len(missing) == len(listed):
        raise LogError("E_NOT_A_FILE", folder, f"none of the {len(listed)} parts that its {METADATA} lists exists")
    if len(listed) > MAX_PARTS:
        raise LogError("E_TOO_LARGE", folder, f"it has {len(listed)} parts, at most {MAX_PARTS} are read")
    found = [Finding("W_PART_MISSING", f"part {printable(name, 100)} is missing", True) for name in missing]
    beside = sorted(present - set(listed))
    if beside:
        text = f"{METADATA} does not list {printable(beside[0], 100)}; {len(beside)} such files are not read"
        found.append(Finding("W_PART_UNKNOWN", text, False))
    return [name for name in listed if name in present], found


def _listed(folder: Path) -> list[str] | None:
    """The parts that `metadata.yaml` lists; None without that file. Raises LogError."""
    file = folder / METADATA
    if not file.is_file():
        return None

    def fail(text: str) -> LogError:
        return LogError("E_METADATA", folder, f"{METADATA} {text}")

    try:
        with file.open("rb") as stream:
            content = stream.read(MAX_METADATA + 1)
        lines = content.decode("utf-8").splitlines()
    except OSError as error:
        raise fail(f"cannot be read ({error.strerror})") from None
    except UnicodeDecodeError:
        raise fail("is not UTF-8 text") from None
    if len(content) > MAX_METADATA:
        raise fail(f"is longer than {MAX_METADATA} bytes")
    values = {key.strip(): value.strip() for key, _, value in (line.partition(":") for line in lines)}
    storage = _plain(values.get("storage_identifier", "mcap"))
    if storage not in ("mcap", ""):
        raise fail(f"says that the bag is stored as {storage[:40]!r}; convert it to MCAP (`ros2 bag convert`)")
    if _plain(values.get("compression_mode", "")).upper() == "FILE":
        raise fail("says that whole files are compressed; unpack them or convert the bag (`ros2 bag convert`)")
    names = _names(lines)
    if not names:
        raise fail("lists no files (relative_file_paths)")
    odd = [name for name in names if name != Path(name).name or name in ("", ".", "..")]
    if odd:
        raise fail(f"lists {printable(odd[0], 60)!r}, expected names of files in the folder")
    return list(dict.fromkeys(names))


def _names(lines: list[str]) -> list[str]:
    """The items of `relative_file_paths`, one to a line, or in brackets on its own."""
    for number, line in enumerate(lines):
        key, _, value = line.partition(":")
        if key.strip() == "relative_file_paths":
            if value.strip().startswith("["):
                return [_plain(item) for item in value.strip().strip("[]").split(",") if item.strip()]
            names = []
            for following in lines[number + 1 :]:
                item = _ITEM.fullmatch(following)
                if item is None:
                    break
                names.append(_plain(item[1]))
            return names
    return []


def _plain(value: str) -> str:
    """A scalar without its quotes."""
    value = value.strip()
    return value[1:-1] if len(value) > 1 and value[0] == value[-1] and value[0] in "'\"" else value


def _joined(folder: Path, logs: list[Log], findings: list[Finding]) -> Log:
    """One log of all parts; a channel that occurs in several is one."""
    channels: dict[tuple[object, ...], Channel] = {}
    counts: Counter[int] = Counter()
    messages: list[Message] = []
    for log in logs:
        new: dict[int, Channel] = {}
        for channel in log.channels:
            identity = channel.topic, channel.encoding, channel.schema, bool(channel.schema_id)
            new[channel.id] = channels.setdefault(identity, channel._replace(id=len(channels) + 1))
            counts[new[channel.id].id] += log.counts.get(channel.id, 0)
        messages += [message._replace(channel=new[message.channel.id]) for message in log.messages]
    lines = "".join(f"{log.sha256}  {log.path.name}\n" for log in logs)
    return Log(
        path=folder,
        sha256=hashlib.sha256(lines.encode("utf-8", "surrogateescape")).hexdigest(),
        size=sum(log.size for log in logs),
        profile=logs[0].profile,
        library=logs[0].library,
        channels=tuple(channels.values()),
        counts=dict(counts),
        messages=tuple(sorted(messages, key=lambda message: message.log_time)),
        metadata=tuple(record for log in logs for record in log.metadata),
        findings=tuple(findings),
    )
