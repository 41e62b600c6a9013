"""Try what must hold whatever happens. Each attack ends with exit status 1 if anything is otherwise than it should be.

Usage: python -m tools.attacks NAME ...

    bad-logs         broken, hostile and odd logs, with a manifest of what each is to give
    brute-collision  the audit's swept area against poses every 0.1 mm
    flip-bits        every prefix and every flipped bit of small logs
    fuzz             what reads foreign bytes, guided by coverage
    kill-storm       signals at random times: no torn file, no process left
    sabotage         spoiled results: each found by its check, each check needed
    same-results     one process, two, and a cluster give the same results
    worker-storm     workers and the coordinator of a regression run are killed

`NAME --help` shows what an attack does, and its options.
"""

import argparse
import importlib
import sys
from typing import Final

from tools.script import run

ATTACKS: Final = (
    "bad-logs",
    "brute-collision",
    "flip-bits",
    "fuzz",
    "kill-storm",
    "sabotage",
    "same-results",
    "worker-storm",
)


def main() -> int | None:
    """Run the attack that the first argument names."""
    names = _parser("python -m tools.attacks", __doc__)
    names.add_argument("name", choices=ATTACKS, metavar="NAME")
    name = names.parse_args(sys.argv[1:2]).name
    attack = importlib.import_module(f"tools.attacks.{name.replace('-', '_')}")
    parser = _parser(f"{names.prog} {name}", attack.__doc__)
    attack.options(parser)
    return attack.main(parser.parse_args(sys.argv[2:]))


def _parser(program: str, description: str | None) -> argparse.ArgumentParser:
    return argparse.ArgumentParser(
        prog=program, description=description, formatter_class=argparse.RawDescriptionHelpFormatter
    )


if __name__ == "__main__":
    run(main)
