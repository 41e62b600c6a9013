"""`replay optimize`: read logs, run methods, write recordings and results, show the comparison."""

import dataclasses
import pathlib
from typing import TYPE_CHECKING, Annotated, Any, Literal, TypeAlias

from cyclopts import Group, Parameter

from optim.methods import METHODS
from replay.base.schemas.results import ResultsDocument
from replay.cli.console import Common, Voice
from replay.cli.flags import MethodFlags, WeightFlags
from replay.cli.options import UsageError, flag_class, options_of
from replay.cli.outputs import Outputs
from replay.cli.reading import Reading
from replay.cli.session import Origin, Session
from replay.cli.settings import (
    Layer,
    RunOptions,
    Settings,
    layer_of_assignments,
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
_List = Annotated[list[str] | None, Parameter(negative=())]


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
    set_: Annotated[_List, Parameter(name="--set")] = None,
    from_: Annotated[pathlib.Path | None, Parameter(name="--from")] = None,
    common: Annotated[Common | None, _FLAT] = None,
    run: Annotated[RunFlags | None, _FLAT] = None,
    reading: Annotated[Reading | None, _FLAT] = None,
    weights: Annotated[WeightFlags | None, _FLAT] = None,
    options: Annotated[MethodFlags | None, _FLAT] = None,
) -> int:
    """Improve the recorded paths of logs; write a Rerun recording and a results file for each.

    An option is what its flag says, else --set, else the configuration file, else its default.

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
        Show the run in a Rerun viewer while it goes on, beside the files. Where none can be opened, the run goes on.
    viewer
        Address of a running viewer to show it in, such as rerun+http://127.0.0.1:9876/proxy.
    config
        TOML file with options: a table for each method, [weights] and [reading]; method, seed, recording, time_limit,
        memory_limit and jobs stand outside of tables.
    set_
        One option as GROUP.OPTION=VALUE, such as shortcut.tries=500, weights.cusp=7 or reading.margin=0.2; may be
        given several times.
    from_
        Results file of an earlier run, which is run again: the same log, checked by its digest, with the same
        options. Options that are given besides replace those.
    """
    layers: list[Layer] = [] if config is None else [layer_of_file(config)]
    layers += [layer_of_assignments(set_ or ()), layer_of_flags(run, reading, weights, options)]
    origin, inputs = None, list(logs or ())
    if from_ is not None:
        document = read_results(from_)
        layers.insert(0, layer_of_results(document, str(from_)))
        origin = Origin.of(document, from_)
        inputs = [_same_log(inputs, document, from_)]
    if not inputs:
        raise UsageError(f"expected one or more logs, as in `{example('optimize')}`, or --from RESULTS")
    settings = settled(layers)
    voice = Voice(common or Common())
    outputs = Outputs(out, inputs, [from_] if from_ else [])
    session = Session(
        voice=voice,
        methods=settings.methods,
        read=settings.read,
        weights=settings.weights,
        seed=settings.run.seed,
        export=export,
        outputs=outputs,
        live=_live(voice, view, viewer, settings),
        recording=settings.run.recording,
        limits=settings.run.limits,
        jobs=settings.run.jobs,
        origin=origin,
    )
    return session.run(inputs)


def _live(voice: Voice, view: bool, viewer: str | None, settings: Settings) -> LiveView | None:
    """What shows the run while it goes on, if that is asked for and there is a viewer."""
    if not (view or viewer):
        return None
    try:
        return LiveView(open_viewer(viewer), settings.methods, voice.error)
    except NoViewer as error:
        voice.error(f"{error}; the run goes on without it")
        return None


def _same_log(logs: list[pathlib.Path], document: ResultsDocument, source: pathlib.Path) -> pathlib.Path:
    """The log of a results file: the one that was given, else where it was then, else beside the results file."""
    if len(logs) > 1:
        raise UsageError(f"--from repeats the run of one log, and {len(logs)} logs are given")
    if logs:
        return logs[0]
    then = pathlib.Path(document.log.path)
    for path in (then, source.parent / then, source.parent / then.name):
        if path.is_file():
            return path
    raise UsageError(f"--from {source}: its log {then} is not there; give the log's place besides")
