"""What a run was timed on."""

import os
import platform
from pathlib import Path

_INFO = Path("/proc/cpuinfo")


def machine_name() -> str:
    """Name of the processor, and how many cores there are."""
    name = platform.processor() or platform.machine()
    if _INFO.exists():
        lines = _INFO.read_text().splitlines()
        models = (line.split(":", 1)[1].strip() for line in lines if line.startswith("model name"))
        name = next(models, name)
    return f"{name}, {os.cpu_count()} cores"
