"""Repulsive contact potentials, by name: both normalisations of the harmonic one.

A potential is data: the scale of its energy as a function of the sum of radii.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from petscjam.box import Array
from petscjam.errors import InputError


@dataclass(frozen=True)
class Potential:
    """U = ½ k(σ) δ², where δ = σ − r is the overlap and σ = ρi + ρj; zero without overlap.

    Parameters
    ----------
    name : str
    spring_constant : callable
        k as a function of σ (array in, array out).
    source : str
        Where it comes from.
    """

    name: str
    spring_constant: Callable[[Array], Array]
    source: str

    def energy(self, r: Array, sigma: Array) -> Array:
        """Energy of pairs at distance ``r``."""
        return 0.5 * self.spring_constant(sigma) * np.maximum(sigma - r, 0) ** 2

    def force(self, r: Array, sigma: Array) -> Array:
        """Repulsive force −dU/dr."""
        return self.spring_constant(sigma) * np.maximum(sigma - r, 0)

    def stiffness(self, r: Array, sigma: Array) -> Array:
        """Second derivative d²U/dr²; a pair that just touches counts as a contact."""
        return np.where(r <= sigma, self.spring_constant(sigma), 0.0)


POTENTIALS = {
    potential.name: potential
    for potential in (
        Potential("harmonic", lambda sigma: np.ones_like(sigma), "BT eq. 3 with k = 1"),
        Potential("harmonic-relative", lambda sigma: sigma**-2.0, "VOT eq. 1 with α = 2, ke = 1"),
    )
}


def potential(name: str) -> Potential:
    """Return the potential called ``name``."""
    try:
        return POTENTIALS[name]
    except KeyError:
        raise InputError(f"potential: {name!r} is unknown; known are {', '.join(POTENTIALS)}") from None
