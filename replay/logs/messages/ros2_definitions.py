"""The standard definitions of the ROS 2 messages that are understood or written, ROS 2 Humble and later.

MARKER_OLD: Foxy and Galactic.
"""

_RULE = "\n" + "=" * 80 + "\n"


def _definition(body: str, *parts: str) -> str:
    return _RULE.join((body, *parts))


_HEADER = "MSG: std_msgs/Header\nbuiltin_interfaces/Time stamp\nstring frame_id\n"
_TIME = "MSG: builtin_interfaces/Time\nint32 sec\nuint32 nanosec\n"
_DURATION = "MSG: builtin_interfaces/Duration\nint32 sec\nuint32 nanosec\n"
_POINT = "MSG: geometry_msgs/Point\nfloat64 x\nfloat64 y\nfloat64 z\n"
_VECTOR = "MSG: geometry_msgs/Vector3\nfloat64 x\nfloat64 y\nfloat64 z\n"
_QUATERNION = "MSG: geometry_msgs/Quaternion\nfloat64 x 0\nfloat64 y 0\nfloat64 z 0\nfloat64 w 1\n"
_POSE = _definition(
    "MSG: geometry_msgs/Pose\ngeometry_msgs/Point position\ngeometry_msgs/Quaternion orientation\n", _POINT, _QUATERNION
)
GRID = _definition(
    "std_msgs/Header header\nnav_msgs/MapMetaData info\nint8[] data\n",
    "MSG: nav_msgs/MapMetaData\nbuiltin_interfaces/Time map_load_time\nfloat32 resolution\n"
    "uint32 width\nuint32 height\ngeometry_msgs/Pose origin\n",
    _HEADER, _TIME, _POSE,
)  # fmt: skip
PATH = _definition(
    "std_msgs/Header header\ngeometry_msgs/PoseStamped[] poses\n",
    "MSG: geometry_msgs/PoseStamped\nstd_msgs/Header header\ngeometry_msgs/Pose pose\n",
    _POSE, _HEADER, _TIME,
)  # fmt: skip
_MARKER_START = (
    "std_msgs/Header header\nstring ns\nint32 id\nint32 type\nint32 action\ngeometry_msgs/Pose pose\n"
    "geometry_msgs/Vector3 scale\nstd_msgs/ColorRGBA color\nbuiltin_interfaces/Duration lifetime\n"
    "bool frame_locked\ngeometry_msgs/Point[] points\nstd_msgs/ColorRGBA[] colors\n"
)
_MARKER_PARTS = (
    _HEADER, _TIME, _POSE,
    _VECTOR,
    "MSG: std_msgs/ColorRGBA\nfloat32 r\nfloat32 g\nfloat32 b\nfloat32 a\n",
    _DURATION,
)  # fmt: skip
_TEXTURE_PARTS = (
    "MSG: sensor_msgs/CompressedImage\nstd_msgs/Header header\nstring format\nuint8[] data\n",
    "MSG: visualization_msgs/UVCoordinate\nfloat32 u\nfloat32 v\n",
    "MSG: visualization_msgs/MeshFile\nstring filename\nuint8[] data\n",
)
MARKER = _definition(
    _MARKER_START + "string texture_resource\nsensor_msgs/CompressedImage texture\n"
    "visualization_msgs/UVCoordinate[] uv_coordinates\nstring text\nstring mesh_resource\n"
    "visualization_msgs/MeshFile mesh_file\nbool mesh_use_embedded_materials\n",
    *_MARKER_PARTS, *_TEXTURE_PARTS,
)  # fmt: skip
MARKER_OLD = _definition(
    _MARKER_START + "string text\nstring mesh_resource\nbool mesh_use_embedded_materials\n", *_MARKER_PARTS
)


def array_of(marker: str) -> str:
    """The definition of an array of markers."""
    return _definition("visualization_msgs/Marker[] markers\n", "MSG: visualization_msgs/Marker\n" + marker)


POSE_ARRAY = _definition("std_msgs/Header header\ngeometry_msgs/Pose[] poses\n", _HEADER, _TIME, _POSE)
TRAJECTORY = _definition(
    "std_msgs/Header header\nautoware_planning_msgs/TrajectoryPoint[] points\n",
    "MSG: autoware_planning_msgs/TrajectoryPoint\nbuiltin_interfaces/Duration time_from_start\n"
    "geometry_msgs/Pose pose\nfloat32 longitudinal_velocity_mps\nfloat32 lateral_velocity_mps\n"
    "float32 acceleration_mps2\nfloat32 heading_rate_rps\nfloat32 front_wheel_angle_rad\n"
    "float32 rear_wheel_angle_rad\n",
    _HEADER, _TIME, _DURATION, _POSE,
)  # fmt: skip
_POINT32 = "MSG: geometry_msgs/Point32\nfloat32 x\nfloat32 y\nfloat32 z\n"
POLYGON = _definition("geometry_msgs/Point32[] points\n", _POINT32)
POLYGON_STAMPED = _definition(
    "std_msgs/Header header\ngeometry_msgs/Polygon polygon\n", "MSG: geometry_msgs/Polygon\n" + POLYGON, _HEADER, _TIME
)
JOINTS = _definition(
    "std_msgs/Header header\nstring[] name\nfloat64[] position\nfloat64[] velocity\nfloat64[] effort\n",
    _HEADER, _TIME,
)  # fmt: skip
TRANSFORMS = _definition(
    "geometry_msgs/TransformStamped[] transforms\n",
    "MSG: geometry_msgs/TransformStamped\nstd_msgs/Header header\nstring child_frame_id\n"
    "geometry_msgs/Transform transform\n",
    "MSG: geometry_msgs/Transform\ngeometry_msgs/Vector3 translation\ngeometry_msgs/Quaternion rotation\n",
    _HEADER, _TIME, _VECTOR, _QUATERNION,
)  # fmt: skip
POSE_STAMPED = _definition("std_msgs/Header header\ngeometry_msgs/Pose pose\n", _HEADER, _TIME, _POSE)
_POSE_COVARIANCE = "MSG: geometry_msgs/PoseWithCovariance\ngeometry_msgs/Pose pose\nfloat64[36] covariance\n"
POSE_COVARIANCE = _definition(
    "std_msgs/Header header\ngeometry_msgs/PoseWithCovariance pose\n", _HEADER, _TIME, _POSE_COVARIANCE, _POSE
)
ODOMETRY = _definition(
    "std_msgs/Header header\nstring child_frame_id\ngeometry_msgs/PoseWithCovariance pose\n"
    "geometry_msgs/TwistWithCovariance twist\n",
    _HEADER, _TIME, _POSE_COVARIANCE, _POSE,
    "MSG: geometry_msgs/TwistWithCovariance\ngeometry_msgs/Twist twist\nfloat64[36] covariance\n",
    "MSG: geometry_msgs/Twist\ngeometry_msgs/Vector3 linear\ngeometry_msgs/Vector3 angular\n",
    _VECTOR,
)  # fmt: skip
