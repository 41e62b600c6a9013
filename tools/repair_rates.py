"""How well the reader repairs recorded paths: true paths of logs are distorted, written as logs and read again.

Usage: python tools/repair_rates.py LOG... [--only TEXT] [--seeds N] [--verbose]

Each row is one distortion, over all logs and seeds. `read`: how many were read at all, `gears`: with all gear changes
of the true path and no others, `sound`: and pass the audit's checks of a recorded path. The deviations are of the
repaired path from the true one [cm], largest (median and worst of all) and RMS, of its last hitch angle [degrees],
and from the poses of the log [cm, RMS]. The last column counts the errors by their codes.
"""

import argparse
import collections
import dataclasses
import importlib
import pathlib
import sys
import tempfile
import time
from typing import Any, NamedTuple

import numpy as np
from mcap.reader import make_reader
from scipy.spatial import KDTree

ROOT = pathlib.Path(__file__).resolve().parent.parent
sys.path[:0] = [str(ROOT), str(ROOT / "tests")]

from optim.audit.checks import audit_recorded  # noqa: E402
from optim.model.path import Path, sample_segment  # noqa: E402
from optim.model.vehicle import Vehicle  # noqa: E402
from optim.numerics.arrays import Array  # noqa: E402
from replay.base.errors import LogError  # noqa: E402
from replay.base.kernels import drop_stale  # noqa: E402
from replay.logs import ReadOptions, read_cases  # noqa: E402
from replay.run.case import Case  # noqa: E402
from replay.run.plain import path_to_document, scene_to_document  # noqa: E402
from tools.script import existing, from_one, run  # noqa: E402

make: Any = importlib.import_module("logs_maker")

STANDSTILL_S = 1.5  # at the ends and at each gear change, while poses go on
ACCELERATION = 0.5  # [m/s^2]
AFTER_ALL_S = 5_000_000_000  # log time of the path: the newest map before it is the last


@dataclasses.dataclass(frozen=True, kw_only=True)
class Distortion:
    """What is done to a true path before it is written as a log."""

    name: str
    spacing: float = 0.5
    """Distance between poses [m]; cusps are among them."""
    speed: float = 0.0
    """Speed of the drive [m/s] whose poses come at 5 Hz; 0: poses by `spacing`."""
    position: float = 0.0
    """White noise on x and y of every pose, the ends among them [m]."""
    heading: float = 0.0
    """White noise on the heading [degrees]."""
    repeated: int = 0
    """Each pose is there so many times more, with its noise."""
    dropped: float = 0.0
    """Length of the stretch that has no poses, round the place a third of the way along [m]."""
    jump: float = 0.0
    """From that place on, poses are moved sideways by so much [m]."""
    outlier: float = 0.0
    """The pose nearest to that place is moved sideways by so much [m]."""
    has_headings: bool = True
    has_trailer: bool = False


def distortions() -> list[Distortion]:
    """The table's rows."""
    rows = []
    for spacing in (0.1, 0.2, 0.5, 1.0):
        for position, heading in ((0.0, 0.0), (0.01, 0.3), (0.02, 0.3), (0.05, 1.0)):
            name = f"{spacing:g} m, {100 * position:g} cm, {heading:g} deg"
            rows.append(Distortion(name=name, spacing=spacing, position=position, heading=heading))
    for speed, position in ((1.0, 0.0), (1.0, 0.02), (2.0, 0.02), (1.0, 0.05)):
        name = f"5 Hz, {speed:g} m/s, {100 * position:g} cm, 0.3 deg"
        rows.append(Distortion(name=name, speed=speed, position=position, heading=0.3 * (position > 0.0)))
    half: dict[str, Any] = {"position": 0.02, "heading": 0.3}
    return [
        *rows,
        Distortion(name="repeated 3 x, 0.2 m, 2 cm", spacing=0.2, repeated=3, **half),
        Distortion(name="repeated 3 x, exact", repeated=3),
        Distortion(name="dropped 1.5 m, 2 cm", dropped=1.5, **half),
        Distortion(name="dropped 3 m, 2 cm", dropped=3.0, **half),
        Distortion(name="one pose off 0.3 m, 2 cm", outlier=0.3, **half),
        Distortion(name="jump 0.1 m, 2 cm", jump=0.1, **half),
        Distortion(name="jump 0.5 m, 2 cm", jump=0.5, **half),
        Distortion(name="no headings, exact", has_headings=False),
        Distortion(name="no headings, 0.5 m, 2 cm", has_headings=False, **half),
        Distortion(name="no headings, 0.1 m, 2 cm", has_headings=False, spacing=0.1, **half),
        Distortion(name="trailer, 0.5 m, 2 cm", has_trailer=True, **half),
        Distortion(name="trailer, 0.1 m, 2 cm", has_trailer=True, spacing=0.1, **half),
        Distortion(name="trailer, 0.1 m, 5 cm, 1 deg", has_trailer=True, spacing=0.1, position=0.05, heading=1.0),
    ]


class Outcome(NamedTuple):
    """What came of one distorted log."""

    code: str  # of the error, else empty
    gears: bool
    sound: bool
    worst: float  # from the true path [m]
    rms: float  # from the true path [m]
    hitch: float  # at the goal [rad]
    off: float  # from the poses, RMS [m]
    text: str


def main() -> int:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("logs", nargs="+", type=existing, metavar="LOG")
    parser.add_argument("--only", default="", help="rows whose name holds this text")
    parser.add_argument(
        "--seeds", type=from_one, default=1, help="distorted logs for each log and row (default: %(default)s)"
    )
    parser.add_argument("--verbose", action="store_true", help="say what was wrong with each")
    given = parser.parse_args()
    drop_stale()
    cases = [(log, read_cases(log)[0]) for log in given.logs]
    heads = f"{'distortion':<30}{'logs':>5}{'read':>5}{'gears':>6}{'sound':>6}{'max':>7}{'worst':>7}{'rms':>6}"
    print(heads + f"{'hitch':>7}{'poses':>7}{'ms':>7}  errors")
    for distortion in distortions():
        if given.only not in distortion.name:
            continue
        began = time.process_time()
        outcomes = []
        for seed in range(given.seeds):
            for number, (log, case) in enumerate(cases):
                rng = np.random.default_rng([seed, number])
                outcomes.append(_outcome(log, case, distortion, rng))
                if given.verbose and outcomes[-1].text:
                    print(f"    {log.stem}, seed {seed}: {outcomes[-1].text}")
        spent = 1000.0 * (time.process_time() - began) / len(outcomes)
        figures, errors = _row(outcomes)
        print(f"{distortion.name:<30}{figures}{spent:>7.0f}  {errors}", flush=True)
    return 0


def _row(outcomes: list[Outcome]) -> tuple[str, str]:
    """The row's figures but its time, and its errors by their codes."""
    read = [outcome for outcome in outcomes if not outcome.code]
    counts = f"{len(outcomes):>5}{len(read):>5}{sum(o.gears for o in read):>6}{sum(o.sound for o in read):>6}"
    errors = collections.Counter(outcome.code for outcome in outcomes if outcome.code)
    named = ", ".join(f"{count} {code}" for code, count in errors.most_common())
    if not read:
        return counts + f"{'-':>7}{'-':>7}{'-':>6}{'-':>7}{'-':>7}", named
    worst, rms, hitch, off = (np.array([getattr(o, key) for o in read]) for key in ("worst", "rms", "hitch", "off"))
    numbers = f"{100 * np.median(worst):>7.1f}{100 * worst.max():>7.1f}{100 * np.median(rms):>6.1f}"
    return counts + numbers + f"{np.degrees(np.median(hitch)):>7.2f}{100 * np.median(off):>7.2f}", named


def _outcome(log: pathlib.Path, case: Case, distortion: Distortion, rng: np.random.Generator) -> Outcome:
    truth, vehicle = case.problem.recorded, case.problem.vehicle
    states = _sampled(vehicle, truth, distortion)
    truck, trailer = _distorted(vehicle, states, distortion, rng)
    with tempfile.TemporaryDirectory() as folder:
        file = pathlib.Path(folder) / "distorted.mcap"
        maker = _copy_without_paths(log).add("/plan", make.path(truck), AFTER_ALL_S)
        if trailer is not None:
            maker.add("/trailer", make.path(trailer), AFTER_ALL_S)
        maker.write(file)
        gear = 1 if truth.segments[0].direction > 0 else -1
        options = ReadOptions(initial_hitch=float(truth.start[3]), start_direction=gear)
        try:
            (found,) = read_cases(file, options)
        except LogError as error:
            return Outcome(error.code, False, False, np.nan, np.nan, np.nan, np.nan, str(error).split("mcap: ")[-1])
    path = found.problem.recorded
    gears = [segment.direction for segment in path.segments]
    same = gears == [segment.direction for segment in truth.segments]
    audit = audit_recorded(dataclasses.asdict(vehicle), scene_to_document(found.problem.scene), path_to_document(path))
    near = KDTree(_dense(path))
    off, from_poses = near.query(truth.samples.states[:, :2])[0], near.query(truck[:, :2])[0]
    text = "" if same else f"gears {gears}, "
    text += "; ".join(audit.failures)
    return Outcome(
        "",
        same,
        same and audit.passed,
        float(off.max()),
        float(np.sqrt(np.mean(off**2))),
        float(abs(path.goal[3] - truth.goal[3])),
        float(np.sqrt(np.mean(from_poses**2))),
        text,
    )


def _dense(path: Path) -> Array:
    """Points of a path every 5 mm. Shape (n, 2)."""
    samples = path.samples
    s = np.arange(0.0, samples.s[-1], 0.005)
    return np.stack([np.interp(s, samples.s, samples.states[:, column]) for column in (0, 1)], axis=1)


def _sampled(vehicle: Vehicle, path: Path, distortion: Distortion) -> Array:
    """True states where the log has poses. Shape (n, 4)."""
    if distortion.speed > 0.0:
        places = [_places_at_5_hz(segment.length, distortion.speed) for segment in path.segments]
    else:
        counts = [max(1, round(segment.length / distortion.spacing)) for segment in path.segments]
        places = [np.linspace(0.0, seg.length, n + 1) for seg, n in zip(path.segments, counts, strict=True)]
        places = [places[0], *(each[1:] for each in places[1:])]
    return np.concatenate(
        [sample_segment(vehicle, segment, s)[0] for segment, s in zip(path.segments, places, strict=True)]
    )


def _places_at_5_hz(length: float, speed: float) -> Array:
    """Arc lengths at 5 Hz from standstill to standstill [m]."""
    top = min(speed, np.sqrt(length * ACCELERATION))
    ramp, cruise = top / ACCELERATION, length / top - top / ACCELERATION
    t = np.arange(-STANDSTILL_S, 2.0 * ramp + cruise + STANDSTILL_S, 0.2)
    t = np.clip(t, 0.0, 2.0 * ramp + cruise)
    back = 2.0 * ramp + cruise - t
    rising, falling = 0.5 * ACCELERATION * t**2, length - 0.5 * ACCELERATION * back**2
    return np.where(t < ramp, rising, np.where(back < ramp, falling, 0.5 * top * ramp + top * (t - ramp)))


def _distorted(
    vehicle: Vehicle, states: Array, distortion: Distortion, rng: np.random.Generator
) -> tuple[Array, Array | None]:
    """Poses (x, y, heading) of the truck and, if asked for, of the trailer's axle, as the log has them."""
    states = np.repeat(states, 1 + distortion.repeated, axis=0)
    s = np.concatenate([[0.0], np.cumsum(np.hypot(*np.diff(states[:, :2], axis=0).T))])
    place = s[-1] / 3.0
    gap = np.abs(s - place) < distortion.dropped / 2.0
    states, s = states[~gap], s[~gap]
    heading = states[:, 2] + states[:, 3]
    axle = states[:, :2] - vehicle.hitch_to_axle * np.stack([np.cos(heading), np.sin(heading)], axis=1)
    sigma = [distortion.position, distortion.position, np.radians(distortion.heading)]
    truck, trailer = (
        poses + rng.normal(0.0, 1.0, poses.shape) * sigma for poses in (states[:, :3], np.column_stack([axle, heading]))
    )
    moved = (s >= place) * distortion.jump
    moved[int(np.argmin(np.abs(s - place)))] += distortion.outlier
    truck[:, 0] -= moved * np.sin(states[:, 2])
    truck[:, 1] += moved * np.cos(states[:, 2])
    if not distortion.has_headings:
        truck[:, 2] = 0.0
    return truck, trailer if distortion.has_trailer else None


def _copy_without_paths(log: pathlib.Path) -> Any:
    """A log with all but the paths and the planner's nodes of another."""
    maker = make.LogMaker()
    with log.open("rb") as stream:
        reader = make_reader(stream)
        for schema, channel, message in reader.iter_messages():
            if schema is not None and schema.name != make.PATH:
                maker.add_raw(
                    channel.topic,
                    schema.name,
                    message.data,
                    message.log_time // make.SECOND,
                    definition=schema.data,
                    encoding=channel.message_encoding,
                    schema_encoding=schema.encoding,
                )
        maker.metadata += [(each.name, each.metadata) for each in reader.iter_metadata() if each.name == "vehicle"]
    return maker


if __name__ == "__main__":
    run(main)
