"""Memory: how much a factor needs, how much there is, and giving back what is free."""

from __future__ import annotations

import ctypes
import math
import os
import resource
import shutil
from contextlib import suppress
from pathlib import Path

from petscjam.base.errors import InputError
from petscjam.parallel.comm import Comm, raise_together
from petscjam.parallel.container import memory_left


def factor_memory(unknowns: int) -> float:
    """Return about how much memory MUMPS needs to factor a contact network, MB, all ranks together.

    In two dimensions a factor has of the order of n log n entries; the constant is measured
    (docs/benchmarks.md).
    """
    return 120e-6 * unknowns * math.log2(max(unknowns, 2))


def available_memory() -> float:
    """Return the memory that is free to this process, MB; infinite where the machine does not say."""
    free = math.inf
    with suppress(OSError, ValueError, StopIteration):
        lines = Path("/proc/meminfo").read_text().splitlines()
        free = int(next(line for line in lines if line.startswith("MemAvailable")).split()[1]) / 1024
    return min(free, memory_left())


def peak_memory() -> float:
    """Return the largest memory that this process has had, MB."""
    return resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 1024


def scratch_folder() -> Path:
    """Return where MUMPS keeps a factor out of core."""
    return Path(os.environ.get("MUMPS_OOC_TMPDIR") or "/tmp")


def require(size: float, what: str, comm: Comm | None = None) -> None:
    """Refuse to ask for ``size`` bytes that this machine, or one of ``comm``, does not have; then collective.

    Raises
    ------
    InputError
        It names ``what`` the memory is for, how much it takes and how much is free.
    """
    free = available_memory() if comm is None else min(comm.allgather(available_memory()))
    if size / 2**20 > free:
        raise InputError(f"{what}: needs about {size / 2**20:.3g} MB, and {free:.0f} MB are free; take less")


def check_memory(comm: Comm, unknowns: int, *, out_of_core: bool = False) -> str:
    """Say what a factor will need, before any work; collective.

    Raises
    ------
    InputError
        If a node has less free than its share of that, in memory or, ``out_of_core``, in the folder.
    """
    from mpi4py import MPI

    node = comm.Split_type(MPI.COMM_TYPE_SHARED)
    share = factor_memory(unknowns) * node.size / comm.size
    node.Free()
    if out_of_core:
        raise_together(comm, _scratch_error(share))
    lacking = comm.allreduce(share - available_memory(), MPI.MAX)
    if lacking > 0 and not out_of_core:
        raise InputError(
            f"the factor of {unknowns} unknowns needs about {factor_memory(unknowns):.0f} MB, "
            f"{lacking:.0f} MB more than are free: take more nodes, or keep it out of core"
        )
    return f"{unknowns} unknowns, the factor needs about {factor_memory(unknowns):.0f} MB"


def _scratch_error(share: float) -> InputError | None:
    """Say why the scratch folder cannot take ``share``, MB."""
    folder = scratch_folder()
    advice = "MUMPS_OOC_TMPDIR names a folder for the factor"
    if not folder.is_dir():
        return InputError(f"out of core: there is no folder {folder}; {advice}")
    if not os.access(folder, os.W_OK | os.X_OK):
        return InputError(f"out of core: the folder {folder} is not writable; {advice}")
    free = shutil.disk_usage(folder).free / 2**20
    if free < share:
        return InputError(
            f"out of core: the factor needs about {share:.0f} MB, {folder} has {free:.0f} MB free; {advice}"
        )
    return None


def give_back_memory() -> None:
    """Return freed memory to the system: glibc keeps it, two thirds of what assembly takes."""
    with suppress(OSError, AttributeError):
        ctypes.CDLL("libc.so.6").malloc_trim(0)
