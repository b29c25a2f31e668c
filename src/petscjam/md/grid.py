"""Many runs, distributed over ranks: every combination of model, size, packing fraction, Q, rate, seed and start."""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass
from functools import partial
from itertools import product
from pathlib import Path
from typing import Any

from petscjam.base.errors import InputError, readable
from petscjam.base.interrupt import deferred
from petscjam.base.progress import Report
from petscjam.base.ranges import MOST_RUNS
from petscjam.md.recording import Steps
from petscjam.md.result import Run
from petscjam.md.runs import engine_of, finish
from petscjam.parallel.claims import claimed, made_folder
from petscjam.parallel.comm import Comm, agree, on_root
from petscjam.parallel.teams import Failure, Team, deal, share
from petscjam.rows.damping import DampingLaw

Abreast = Callable[[Sequence[Any], Callable[[Any], Any], Callable[[Any, Run], None], int], Iterator[Failure[Any]]]


@dataclass(frozen=True)
class Point:
    """One run of a grid; with a start, number of disks and packing fraction may be None: those of the start."""

    model: str | DampingLaw
    n: int | None
    phi: float | None
    Q: float
    rate: float
    seed: int
    start: Path | None = None

    @property
    def name(self) -> str:
        """Name of its file, without the extension."""
        law = self.model if isinstance(self.model, str) else str(self.model).replace(" ", "")
        size = "" if self.n is None else f"-N{self.n}"
        density = "" if self.phi is None else f"-phi{self.phi:g}"
        first = f"seed{self.seed}" if self.start is None else self.start.stem
        return f"{law}{size}{density}-Q{self.Q:g}-rate{self.rate:g}-{first}"

    @property
    def cost(self) -> float:
        """Computing time for a given strain, in any unit."""
        return (self.n or 1) / abs(self.rate) if self.rate else 0.0


def grid(
    models: Sequence[str | DampingLaw],
    n: Sequence[int | None],
    phi: Sequence[float | None],
    Q: Sequence[float],
    rate: Sequence[float],
    seeds: Sequence[int],
    starts: Sequence[Path | None] = (None,),
) -> list[Point]:
    """Return every combination, each once.

    Parameters
    ----------
    models : sequence
        Names of models of VOT, or damping laws.
    n, phi, Q, rate, seeds : sequences
        Numbers of disks, packing fractions, quality factors, strain rates (1/τe), seeds.
    starts : sequence
        Files of runs or packings, or folders of LAMMPS runs.

    Returns
    -------
    list of Point

    Raises
    ------
    InputError
        If there are more than :data:`petscjam.base.ranges.MOST_RUNS`, or two starts have the same name.
    """
    axes = (models, n, phi, Q, rate, seeds, list(dict.fromkeys(starts)))
    names = [start.stem for start in axes[-1] if start is not None]
    if twice := sorted(name for name in names if names.count(name) > 1):
        raise InputError(f"shear: several starts are called {readable(twice[0])}, and so would be their runs")
    count = math.prod(map(len, axes))
    if count > MOST_RUNS:
        raise InputError(f"shear: {count} runs; at most {MOST_RUNS:.0g} at once")
    return list(dict.fromkeys(Point(*values) for values in product(*axes)))


@deferred()
def run_grid(
    points: Sequence[Point],
    folder: Path,
    begin: Callable[..., Steps],
    *,
    comm: Comm,
    engine: str = "cpu",
    resume: bool = False,
    overwrite: bool = False,
    progress: Report | None = None,
    log: Callable[[Path, Run], None],
) -> tuple[int, list[str]]:
    """Run every point, each on one rank, into its own file in ``folder``.

    With the engine ``cuda`` a rank makes many of its runs at a time.

    Parameters
    ----------
    points : sequence of Point
    folder : Path
    begin : callable
        ``begin(**point, output=…, resume=…, overwrite=…, progress=…)`` returns the steps of a run with this engine
        (:func:`petscjam.md.runs.begin`).
    comm : communicator
    engine : str
        A name of :data:`petscjam.md.runs.ENGINES`.
    resume, overwrite : bool
        For files that exist; an error if both are false.
    progress, log : callable
        ``log`` is called with the file and the run of each finished point, on its rank.

    Returns
    -------
    made : int
        Number of complete runs, including existing ones.
    failures : list of str

    Raises
    ------
    InputError
        If the folder cannot be made, a file exists, or all points are refused.
    """
    agree(comm, points, folder, resume, overwrite)
    abreast: Abreast | None = getattr(engine_of(engine), "abreast", None)
    files = {point: folder / f"{point.name}.h5" for point in points}
    made = 0

    def unwritten() -> None:
        for file in files.values():
            if file.exists() and not (resume or overwrite):
                raise InputError(f"{file}: exists already; ask to overwrite it or to resume")

    def steps(point: Point, report: Report | None) -> Steps:
        return begin(**vars(point), output=files[point], resume=resume, overwrite=overwrite, progress=report)

    def done(point: Point, run: Run) -> None:
        nonlocal made
        made += 1
        log(files[point], run)

    def one(point: Point, team: Team, report: Report | None) -> None:
        done(point, finish(steps(point, report)))

    def many(mine: list[Point], team: Team) -> Iterator[Failure[Point]]:
        from mpi4py import MPI

        parts, node = dict.fromkeys(mine, 0.0), comm.Split_type(MPI.COMM_TYPE_SHARED)
        rank = node.rank
        node.Free()

        def report(point: Point, fraction: float, text: str) -> None:
            parts[point] = fraction
            if progress is not None:
                progress(sum(parts.values()) / len(parts), f"{len(parts)} runs, {point.name}: {text}")

        assert abreast is not None
        by_size = sorted(mine, key=lambda point: point.n or 0)
        yield from abreast(by_size, lambda point: steps(point, partial(report, point)), done, rank)

    def cost(point: Point) -> float:
        return point.cost

    with made_folder(folder, comm), claimed(folder, comm):
        on_root(comm, unwritten)
        if abreast is None:
            lost = deal(comm, points, one, cost=cost, progress=progress)
        else:
            lost = share(comm, points, many, cost=cost)
        failures = [f"{point.name}: {error}" for point, error in lost]
        if sum(isinstance(error, InputError) for _, error in lost) == len(points):  # invalid arguments
            raise InputError(failures[0])
        return comm.allreduce(made), failures
