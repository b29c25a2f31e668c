"""The sheared runs of a set of figures: made once, kept in one folder, and prolonged until their means are good enough.

Which runs are made depends only on the numbers of earlier runs, so a set is the same on any number of ranks, and after
a stop.
"""

from __future__ import annotations

from collections.abc import Callable, Generator, Iterator, Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any, TypeVar

import numpy as np

from petscjam.analysis.flows import falls, log_contacts, newtonian
from petscjam.base.errors import InputError, SolverError
from petscjam.figures.data import FigureData
from petscjam.md import protocols
from petscjam.md.grid import Point, run_grid
from petscjam.md.recording import Steps
from petscjam.md.result import Run, read
from petscjam.md.runs import begin
from petscjam.md.starts import Phases
from petscjam.parallel.comm import on_root

T = TypeVar("T")
Drawing = Iterator[None]  # of a figure: what all ranks compute and, after a yield, what rank 0 draws
Search = Generator[list[Point], dict[Point, Run], T]  # yields points, gets their runs


@dataclass(frozen=True, kw_only=True)
class Banded(Point):
    """A run that starts with two bands.

    Attributes
    ----------
    start_bands : ((float, float), (float, float))
        (φ, γ̇) of the Bagnoldian and of the Newtonian band.
    """

    start_bands: Phases

    @property
    def name(self) -> str:
        """Name of its file, without the extension."""
        return f"{super().name}-bands"


@dataclass(frozen=True, kw_only=True)
class Ramp(Point):
    """A ramp of the strain rate up and down.

    Attributes
    ----------
    to : float
        Highest rate, 1/τe.
    kappa : float
        κ̃.
    row_time : float
        τe between two rows.
    """

    to: float
    kappa: float
    row_time: float

    @property
    def name(self) -> str:
        """Name of its file, without the extension."""
        return f"{super().name}-to{self.to:g}-kappa{self.kappa:g}"

    @property
    def cost(self) -> float:
        """Computing time, in any unit."""
        return (self.n or 1) / self.kappa

    @property
    def duration(self) -> float:
        """In τe."""
        return protocols.ramp(self.rate, self.to, self.kappa).duration


@dataclass
class Flows:
    """The runs of a set of figures.

    A run ends when the error of its mean P^el is below ``goal``, or its strain is ``budget``; a ramp, at its end.

    Attributes
    ----------
    data : FigureData
        Of the current figure.
    name : str
        Of the set, and of its folder.
    strain, budget : float
        Amount of strain at first and at most; it is doubled.
    goal : float
        Relative standard error of P^el.
    """

    data: FigureData
    name: str
    strain: float
    budget: float
    goal: float
    runs: dict[Point, Run] = field(default_factory=dict)

    @property
    def folder(self) -> Path:
        """Folder of the runs."""
        return self.data.folder / "runs" / self.name

    def make(self, points: Sequence[Point]) -> None:
        """Make runs, or read those that exist; ``runs`` has them on rank 0. Collective.

        Raises
        ------
        SolverError
            If a run fails.
        """
        comm, data, strain = self.data.comm, self.data, self.strain
        left = on_root(comm, self._left, list(dict.fromkeys(points)), strain)
        while left:
            _, failures = run_grid(
                left,
                self.folder,
                self._begin(strain),
                comm=comm,
                engine=data.engine,
                resume=True,
                progress=data.progress,
                log=_quiet,
            )
            if failures:
                raise SolverError("; ".join(failures))
            strain = min(2 * strain, self.budget)
            left = on_root(comm, self._left, left, strain)

    def search(self, searches: Sequence[Search[T]]) -> list[T]:
        """Run searches side by side: the points of all of them are made together. Collective.

        Parameters
        ----------
        searches : sequence of generators
            On rank 0; elsewhere they are not used.

        Returns
        -------
        list
            What the searches return; on rank 0 only.
        """
        comm, results = self.data.comm, [None] * len(searches)
        wanted: dict[int, list[Point]] = {}

        def go_on(first: bool) -> list[Point]:
            for k, search in enumerate(searches):
                if first or k in wanted:
                    try:
                        made = {point: self.runs[point] for point in wanted.get(k, [])}
                        wanted[k] = next(search) if first else search.send(made)
                    except StopIteration as done:
                        results[k] = done.value
                        wanted.pop(k, None)
            return [point for points in wanted.values() for point in points]

        points = on_root(comm, go_on, True)
        while points:
            self.make(points)
            points = on_root(comm, go_on, False)
        return results  # type: ignore[return-value]

    def file(self, point: Point) -> Path:
        """Return the file of a run."""
        return self.folder / f"{point.name}.h5"

    def _begin(self, strain: float) -> Callable[..., Steps]:
        def steps(rate: float, to: float = 0.0, kappa: float = 0.0, **settings: Any) -> Steps:
            protocol = protocols.ramp(rate, to, kappa) if kappa else protocols.steady(rate, strain)
            return (yield from begin(protocol, integrator="single", engine=self.data.engine, **settings))

        return steps

    def _left(self, points: Sequence[Point], strain: float) -> list[Point]:
        """Read the runs; return the points of those that have to go on to ``strain``."""
        left = []
        for point in points:
            if point in self.runs and (self.data.existing or self._done(point, strain)):
                continue
            file = self.file(point)
            if file.exists():
                self.runs[point] = read(file)
            elif self.data.existing:
                raise InputError(f"{file}: is not there, and --existing makes no further runs")
            if not (file.exists() and self._done(point, strain)):
                left.append(point)
        return [] if self.data.existing else left

    def _done(self, point: Point, strain: float) -> bool:
        run = self.runs[point]
        if isinstance(point, Ramp):
            return bool(run.time[-1] - run.settings.time0 > 0.999 * point.duration)
        return self._strain(run) > 0.999 * strain or self._good(run)

    def _good(self, run: Run) -> bool:
        if self._strain(run) < 0.999 * self.strain:
            return False
        value, error = run.mean("pressure_elastic")
        return error <= self.goal * value

    @staticmethod
    def _strain(run: Run) -> float:
        return float(abs(run.strain[-1] - run.settings.strain0))

    @property
    def tally(self) -> str:
        """The number of runs, their total strain and their cost, for the page."""
        strain = sum(map(self._strain, self.runs.values()))
        cost = sum(run.rows["steps"].sum() * run.settings.particles for run in self.runs.values())
        steady = [run for point, run in self.runs.items() if not isinstance(point, Ramp)]
        unsettled = sum(not self._good(run) for run in steady)
        return (
            f"{len(self.runs)} runs of the set {self.name}, a total strain of {strain:.4g} in "
            f"{cost:.2g} disk steps; in {unsettled} of them the "
            f"error of P^el is above {self.goal:.0%} at a strain of {self.budget:g}. "
            "Integrator single, default time steps."
        )


def draw_on_root(data: FigureData, drawing: Drawing) -> None:
    """Compute on all ranks, and draw on rank 0; its errors are those of all ranks. Collective.

    Parameters
    ----------
    data : FigureData
    drawing : generator
    """
    next(drawing)
    on_root(data.comm, next, drawing, None)


def _quiet(file: Path, run: Run) -> None:
    """Print nothing: a set has hundreds of runs."""


def bisection(points: list[Point], rounds: int, file: Callable[[Point], Path]) -> Search[dict[float, list[float]]]:
    """Search Qc at one packing fraction and strain rate: runs from both sides where the share is least known.

    Near Qc the flow is bistable; so new runs start from the ends of the Newtonian and of the Bagnoldian runs at the two
    values of Q between which Z falls.

    Parameters
    ----------
    points : list of Point
        From random starts, several Q and seeds.
    rounds : int
        Bisections of ln Q.
    file : callable
        The file of a run.

    Returns
    -------
    dict
        The shares of Newtonian strain of each seed, by Q, ascending; empty if Z does not fall.
    """
    runs = yield points
    at = {Q: [p for p in points if p.Q == Q] for Q in sorted({p.Q for p in points})}
    level = {Q: log_contacts([runs[p] for p in some]) for Q, some in at.items()}
    ends = falls(level)
    if ends is None:
        return {}
    low, high = ends
    at = {Q: at[Q] for Q in ends}
    threshold = float(np.exp((level[low] + level[high]) / 2))
    shares = {Q: [newtonian(runs[p], threshold) for p in some] for Q, some in at.items()}
    for _ in range(rounds):
        Q = float(f"{(low * high) ** 0.5:.4g}")
        some = [replace(p, Q=Q, start=file(p)) for end in ends for p in at[end]]
        runs = yield some
        each = [newtonian(runs[p], threshold) for p in some]
        shares[Q] = np.reshape(each, (2, -1)).mean(0).tolist()
        low, high = (Q, high) if np.mean(shares[Q]) >= 0.5 else (low, Q)
    return dict(sorted(shares.items()))
