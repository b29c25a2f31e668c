"""Communicators, and errors that must reach every rank."""

from __future__ import annotations

import os
import sys
import time
from collections.abc import Callable
from pathlib import Path
from typing import TYPE_CHECKING, Any, TypeVar

import numpy as np

from petscjam.base.errors import InputError, SolverError
from petscjam.base.interrupt import Interrupted

if TYPE_CHECKING:
    from mpi4py.MPI import Comm as Comm
else:
    Comm = Any  # importing mpi4py starts MPI

T = TypeVar("T")


# Variables with the number of processes of a launcher: Open MPI, MPICH and similar ones, MVAPICH; Slurm's srun if
# there is none of these. A batch script also has SLURM_NTASKS, but is a single process.
LAUNCHERS = ("OMPI_COMM_WORLD_SIZE", "PMI_SIZE", "MV2_COMM_WORLD_SIZE", "SLURM_STEP_NUM_TASKS")


def world() -> Comm:
    """Return COMM_WORLD.

    Raises
    ------
    InputError
        If a launcher of another MPI started several ranks: each would be a separate job of one rank.
    """
    from mpi4py import MPI

    ranks = next((os.environ[name] for name in LAUNCHERS if os.environ.get(name, "").isdigit()), "1")
    if MPI.COMM_WORLD.size == 1 < int(ranks):
        beside = Path(sys.executable).with_name("mpirun")
        raise InputError(
            f"{ranks} ranks were started, but each is alone: the launcher (mpirun, srun) does not belong to "
            f"{MPI.get_vendor()[0]}, the MPI of mpi4py; take {beside if beside.exists() else 'that one'}"
        )
    return MPI.COMM_WORLD


def resolve(comm: Comm | None = None) -> Comm:
    """Return ``comm``; default: COMM_SELF, with a warning if the program runs on several ranks.

    Raises
    ------
    InputError
        As :func:`world`, if ``comm`` is COMM_WORLD.
    """
    from mpi4py import MPI

    if comm is not None:
        return world() if comm == MPI.COMM_WORLD else comm
    if MPI.COMM_WORLD.size > 1 and MPI.COMM_WORLD.rank == 0:
        import warnings

        warnings.warn("no comm given: every rank solves the whole problem by itself", stacklevel=3)
    return MPI.COMM_SELF


def agree(comm: Comm, *arguments: object) -> None:
    """Refuse arguments that differ between ranks, which would wait for each other without end. Collective.

    Packings are compared by checksum, arrays by value, anything else by its text.
    """
    if len(set(comm.allgather(tuple(map(_told, arguments))))) > 1:
        raise InputError("the arguments (packing, frequencies, law, …) differ between the ranks")


def _told(argument: object) -> str:
    checksum = getattr(argument, "checksum", None)
    of = getattr(getattr(argument, "origin", None), "checksum", "")  # of a result
    return checksum or of + repr(argument.tolist() if isinstance(argument, np.ndarray) else argument)


def on_root(comm: Comm, work: Callable[..., T], *arguments: Any, **options: Any) -> T:
    """Call ``work`` on rank 0 and give every rank its result, or raise its error on every rank.

    An error other than ours is raised unchanged on rank 0, and as a RuntimeError on the other ranks.

    Parameters
    ----------
    comm : Comm
    work : callable
    *arguments, **options
        Of ``work``.
    """
    result: Any = None
    error: Exception | Interrupted | None = None
    if comm.rank == 0:
        try:
            result = work(*arguments, **options)
        except (Exception, Interrupted) as caught:
            error = caught
    result, shared = comm.bcast((result, _for_others(error)))
    if shared is not None:
        raise error or shared
    return result


def raise_together(comm: Comm, error: Exception | Interrupted | None) -> None:
    """Raise if any rank has an error: on that rank its own, on the others that of the lowest such rank.

    Collective. An error other than ours is a RuntimeError on the other ranks.

    Parameters
    ----------
    comm : Comm
    error : exception or None
        The error of this rank.
    """
    shared = [e for e in comm.allgather(_for_others(error)) if e is not None]
    if shared:
        raise error or shared[0]


def _for_others(error: Exception | Interrupted | None) -> Exception | Interrupted | None:
    ours = isinstance(error, InputError | SolverError | Interrupted)
    return error if ours else error and RuntimeError(repr(error))


def total(comm: Comm, share: Any) -> Any:
    """Sum over the ranks.

    Parameters
    ----------
    comm : Comm
    share : scalar or array
        Of this rank; the same shape on all.
    """
    share = np.asarray(share)
    out = np.empty_like(share)
    comm.Allreduce(share, out)
    return out if out.ndim else out[()]


def exit_together(comm: Comm, code: int, message: str, patience: float = 2.0) -> int:
    """Exit together if all ranks exit within ``patience`` (s), else by MPI_Abort.

    ``comm`` spans all ranks and is used for nothing else. The message is printed once if every rank exits, else
    by the rank that failed.

    Parameters
    ----------
    comm : Comm
    code : int
        Exit status.
    message : str
    patience : float
        s.

    Returns
    -------
    ``code``
    """
    everyone = comm.Ibarrier()
    patience += time.monotonic()
    while not everyone.Test():
        if time.monotonic() > patience:
            print(f"{message} (rank {comm.rank} of {comm.size})", file=sys.stderr, flush=True)
            comm.Abort(code)
        time.sleep(0.01)
    if comm.rank == 0:
        print(message, file=sys.stderr, flush=True)
    return code
