"""Message types: which ones are understood, and how the messages of each are decoded."""

from collections.abc import Mapping
from typing import Final

from replay.logs.messages import foxglove, ros2
from replay.logs.messages.types import MessageType

MESSAGE_TYPES: Final[Mapping[str, MessageType]] = {**ros2.MESSAGE_TYPES, **foxglove.MESSAGE_TYPES}
"""All message types that are understood, by schema name."""
