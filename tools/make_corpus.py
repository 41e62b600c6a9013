"""Make the logs in recordings/, or check that they are what this tool makes.

python tools/make_corpus.py                  all logs and the lists, corpus.toml, beside them
python tools/make_corpus.py --set sample     the sample logs only; full: the others, in recordings/full
python tools/make_corpus.py --only bay_01    one log and its entry
python tools/make_corpus.py --check          make them in memory and compare with the list and the files
"""

import argparse
import hashlib
import time
from collections.abc import Iterator, Sequence
from concurrent.futures import ProcessPoolExecutor
from multiprocessing import get_context
from pathlib import Path

from replay.base.kernels import drop_stale
from tools.corpus.catalogue import Made, difference, full_names, make, read_list, sample_names, write_list
from tools.script import from_one, run

FOLDER = Path(__file__).resolve().parent.parent / "recordings"


def main(arguments: Sequence[str] | None = None) -> int:
    """Exit status: 0 all well, 1 a log differs from the list."""
    options = _parser().parse_args(arguments)
    drop_stale()
    samples, full = sample_names(), full_names()
    begin, differences, count = time.perf_counter(), 0, 0
    for folder, names in ((options.folder, samples), (options.folder / "full", full)):
        chosen = [name for name in names if name in options.only] if options.only else list(names)
        if not chosen or (options.set == "sample" and names is full) or (options.set == "full" and names is samples):
            continue
        differences += _make_folder(folder, chosen, options)
        count += len(chosen)
    print(f"{count} logs in {time.perf_counter() - begin:.0f} s, {differences} differences")
    return 1 if differences else 0


def _make_folder(folder: Path, names: Sequence[str], options: argparse.Namespace) -> int:
    """Make or check logs of one folder; how many differ from its list."""
    listed, differences = read_list(folder), 0
    for made in _make_all(names, options.jobs):
        entry = made.entry
        figures = f"{entry['length_m']:6.1f} m  {entry['cusps']} cusps  {len(made.data) / 1000:5.1f} kB"
        problem = None
        if options.check:
            problem = difference(made, listed.get(made.name)) or _file_problem(folder, made)
            differences += problem is not None
        else:
            folder.mkdir(exist_ok=True)
            (folder / f"{made.name}.mcap").write_bytes(made.data)
            listed[made.name] = entry
            write_list(folder, listed)
        print(f"{made.name:15} {figures}  {problem or ''}".rstrip(), flush=True)
    return differences


def _parser() -> argparse.ArgumentParser:
    parser = argparse.ArgumentParser(description=(__doc__ or "").partition("\n")[0])
    every = [*sample_names(), *full_names()]
    parser.add_argument("--only", action="append", choices=every, metavar="NAME", help="one log; may be repeated")
    parser.add_argument("--set", choices=("sample", "full"), help="one of the two sets (default: both)")
    parser.add_argument("--check", action="store_true", help="write nothing; compare")
    parser.add_argument("--folder", type=Path, default=FOLDER, help="where the logs are (default: %(default)s)")
    parser.add_argument("--jobs", type=from_one, default=2, help="processes (default: %(default)s)")
    return parser


def _make_all(names: Sequence[str], jobs: int) -> Iterator[Made]:
    """The logs in the order of their names, made in several processes; each depends on its own seed only."""
    if jobs == 1 or len(names) == 1:
        yield from map(make, names)
        return
    with ProcessPoolExecutor(jobs, mp_context=get_context("spawn")) as pool:
        yield from pool.map(make, names)


def _file_problem(folder: Path, made: Made) -> str | None:
    """One sentence if the file is not the one in the list."""
    path = folder / f"{made.name}.mcap"
    if not path.exists():
        return f"{path} is missing"
    if hashlib.sha256(path.read_bytes()).hexdigest() != made.entry["sha256"]:
        return f"{path} is not the listed file"
    return None


if __name__ == "__main__":
    run(main)
