"""What the benchmark ran on, and how much others ran on it meanwhile. Standard library only."""

from __future__ import annotations

import os
import platform
import resource
import time
from pathlib import Path
from typing import Any

BUSY = 0.5  # load average above which threads that wait for a core distort the result
STAT = Path("/proc/stat")


def describe() -> dict[str, Any]:
    """Call it before anything else runs: the load is the machine's, not the benchmark's."""
    cpu = platform.processor() or platform.machine()
    info = Path("/proc/cpuinfo")
    if info.exists():
        names = [line for line in info.read_text().splitlines() if line.startswith("model name")]
        cpu = names[0].split(":", 1)[1].strip() if names else cpu
    affinity = getattr(os, "sched_getaffinity", None)
    return {
        "cpu": cpu,
        "cores": len(affinity(0)) if affinity else os.cpu_count(),
        "memory_gib": os.sysconf("SC_PAGE_SIZE") * os.sysconf("SC_PHYS_PAGES") / 2**30,
        "system": f"{platform.system()} {platform.release()}",
        "load": os.getloadavg(),
    }


class Others:
    """How many cores other processes kept busy between here and `cores`, on average (Linux)."""

    def __init__(self) -> None:
        self._start = time.monotonic(), busy_seconds(), own_seconds()

    def cores(self) -> float | None:
        """Call it when all child processes have ended: their time counts only then."""
        began, busy, own = self._start
        now = busy_seconds()
        if busy is None or now is None:
            return None
        others = (now - busy) - (own_seconds() - own)
        return max(0.0, others / (time.monotonic() - began))


def busy_seconds() -> float | None:
    """Seconds that all cores together have worked or were taken by other machines on the host."""
    if not STAT.exists():
        return None
    user, nice, system, _idle, _wait, irq, soft, steal = STAT.read_text().split()[1:9]
    ticks = sum(int(part) for part in (user, nice, system, irq, soft, steal))
    return ticks / os.sysconf("SC_CLK_TCK")


def own_seconds() -> float:
    """Seconds that this process and its ended children have worked."""
    used = (resource.getrusage(who) for who in (resource.RUSAGE_SELF, resource.RUSAGE_CHILDREN))
    return sum(each.ru_utime + each.ru_stime for each in used)
