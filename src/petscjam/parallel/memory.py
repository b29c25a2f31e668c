"""Memory: how much a factor needs, how much there is, and giving back what is free."""

from __future__ import annotations

import ctypes
import math
from contextlib import suppress
from pathlib import Path
from typing import Any

from petscjam.errors import InputError


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


def check_memory(comm: Any, unknowns: int, *, out_of_core: bool = False) -> str:
    """Say what a factor will need, before any work; collective.

    Raises
    ------
    InputError
        If a node has less free than its share of that, and ``out_of_core`` is not set.
    """
    from mpi4py import MPI

    node = comm.Split_type(MPI.COMM_TYPE_SHARED)
    share = factor_memory(unknowns) * node.size / comm.size
    node.Free()
    lacking = comm.allreduce(share - available_memory(), MPI.MAX)
    if lacking > 0 and not out_of_core:
        raise InputError(
            f"the factor of {unknowns} unknowns needs about {factor_memory(unknowns):.0f} MB, "
            f"{lacking:.0f} MB more than are free: take more nodes, or keep it out of core"
        )
    return f"{unknowns} unknowns, the factor needs about {factor_memory(unknowns):.0f} MB"


def give_back_memory() -> None:
    """Return freed memory to the system: glibc keeps it, two thirds of what assembly takes."""
    with suppress(OSError, AttributeError):
        ctypes.CDLL("libc.so.6").malloc_trim(0)
