"""Minimise the energy of soft disks at constant volume, or their enthalpy at constant pressure.

FIRE, and nonlinear conjugate gradients as in BT sec. 2.1.

Axes: i disk, c pair of the neighbour list, x Cartesian, s strain of the cell.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace

import numpy as np

from petscjam.base.errors import SolverError
from petscjam.base.interrupt import check
from petscjam.base.types import Array
from petscjam.geometry.packing import Packing
from petscjam.preparation.records import Bounds, CellStrains, Forces, Goal, Line, NeighbourList, System

NOTHING = np.zeros((0, 2, 2))
SIZE = np.eye(2)[None]
SHAPE = np.array([[[1, 0], [0, 0]], [[0, 1], [0, 0]], [[0, 0], [0, 1]]], dtype=float)
REPORT_EVERY = 200


class Enthalpy:
    """H = U + pV of disks in a periodic cell, as a function of one flat vector z, (2N + S,).

    z has the positions in the reference cell, sorted in space, and then w·e for each strain that relaxes: the
    deformation gradient is F = 1 + Σ e_s E_s. With w = √N d the curvature of H along a strain is about that along
    the displacement of a disk: kNd²/w² = k.

    Parameters
    ----------
    packing : Packing
    pressure : float or None
        Target; ``None``: the cell is fixed.
    shape : bool
        Whether both shears of the cell relax, and not only its size.
    threads : int
        They have an effect from 4096 disks on, and only on the time.
    budget, evaluations : int
        Largest number of gradients, and number of gradients so far.
    report : callable
        Called regularly with the object itself and z.

    Attributes
    ----------
    start : (2N + S,)
        The z of ``packing``.
    unit : float
        Stiffness of the packing's potential (:meth:`petscjam.geometry.potential.Potential.unit`).
    now : Forces
        Of the last gradient.
    evaluations : int
        Number of gradients so far.
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
        self.cell = CellStrains(self.strains, self.weight, np.nan if pressure is None else pressure, packing.box.area)
        self.budget, self.report = budget, report
        self.evaluations = evaluations
        self.now = Forces(np.nan, np.nan, np.full(3, np.nan))
        x = packing.box.wrap(packing.positions)
        self.order = np.lexsort((x[:, 0], np.floor(x[:, 1] / self.diameter)))
        self.radii = packing.radii[self.order]
        self.start = np.append(x[self.order], np.zeros(len(self.strains)))
        self.skin = 0.3 * self.diameter
        check_memory(packing.box, packing.radii, self.skin)
        self._threads = _use_threads(threads, len(packing))
        self._mapped = np.empty(len(x), dtype=complex)
        self._system: System | None = None
        self._built_at = evaluations

    @property
    def pressure(self) -> float:
        """Half the trace of the pressure tensor."""
        return float(self.now.stress[0] + self.now.stress[2]) / 2

    @property
    def stress_error(self) -> float:
        """Largest error of the relaxed part of the stress: the pressure, or every component of the pressure tensor."""
        from petscjam.preparation import kernels

        return float(kernels.stress_error(self.now.stress, self.cell))

    def unpack(self, z: Array) -> tuple[Array, Array]:
        """Return the positions in the reference cell, sorted, (N, 2), and F, (2, 2)."""
        n = 2 * len(self.radii)
        return z[:n].reshape(-1, 2), np.eye(2) + np.tensordot(z[n:] / self.weight, self.strains, 1)

    def at(self, z: Array) -> Packing:
        """Return the packing of ``z``, its disks in their original order."""
        in_order, F = self.unpack(z)
        x = np.empty_like(in_order)
        x[self.order] = in_order @ F.T
        box = self.packing.box.deformed(F) if len(self.strains) else self.packing.box
        return replace(self.packing, positions=x, box=box)

    def reached(self, goal: Goal) -> bool:
        """Whether the last gradient meets ``goal``."""
        from petscjam.preparation import kernels

        return bool(kernels.reached(self.now, self.cell, goal))

    def distance(self, goal: Goal) -> float:
        """Largest ratio of force or stress of the last gradient to ``goal``."""
        force = self.now.force / max(goal.force, goal.relative * self.pressure)
        return max(force, self.stress_error / goal.stress) if len(self.strains) else force

    def gradient(self, z: Array) -> Array:
        """Return dH/dz, (2N + S,).

        Raises
        ------
        SolverError
            If the budget is used up.
        """
        from petscjam.preparation import kernels

        g = np.empty_like(z)
        self.now = kernels.evaluate(z, self.system(z), g)
        self._count(z, 1)
        return g

    def downhill(self, displacement: Array, strain: Array, step: float) -> Array:
        """Return a z with a lower H on the line of a motion of disks (N, 2) and cell (2, 2) from the start.

        The largest displacement is ``step``, halved until H decreases up to it, else doubled while H decreases.

        Parameters
        ----------
        displacement : (N, 2)
        strain : (2, 2)
        step : float
            Initial length.
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

    def _count(self, z: Array, gradients: int) -> None:
        """Count ``gradients``, report every 200 of them, and stop after a signal."""
        check()
        before = self.evaluations
        self.evaluations += gradients
        if self.report is not None and self.evaluations // REPORT_EVERY > before // REPORT_EVERY:
            self.report(self, z)
        if self.evaluations >= self.budget:
            aim = f"target {self.target}" if self.target else "at constant volume"
            raise SolverError(
                f"minimise: not converged after {self.evaluations} force evaluations; the largest force is "
                f"{self.now.force:.3g}, the pressure {self.pressure:.9g} ({aim})"
            )

    def system(self, z: Array) -> System:
        """Return the data of the kernels, with a new list of pairs if one that is not in the list may touch at ``z``.

        The skin adapts to the motion: a list should be valid for a hundred gradients; it costs about fourteen.
        """
        from petscjam.preparation import kernels

        if self._system is not None:
            pairs = self._system.pairs
            moved = kernels.farthest(len(self.radii), z, pairs.built)
            if not kernels.stale(moved, z, pairs, self.cell):
                return self._system
            age = self.evaluations - self._built_at
            factor = 1.4 if age < 60 else 0.7 if age > 200 else 1.0
            self.skin = float(np.clip(factor * self.skin, 0.03 * self.diameter, 0.5 * self.diameter))
        self._built_at = self.evaluations
        self.pairs = self._list(z)
        sums = np.zeros((len(self.pairs.chunks), 4))
        n, law = len(self.radii), self.packing.potential
        loops = law.exponent or 1.0, law.compiled, self._threads
        self._system = System(n, self.cell, self.pairs, *loops, self._mapped, sums)
        return self._system

    def _list(self, z: Array) -> NeighbourList:
        """List the pairs: those within a chunk of disks first, chunk by chunk, then the rest with their images."""
        from petscjam.geometry.neighbours import find

        x, F = self.unpack(z)
        box = self.packing.box.deformed(F) if len(self.strains) else self.packing.box
        i, j, chunks, images = find(x @ F.T, np.array(box.reduced), self.radii, self.skin)
        in_cell = np.rint(box.reduced @ np.linalg.inv(box.cell))  # exactly the same lattice
        sigma = self.radii[i] + self.radii[j]
        k = self.packing.potential.k(sigma)
        image = np.ascontiguousarray(images @ in_cell @ self.packing.box.cell).view(complex)[:, 0]
        overlap = self.packing.potential.stiffness(0.9 * sigma, sigma)
        self.stiffest = float(overlap.max(initial=1e-3 * self.unit))
        largest = 2 * float(self.packing.radii.max())
        return NeighbourList(i, j, sigma, k, chunks, image, z.copy(), self.skin, largest)


def _use_threads(threads: int, n: int) -> bool:
    from petscjam.base.compiled import MOST_THREADS, use_threads
    from petscjam.geometry.neighbours import CHUNK

    if threads > 1 and n > CHUNK:
        use_threads(min(threads, MOST_THREADS))
        return True
    return False


def fire(h: Enthalpy, z: Array, goal: Goal) -> Array:
    """Minimise by FIRE (Bitzek et al., Phys. Rev. Lett. 97, 170201) until ``goal``; return z.

    Unit masses; the fastest mode, ω² ≈ 8k, bounds the time step.

    Parameters
    ----------
    h : Enthalpy
    z : (2N + S,)
        Initial point.
    goal : Goal

    Returns
    -------
    (2N + S,)
    """
    from petscjam.preparation import kernels

    z = z.copy()
    g, v = h.gradient(z), np.zeros_like(z)
    state = np.array([0.1 / h.unit**0.5, 0.1, 0.0, 0.0])
    while not h.reached(goal):
        system = h.system(z)
        bounds = Bounds(min(REPORT_EVERY, h.budget - h.evaluations), 0.6 / h.stiffest**0.5, 0.1 * h.diameter)
        taken, fresh, h.now = kernels.fire(z, g, v, state, h.now, goal, bounds, system)
        h._count(z, taken)
        if not fresh:
            g = h.gradient(z)
    return z


def conjugate_gradients(h: Enthalpy, z: Array, goal: Goal) -> Array:
    """Minimise by Polak–Ribière+ conjugate gradients (BT sec. 2.1) until ``goal``; return z.

    Parameters
    ----------
    h, z, goal
        As for :func:`fire`.

    Returns
    -------
    (2N + S,)
    """
    from petscjam.preparation import kernels

    line = Line(z.copy(), h.gradient(z), np.empty_like(z), z.copy(), np.empty_like(z))
    line.d[:] = -line.g
    limit, slope = 0.1 * h.diameter, -float(line.g @ line.g)
    longest = limit / max(float(np.abs(line.d).max()), 1e-300)
    state = np.array([slope, min(0.1 / h.unit, longest), 0.0, slope, np.inf, np.inf, longest, 0.0])
    while not h.reached(goal):
        system, gradients = h.system(line.trial), min(REPORT_EVERY, h.budget - h.evaluations)
        taken, h.now = kernels.conjugate_gradients(line, state, h.now, goal, gradients, limit, system)
        h._count(line.z, taken)
    return line.z


METHODS: dict[str, Callable[[Enthalpy, Array, Goal], Array]] = {"fire": fire, "cg": conjugate_gradients}
