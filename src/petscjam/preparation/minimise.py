"""Minimise the energy of soft disks at constant volume, or their enthalpy at constant pressure.

FIRE, and nonlinear conjugate gradients as in BT sec. 2.1.

Axes: i disk, c pair of the neighbour list, x Cartesian, s strain of the cell.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from typing import Any

import numpy as np

from petscjam.base.errors import SolverError
from petscjam.base.interrupt import check
from petscjam.base.types import Array
from petscjam.geometry.packing import Packing

NOTHING = np.zeros((0, 2, 2))
SIZE = np.eye(2)[None]
SHAPE = np.array([[[1, 0], [0, 0]], [[0, 1], [0, 0]], [[0, 0], [0, 1]]], dtype=float)
REPORT_EVERY = 200
Goal = tuple[float, float, float]  # largest force; the same in units of the pressure; error of the stress


class Enthalpy:
    """H = U + pV of disks in a periodic cell, as a function of one flat vector z, (2N + S,).

    z holds the positions in the cell as it was given, sorted in space, and then w·e for each strain that
    relaxes: the deformation gradient is F = 1 + Σ e_s E_s. With w = √N d the curvature of H along a strain
    is about that along a disk: kNd²/w² = k.

    Parameters
    ----------
    packing : Packing
    pressure : float or None
        Target; ``None`` keeps the cell as it is.
    shape : bool
        Whether both shears of the cell relax, too, and not only its size.
    threads : int
        They matter beyond 4096 disks, and only for the time it takes.
    budget, evaluations : int
        Gradients that may be evaluated, and how many of them have been.
    report : callable
        Called now and then with the object itself and z.

    Attributes
    ----------
    start : (2N + S,)
        The z of ``packing``.
    unit : float
        Stiffness of the packing's potential (:meth:`petscjam.geometry.potential.Potential.unit`).
    energy, force : float
        U, and the largest net force on a disk, of the last gradient.
    stress : (3,)
        Pressure tensor Σ f r⊗n / V of the last gradient: xx, xy, yy.
    evaluations : int
        Gradients evaluated so far.
    """

    def __init__(
        self,
        packing: Packing,
        pressure: float | None = None,
        *,
        shape: bool = False,
        threads: int = 1,
        budget: int = 2_000_000,
        evaluations: int = 0,
        report: Callable[[Enthalpy, Array], None] | None = None,
    ) -> None:
        from petscjam.geometry.neighbours import check_memory

        self.packing, self.target = packing, pressure
        self.strains = NOTHING if pressure is None else SHAPE if shape else SIZE
        self.diameter = packing.mean_diameter
        self.unit = packing.potential.unit(self.diameter)
        self.weight = len(packing) ** 0.5 * self.diameter
        self.cell = self.strains, self.weight, np.nan if pressure is None else pressure, packing.box.area
        self.exponent = packing.potential.exponent
        self.budget, self.report = budget, report
        self.evaluations = evaluations
        self.energy = self.force = np.nan
        self.stress = np.full(3, np.nan)
        x = packing.box.wrap(packing.positions)
        self.order = np.lexsort((x[:, 0], np.floor(x[:, 1] / self.diameter)))
        self.radii = packing.radii[self.order]
        self.start = np.append(x[self.order], np.zeros(len(self.strains)))
        self.largest = 2 * float(packing.radii.max())
        self.skin = 0.3 * self.diameter
        check_memory(packing.box, packing.radii, self.skin)
        self._threads = _use_threads(threads, len(packing))
        self._true = np.empty(len(x), dtype=complex)
        self._built, self._built_at = np.empty(0), evaluations

    @property
    def pressure(self) -> float:
        """Half the trace of the pressure tensor."""
        return float(self.stress[0] + self.stress[2]) / 2

    @property
    def stress_error(self) -> float:
        """Largest error of what the cell relaxes: the pressure, or every part of the pressure tensor."""
        from petscjam.preparation.kernels import stress_error

        return float(stress_error(self.stress, self.cell))

    def unpack(self, z: Array) -> tuple[Array, Array]:
        """Return the positions in the reference cell, sorted, (N, 2), and F, (2, 2)."""
        n = 2 * len(self.radii)
        return z[:n].reshape(-1, 2), np.eye(2) + np.tensordot(z[n:] / self.weight, self.strains, 1)

    def at(self, z: Array) -> Packing:
        """Return the packing that ``z`` stands for, its disks in their first order."""
        in_order, F = self.unpack(z)
        x = np.empty_like(in_order)
        x[self.order] = in_order @ F.T
        box = self.packing.box.deformed(F) if len(self.strains) else self.packing.box
        return replace(self.packing, positions=x, box=box)

    def reached(self, goal: Goal) -> bool:
        """Whether the last gradient meets ``goal``."""
        from petscjam.preparation.kernels import reached

        return bool(reached(self.force, self.stress, self.cell, goal))

    def distance(self, goal: Goal) -> float:
        """How many times force or stress of the last gradient exceed ``goal``, whichever is worse."""
        force = self.force / max(goal[0], goal[1] * self.pressure)
        return max(force, self.stress_error / goal[2]) if len(self.strains) else force

    def gradient(self, z: Array) -> Array:
        """Return dH/dz, (2N + S,).

        Raises
        ------
        SolverError
            If the budget is used up.
        """
        from petscjam.preparation.kernels import evaluate

        self.refresh(z)
        g = np.empty_like(z)
        n, cell, pairs, exponent, threads, true, sums = self.arguments()
        found = evaluate(z, n, cell, pairs, exponent, threads, true, sums, g)
        self.force, self.energy, self.stress = found
        self.count(z, 1)
        return g

    def downhill(self, displacement: Array, strain: Array, step: float) -> Array:
        """Return a z with a lower H on the line of a motion of disks (N, 2) and cell (2, 2) from the start.

        The largest displacement is ``step``, halved until H falls up to there, else doubled while it does.
        """
        on_cell = [np.sum(strain * E) / np.sum(E * E) for E in self.strains]
        d = np.append(displacement[self.order], self.weight * np.array(on_cell))
        d /= np.abs(d).max()
        if self.gradient(self.start) @ d > 0:
            d = -d
        while self.gradient(self.start + step * d) @ d >= 0 and step > 1e-9 * self.diameter:
            step /= 2
        while step < 0.1 * self.diameter and self.gradient(self.start + 2 * step * d) @ d < 0:
            step *= 2
        self.gradient(self.start + step * d)
        return self.start + step * d

    def arguments(self) -> Any:
        """Return what the kernels need beside z."""
        return len(self.radii), self.cell, self.pairs, self.exponent, self._threads, self._true, self._sums

    def count(self, z: Array, gradients: int) -> None:
        """Book ``gradients`` against the budget, report now and then, and stop if a signal has come."""
        check()
        before = self.evaluations
        self.evaluations += gradients
        if self.report is not None and self.evaluations // REPORT_EVERY > before // REPORT_EVERY:
            self.report(self, z)
        if self.evaluations >= self.budget:
            aim = f"target {self.target}" if self.target else "at constant volume"
            raise SolverError(
                f"minimise: not converged after {self.evaluations} force evaluations; the largest force is "
                f"{self.force:.3g}, the pressure {self.pressure:.9g} ({aim})"
            )

    def refresh(self, z: Array) -> Array:
        """Rebuild the neighbour list if a pair that is not on it may touch; return z when it was built.

        The skin follows the motion: a list is to last for a hundred gradients, and costs about fourteen.
        """
        from petscjam.preparation.kernels import farthest, stale

        n = len(self.radii)
        if len(self._built):
            moved = farthest(n, z, self._built)
            if not stale(moved, z, self._built, n, self.cell, self.largest, self.skin):
                return self._built
            age = self.evaluations - self._built_at
            factor = 1.4 if age < 60 else 0.7 if age > 200 else 1.0
            self.skin = float(np.clip(factor * self.skin, 0.03 * self.diameter, 0.5 * self.diameter))
        self._built, self._built_at = z.copy(), self.evaluations
        self._build(*self.unpack(z))
        return self._built

    def _build(self, x: Array, F: Array) -> None:
        """List the pairs: those within a run of disks first, run by run, then the rest with their images."""
        from petscjam.geometry.neighbours import find

        box = self.packing.box.deformed(F) if len(self.strains) else self.packing.box
        i, j, runs, images = find(x @ F.T, np.array(box.reduced), self.radii, self.skin)
        in_cell = np.rint(box.reduced @ np.linalg.inv(box.cell))  # exactly the same lattice
        sigma = self.radii[i] + self.radii[j]
        k = self.packing.potential.spring_constant(sigma)
        image = np.ascontiguousarray(images @ in_cell @ self.packing.box.cell).view(complex)[:, 0]
        self.pairs = i, j, sigma, k, runs, image
        self._sums = np.zeros((len(runs), 4))
        overlap = self.packing.potential.stiffness(0.9 * sigma, sigma)
        self.stiffest = float(overlap.max(initial=1e-3 * self.unit))


def _use_threads(threads: int, n: int) -> bool:
    from petscjam.geometry.neighbours import CHUNK

    if threads > 1 and n > CHUNK:
        from petscjam.base.compiled import MOST_THREADS, use_threads

        use_threads(min(threads, MOST_THREADS))
        return True
    return False


def fire(h: Enthalpy, z: Array, goal: Goal) -> Array:
    """Minimise by FIRE (Bitzek et al., Phys. Rev. Lett. 97, 170201) until ``goal``; return z.

    Unit masses; the fastest mode, ω² ≈ 8k, bounds the time step.
    """
    from petscjam.preparation import kernels

    z = z.copy()
    g, v = h.gradient(z), np.zeros_like(z)
    state = np.array([0.1 / h.unit**0.5, 0.1, 0.0, 0.0])
    while not h.reached(goal):
        taken, fresh, h.force, h.energy, h.stress = kernels.fire(
            z,
            g,
            v,
            state,
            h.force,
            h.energy,
            h.stress,
            goal,
            min(REPORT_EVERY, h.budget - h.evaluations),
            0.6 / h.stiffest**0.5,
            0.1 * h.diameter,
            h.refresh(z),
            h.largest,
            h.skin,
            *h.arguments(),
        )
        h.count(z, taken)
        if not fresh:
            g = h.gradient(z)
    return z


def conjugate_gradients(h: Enthalpy, z: Array, goal: Goal) -> Array:
    """Minimise by Polak–Ribière+ conjugate gradients (BT sec. 2.1) until ``goal``; return z."""
    from petscjam.preparation import kernels

    z, trial = z.copy(), z.copy()
    g, g_trial = h.gradient(z), np.empty_like(z)
    d, limit, slope = -g, 0.1 * h.diameter, -float(g @ g)
    longest = limit / max(float(np.abs(d).max()), 1e-300)
    state = np.array([slope, min(0.1 / h.unit, longest), 0.0, slope, np.inf, np.inf, longest, 0.0])
    while not h.reached(goal):
        taken, h.force, h.energy, h.stress = kernels.conjugate_gradients(
            z,
            g,
            d,
            trial,
            g_trial,
            state,
            h.force,
            h.energy,
            h.stress,
            goal,
            min(REPORT_EVERY, h.budget - h.evaluations),
            limit,
            h.refresh(trial),
            h.largest,
            h.skin,
            *h.arguments(),
        )
        h.count(z, taken)
    return z


METHODS: dict[str, Callable[[Enthalpy, Array, Goal], Array]] = {"fire": fire, "cg": conjugate_gradients}
