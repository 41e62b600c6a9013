"""How long a call takes."""

import time
from collections.abc import Callable


def least(call: Callable[[], object], runs: int, clock: Callable[[], float] = time.process_time) -> float:
    """The least time of some calls [s]: CPU time of this process, or by another clock."""
    times = []
    for _ in range(runs):
        began = clock()
        call()
        times.append(clock() - began)
    return min(times)
