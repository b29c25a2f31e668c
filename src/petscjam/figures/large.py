"""The runs of CD_rot at Q = 1 with many disks (VOT secs. III C, III D), and the boundaries of coexistence in them.

Every point has a run from a random start and, between the guessed packing fractions of the bands, one that starts from
a faster, Newtonian run that is divided into two bands (from a random start the bands are lost). Axes: s seed, k packing
fraction.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from typing import NamedTuple

import numpy as np

from petscjam.analysis.coexistence import Boundaries, end_point, jumps, kinks, switches
from petscjam.analysis.flows import over_seeds
from petscjam.analysis.transitions import Located
from petscjam.base.errors import InputError
from petscjam.base.types import Array
from petscjam.figures.data import FigureData
from petscjam.figures.flows import Banded, Flows
from petscjam.md.banding import Bands, bands
from petscjam.md.grid import Point, grid
from petscjam.md.result import Run

PAPER = 2e-5  # P of the contour of VOT
HOMOGENEOUS = 2.0  # Rv below it: no bands are looked for
MISSING = {  # why a boundary is not determined
    "P_el": "no two kinks of ln P_el with a slope between them twice that outside",
    "μ": "μ does not rise by three standard errors inside the range of φ",
    "Rv": "Rv does not exceed the threshold, or does so at the end of the range",
}
SIDES = {"B": "Bagnoldian", "N": "Newtonian"}


@dataclass(frozen=True)
class Guess:
    """Two bands, to start from: φ of both, and the ratio of their strain rates."""

    bagnoldian: float
    newtonian: float
    ratio: float

    def contains(self, phi: float) -> bool:
        """Return whether ``phi`` lies between the bands."""
        return self.bagnoldian < phi < self.newtonian

    def bands(self, phi: float, rate: float) -> tuple[tuple[float, float], tuple[float, float]]:
        """Return (φ, γ̇) of both bands: f from φ = f φB + (1 − f) φN, rates from γ̇ = f γ̇B + (1 − f) γ̇N.

        Parameters
        ----------
        phi, rate : float
            Of the cell, the rate in 1/τe.
        """
        share = (self.newtonian - phi) / (self.newtonian - self.bagnoldian)
        fast = rate * self.ratio / (share * self.ratio + 1 - share)
        return (self.bagnoldian, fast), (self.newtonian, fast / self.ratio)


class Edge(NamedTuple):
    """A point on the Bagnoldian (B) or Newtonian (N) boundary of coexistence.

    Attributes
    ----------
    side : str
        ``B`` or ``N``.
    how : str
        ``P_el``, ``μ`` or ``Rv``: of the cell, from its change with φ; ``bands``: in the middle of a band.
    start : str
    phi, rate, pressure, stress : Located
        φ, γ̇ in 1/τe, P and Σ in m/τe².
    """

    side: str
    how: str
    start: str
    phi: Located
    rate: Located
    pressure: Located
    stress: Located


class Pair(NamedTuple):
    """The two states in a run with bands."""

    point: Point
    bagnoldian: Edge
    newtonian: Edge


class Crossing(NamedTuple):
    """Where the contour of constant P passes a packing fraction: numbers interpolated in ln γ̇ between two runs.

    Attributes
    ----------
    phi : float
    rate, friction : Located
    banding : float
        Rv.
    slope : float
        d ln P/d ln γ̇: 2 in Bagnoldian flow, 1 in Newtonian flow.
    """

    phi: float
    rate: Located
    friction: Located
    banding: float
    slope: float


class Large:
    """The runs, by what they are for.

    Parameters
    ----------
    data : FigureData
    """

    def __init__(self, data: FigureData) -> None:
        self.data, self.parameters = data, data.parameters
        p = data.parameters
        self.flows = Flows(data, "large", p["strain"], p["budget"], p["goal"])
        self.guess = Guess(p["phi_bagnoldian"], p["phi_newtonian"], p["rate_ratio"])
        self.phis, self.rates = (sorted(p.points(name).tolist()) for name in ("phi", "rates"))

    def points(self, phi: Sequence[float], rate: Sequence[float], n: int = 0) -> list[Point]:
        """Return points with random starts, of ``n`` disks if that is not 0.

        Parameters
        ----------
        phi, rate : sequences of float
        n : int
        """
        p = self.parameters
        return grid(["CD_rot"], [n or int(p["particles"])], phi, [1.0], rate, p["seeds"])

    def two_phase(self, points: Sequence[Point]) -> list[Point]:
        """Return the points between the guessed bands, with two bands at the start."""
        return [
            Banded(
                **vars(replace(p, start=self.flows.file(self._newtonian(p)))),
                start_bands=self.guess.bands(p.phi, p.rate),
            )
            for p in points
            if p.phi is not None and self.guess.contains(p.phi)
        ]

    def _newtonian(self, point: Point) -> Point:
        """Return the run from which one with two bands starts."""
        return Point(point.model, point.n, point.phi, point.Q, float(self.parameters["start_rate"]), point.seed)

    def make(self, points: Sequence[Point]) -> None:
        """Make runs, after those from which they start. Collective."""
        banded = [p for p in points if isinstance(p, Banded)]
        self.flows.make([*(p for p in points if p not in banded), *map(self._newtonian, banded)])
        self.flows.make(banded)

    @cached_property
    def scan(self) -> dict[str, list[Point]]:
        """All φ and rates, by start; where there is no start with two bands, the random one stands in. Collective."""
        random = self.points(self.phis, self.rates)
        branches = self.branches(random)
        self.make([p for points in branches.values() for p in points])
        return branches

    def branches(self, random: Sequence[Point]) -> dict[str, list[Point]]:
        """Return points by start, as in :attr:`scan`."""
        banded = self.two_phase(random)
        if not banded:
            return {"random start": list(random)}
        between = {p.phi for p in banded}
        others = [p for p in random if p.phi not in between]
        return {"random start": list(random), "two-phase start": [*others, *banded]}

    @cached_property
    def contour(self) -> list[Point]:
        """The points of VOT fig. 28, first seed, with two bands at the start. Collective."""
        pairs = zip(*(self.parameters.points(f"contour_{name}").tolist() for name in ("phi", "rate")), strict=True)
        random = [self.points([phi], [rate])[0] for phi, rate in pairs]
        points = [(self.two_phase([p]) or [p])[0] for p in random]
        self.make(points)
        return points

    @property
    def runs(self) -> dict[Point, Run]:
        """All runs so far, on rank 0."""
        return self.flows.runs

    def paper(self, text: str) -> str:
        """Return a number of the paper, if it is for the pressure of the preset."""
        return text if self.parameters["pressure"] == PAPER else ""

    def table(self, points: Sequence[Point], key: str, what: str) -> tuple[Array, Array, Array]:
        """Return x (K,), means of runs (S, K), and standard errors over seeds (K,).

        Parameters
        ----------
        points : sequence of Point
            That differ in x and seed.
        key : str
            ``phi`` or ``rate``: x.
        what : str
            As for :func:`petscjam.analysis.flows.mean`.
        """
        x = sorted({getattr(p, key) for p in points})
        rows = [sorted((p for p in points if getattr(p, key) == one), key=lambda p: p.seed) for one in x]
        values = [[self.runs[p].mean(what).value for p in row] for row in rows]
        errors = [over_seeds([self.runs[p] for p in row], what).error for row in rows]
        return np.array(x), np.array(values).T, np.array(errors)

    def boundaries(self, points: Sequence[Point], how: str) -> Boundaries:
        """Return the boundaries of coexistence in φ, of points at one rate.

        Parameters
        ----------
        points : sequence of Point
        how : str
            ``P_el``, ``μ`` or ``Rv``.
        """
        if how == "P_el":
            return kinks(*self.table(points, "phi", "pressure_elastic")[:2])
        if how == "μ":
            return switches(*self.table(points, "phi", "friction"))
        return jumps(*self.table(points, "phi", "banding")[:2], self.parameters["threshold"])

    def edges(self, hows: Sequence[str]) -> list[Edge]:
        """Return the boundaries from all rates and starts; φ is NaN where they are not determined. Rank 0 only."""
        found = []
        for start, branch in self.scan.items():
            for rate in self.rates:
                points = [p for p in branch if p.rate == rate]
                for how in hows:
                    for side, phi in zip(SIDES, self.boundaries(points, how), strict=True):
                        stresses = (self._interpolated(points, what, phi) for what in ("pressure", "stress"))
                        found.append(Edge(side, how, start, phi, Located(rate, 0.0), *stresses))
        return found

    def _interpolated(self, points: Sequence[Point], what: str, phi: Located) -> Located:
        """Return a stress at ``phi``: its logarithm is interpolated linearly."""
        if np.isnan(phi.value):
            return phi
        x, values, _ = self.table(points, "phi", what)
        y = np.log(np.abs(values).mean(0))
        k = int(np.clip(np.searchsorted(x, phi.value), 1, len(x) - 1))
        slope = (y[k] - y[k - 1]) / (x[k] - x[k - 1])
        value = float(np.exp(y[k - 1] + slope * (phi.value - x[k - 1])))
        return Located(value, value * abs(slope) * phi.error)

    def binodal(self) -> list[Pair]:
        """Return both states in every run with lasting bands: of the scan, then of the contour; on rank 0 only."""
        found = []
        for point in dict.fromkeys([*(p for branch in self.scan.values() for p in branch), *self.contour]):
            run = self.runs[point]
            if not lasts(run):
                continue
            try:
                seen = coexisting(run)
            except InputError:
                continue
            start = "two-phase start" if isinstance(point, Banded) else "random start"
            stresses = [Located(*run.mean(what, half(run))) for what in ("pressure", "stress")]
            edges = [Edge(side, "bands", start, *_state(seen, k), *stresses) for k, side in enumerate(SIDES)]
            found.append(Pair(point, *edges))
        return found

    def end_points(self, binodal: Sequence[Pair]) -> tuple[Located, Located]:
        """Return P and γ̇ where both states become the same; γ̇ is the geometric mean of those of the bands."""
        gaps = [N.phi.value - B.phi.value for _, B, N in binodal]
        errors = [float(np.hypot(N.phi.error, B.phi.error)) for _, B, N in binodal]
        pressures = [np.log(B.pressure.value) for _, B, _ in binodal]
        rates = [np.log(B.rate.value * abs(N.rate.value)) / 2 for _, B, N in binodal]
        logs = [end_point(x, gaps, errors) for x in (pressures, rates)]
        first, second = (Located(float(np.exp(v)), float(np.exp(v)) * e) for v, e in logs)
        return first, second

    def crossings(self, points: Sequence[Point]) -> list[Crossing]:
        """Return where the contour of constant P passes each φ, if that is between two rates; on rank 0 only."""
        found, level = [], np.log(self.parameters["pressure"])
        for phi in self.phis:
            some = [p for p in points if p.phi == phi]
            rates, P, errors = self.table(some, "rate", "pressure")
            x, y, e = np.log(rates), np.log(P.mean(0)), errors / P.mean(0)
            passed = np.flatnonzero((y[:-1] <= level) & (y[1:] > level))
            if not len(passed):
                continue
            k = int(passed[0])
            pair, slope = slice(k, k + 2), (y[k + 1] - y[k]) / (x[k + 1] - x[k])
            part = (level - y[k]) / (y[k + 1] - y[k])
            weights = np.array([1 - part, part])
            rate = float(np.exp(weights @ x[pair]))
            off = float(np.linalg.norm(weights * e[pair])) / slope  # of ln γ̇
            _, friction, of_friction = self.table(some, "rate", "friction")
            mu = friction.mean(0)[pair]
            spread = np.hypot(np.linalg.norm(weights * of_friction[pair]), np.diff(mu)[0] / np.diff(x[pair])[0] * off)
            Rv = np.log(self.table(some, "rate", "banding")[1]).mean(0)[pair]
            located = Located(rate, rate * off), Located(float(weights @ mu), float(spread))
            found.append(Crossing(phi, *located, float(np.exp(weights @ Rv)), float(slope)))
        return found

    def tally_lost(self) -> None:
        """Note the two-phase starts whose bands do not last; on rank 0 only."""
        lost = [p for p, run in self.runs.items() if isinstance(p, Banded) and not lasts(run)]
        names = "; ".join(f"φ = {p.phi:g}, γ̇ = {p.rate:g}" for p in lost)
        self.data.page.tallies.append(
            "Two-phase starts whose bands do not last (Rv in the last third of the run is below "
            f"{HOMOGENEOUS:g}, or below half of that in the second): {names or 'none'}."
        )


def half(run: Run) -> float:
    """Return half of the strain of a run: bands are measured after it, since they change slowly."""
    return float(abs(run.strain[-1] - run.settings.strain0)) / 2


def coexisting(run: Run) -> Bands:
    """Return the two bands in the second half of a run.

    Raises
    ------
    NoBandsError
        See :func:`petscjam.md.banding.bands`.
    """
    return bands(run, half(run))


def lasts(run: Run) -> bool:
    """Return whether Rv in the last third of a run is above 2, and above half of that in the second."""
    if len(run.banding) < 3:
        return False
    _, middle, last = (some.mean() for some in np.array_split(run.banding, 3))
    return bool(last > max(HOMOGENEOUS, middle / 2))


def _state(found: Bands, k: int) -> tuple[Located, Located]:
    """Return φ and γ̇ in the middle of a band."""
    e = found.errors
    return Located(float(found.phi[k]), float(e.phi[k])), Located(float(found.rate[k]), float(e.rate[k]))
