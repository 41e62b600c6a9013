"""The ROS 2 message types that are understood.

A further type is one decoder, one message definition and one entry in `MESSAGE_TYPES`.
"""

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from typing import Any, Final

from replay.logs.messages import ros2_decoders as decoders
from replay.logs.messages import ros2_definitions as definitions
from replay.logs.messages.definition import matching_definition
from replay.logs.messages.types import Decode, MessageType, Role


@dataclass(frozen=True, kw_only=True)
class Ros2Type(MessageType):
    """A ROS 2 message type, in CDR."""

    encodings = ("cdr", "ros2msg"), ("cdr", "ros2idl")
    standards: tuple[str, ...]
    """The message definitions that `decode` knows."""
    decode: Callable[[bytes, int], Any]
    """Decodes a message whose definition is the one of that number. Raises PayloadError."""

    def decoder(self, encodings: tuple[str, str], definition: bytes) -> Decode:
        """The decoder for the messages of a channel. Raises DefinitionError."""
        standard = matching_definition(self.name, definition, self.standards, encodings[1])
        return lambda data: self.decode(data, standard)


def _by_name(*types: tuple[str, Role, Callable[[bytes, int], Any], tuple[str, ...]]) -> dict[str, Ros2Type]:
    return {
        name: Ros2Type(name=name, role=role, decode=decode, standards=standards)
        for name, role, decode, standards in types
    }


_MARKERS = (definitions.MARKER, definitions.MARKER_OLD)
MESSAGE_TYPES: Final[Mapping[str, Ros2Type]] = _by_name(
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
