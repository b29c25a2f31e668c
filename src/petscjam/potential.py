"""Repulsive contact potentials, by name: harmonic and Hertzian, each in two normalisations.

A potential is data: an exponent, and the scale of its energy as a function of the sum of radii.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from petscjam.box import Array
from petscjam.errors import InputError


@dataclass(frozen=True)
class Potential:
    """U = k(σ) δ^α / α, where δ = σ − r is the overlap and σ = ρi + ρj; zero without overlap.

    Parameters
    ----------
    name : str
    exponent : float
        α, at least 2.
    spring_constant : callable
        k as a function of σ (array in, array out).
    source : str
        Where it comes from.
    """

    name: str
    exponent: float
    spring_constant: Callable[[Array], Array]
    source: str

    def unit(self, d: float) -> float:
        """Stiffness k(d) d^(α − 2) of disks whose overlap is their diameter ``d``."""
        return float(self.spring_constant(np.array(d)) * d ** (self.exponent - 2))

    def energy(self, r: Array, sigma: Array) -> Array:
        """Energy of pairs at distance ``r``."""
        return self.spring_constant(sigma) * np.maximum(sigma - r, 0) ** self.exponent / self.exponent

    def force(self, r: Array, sigma: Array) -> Array:
        """Repulsive force −dU/dr."""
        return self.spring_constant(sigma) * np.maximum(sigma - r, 0) ** (self.exponent - 1)

    def stiffness(self, r: Array, sigma: Array) -> Array:
        """Second derivative d²U/dr²; a pair that just touches counts as a contact."""
        alpha = self.exponent
        overlap = np.maximum(sigma - r, 0)
        return np.where(r <= sigma, self.spring_constant(sigma) * (alpha - 1) * overlap ** (alpha - 2), 0.0)


POTENTIALS = {
    potential.name: potential
    for potential in (
        Potential("harmonic", 2.0, lambda sigma: np.ones_like(sigma), "BT eq. 3 with k = 1"),
        Potential("harmonic-relative", 2.0, lambda sigma: sigma**-2.0, "VOT eq. 1 with α = 2, ke = 1"),
        Potential("hertzian", 2.5, lambda sigma: np.ones_like(sigma), "Hertz, with k = 1 at δ = d"),
        Potential("hertzian-relative", 2.5, lambda sigma: sigma**-2.5, "VOT eq. 1 with α = 5/2, ke = 1"),
    )
}


def potential(name: str) -> Potential:
    """Return the potential called ``name``."""
    try:
        return POTENTIALS[name]
    except KeyError:
        raise InputError(f"potential: {name!r} is unknown; known are {', '.join(POTENTIALS)}") from None
