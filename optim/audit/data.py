"""Reading a results document for the audit: plain data in, arrays out, and `Unreadable` for everything else.

A document may come from anywhere and hold anything. Whatever is wrong with it ends as `Unreadable`, which
carries the name of the check that reports it: `structure` (missing, wrong type or shape, impossible value)
or `finite` (null, NaN, infinite, absurdly large). Nothing is repaired, nothing is guessed.
"""

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Annotated as Float64
from typing import Annotated as Int64
from typing import Annotated as Shaped
from typing import Any, NamedTuple

import numpy as np
import shapely
from numpy.typing import NDArray

# as in `optim.numerics.arrays`, which the audit does not import
Array = NDArray[np.float64]
IntArray = NDArray[np.int64]
Shapes = NDArray[np.object_]

COLUMNS = ("s", "x", "y", "theta", "alpha", "phi")
WEIGHTS = ("length", "steer", "rate", "cusp", "jump")
LARGEST = 1e8
"""No coordinate or angle may be larger [m, rad]: above it a float64 no longer resolves the tolerances."""


@dataclass(frozen=True, kw_only=True)
class Place:
    """Place on a path where a check is worst."""

    segment: int
    s: float
    """Arc length in the segment [m]."""
    body: str | None = None
    """One of `optim.audit.motion.BODIES`, where the check distinguishes them."""
    polygon: int | None = None
    """Index of the nearest obstacle."""


class Unreadable(Exception):
    """The document cannot be read; `name` is the check that reports it."""

    def __init__(self, name: str, sentence: str) -> None:
        super().__init__(sentence)
        self.name = name


class VehicleData(NamedTuple):
    """Dimensions and limits [m, rad, rad/m]; the names are the document's."""

    wheelbase: float
    truck_front: float
    truck_rear: float
    truck_width: float
    hitch_to_axle: float
    trailer_front: float
    trailer_rear: float
    trailer_width: float
    max_steer: float
    max_hitch: float
    max_steer_rate: float
    hitch_offset: float


class SceneData(NamedTuple):
    """Obstacles and the map's outline as shapely polygons."""

    polygons: Shaped[Shapes, " _"]
    boundary: shapely.Polygon | None


class PathData(NamedTuple):
    """A path in one piece: N samples, M intervals between neighbours (none across a joint of segments)."""

    samples: Float64[Array, "6 N"]
    """Shape (6, N), rows as COLUMNS."""
    segment: Int64[IntArray, " N"]
    """Segment of each sample. Shape (N,)."""
    directions: Int64[IntArray, " S"]
    """+1 or -1 for each segment. Shape (S,)."""
    left: Int64[IntArray, " M"]
    """Sample at which each interval starts. Shape (M,)."""

    @property
    def before(self) -> Array:
        """Samples at the intervals' starts. Shape (6, M)."""
        return self.samples[:, self.left]

    @property
    def after(self) -> Array:
        """Samples at the intervals' ends. Shape (6, M)."""
        return self.samples[:, self.left + 1]

    @property
    def ds(self) -> Array:
        """Lengths of the intervals [m]. Shape (M,)."""
        return self.after[0] - self.before[0]

    @property
    def direction(self) -> IntArray:
        """+1 or -1 for each interval. Shape (M,)."""
        return self.directions[self.segment[self.left]]

    @property
    def firsts(self) -> IntArray:
        """The first sample of each segment."""
        return np.flatnonzero(np.diff(self.segment, prepend=-1))

    def place(self, sample: int | np.integer) -> Place:
        """Place of a sample: its segment, and the arc length in it [m]."""
        return Place(segment=int(self.segment[sample]), s=float(self.samples[0, sample]))


def read_vehicle(vehicle: Any) -> VehicleData:
    """The vehicle, all fields present and possible."""
    low = {"wheelbase": 1e-3, "hitch_to_axle": 1e-3, "hitch_offset": -100.0}
    high = {"max_steer": 1.5, "max_hitch": math.pi / 2, "max_steer_rate": 1e3}
    names = VehicleData._fields
    return VehicleData(*(_number(vehicle, n, "vehicle", low.get(n, 0.0), high.get(n, 100.0)) for n in names))


def read_weights(weights: Any) -> dict[str, float]:
    """The objective's weights, by the names in WEIGHTS."""
    return {name: _number(weights, name, "weights", 0.0, LARGEST) for name in WEIGHTS}


def read_scene(scene: Any) -> SceneData:
    """The polygons, each simple and with an area, and the boundary where there is one."""
    outlines = _entry(scene, "polygons", "scene")
    if isinstance(outlines, (str, bytes)) or not isinstance(outlines, (Sequence, np.ndarray)):
        raise Unreadable("structure", f"scene.polygons is {_kind(outlines)}, expected a list")
    boundary = scene.get("boundary")
    areas = _areas(outlines, "scene.polygons")
    return SceneData(areas, None if boundary is None else _areas([boundary], "scene.boundary")[0])


def read_path(path: Any, where: str) -> PathData:
    """A path of at least one segment of at least two samples; `where` names it in messages."""
    segments = _entry(path, "segments", where)
    if not isinstance(segments, (list, tuple)) or not segments:
        raise Unreadable("structure", f"{where}.segments is empty or no list")
    parts = [_segment(segment, f"{where}.segments[{i}]") for i, segment in enumerate(segments)]
    counts = [part.shape[1] for _, part in parts]
    inner = np.ones(sum(counts), dtype=bool)
    inner[np.cumsum(counts) - 1] = False
    return PathData(
        samples=np.concatenate([part for _, part in parts], axis=1),
        segment=np.repeat(np.arange(len(counts)), counts),
        directions=np.array([direction for direction, _ in parts]),
        left=np.flatnonzero(inner),
    )


def _segment(segment: Any, where: str) -> tuple[int, Array]:
    direction = _entry(segment, "direction", where)
    _require_gear(direction, where)
    columns = [_numbers(_entry(segment, key, where), f"{where}.{key}") for key in COLUMNS]
    shapes = {column.shape for column in columns}
    if len(shapes) > 1 or columns[0].ndim != 1 or len(columns[0]) < 2:
        raise Unreadable("structure", f"{where} has arrays of shapes {sorted(shapes)}, expected one, (2 or more,)")
    for key, column in zip(COLUMNS, columns, strict=True):
        _require_finite(column, f"{where}.{key}")
    return int(direction), np.array(columns)


def _require_gear(direction: Any, where: str) -> None:
    if isinstance(direction, bool) or not isinstance(direction, (int, np.integer)) or direction not in (1, -1):
        raise Unreadable("structure", f"{where}.direction is neither 1 nor -1")


def _areas(outlines: Sequence[Any] | NDArray[Any], where: str) -> Shapes:
    rings = [_numbers(outline, f"{where}[{i}]") for i, outline in enumerate(outlines)]
    for i, ring in enumerate(rings):
        if ring.ndim != 2 or ring.shape[1] != 2 or len(ring) < 3:
            raise Unreadable("structure", f"{where}[{i}] has shape {ring.shape}, expected (3 or more, 2)")
        _require_finite(ring, f"{where}[{i}]")
    if not rings:
        return np.empty(0, dtype=object)
    owner = np.repeat(np.arange(len(rings)), [len(ring) for ring in rings])
    areas = np.asarray(shapely.polygons(shapely.linearrings(np.concatenate(rings), indices=owner)))
    _require_simple(areas, where)
    return areas


def _require_simple(areas: Shapes, where: str) -> None:
    bad = ~(shapely.is_valid(areas) & (shapely.area(areas) > 0.0))
    if bad.any():
        raise Unreadable("structure", f"{where}[{int(np.argmax(bad))}] is not a simple polygon with an area")


def _entry(data: Any, key: str, where: str) -> Any:
    if not isinstance(data, Mapping):
        raise Unreadable("structure", f"{where} is {_kind(data)}, expected an object")
    if key not in data:
        raise Unreadable("structure", f"{where}.{key} is missing")
    return data[key]


def _kind(value: Any) -> str:
    return "null" if value is None else f"of type {type(value).__name__}"


def _is_number(value: Any) -> bool:
    return isinstance(value, (int, float, np.integer, np.floating)) and not isinstance(value, bool)


def _number(data: Any, key: str, where: str, low: float, high: float) -> float:
    value = _entry(data, key, where)
    if not _is_number(value):
        raise Unreadable("structure", f"{where}.{key} is {_kind(value)}, expected a number")
    if isinstance(value, float) and not math.isfinite(value):
        raise Unreadable("finite", f"{where}.{key} is {value}")
    number = float(min(max(value, -1e300), 1e300))  # an integer may be beyond float64
    if not low <= number <= high:
        raise Unreadable("structure", f"{where}.{key} is {number:g}, expected {low:g} to {high:g}")
    return number


def _numbers(values: Any, where: str) -> Array:
    """Numbers in a list, or in lists of equal lengths; null counts as NaN (see `_require_finite`)."""
    try:
        array = np.array(values)
        if array.dtype == object and array.ndim > 0 and all(v is None or _is_number(v) for v in array.flat):
            array = array.astype(np.float64)
        if array.ndim > 0 and array.dtype.kind in "fiu":
            return array.astype(np.float64)
    except (ValueError, TypeError, OverflowError):
        pass  # ragged, or an integer beyond float64
    raise Unreadable("structure", f"{where} is not an array of numbers")


def _require_finite(array: Array, where: str) -> None:
    bad = ~(np.abs(array) <= LARGEST)
    if bad.any():
        index = tuple(int(i) for i in np.argwhere(bad)[0])
        position = ", ".join(map(str, index))
        raise Unreadable("finite", f"{where}[{position}] is {array[index]:g}, expected a number up to {LARGEST:g}")
