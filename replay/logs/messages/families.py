"""All message types that are understood, by schema name."""

from collections.abc import Mapping
from typing import Final

from replay.logs.messages import foxglove, ros2

Family = ros2.Family | foxglove.Family
FAMILIES: Final[Mapping[str, Family]] = {**ros2.FAMILIES, **foxglove.FAMILIES}
