"""All message types that are understood, by schema name."""

from collections.abc import Mapping
from typing import Final

from replay.logs import ros2

Family = ros2.Family
FAMILIES: Final[Mapping[str, Family]] = ros2.FAMILIES
