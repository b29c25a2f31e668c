"""Memory: how much a factor needs, how much there is, and giving back what is free."""

from __future__ import annotations

import ctypes
import math
from contextlib import suppress
from pathlib import Path


def factor_memory(unknowns: int) -> float:
    """Return about how much memory MUMPS needs to factor a contact network, MB, all ranks together.

    In two dimensions a factor has of the order of n log n entries; the constant is measured
    (docs/benchmarks.md).
    """
    return 120e-6 * unknowns * math.log2(max(unknowns, 2))


def available_memory() -> float:
    """Return the memory of this machine that is free, MB; infinite where it does not say."""
    with suppress(OSError, ValueError, StopIteration):
        lines = Path("/proc/meminfo").read_text().splitlines()
        return int(next(line for line in lines if line.startswith("MemAvailable")).split()[1]) / 1024
    return math.inf


def give_back_memory() -> None:
    """Return freed memory to the system: glibc keeps it, two thirds of what assembly takes."""
    with suppress(OSError, AttributeError):
        ctypes.CDLL("libc.so.6").malloc_trim(0)
