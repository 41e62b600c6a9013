"""The ROS 2 messages that are understood. A further type is one decoder, one definition and one entry in `FAMILIES`."""

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from typing import Any, Final

from replay.logs.messages import ros2_decoders as decoders
from replay.logs.messages import ros2_definitions as definitions
from replay.logs.messages.content import Role
from replay.logs.messages.layout import matching_layout

DEFINITIONS: Final = ("ros2msg", "ros2idl")
"""Encodings of definitions that are read."""


@dataclass(frozen=True, kw_only=True)
class Family:
    """A message type that is understood."""

    name: str
    role: Role
    """What it is read as."""
    standards: tuple[str, ...]
    """Definitions that the decoder knows; the decoder is told which one it is."""
    decode: Callable[[bytes, int], Any]

    @property
    def encodings(self) -> tuple[tuple[str, str], ...]:
        """Pairs of message encoding and encoding of the definition that are read."""
        return tuple(("cdr", each) for each in DEFINITIONS)

    def reader(self, encodings: tuple[str, str], definition: bytes) -> Callable[[bytes], Any]:
        """What decodes the messages of a channel. Raises LayoutError where its definition is not the standard one."""
        layout = matching_layout(self.name, definition, self.standards, encodings[1])
        return lambda data: self.decode(data, layout)


def _by_name(*families: tuple[str, Role, Callable[[bytes, int], Any], tuple[str, ...]]) -> dict[str, Family]:
    return {
        name: Family(name=name, role=role, decode=decode, standards=standards)
        for name, role, decode, standards in families
    }


_MARKERS = (definitions.MARKER, definitions.MARKER_OLD)
FAMILIES: Final[Mapping[str, Family]] = _by_name(
    ("nav_msgs/msg/OccupancyGrid", "grid", decoders.decode_grid, (definitions.GRID,)),
    (
        "visualization_msgs/msg/MarkerArray",
        "markers",
        decoders.decode_markers,
        tuple(map(definitions.array_of, _MARKERS)),
    ),
    ("visualization_msgs/msg/Marker", "markers", decoders.decode_marker, _MARKERS),
    ("geometry_msgs/msg/PolygonStamped", "polygon", decoders.decode_polygon_stamped, (definitions.POLYGON_STAMPED,)),
    ("geometry_msgs/msg/Polygon", "polygon", decoders.decode_polygon, (definitions.POLYGON,)),
    ("nav_msgs/msg/Path", "path", decoders.decode_path, (definitions.PATH,)),
    ("geometry_msgs/msg/PoseArray", "path", decoders.decode_pose_array, (definitions.POSE_ARRAY,)),
    ("autoware_planning_msgs/msg/Trajectory", "path", decoders.decode_trajectory, (definitions.TRAJECTORY,)),
    ("nav_msgs/msg/Odometry", "stream", decoders.decode_odometry, (definitions.ODOMETRY,)),
    ("geometry_msgs/msg/PoseStamped", "stream", decoders.decode_pose_stamped, (definitions.POSE_STAMPED,)),
    (
        "geometry_msgs/msg/PoseWithCovarianceStamped",
        "stream",
        decoders.decode_pose_covariance,
        (definitions.POSE_COVARIANCE,),
    ),
    ("sensor_msgs/msg/JointState", "joints", decoders.decode_joints, (definitions.JOINTS,)),
    ("tf2_msgs/msg/TFMessage", "transforms", decoders.decode_transforms, (definitions.TRANSFORMS,)),
)
"""Message types by schema name."""
