"""`replay methods`: the methods and their options."""

from typing import Annotated, Any

from cyclopts import Parameter

from optim.methods import METHODS
from optim.methods.chain import JOINT
from optim.model.method import Method
from replay.base.errors import UsageError, unknown
from replay.cli.console import Common, Voice
from replay.cli.options import Option, options_of, summary_of
from replay.cli.tables import options_table
from replay.cli.usage import ExitStatus, reflowed


@reflowed
def methods(names: list[str] | None = None, /, *, common: Annotated[Common | None, Parameter(name="*")] = None) -> int:
    """List the methods and their options, each a flag of `replay optimize`.

    Parameters
    ----------
    names
        Methods to list, by name; all by default.
    """
    voice = Voice(common or Common())
    wanted = [name.lower() for name in names or METHODS]
    for name in wanted:
        if name not in METHODS:
            raise UsageError(unknown("method", name, METHODS))
    listed = {name: METHODS[name] for name in wanted}
    for name, method in listed.items():
        voice.show(f"{name}: {summary_of(method)}", options_table(options_of(method, name)))
    voice.show(f"Names joined by {JOINT} run one after the other, each from where the one before ended.")
    found = [_method_document(name, method) for name, method in listed.items()]
    voice.document({"schema": "replay.methods/1", "methods": found})
    return ExitStatus.OK


def _method_document(name: str, method: Method) -> dict[str, Any]:
    options = [_option_document(option) for option in options_of(method, name)]
    return {"name": name, "summary": summary_of(method), "options": options}


def _option_document(option: Option) -> dict[str, Any]:
    keys = ("name", "flag", "kind", "unit", "default", "doc")
    return {key: getattr(option, key) for key in keys}
