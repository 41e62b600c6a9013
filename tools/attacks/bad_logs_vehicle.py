"""Logs that name their vehicle in a JSON message of their own, as logs that name it where `replay` looks for it.

The manifest's scenarios have a message on `/vehicle`, two JSON objects `tractor` and `trailer`. `with_vehicle` puts a
metadata record `vehicle` in front of such a log, value by value as its text stands there: what is wrong with a value
(not a number, twice, not UTF-8, too long) is wrong in the record too. Nothing else of the log changes; the summary,
whose offsets would no longer hold, is left out, which is legal.
"""

import io
import json
import re
import struct
from typing import Any

from mcap.exceptions import McapError
from mcap.reader import NonSeekingReader

MAGIC = b"\x89MCAP0\r\n"
_HEADER, _FOOTER, _METADATA, _DATA_END = 1, 2, 0x0C, 0x0F
_HEAD = struct.Struct("<BQ")

# Where a value of ours stands in theirs. Their steering rate is in rad/s, ours in rad/m: it has no counterpart.
_SAME = {
    "wheelbase": ("tractor", "wheelbase_m"),
    "truck_rear": ("tractor", "rear_overhang_m"),
    "truck_width": ("tractor", "width_m"),
    "max_steer": ("tractor", "max_steer_rad"),
    "hitch_to_axle": ("trailer", "length_m"),
    "trailer_front": ("trailer", "front_overhang_m"),
    "trailer_width": ("trailer", "width_m"),
    "max_hitch": ("trailer", "max_hitch_rad"),
    "hitch_offset": ("trailer", "hitch_offset_m"),
}
# Theirs are overhangs beyond an axle, ours lengths from the hitch.
_SUMS = {
    "truck_front": (("tractor", "wheelbase_m"), ("tractor", "front_overhang_m")),
    "trailer_rear": (("trailer", "length_m"), ("trailer", "rear_overhang_m")),
}


def vehicle_message(data: bytes) -> bytes | None:
    """The payload of the message on `/vehicle`, or None: no such message, or a file that cannot be read to its end."""
    try:
        for _, channel, message in NonSeekingReader(io.BytesIO(data)).iter_messages(topics=["/vehicle"]):
            return message.data if channel.message_encoding == "json" else None
    except (McapError, ValueError, struct.error, OSError):
        return None
    return None


def with_vehicle(data: bytes, payload: bytes) -> bytes:
    """The log `data` with the vehicle of `payload` as its metadata record."""
    records = _records(data)
    kept = b"".join(record for opcode, record in records if opcode != _HEADER)
    entries = b"".join(_text(key.encode()) + _text(value) for key, value in entries_of(payload))
    metadata = _record(_METADATA, _text(b"vehicle") + struct.pack("<I", len(entries)) + entries)
    header = next(record for opcode, record in records if opcode == _HEADER)
    end = _record(_DATA_END, bytes(4)) + _record(_FOOTER, bytes(20))
    return MAGIC + header + metadata + kept + end + MAGIC


def entries_of(payload: bytes) -> list[tuple[str, bytes]]:
    """Keys of `optim.model.vehicle.Vehicle` and their values' texts; one that stands there twice comes twice."""
    parts = _parts(payload)
    if parts is None:  # no such object: it stands where its first value would
        return [("wheelbase", payload), ("hitch_to_axle", payload)]
    entries = [(key, text) for key, (part, name) in _SAME.items() for text in _texts(parts[part], name)]
    for key, terms in _SUMS.items():
        numbers = [_number(text) for part, name in terms for text in _texts(parts[part], name)]
        if None not in numbers:
            entries.append((key, json.dumps(sum(filter(None, numbers))).encode()))
    return entries


def _parts(payload: bytes) -> dict[str, bytes] | None:
    """The texts of the two objects; None if they are not there."""
    found = {name: re.search(rb'"%s":\s*\{([^{}]*)\}' % name.encode(), payload) for name in ("tractor", "trailer")}
    return {name: match[1] for name, match in found.items() if match} if all(found.values()) else None


def _texts(part: bytes, name: str) -> list[bytes]:
    return [text.strip() for text in re.findall(rb'"%s":([^,]*)' % name.encode(), part)]


def _number(text: bytes) -> float | None:
    """A finite number, as JSON has it."""
    try:
        value: Any = json.loads(text, parse_constant=lambda _: None)
    except (ValueError, RecursionError):
        return None
    return float(value) if isinstance(value, int | float) else None


def _records(data: bytes) -> list[tuple[int, bytes]]:
    """Opcode and bytes of every record of the data section, of a file that is known to be sound."""
    records, at = [], len(MAGIC)
    while True:
        opcode, length = _HEAD.unpack_from(data, at)
        if opcode == _DATA_END:
            return records
        records.append((opcode, data[at : at + _HEAD.size + length]))
        at += _HEAD.size + length


def _record(opcode: int, body: bytes) -> bytes:
    return _HEAD.pack(opcode, len(body)) + body


def _text(raw: bytes) -> bytes:
    return struct.pack("<I", len(raw)) + raw
