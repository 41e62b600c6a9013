"""Reading MCAP logs: the container, the messages in it, and the parking requests that they make up."""

from replay.logs.assemble import read_cases
from replay.logs.options import ReadOptions

__all__ = ["ReadOptions", "read_cases"]
