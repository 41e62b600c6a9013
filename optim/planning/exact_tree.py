"""The bidirectional random tree over exact steering, as a planner among others."""

import math
from dataclasses import dataclass, field

from optim.planning.protocol import CONNECTION_SPACING, Plan, Task, assemble, deadline
from optim.planning.rrt import Search, plan


@dataclass(frozen=True, kw_only=True)
class ExactTree:
    """Random curvature ramps and exact connections; see `optim.planning.rrt`."""

    search: Search = field(default_factory=Search)

    @property
    def name(self) -> str:
        return "RRT"

    def plan(self, task: Task, seed: int, time_limit: float = math.inf) -> Plan | None:
        """The first path found; see `optim.planning.protocol.Planner`."""
        found = plan(task, seed, self.search, deadline(time_limit))
        if found is None:
            return None
        return assemble([edge.segment(CONNECTION_SPACING) for edge in found.edges], found.iterations)
