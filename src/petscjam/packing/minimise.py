"""Minimise the energy of soft disks at constant volume, or their enthalpy at constant pressure.

Nonlinear conjugate gradients as in BT sec. 2.1, and FIRE to compare it with.

Axes: i disk, c pair of the neighbour list, x Cartesian.
"""

from __future__ import annotations

from collections.abc import Callable

import numpy as np

from petscjam.box import Array, Box
from petscjam.errors import SolverError
from petscjam.potential import potential


class Enthalpy:
    """H = U + pV of disks in a square cell, as a function of one flat vector z, (2N + 1,).

    z holds the positions in a reference cell of edge ``length`` and, last, w·ln(L/length). With
    w = √N d the curvature of H along the box is about that along a disk: kNd²/w² = k.

    Parameters
    ----------
    radii : (N,)
    length : float
        Edge of the reference cell.
    pressure : float or None
        Target; ``None`` keeps the box as it is.
    potential_name : str
    skin : float
        How far beyond contact the neighbour list reaches, in mean diameters.
    budget : int
        Gradients that may be evaluated.
    report : callable
        Called now and then with the object itself.

    Attributes
    ----------
    energy, pressure, force : float
        U, Σ f·r / (2V) and the largest net force on a disk, of the last gradient.
    evaluations : int
        Gradients evaluated so far.
    """

    def __init__(
        self,
        radii: Array,
        length: float,
        pressure: float | None = None,
        *,
        potential_name: str = "harmonic",
        skin: float = 0.3,
        budget: int = 2_000_000,
        report: Callable[[Enthalpy], None] | None = None,
    ) -> None:
        self.radii, self.length, self.target = radii, length, pressure
        self.diameter = float(2 * radii.mean())
        self.weight = len(radii) ** 0.5 * self.diameter
        self.skin = skin * self.diameter
        self.law = potential(potential_name)
        self.budget, self.report = budget, report
        self.evaluations = 0
        self.energy = self.pressure = self.force = float("nan")
        self._built: tuple[Array, float] | None = None

    def unpack(self, z: Array) -> tuple[Array, float]:
        """Return the positions in the reference cell, (N, 2), and L/length."""
        return z[:-1].reshape(-1, 2), float(np.exp(z[-1] / self.weight))

    def gradient(self, z: Array) -> Array:
        """Return dH/dz, (2N + 1,).

        Raises
        ------
        SolverError
            If the budget is used up.
        """
        from petscjam.packing.kernels import gradient

        if self.evaluations >= self.budget:
            raise SolverError(
                f"minimise: not converged after {self.evaluations} force evaluations; the largest force is "
                f"{self.force:.3g}, the pressure {self.pressure:.9g} (target {self.target})"
            )
        x, scale = self.unpack(z)
        self._refresh(x, scale)
        g = np.empty_like(z)
        self.energy, virial, self.force = gradient(
            x, scale, self.i, self.j, self.image, self.sigma, self.k, g[:-1].reshape(-1, 2)
        )
        area = (scale * self.length) ** 2
        self.pressure = virial / (2 * area)
        g[-1] = 0.0 if self.target is None else 2 * area * (self.target - self.pressure) / self.weight
        self.evaluations += 1
        if self.report is not None and self.evaluations % 200 == 0:
            self.report(self)
        return g

    def _refresh(self, x: Array, scale: float) -> None:
        """Rebuild the neighbour list if a pair that is not on it may touch."""
        from petscjam.packing.kernels import farthest

        largest = 2 * self.radii.max()
        if self._built is not None:
            x0, scale0 = self._built
            if 2 * farthest(x, x0) < (largest + self.skin) / scale0 - largest / scale:
                return
        i, j, r = Box.square(self.length).pairs_within(x, (largest + self.skin) / scale)
        sigma = self.radii[i] + self.radii[j]
        near = np.hypot(r[:, 0], r[:, 1]) < (sigma + self.skin) / scale
        self.i, self.j, self.sigma = i[near], j[near], sigma[near]
        self.k = self.law.spring_constant(self.sigma)
        self.image = self.length * np.rint((r[near] - x[self.j] + x[self.i]) / self.length)
        self._built = x.copy(), scale


Done = Callable[[Enthalpy], bool]


def conjugate_gradients(h: Enthalpy, z: Array, done: Done) -> Array:
    """Minimise by Polak–Ribière+ conjugate gradients until ``done(h)``; return z.

    Only gradients are compared: energies stop telling points apart at √ε of the way.
    """
    g = h.gradient(z)
    d, step = -g, 0.1
    while not done(h):
        if g @ d >= 0:
            d = -g
        z, g_new, step = _line_minimum(h, z, d, float(g @ d), step)
        beta = max(0.0, float(g_new @ (g_new - g) / (g @ g)))
        g, d = g_new, beta * d - g_new
    return z


def _line_minimum(h: Enthalpy, z: Array, d: Array, slope0: float, step: float) -> tuple[Array, Array, float]:
    """Find where the slope of H along ``d`` has risen from slope0 < 0 to zero, within 5 %, by secants.

    A looser search takes more gradients at low pressure, a tighter one no fewer.
    """
    limit = 0.1 * h.diameter / float(np.abs(d).max())
    step = min(step, limit)
    low, slope_low = 0.0, slope0
    high, slope_high = np.inf, np.inf
    for _ in range(20):
        z_new = z + step * d
        g = h.gradient(z_new)
        slope = float(g @ d)
        if abs(slope) <= -0.05 * slope0 or (slope < 0 and step >= limit):
            break
        if slope > 0:
            high, slope_high = step, slope
            step = low + (high - low) * slope_low / (slope_low - slope_high)
        elif high < np.inf:
            low, slope_low = step, slope
            step = low + (high - low) * slope_low / (slope_low - slope_high)
        else:
            zero = step + (step - low) * slope / (slope_low - slope) if slope > slope_low else np.inf
            low, slope_low, step = step, slope, min(zero, 4 * step, limit)
    return z_new, g, step


def fire(h: Enthalpy, z: Array, done: Done) -> Array:
    """Minimise by FIRE (Bitzek et al., Phys. Rev. Lett. 97, 170201) until ``done(h)``; return z.

    Unit masses; the fastest mode, ω² ≈ 8k, bounds the time step.
    """
    v = np.zeros_like(z)
    dt, mix, downhill = 0.1, 0.1, 0
    g = h.gradient(z)
    while not done(h):
        if g @ v < 0:
            v = (1 - mix) * v - mix * np.sqrt(v @ v / (g @ g)) * g
            downhill += 1
            if downhill > 5:
                dt, mix = min(1.1 * dt, 0.6), 0.99 * mix
        else:
            v[:] = 0
            dt, mix, downhill = 0.5 * dt, 0.1, 0
        v -= dt * g
        v *= min(1.0, 0.1 * h.diameter / (dt * float(np.abs(v).max())))
        z = z + dt * v
        g = h.gradient(z)
    return z


METHODS: dict[str, Callable[[Enthalpy, Array, Done], Array]] = {"cg": conjugate_gradients, "fire": fire}
