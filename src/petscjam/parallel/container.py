"""Limits of the control groups of Linux (containers, batch systems) for this process: memory and processors."""

from __future__ import annotations

import math
from collections.abc import Iterator
from contextlib import suppress
from pathlib import Path

ROOT = Path("/")


def memory_left() -> float:
    """Return the memory that the limits of this process leave, MB; infinite without a limit.

    Pages of files that are cached and not in use count as free.
    """
    left = math.inf
    for folder in _groups("memory"):
        with suppress(OSError, ValueError):  # no limit: no file, or "max"
            limit = int(_first(folder, "memory.max", "memory.limit_in_bytes"))
            used = int(_first(folder, "memory.current", "memory.usage_in_bytes"))
            lines = (folder / "memory.stat").read_text().splitlines()
            cached = {key: int(value) for key, value in map(str.split, lines)}
            used -= cached.get("total_inactive_file", cached.get("inactive_file", 0))
            left = min(left, max(limit - used, 0) / 2**20)
    return left


def cores() -> float:
    """Return the processor time per time that this process may use; infinite without a limit."""
    found = math.inf
    for folder in _groups("cpu"):
        with suppress(OSError, ValueError):
            if (folder / "cpu.max").exists():
                quota, period = map(int, (folder / "cpu.max").read_text().split())
            else:
                quota, period = (int(_first(folder, f"cpu.cfs_{name}_us")) for name in ("quota", "period"))
            if quota > 0:
                found = min(found, quota / period)
    return found


def _groups(controller: str) -> Iterator[Path]:
    """Yield the folders of the control groups that limit this process, for both versions of control groups."""
    with suppress(OSError):
        for line in (ROOT / "proc/self/cgroup").read_text().splitlines():
            _, names, path = line.split(":", 2)
            if names == "" or controller in names.split(","):
                base = ROOT / "sys/fs/cgroup" / (controller if names else "")
                for group in (Path(path), *Path(path).parents):
                    yield base / str(group).lstrip("/")


def _first(folder: Path, *names: str) -> str:
    """Return the text of the first of these files that exists."""
    return next((folder / name for name in names if (folder / name).exists()), folder / names[0]).read_text()
