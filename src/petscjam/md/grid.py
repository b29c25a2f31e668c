"""Many runs, dealt to ranks: every combination of model, size, packing fraction, Q, strain rate and seed."""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from itertools import product
from pathlib import Path
from typing import Any

from petscjam.base.errors import InputError, SolverError
from petscjam.base.interrupt import Interrupted, check, deferred
from petscjam.base.progress import Report, part
from petscjam.base.ranges import MOST_RUNS
from petscjam.md.result import Run
from petscjam.parallel.claims import claimed, made_folder
from petscjam.parallel.comm import agree, on_root, raise_together
from petscjam.parallel.teams import teams
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
        """Name of its file, without the ending."""
        law = self.model if isinstance(self.model, str) else str(self.model).replace(" ", "")
        return f"{law}-N{self.n}-phi{self.phi:g}-Q{self.Q:g}-rate{self.rate:g}-seed{self.seed}"


def grid(
    models: Sequence[str | DampingLaw],
    n: Sequence[int],
    phi: Sequence[float],
    Q: Sequence[float],
    rate: Sequence[float],
    seeds: Sequence[int],
) -> list[Point]:
    """Return every combination, each once.

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
    comm: Any,
    resume: bool = False,
    overwrite: bool = False,
    progress: Report | None = None,
    log: Callable[[Path, Run], None],
) -> tuple[int, list[str]]:
    """Run every point, each on one rank, into a file of its own in ``folder``.

    Parameters
    ----------
    points : sequence of Point
    work : callable
        ``work(**point, output=…, resume=…, overwrite=…, progress=…)`` gives the run.
    log : callable
        Gets the file and the run of each point that is done, on the rank that did it.

    Returns
    -------
    made : int
        Runs that are complete, those that were there before counted.
    failures : list of str

    Raises
    ------
    InputError
        If the folder cannot be made, a file is there already (neither ``resume`` nor ``overwrite``), or none
        of the points makes sense.
    """
    agree(comm, points, folder, resume, overwrite)

    def files() -> dict[Point, Path]:
        found = {point: folder / f"{point.name}.h5" for point in points}
        for file in found.values():
            if file.exists() and not (resume or overwrite):
                raise InputError(f"{file}: exists already; ask to overwrite it or to resume")
        return found

    with made_folder(folder, comm), claimed(folder, comm):
        targets = on_root(comm, files)
        made, failures, bad = 0, [], 0
        stopped: Interrupted | None = None
        with teams(comm, 1) as team:
            mine = team.deal(points, lambda point: point.n / abs(point.rate) if point.rate else 0.0)
            for k, point in enumerate(mine):
                report = part(progress, k, len(mine), f"{point.name}: ") if progress else None
                try:
                    check()
                    run = work(
                        **vars(point), output=targets[point], resume=resume, overwrite=overwrite, progress=report
                    )
                except (InputError, SolverError) as error:
                    failures.append(f"{point.name}: {error}")
                    bad += isinstance(error, InputError)
                    continue
                except Interrupted as signal:
                    stopped = signal
                    break
                made += 1
                log(targets[point], run)
        raise_together(comm, stopped)
        everyone = comm.allgather((made, failures, bad))
        lost = [text for _, some, _ in everyone for text in some]
        if sum(count for *_, count in everyone) == len(points):  # what was asked for makes no sense
            raise InputError(lost[0])
        return sum(count for count, *_ in everyone), lost
