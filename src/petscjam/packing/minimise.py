"""Minimise the energy of soft disks at constant volume, or the enthalpy at constant pressure.

BT sec. 2.1 takes nonlinear conjugate gradients; FIRE is here to compare.

Axes: i disk, c pair of the neighbour list, x Cartesian.
"""

from __future__ import annotations

from collections.abc import Callable

import numpy as np

from petscjam.box import Array, Box
from petscjam.errors import SolverError
from petscjam.potential import potential

EPS = float(np.finfo(float).eps)
Report = Callable[[float], None]


class Enthalpy:
    """H = U + pV of disks in a square cell, as a function of one flat vector z, (2N + 1,).

    z holds the positions in the reference cell of edge ``length`` and, last, w·ln(L/length).
    With w = √N d the curvature along the box is that along a disk (k N d² / w² = k).

    Parameters
    ----------
    radii : (N,)
    length : float
        Edge of the reference cell.
    pressure : float or None
        Target; ``None`` keeps the box as it is.
    potential_name : str
    """

    def __init__(
        self, radii: Array, length: float, pressure: float | None, potential_name: str = "harmonic"
    ) -> None:
        self.radii, self.length, self.target = radii, length, pressure
        self.weight = len(radii) ** 0.5 * 2 * radii.mean()
        self.skin = 0.3 * 2 * radii.mean()
        self.law = potential(potential_name)
        self.built: tuple[Array, float] | None = None
        self.evaluations = self.builds = 0

    def unpack(self, z: Array) -> tuple[Array, float]:
        """Return the positions in the reference cell (N, 2) and L/length."""
        return z[:-1].reshape(-1, 2), float(np.exp(z[-1] / self.weight))

    def gradient(self, z: Array) -> Array:
        """Return dH/dz; leave energy, pressure and the largest force behind as attributes."""
        from petscjam.packing import kernels

        x, scale = self.unpack(z)
        self._refresh(x, scale, kernels.farthest)
        g = np.empty_like(z)
        self.energy, virial, self.force = kernels.gradient(
            x, scale, self.i, self.j, self.image, self.sigma, self.k, g[:-1].reshape(-1, 2)
        )
        area = (scale * self.length) ** 2
        self.pressure = virial / (2 * area)
        g[-1] = 0.0 if self.target is None else 2 * area * (self.target - self.pressure) / self.weight
        self.evaluations += 1
        return g

    def _refresh(self, x: Array, scale: float, farthest: Callable[[Array, Array], float]) -> None:
        """Rebuild the neighbour list when a pair outside it may touch."""
        sigma = 2 * self.radii.max()
        if self.built is not None:
            x0, scale0 = self.built
            if 2 * farthest(x, x0) < (sigma + self.skin) / scale0 - sigma / scale:
                return
        i, j, r = Box.square(self.length).pairs_within(x, (sigma + self.skin) / scale)
        sigma = self.radii[i] + self.radii[j]
        near = np.hypot(r[:, 0], r[:, 1]) < (sigma + self.skin) / scale
        self.i, self.j, self.sigma = i[near], j[near], sigma[near]
        self.k = self.law.spring_constant(self.sigma)
        self.image = self.length * np.rint((r[near] - x[self.j] + x[self.i]) / self.length)
        self.built = x.copy(), scale
        self.builds += 1


def cg(h, z, done, budget):
    tight = 0.1
    g = h.gradient(z)
    d = -g
    alpha = 0.1
    its = 0
    while not done(h):
        its += 1
        if h.evaluations > budget:
            raise SolverError(f"budget {h.force} {h.pressure}")
        slope0 = g @ d
        if slope0 >= 0:
            d = -g
            slope0 = g @ d
        limit = 0.1 / max(np.abs(d).max(), 1e-300)
        lo, slo, hi, shi = 0.0, slope0, np.inf, np.nan
        alpha = min(alpha, limit)
        for _ in range(20):
            znew = z + alpha * d
            gnew = h.gradient(znew)
            slope = gnew @ d
            if abs(slope) <= cg.tol * -slope0 or (slope<0 and alpha >= limit):
                break
            if slope < 0:
                if hi == np.inf:
                    nxt = alpha*slope0/(slope0-slope) if slope > slope0 else 4*alpha
                    nxt = min(nxt, 4*alpha, limit)
                lo, slo = alpha, slope
            else:
                hi, shi = alpha, slope
            if hi < np.inf:
                nxt = lo + (hi - lo) * slo / (slo - shi)
            alpha = nxt
        y = gnew - g
        if cg.beta == "pr":
            beta = max(0.0, gnew @ y / (g @ g))
        else:
            dy = d @ y
            beta = (y @ gnew - 2 * (y @ y) / dy * (d @ gnew)) / dy if dy > 0 else 0.0
            beta = max(beta, -1/(np.linalg.norm(d)*min(.01*0+1e-2*np.linalg.norm(g), np.linalg.norm(g))))
        z, g = znew, gnew
        d = beta * d - g
    return z, its
cg.tol = 0.1
cg.beta = "pr"

def fire(h, z, done, budget):
    v = np.zeros_like(z)
    dt, a, up = 0.1, 0.1, 0
    g = h.gradient(z)
    its = 0
    while not done(h):
        its += 1
        if h.evaluations > budget:
            raise SolverError(f"budget {h.force} {h.pressure}")
        power = -(g @ v)
        if power > 0:
            up += 1
            v = (1 - a) * v - a * np.sqrt(v @ v / (g @ g)) * g
            if up > 5:
                dt, a = min(1.1 * dt, fire.dtmax), 0.99 * a
        else:
            if its>1: z = z - 0.5*dt*v
            v = np.zeros_like(v); up = 0; dt, a = max(0.5 * dt, 0.02), 0.1
            g = h.gradient(z)
        v = v - dt * g
        m = np.abs(v).max()*dt
        if m > .1: v *= .1/m
        z = z + dt * v
        g = h.gradient(z)
    return z, its
fire.dtmax=0.6
