"""Memory: the need of a factor, the free memory, and the return of freed memory to the system."""

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
    """Return an estimate of the memory of MUMPS for the factor of a contact network, MB, sum over ranks.

    In two dimensions a factor has of the order of n log n entries; the constant is measured
    (docs/benchmarks.md).
    """
    return 120e-6 * unknowns * math.log2(max(unknowns, 2))


def available_memory() -> float:
    """Return the memory that is free for this process, MB; infinite if unknown."""
    free = math.inf
    with suppress(OSError, ValueError, StopIteration):
        lines = Path("/proc/meminfo").read_text().splitlines()
        free = int(next(line for line in lines if line.startswith("MemAvailable")).split()[1]) / 1024
    return min(free, memory_left())


def peak_memory() -> float:
    """Return the peak memory of this process, MB."""
    return resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 1024


def scratch_folder() -> Path:
    """Return the folder in which MUMPS stores a factor out of core."""
    return Path(os.environ.get("MUMPS_OOC_TMPDIR") or "/tmp")


def require(size: float, what: str, comm: Comm | None = None) -> None:
    """Raise if ``size`` bytes are not free on this machine or, with ``comm`` (collective), on any of its ranks.

    Parameters
    ----------
    size : float
        Bytes.
    what : str
    comm : Comm, optional

    Raises
    ------
    InputError
        It names ``what`` needs the memory, the size, and the free memory.
    """
    free = available_memory() if comm is None else min(comm.allgather(available_memory()))
    if size / 2**20 > free:
        raise InputError(f"{what}: needs about {size / 2**20:.3g} MB, and {free:.0f} MB are free; take less")


def check_memory(comm: Comm, unknowns: int, *, out_of_core: bool = False) -> str:
    """Return a text on the memory of a factor, before the computation; collective.

    Parameters
    ----------
    comm : Comm
    unknowns : int
        Rows of the matrix.
    out_of_core : bool
        Whether the factor is stored in files.

    Raises
    ------
    InputError
        If the free memory of a node, or with ``out_of_core`` of the folder, is less than its share.
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
    """Return why the scratch folder cannot store ``share``, MB."""
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
    """Return freed memory to the system: glibc keeps it, two thirds of the memory of assembly."""
    with suppress(OSError, AttributeError):
        ctypes.CDLL("libc.so.6").malloc_trim(0)
