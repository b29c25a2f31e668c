"""Teams of ranks: tasks are distributed over teams, and the ranks of a team work together on each of its tasks."""

from __future__ import annotations

import os
from collections.abc import Callable, Iterable, Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass
from typing import Protocol, TypeVar

from petscjam.base.errors import InputError, SolverError
from petscjam.base.interrupt import Interrupted, check
from petscjam.base.progress import Report, part
from petscjam.parallel import container
from petscjam.parallel.comm import Comm, raise_together

T = TypeVar("T")


@dataclass(frozen=True)
class Team:
    """Ranks that work together.

    Attributes
    ----------
    comm : communicator
        Of this team.
    index, count : int
        Number of this team, and number of teams.
    """

    comm: Comm
    index: int
    count: int

    def deal(self, tasks: Iterable[T], cost: Callable[[T], float]) -> list[T]:
        """Return the tasks of this team, the most costly first.

        Parameters
        ----------
        tasks : iterable
            The same on every rank.
        cost : callable
            Of a task.
        """
        return sorted(tasks, key=cost, reverse=True)[self.index :: self.count]


@contextmanager
def teams(comm: Comm, size: int = 1) -> Iterator[Team]:
    """Split the ranks into teams; the last may be smaller.

    Parameters
    ----------
    comm : communicator
    size : int
        Ranks of a team.

    Raises
    ------
    InputError
        If ``size`` is less than 1.
    """
    if size < 1:
        raise InputError(f"a team has at least one rank, not {size}")
    team = Team(comm.Split(comm.rank // size, comm.rank), comm.rank // size, -(-comm.size // size))
    yield team
    team.comm.Free()  # collective: after an error on this rank only, it must not wait for the others


class Task(Protocol):
    """A piece of work with a name."""

    @property
    def name(self) -> str:
        """Its name in the progress."""


Named = TypeVar("Named", bound=Task)
Failure = tuple[Named, InputError | SolverError]


def deal(
    comm: Comm,
    tasks: Sequence[Named],
    work: Callable[[Named, Team, Report | None], None],
    *,
    cost: Callable[[Named], float],
    size: int = 1,
    progress: Report | None = None,
) -> list[Failure[Named]]:
    """Distribute tasks over teams and return those that failed, with their errors, on every rank. Collective.

    If a task fails, the others continue. A signal stops all teams after their current tasks.

    Parameters
    ----------
    comm : communicator
    tasks : sequence
        The same on every rank.
    work : callable
        ``work(task, team, progress)``, called on every rank of the team.
    cost : callable
        Time of a task, in any unit.
    size : int
        Ranks of a team.
    progress : callable, optional
        Called with the completed fraction of a team's work and a text.

    Raises
    ------
    Interrupted
        On a signal.
    """

    def one_by_one(mine: list[Named], team: Team) -> Iterator[Failure[Named]]:
        for k, task in enumerate(mine):
            try:
                check(team.comm)
                work(task, team, part(progress, k, len(mine), f"{task.name}: ") if progress else None)
            except (InputError, SolverError) as error:  # the same on all ranks of the team
                yield task, error

    return share(comm, tasks, one_by_one, cost=cost, size=size)


def share(
    comm: Comm,
    tasks: Sequence[Named],
    work: Callable[[list[Named], Team], Iterable[Failure[Named]]],
    *,
    cost: Callable[[Named], float],
    size: int = 1,
) -> list[Failure[Named]]:
    """Distribute tasks over teams, which do all of theirs at once; otherwise as :func:`deal`. Collective.

    Parameters
    ----------
    comm : communicator
    tasks : sequence
        The same on every rank.
    work : callable
        ``work(tasks, team)``, called on every rank of the team, yields the tasks that failed and their errors.
    cost : callable
        Time of a task, in any unit.
    size : int
        Ranks of a team.

    Raises
    ------
    Interrupted
        On a signal.
    """
    failed: list[Failure[Named]] = []
    stopped: Interrupted | None = None
    with teams(comm, size) as team:
        first = team.comm.rank == 0
        try:
            failed.extend(work(team.deal(tasks, cost), team))
        except Interrupted as signal:
            stopped = signal
    raise_together(comm, stopped)
    return [one for some in comm.allgather(failed if first else []) for one in some]


def cores_each(comm: Comm) -> int:
    """Return the number of cores of a node divided by its ranks of ``comm``, bound to cores or not.

    At most the limit of a container.
    """
    from mpi4py import MPI

    mine = os.sched_getaffinity(0) if hasattr(os, "sched_getaffinity") else range(os.cpu_count() or 1)
    node = comm.Split_type(MPI.COMM_TYPE_SHARED)
    cores = set().union(*node.allgather(set(mine)))
    limit = node.allreduce(container.cores(), MPI.MIN)
    ranks = node.size
    node.Free()
    return max(1, int(min(len(cores), limit)) // ranks)
