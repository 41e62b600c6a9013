"""`replay optimize`: read logs, run methods, write recordings and results, show the comparison."""

import dataclasses
import pathlib
from typing import TYPE_CHECKING, Annotated, Any, Literal, TypeAlias

from cyclopts import Group, Parameter

from optim.methods import METHODS
from replay.base.errors import UsageError
from replay.cli.console import Common, Voice
from replay.cli.options import flag_class, options_of
from replay.cli.origin import Origin, same_log
from replay.cli.outputs import Outputs
from replay.cli.reading import Reading
from replay.cli.session import Session
from replay.cli.settings import (
    Layer,
    MethodFlags,
    RunOptions,
    Settings,
    WeightFlags,
    layer_of_file,
    layer_of_flags,
    layer_of_results,
    settled,
)
from replay.cli.usage import example, reflowed
from replay.recording.viewer import LiveView, NoViewer, open_viewer
from replay.run.results import read_results

if TYPE_CHECKING:
    RunFlags: TypeAlias = Any
else:
    # names for the help and for completion; a chain is any text
    _NAMES = tuple[Literal[tuple(METHODS)] | str, ...] | None
    RunFlags = flag_class(
        [dataclasses.replace(o, hint=_NAMES) if o.name == "method" else o for o in options_of(RunOptions())],
        Group("The run", sort_key=4),
    )

_FLAT = Parameter(name="*")


@reflowed
def optimize(
    logs: list[pathlib.Path] | None = None,
    /,
    *,
    out: pathlib.Path = pathlib.Path(),
    export: Annotated[bool, Parameter(negative=())] = False,
    view: Annotated[bool, Parameter(negative=())] = False,
    viewer: str | None = None,
    config: pathlib.Path | None = None,
    from_: Annotated[pathlib.Path | None, Parameter(name="--from")] = None,
    common: Annotated[Common | None, _FLAT] = None,
    run: Annotated[RunFlags | None, _FLAT] = None,
    reading: Annotated[Reading | None, _FLAT] = None,
    weights: Annotated[WeightFlags | None, _FLAT] = None,
    options: Annotated[MethodFlags | None, _FLAT] = None,
) -> int:
    """Improve the recorded paths of logs; write a Rerun recording and a results file for each.

    An option is what its flag says, else the configuration file, else its default.

    Parameters
    ----------
    logs
        MCAP files, or folders that rosbag2 recorded.
    out
        Folder for the files, made if it is missing: STEM.rrd and STEM.results.json for each log. STEM is the log's
        name; where a log holds several requests, their numbers follow it (STEM-0, STEM-1). Earlier files of the same
        name are replaced.
    export
        Write STEM.optimised.mcap too: a copy of the log with each method's paths added as nav_msgs/msg/Path, on
        /replay/METHOD/path (truck) and /replay/METHOD/trailer_path; in METHOD, a chain's + is _, as in scp_ddp. Of a
        folder, a folder STEM.optimised.
    view
        Show the run live in a Rerun viewer, beside the files. Without a viewer the run continues.
    viewer
        Address of a running viewer to show it in, such as rerun+http://127.0.0.1:9876/proxy.
    config
        TOML file with options: a table for each method, [weights] and [reading]; method, seed, recording, time_limit,
        memory_limit and jobs stand outside of tables.
    from_
        Results file of an earlier run, which is run again: the same log, checked by its digest, with the same
        options. Options given in addition replace those.
    """
    layers: list[Layer] = [] if config is None else [layer_of_file(config)]
    layers.append(layer_of_flags(run, reading, weights, options))
    origin, inputs = None, list(logs or ())
    if from_ is not None:
        document = read_results(from_)
        layers.insert(0, layer_of_results(document, str(from_)))
        origin = Origin.of(document, from_)
        inputs = [same_log(inputs, document, from_)]
    if not inputs:
        raise UsageError(f"expected one or more logs, as in `{example('optimize')}`, or --from RESULTS")
    settings = settled(layers)
    voice = Voice(common or Common())
    outputs = Outputs(out, inputs, [from_] if from_ else [])
    live = _live(voice, view, viewer, settings)
    session = Session(voice=voice, settings=settings, outputs=outputs, export=export, live=live, origin=origin)
    return session.run(inputs)


def _live(voice: Voice, view: bool, viewer: str | None, settings: Settings) -> LiveView | None:
    """The live view of the run, if it is requested and there is a viewer."""
    if not (view or viewer):
        return None
    try:
        return LiveView(open_viewer(viewer), settings.methods, voice.error)
    except NoViewer as error:
        voice.error(f"{error}; the run continues without it")
        return None
