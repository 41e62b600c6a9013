"""Count what one log goes through to become a result: files, functions, and moves between files.

Usage: python tools/call_path.py LOG [--method NAME] [--recording] [--command] [--list]

Reads the log, runs one method on its first case and saves the result, all in this process, and counts with
`sys.setprofile`:

    files       files of optim/ and replay/ of which code ran
    functions   distinct functions and lambdas that ran; comprehensions count as part of theirs, a kernel as the
                function that calls it, since compiled code is not seen
    moves       calls that lead from one of these files to another, be it through libraries; the returns from them
                do not count

All modules are imported before the count begins, so that no import counts, and nothing has been computed yet. With
--command, the command line is called instead of the functions. The script runs on older versions of the project too:
copy it elsewhere, and start it with PYTHONPATH set to the checkout and from inside of it.
"""

import argparse
import collections
import contextlib
import importlib
import importlib.metadata
import multiprocessing
import os
import pathlib
import pkgutil
import sys
import tempfile
import types
from collections.abc import Callable, Iterator, Sequence
from typing import Any

PACKAGES = ("optim", "replay")
MOST_PAIRS = 20
"""Pairs of files that --list prints, those with most moves."""
_INNER = ("<listcomp>", "<setcomp>", "<dictcomp>", "<genexpr>", "<module>")


class Counter:
    """Counts calls of the project's functions while it is the profile function of a process."""

    def __init__(self, folders: Sequence[str]) -> None:
        self.folders = tuple(folders)
        self.functions: collections.Counter[tuple[str, str]] = collections.Counter()
        """Calls of each function, by file and qualified name."""
        self.between: collections.Counter[tuple[str, str]] = collections.Counter()
        """Moves from one file to another."""
        self._at = ""  # the file of the project that control is in, or was in last
        self._files: dict[str, str] = {}

    def __call__(self, frame: types.FrameType, event: str, _: Any) -> None:
        """Note a call, and where a return leads; every other event is ignored."""
        if event not in ("call", "return"):
            return
        code = frame.f_code
        file = self._own(code)
        if not file:
            return
        if event == "return":
            self._at = (frame.f_back and self._own(frame.f_back.f_code)) or self._at
            return
        if self._at not in ("", file):
            self.between[self._at, file] += 1
        self._at = file
        if code.co_name not in _INNER:
            self.functions[file, code.co_qualname] += 1

    def _own(self, code: types.CodeType) -> str:
        """The file of a function of the project; empty for others."""
        file = self._files.get(code.co_filename)
        if file is None:
            is_own = code.co_filename.startswith(self.folders)
            file = self._files[code.co_filename] = code.co_filename if is_own else ""
        return file

    @property
    def moves(self) -> int:
        """Moves between files."""
        return self.between.total()

    @property
    def files(self) -> collections.Counter[str]:
        """Distinct functions of each file."""
        return collections.Counter(file for file, _ in self.functions)

    @contextlib.contextmanager
    def counting(self) -> Iterator[None]:
        """Count what is called inside."""
        sys.setprofile(self)
        try:
            yield
        finally:
            sys.setprofile(None)


def main(arguments: Sequence[str] | None = None) -> int:
    """Print the counts for one log."""
    options = _parser().parse_args(arguments)
    multiprocessing.get_all_start_methods = lambda: ["spawn"]  # then methods run in this process
    folders = import_everything()
    with tempfile.TemporaryDirectory() as name:
        make = command if options.command else functions
        steps = make(options.log, options.method, pathlib.Path(name), options.recording)
        counter = Counter(folders)
        with counter.counting():
            for step in steps:
                step()
    if options.listing:
        print_lists(counter, os.path.commonpath(folders))
    print(f"{len(counter.files)} files, {len(counter.functions)} functions, {counter.moves} moves between files")
    return 0


def print_lists(counter: Counter, root: str) -> None:
    """Print each file with its number of functions, then the pairs of files with most moves."""
    for file, count in sorted(counter.files.items()):
        print(f"{count:5}  {os.path.relpath(file, root)}")
    print()
    for (start, end), count in counter.between.most_common(MOST_PAIRS):
        print(f"{count:5}  {os.path.relpath(start, root)} -> {os.path.relpath(end, root)}")
    print()


def _parser() -> argparse.ArgumentParser:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("log", type=pathlib.Path, metavar="LOG", help="an MCAP file")
    parser.add_argument("--method", default="scp", help="name of the method (default: %(default)s)")
    parser.add_argument("--recording", action="store_true", help="write the Rerun recording too")
    parser.add_argument("--command", action="store_true", help="call the command line instead of the functions")
    parser.add_argument(
        "--list",
        action="store_true",
        dest="listing",
        help="print each file's number of functions, and the files between which control moves most",
    )
    return parser


def import_everything() -> list[str]:
    """Import every module of the project, but for those whose packages are not installed; the packages' folders."""
    folders = []
    for name in PACKAGES:
        package = importlib.import_module(name)
        folders += [os.path.join(os.path.abspath(folder), "") for folder in package.__path__]  # noqa: PTH100, PTH118
        for module in pkgutil.walk_packages(package.__path__, f"{name}."):
            with contextlib.suppress(ImportError):
                importlib.import_module(module.name)
    return folders


def command(log: pathlib.Path, method: str, folder: pathlib.Path, recording: bool) -> list[Callable[[], Any]]:
    """The steps of `replay optimize`."""
    words = ["optimize", str(log), "--method", method, "--out", str(folder), "--quiet"]
    words.append("--recording" if recording else "--no-recording")
    (entry,) = importlib.metadata.entry_points(group="console_scripts", name="replay")
    return [lambda: entry.load()(words)]


def functions(log: pathlib.Path, method: str, folder: pathlib.Path, recording: bool) -> list[Callable[[], Any]]:
    """The steps by the pipeline's functions, or by those that came before them."""
    state: dict[str, Any] = {}
    try:
        pipeline = importlib.import_module("replay.pipeline")
    except ModuleNotFoundError:
        read, optimize, record, save = _before_the_pipeline()
    else:
        read, optimize, record, save = pipeline.read, pipeline.optimize, pipeline.record, pipeline.save
    return [
        lambda: state.update(case=read(log)[0]),
        lambda: state.update(run=optimize(state["case"], method)),
        *([lambda: record(state["run"], folder / "case.rrd")] if recording else []),
        lambda: save(state["run"], folder / "case.results.json"),
    ]


def _before_the_pipeline() -> tuple[Callable[..., Any], ...]:
    """Read, optimize, record, save as they were called before there was a pipeline."""
    from optim.methods import METHODS

    def found(name: str, *modules: str) -> Any:
        for module in modules:
            with contextlib.suppress(ImportError, AttributeError):
                return getattr(importlib.import_module(module), name)
        raise ImportError(f"no {name} in {', '.join(modules)}")

    results = ("replay.results", "replay.run.results")
    run_case = found("run_case", "replay.run.judge", "replay.run")
    to_document, write_results = found("to_document", *results), found("write_results", *results)
    return (
        found("read_cases", "replay.logs"),
        lambda case, method: run_case(case, {method: METHODS[method]}),
        found("write_recording", "replay.recording"),
        lambda run, path: write_results(path, to_document(run)),
    )


if __name__ == "__main__":
    sys.exit(main())
