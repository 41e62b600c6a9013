"""Which logs there are, how one is made, and the list of them that is kept beside them."""

import hashlib
import json
import tomllib
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from types import MappingProxyType
from typing import Any, Final

from optim.model.vehicle import Vehicle
from tools.corpus import families, odd
from tools.corpus.build import Built, build, build_with
from tools.corpus.read import sites
from tools.corpus.site import Grid, Site
from tools.corpus.write import content_digest, to_bytes

HARD: Final[Mapping[str, str]] = MappingProxyType(
    {
        "narrow_03": "CL-RRT",
        "narrow_05": "Hybrid A*",
        "narrow_07": "CL-RRT",
        "reverse_05": "CL-RRT",
        "reverse_07": "Hybrid A*",
    }
)
"""Drawn sites that leave too little room for the RRT's clearance, and the planner that makes their path."""
DRAWN: Final = tuple(f"{kind}_{n:02d}" for kind in families.CLASSES for n in range(1, 10))
"""Names of the drawn sites, nine of each class."""

LIST_NAME = "corpus.toml"
_SCHEMA = "replay.corpus/1"
_HEAD = f"""\
# The logs of this folder. Made by tools/make_corpus.py, which also makes them anew and compares (--check).
# sha256 is that of the file, content that of what it says (another zstd may compress the same content differently).
schema = "{_SCHEMA}"
"""

SAMPLE, PUBLIC = "sample", "public"
"""Files of scenes: of the sample logs, and of public scenarios in the full corpus."""
Entry = dict[str, Any]
"""What the list says of one log."""


@dataclass(frozen=True, kw_only=True)
class Made:
    """A log in memory, with its entry in the list."""

    name: str
    data: bytes
    entry: Entry


def sample_names() -> tuple[str, ...]:
    """Names of the sample logs."""
    return tuple(sites(SAMPLE))


def full_names() -> tuple[str, ...]:
    """Names of the logs of the full corpus, beside the sample logs."""
    return (*DRAWN, *sites(PUBLIC), *odd.odd_logs())


def make(name: str) -> Made:
    """Plan and write one log, of the samples or of the full corpus."""
    if name in sites(SAMPLE):
        return make_log(sites(SAMPLE)[name])
    if name in odd.odd_logs():
        built, data = odd.make_odd(name)
        kind = odd.odd_logs()[name]
        entry = _entry(built, data) | {"title": kind.title, "expect": kind.expect}
        return Made(name=name, data=data, entry=entry)
    kind, _, number = name.rpartition("_")
    if name in sites(PUBLIC):
        built = build_with(sites(PUBLIC)[name])
    elif name in HARD:
        built = families.build_hard(kind, int(number), HARD[name])
    else:
        built = families.build_drawn(kind, int(number))
    data = to_bytes(built)
    return Made(name=name, data=data, entry=_entry(built, data))


def make_log(site: Site) -> Made:
    """Plan and write the log of a site; the same bytes every time."""
    built = build(site)
    data = to_bytes(built)
    return Made(name=site.name, data=data, entry=_entry(built, data))


def _entry(built: Built, data: bytes) -> Entry:
    site = built.site
    told = {"planner": site.planner} if site.planner != Site.planner else {}
    told |= {"source": site.source, "licence": site.licence} if site.source else {}
    is_whole = data.endswith(b"\x89MCAP0\r\n")
    return {
        "sha256": hashlib.sha256(data).hexdigest(),
        "content": content_digest(data) if is_whole else hashlib.sha256(data).hexdigest(),
        "class": site.name.partition("_")[0] if site.name in odd.odd_logs() else site.name.rpartition("_")[0],
        "expect": "improved",
        "title": site.title,
        "special": site.special,
        "map": "grid" if isinstance(site.map, Grid) else "shapes",
        "vehicle": _vehicle_of(site),
        "seed": built.seed,
        "poses": len(built.poses.truck),
        "edges": len(built.poses.nodes) - 1,
        "cusps": built.num_cusps,
        "length_m": round(built.length, 2),
        "trailer_path": site.has_trailer_path,
        "path_nodes": site.has_path_nodes,
        **told,
    }


def _vehicle_of(site: Site) -> str:
    if site.name in full_names() and site.name not in sites(PUBLIC):
        return families.vehicle_name(site.vehicle)
    return "default" if site.vehicle == Vehicle() else "own"


def read_list(folder: Path) -> dict[str, Entry]:
    """Entries of the list in a folder, by name; none where there is no list."""
    path = folder / LIST_NAME
    if not path.exists():
        return {}
    document = tomllib.loads(path.read_text(encoding="utf-8"))
    if document.get("schema") != _SCHEMA:
        raise ValueError(f"{path}: schema is {document.get('schema')!r}, expected {_SCHEMA!r}")
    return document["logs"]


def write_list(folder: Path, entries: Mapping[str, Entry]) -> None:
    """Write the list, in the order in which logs are named here."""
    blocks = [_HEAD]
    for name in (*sample_names(), *full_names()):
        if name in entries:
            rows = [f"{key} = {json.dumps(value)}" for key, value in entries[name].items()]
            blocks.append("\n".join([f"[logs.{name}]", *rows]) + "\n")
    (folder / LIST_NAME).write_text("\n".join(blocks), encoding="utf-8")


def difference(made: Made, expected: Entry | None) -> str | None:
    """One sentence if a log made anew is not the listed one, else None."""
    if expected is None:
        return "not in the list"
    if made.entry["sha256"] == expected["sha256"]:
        return None
    if made.entry["content"] == expected["content"]:
        return "the same content, compressed differently: another version of zstandard"
    keys = [key for key in expected if key not in ("sha256", "content") and made.entry.get(key) != expected[key]]
    named = ", ".join(f"{key} {made.entry.get(key)!r} instead of {expected[key]!r}" for key in keys)
    return f"other content: {named or 'same figures, other numbers in the messages'}"
