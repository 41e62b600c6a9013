"""Messages of one pose for tests: each of (x, y, yaw) at a time [ns], with the speed at which it is left [m/s]."""

from typing import Any

import logs_maker as make
import numpy as np


def odometry(row: np.ndarray, time: int, speed: float) -> Any:
    none = np.zeros(36)
    zero = make.ros("geometry_msgs/msg/Vector3", x=0.0, y=0.0, z=0.0)
    ahead = make.ros("geometry_msgs/msg/Vector3", x=float(speed), y=0.0, z=0.0)
    twist = make.ros("geometry_msgs/msg/Twist", linear=ahead, angular=zero)
    return make.ros(
        "nav_msgs/msg/Odometry",
        header=make.header("map", time),
        child_frame_id="base_link",
        pose=make.ros("geometry_msgs/msg/PoseWithCovariance", pose=make.pose(*row.tolist()), covariance=none),
        twist=make.ros("geometry_msgs/msg/TwistWithCovariance", twist=twist, covariance=none),
    )


def stamped(row: np.ndarray, time: int, _: float) -> Any:
    return make.ros("geometry_msgs/msg/PoseStamped", header=make.header("map", time), pose=make.pose(*row.tolist()))


def with_covariance(row: np.ndarray, time: int, _: float) -> Any:
    pose = make.ros("geometry_msgs/msg/PoseWithCovariance", pose=make.pose(*row.tolist()), covariance=np.zeros(36))
    return make.ros("geometry_msgs/msg/PoseWithCovarianceStamped", header=make.header("map", time), pose=pose)
