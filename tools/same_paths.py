"""Compare two folders of results files: whether every method found the same path, to the last bit.

Usage: python tools/same_paths.py A B [--history]

Case by case and method by method: the path, bit for bit, status, reason to stop, iterations, metrics and the values
of the audit; the recorded path and its metrics too. With --history every iterate's scalars. Times, sentences, options
and versions may differ. The exit status is 1 if anything else does. The files are read as plain data, not by the
product's own reader, so that files of any two versions can be compared.
"""

import argparse
import json
import pathlib
from collections.abc import Iterator, Sequence
from typing import Any

from tools.script import existing, run

SUFFIX = ".results.json"
OF_A_METHOD = ("status", "stop", "iterations", "metrics", "path", "audit", "rejected")
"""What is compared of a method, the most telling first."""
OF_A_CASE = ("recorded_metrics", "recorded")
IGNORED = {"wall_s", "solver_s", "sentence", "reason"}
"""Keys of times and sentences, wherever they stand."""
Document = dict[str, Any]


def main(arguments: Sequence[str] | None = None) -> int:
    """Exit status: 0 the same, 1 differences."""
    options = _parser().parse_args(arguments)
    first, second = (read_folder(folder) for folder in (options.first, options.second))
    lines = [*only_in(options.first, first, second), *only_in(options.second, second, first)]
    cases, methods = sorted(set(first) & set(second)), 0
    for case in cases:
        found = differences(first[case], second[case], with_history=options.history)
        methods += len(methods_of(first[case]))
        lines += [f"{case} {name}: {text}" for name, text in found]
    print("\n".join([*lines, f"{len(cases)} cases, {methods} methods compared: {len(lines)} differences"]))
    if not cases:
        print("nothing was compared: no results file of one folder has its like in the other")
    return int(bool(lines) or not cases)


def _parser() -> argparse.ArgumentParser:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("first", type=existing, metavar="A", help="folder with results files (*.results.json)")
    parser.add_argument("second", type=existing, metavar="B", help="another one, or the same made by another version")
    parser.add_argument("--history", action="store_true", help="compare every iterate's scalars too")
    return parser


def read_folder(folder: pathlib.Path) -> dict[str, Document]:
    """The results documents of a folder and its subfolders, by the path of their files in it."""
    files = sorted(folder.rglob(f"*{SUFFIX}"))
    return {
        file.relative_to(folder).as_posix().removesuffix(SUFFIX): json.loads(file.read_text(encoding="utf-8"))
        for file in files
    }


def only_in(folder: pathlib.Path, documents: dict[str, Document], others: dict[str, Document]) -> list[str]:
    """A line for each case that the other folder lacks."""
    return [f"{case}: only in {folder}" for case in sorted(set(documents) - set(others))]


def methods_of(document: Document) -> dict[str, Document]:
    """The methods of a document by their names."""
    return {method["name"]: method for method in document["methods"]}


def differences(first: Document, second: Document, *, with_history: bool = False) -> list[tuple[str, str]]:
    """What differs between two documents of one case: the method, or "recorded", and a line of text."""
    found = [("recorded", text) for key in OF_A_CASE if (text := difference(first, second, key))]
    one, other = methods_of(first), methods_of(second)
    for name in [*one, *(name for name in other if name not in one)]:
        if name not in one or name not in other:
            found.append((name, f"only in {'A' if name in one else 'B'}"))
            continue
        keys = (*OF_A_METHOD, "history") if with_history else OF_A_METHOD
        found += [(name, text) for key in keys if (text := difference(one[name], other[name], key))]
    return found


def difference(first: Document, second: Document, key: str) -> str | None:
    """One line about one entry of two documents: the first place that differs, how many do, and by how much."""
    one, other = dict(leaves(first.get(key), key)), dict(leaves(second.get(key), key))
    places = [place for place in {**one, **other} if bits(one.get(place)) != bits(other.get(place))]
    if not places:
        return None
    place = places[0]
    text = f"{place} is {said(one, place)} and {said(other, place)}"
    if len(places) > 1:
        text += f"; {len(places)} of {len({**one, **other})} values differ"
    pairs: list[tuple[Any, Any]] = [(one.get(each), other.get(each)) for each in places]
    sizes = [abs(a - b) for a, b in pairs if _is_number(a) and _is_number(b)]
    return f"{text}, by up to {max(sizes):.3g}" if sizes else text


def leaves(value: Any, place: str) -> Iterator[tuple[str, Any]]:
    """The scalars in a value with the place of each; empty lists and objects count as scalars."""
    if isinstance(value, dict) and value:
        for key, entry in value.items():
            if key not in IGNORED:
                yield from leaves(entry, f"{place}.{key}")
    elif isinstance(value, list) and value:
        for index, entry in enumerate(value):
            yield from leaves(entry, f"{place}[{index}]")
    else:
        yield place, value


def bits(value: Any) -> str:
    """A text that is the same for the same bits only: 0.0 is not -0.0, and 1 is not 1.0."""
    return value.hex() if isinstance(value, float) else repr(value)


def said(values: dict[str, Any], place: str) -> str:
    """A value as it stands in a message."""
    return repr(values[place]) if place in values else "missing"


def _is_number(value: Any) -> bool:
    return isinstance(value, (int, float)) and not isinstance(value, bool)


if __name__ == "__main__":
    run(main)
