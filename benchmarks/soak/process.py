"""Resources of the process: processor time, memory, garbage collections."""

import gc
import resource
import sys
import time
from pathlib import Path
from types import TracebackType
from typing import Any

_STATM = Path("/proc/self/statm")


class CollectorTime:
    """Total time of the garbage collector within a `with` block."""

    def __init__(self) -> None:
        self.total_s = 0.0
        self._began_s = 0.0

    def __enter__(self) -> "CollectorTime":
        gc.callbacks.append(self._note)
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        gc.callbacks.remove(self._note)

    def _note(self, phase: str, info: dict[str, Any]) -> None:
        if phase == "start":
            self._began_s = time.perf_counter()
        else:
            self.total_s += time.perf_counter() - self._began_s


def preemptions() -> int:
    """Return the number of involuntary context switches of this process so far."""
    return resource.getrusage(resource.RUSAGE_SELF).ru_nivcsw


def resident_mb() -> float:
    """Return the memory of this process; its peak so far if the system does not report the memory."""
    if _STATM.exists():
        return int(_STATM.read_text().split()[1]) * resource.getpagesize() / 1e6
    peak = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss
    return peak / (1e6 if sys.platform == "darwin" else 1e3)  # macOS counts bytes, Linux kilobytes
