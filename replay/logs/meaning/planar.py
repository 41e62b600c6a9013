"""Projection of poses in space to the plane; poses that are tilted or not finite are refused."""

import numpy as np

from optim.numerics.arrays import Array

NORM_SILENT = 1e-6
"""Quaternions that are off the unit sphere by this much are normalised silently (float32 sources)."""
NORM_REFUSED = 1e-3
"""Quaternions that are off by more are refused; in between, a note says so."""
MAX_TILT = np.radians(1.0)
"""Largest angle between a pose's z axis and the vertical [rad]."""
_FIELDS = (
    "position.x",
    "position.y",
    "position.z",
    "orientation.x",
    "orientation.y",
    "orientation.z",
    "orientation.w",
)


class Refusal(Exception):
    """Refusal of a part of a log; the caller adds file and topic."""

    def __init__(self, code: str, text: str) -> None:
        self.code = code
        super().__init__(text)


def planar(poses: Array, what: str) -> tuple[Array, list[str]]:
    """Columns x, y [m] and yaw [rad] of poses (n, 7) of position and quaternion; shape (n, 3), and notes.

    Raises:
        Refusal: a value that is not finite, no unit quaternion, or tilted by more than `MAX_TILT`.
    """
    notes: list[str] = []
    finite = np.isfinite(poses)
    if not finite.all():
        row, column = np.argwhere(~finite)[0]
        value = poses[row, column]
        raise Refusal("E_NONFINITE", f"{_at(what, row, len(poses))}: {_FIELDS[column]} is {value}, expected a number")
    with np.errstate(over="ignore", under="ignore", invalid="ignore"):
        norm = np.sqrt(np.sum(poses[:, 3:] ** 2, axis=1))
    off = np.abs(norm - 1.0)
    worst = int(np.argmax(off)) if len(off) else 0
    if len(off) and not off[worst] <= NORM_REFUSED:
        text = f"{_at(what, worst, len(poses))}: its quaternion has the norm {norm[worst]:.6g}, expected 1"
        raise Refusal("E_QUATERNION", text)
    if len(off) and off[worst] > NORM_SILENT:
        notes.append(f"{_at(what, worst, len(poses))}: its quaternion has the norm {norm[worst]:.6g}; normalised")
    qx, qy, qz, qw = (poses[:, 3:] / norm[:, None]).T
    tilt = np.arccos(np.clip(1.0 - 2.0 * (qx**2 + qy**2), -1.0, 1.0))
    if len(tilt) and tilt.max() > MAX_TILT:
        worst = int(np.argmax(tilt))
        text = f"{_at(what, worst, len(poses))} is tilted by {np.degrees(tilt[worst]):.3g} degrees, expected at most 1"
        raise Refusal("E_QUATERNION", text)
    yaw = np.arctan2(2.0 * (qw * qz + qx * qy), 1.0 - 2.0 * (qy**2 + qz**2))
    return np.column_stack([poses[:, 0], poses[:, 1], yaw]), notes


def _at(what: str, row: int, count: int) -> str:
    return what if count == 1 else f"{what} {row}"


def rotation(quaternion: Array) -> Array:
    """The rotation matrix of a unit quaternion x, y, z, w. Shape (3, 3)."""
    x, y, z, w = quaternion
    return np.array(
        [
            [1 - 2 * (y * y + z * z), 2 * (x * y - w * z), 2 * (x * z + w * y)],
            [2 * (x * y + w * z), 1 - 2 * (x * x + z * z), 2 * (y * z - w * x)],
            [2 * (x * z - w * y), 2 * (y * z + w * x), 1 - 2 * (x * x + y * y)],
        ]
    )
