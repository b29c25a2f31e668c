"""Teams of ranks: tasks are dealt to teams, and a team works on each of its tasks together."""

from __future__ import annotations

import os
from collections.abc import Callable, Iterable, Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from typing import Any, TypeVar

from petscjam.base.errors import InputError
from petscjam.parallel import container

T = TypeVar("T")


@dataclass(frozen=True)
class Team:
    """Ranks that work together.

    Attributes
    ----------
    comm : communicator
        Of this team.
    index, count : int
        Which team this is, and of how many.
    """

    comm: Any
    index: int
    count: int

    def deal(self, tasks: Iterable[T], cost: Callable[[T], float]) -> list[T]:
        """Return the tasks of this team, the most costly first; every rank must give the same tasks."""
        return sorted(tasks, key=cost, reverse=True)[self.index :: self.count]


@contextmanager
def teams(comm: Any, size: int = 1) -> Iterator[Team]:
    """Split ``comm`` into teams of ``size`` ranks; the last may be smaller.

    Raises
    ------
    InputError
        If ``size`` is less than 1.
    """
    if size < 1:
        raise InputError(f"a team has at least one rank, not {size}")
    team = Team(comm.Split(comm.rank // size, comm.rank), comm.rank // size, -(-comm.size // size))
    yield team
    team.comm.Free()  # collective: an error that is this rank's alone does not wait for the others


def cores_each(comm: Any) -> int:
    """Return how many cores of its node there are for each rank of ``comm``, bound to cores or not.

    No more than the limit of a container.
    """
    from mpi4py import MPI

    mine = os.sched_getaffinity(0) if hasattr(os, "sched_getaffinity") else range(os.cpu_count() or 1)
    node = comm.Split_type(MPI.COMM_TYPE_SHARED)
    cores = set().union(*node.allgather(set(mine)))
    limit = node.allreduce(container.cores(), MPI.MIN)
    ranks = node.size
    node.Free()
    return max(1, int(min(len(cores), limit)) // ranks)
