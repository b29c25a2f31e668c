"""Communicators, and errors that must reach every rank."""

from __future__ import annotations

import sys
from collections.abc import Callable
from typing import Any, TypeVar

import numpy as np

T = TypeVar("T")


def resolve(comm: Any = None) -> Any:
    """Return ``comm``; left out, COMM_SELF, with a warning if the program runs on several ranks."""
    from mpi4py import MPI

    if comm is not None:
        return comm
    if MPI.COMM_WORLD.size > 1 and MPI.COMM_WORLD.rank == 0:
        import warnings

        warnings.warn("no comm given: every rank solves the whole problem by itself", stacklevel=3)
    return MPI.COMM_SELF


def on_root(comm: Any, work: Callable[[], T]) -> T:
    """Do ``work`` on rank 0 and give every rank its result, or raise its error on every rank."""
    result: Any = None
    error: Exception | None = None
    if comm.rank == 0:
        try:
            result = work()
        except Exception as caught:
            error = caught
    result, error = comm.bcast((result, error))
    if error is not None:
        raise error
    return result


def total(comm: Any, share: Any) -> Any:
    """Sum a scalar or an array over the ranks."""
    share = np.asarray(share)
    out = np.empty_like(share)
    comm.Allreduce(share, out)
    return out if out.ndim else out[()]


def exit_together(code: int, message: str) -> None:
    """End the program on every rank: together if all are ending, else by MPI_Abort within seconds.

    The message is printed once where every rank has the same, else by the rank that failed.
    """
    import time

    from mpi4py import MPI

    world = MPI.COMM_WORLD
    if world.size > 1:
        everyone = world.Ibarrier()
        patience = time.monotonic() + 2.0
        while not everyone.Test() and time.monotonic() < patience:
            time.sleep(0.01)
        if not everyone.Test():
            print(f"{message} (on rank {world.rank})", file=sys.stderr, flush=True)
            world.Abort(code)
    if world.rank == 0:
        print(message, file=sys.stderr, flush=True)
    sys.exit(code)
