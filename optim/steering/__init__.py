"""The exact local planner: steering between two full states without a map."""

from optim.steering.connect import Connection, Sampled, connections
from optim.steering.flat import Flat

__all__ = ["Connection", "Flat", "Sampled", "connections"]
