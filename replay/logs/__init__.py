"""Reading MCAP logs: the container, the messages in it, and the parking requests that they make up."""

from replay.logs.meaning.assemble import read_cases
from replay.logs.meaning.read_options import ReadOptions

__all__ = ["ReadOptions", "read_cases"]
