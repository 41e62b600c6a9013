"""Limits of one method's time and memory."""

import math
from dataclasses import dataclass
from typing import Final

GRACE_S: Final = 2.0
"""Time that a method has to report its next iterate after its time is up [s]; then its process is ended."""
BUSY: Final = 5.0
"""Multiple of the limit of processor time that a method may take in wall time; beyond it, it counts as hung."""


@dataclass(frozen=True, kw_only=True)
class Limits:
    """Limits of one method."""

    time_s: float = math.inf
    """Time for solving, compiling not counted [s]."""
    by_processor: bool = False
    """Whether that is time of the processor, which does not depend on what else the machine does."""
    memory_mib: int | None = None
    """Memory for data that the process may hold [MiB]; only systems with RLIMIT_DATA keep it."""

    @property
    def watch_s(self) -> float:
        """Wall time after which the process is ended, whatever it does [s]."""
        return self.time_s * (BUSY if self.by_processor else 1.0) + GRACE_S


NO_LIMITS: Final = Limits()
LIMITS: Final = Limits(memory_mib=4096)
"""Limits of a method by default, and of reading: no limit of time."""
