"""Many runs, distributed over ranks: every combination of model, size, packing fraction, Q, strain rate and seed."""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from itertools import product
from pathlib import Path

from petscjam.base.errors import InputError
from petscjam.base.interrupt import deferred
from petscjam.base.progress import Report
from petscjam.base.ranges import MOST_RUNS
from petscjam.md.result import Run
from petscjam.parallel.claims import claimed, made_folder
from petscjam.parallel.comm import Comm, agree, on_root
from petscjam.parallel.teams import Team, deal
from petscjam.rows.damping import DampingLaw


@dataclass(frozen=True)
class Point:
    """One run of a grid."""

    model: str | DampingLaw
    n: int
    phi: float
    Q: float
    rate: float
    seed: int

    @property
    def name(self) -> str:
        """Name of its file, without the extension."""
        law = self.model if isinstance(self.model, str) else str(self.model).replace(" ", "")
        return f"{law}-N{self.n}-phi{self.phi:g}-Q{self.Q:g}-rate{self.rate:g}-seed{self.seed}"

    @property
    def cost(self) -> float:
        """Computing time for a given strain, in any unit."""
        return self.n / abs(self.rate) if self.rate else 0.0


def grid(
    models: Sequence[str | DampingLaw],
    n: Sequence[int],
    phi: Sequence[float],
    Q: Sequence[float],
    rate: Sequence[float],
    seeds: Sequence[int],
) -> list[Point]:
    """Return every combination, each once.

    Parameters
    ----------
    models : sequence
        Names of models of VOT, or damping laws.
    n, phi, Q, rate, seeds : sequences
        Numbers of disks, packing fractions, quality factors, strain rates (1/τe), seeds.

    Returns
    -------
    list of Point

    Raises
    ------
    InputError
        If there are more than :data:`petscjam.base.ranges.MOST_RUNS`.
    """
    count = math.prod(map(len, (models, n, phi, Q, rate, seeds)))
    if count > MOST_RUNS:
        raise InputError(f"shear: {count} runs; at most {MOST_RUNS:.0g} at once")
    return list(dict.fromkeys(Point(*values) for values in product(models, n, phi, Q, rate, seeds)))


@deferred()
def run_grid(
    points: Sequence[Point],
    folder: Path,
    work: Callable[..., Run],
    *,
    comm: Comm,
    resume: bool = False,
    overwrite: bool = False,
    progress: Report | None = None,
    log: Callable[[Path, Run], None],
) -> tuple[int, list[str]]:
    """Run every point, each on one rank, into its own file in ``folder``.

    Parameters
    ----------
    points : sequence of Point
    folder : Path
    work : callable
        ``work(**point, output=…, resume=…, overwrite=…, progress=…)`` returns the run.
    comm : communicator
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
    files = {point: folder / f"{point.name}.h5" for point in points}
    made = 0

    def unwritten() -> None:
        for file in files.values():
            if file.exists() and not (resume or overwrite):
                raise InputError(f"{file}: exists already; ask to overwrite it or to resume")

    def make(point: Point, team: Team, report: Report | None) -> None:
        nonlocal made
        run = work(**vars(point), output=files[point], resume=resume, overwrite=overwrite, progress=report)
        made += 1
        log(files[point], run)

    with made_folder(folder, comm), claimed(folder, comm):
        on_root(comm, unwritten)
        lost = deal(comm, points, make, cost=lambda point: point.cost, progress=progress)
        failures = [f"{point.name}: {error}" for point, error in lost]
        if sum(isinstance(error, InputError) for _, error in lost) == len(points):  # invalid arguments
            raise InputError(failures[0])
        return comm.allreduce(made), failures
