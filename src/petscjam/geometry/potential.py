"""Repulsive contact potentials, by name: harmonic, Hertzian and other powers, each in two normalisations.

A potential is data: an exponent, and whether the overlap is absolute or relative to the sum of radii. With these
two spring constants results do not depend on the unit of length.
"""

from __future__ import annotations

import re
from dataclasses import dataclass

import numpy as np

from petscjam.base.errors import InputError
from petscjam.base.ranges import EXPONENT
from petscjam.base.types import Array


@dataclass(frozen=True)
class Potential:
    """U = k(σ) δ^α / α, where δ = σ − r is the overlap and σ = ρi + ρj; zero without overlap.

    Parameters
    ----------
    name : str
    exponent : float
        α, at least 2.
    relative : bool
        Whether k(σ) is σ^−α, so that U = (δ/σ)^α / α, or 1.
    source : str
        Publication.
    """

    name: str
    exponent: float
    relative: bool
    source: str

    def spring_constant(self, sigma: Array) -> Array:
        """Return k for each σ."""
        return sigma**-self.exponent if self.relative else np.ones_like(sigma)

    def unit(self, d: float) -> float:
        """Stiffness k(d) d^(α − 2) of disks whose overlap is their diameter ``d``."""
        return float(self.spring_constant(np.array(d)) * d ** (self.exponent - 2))

    def energy(self, r: Array, sigma: Array) -> Array:
        """Energy of pairs at distance ``r``.

        Parameters
        ----------
        r, sigma : arrays
        """
        return self.spring_constant(sigma) * np.maximum(sigma - r, 0) ** self.exponent / self.exponent

    def force(self, r: Array, sigma: Array) -> Array:
        """Repulsive force −dU/dr.

        Parameters
        ----------
        r, sigma : arrays
        """
        return self.spring_constant(sigma) * np.maximum(sigma - r, 0) ** (self.exponent - 1)

    def stiffness(self, r: Array, sigma: Array) -> Array:
        """Second derivative d²U/dr²; a pair with overlap 0 counts as a contact.

        Parameters
        ----------
        r, sigma : arrays
        """
        alpha = self.exponent
        overlap = np.maximum(sigma - r, 0)
        return np.where(r <= sigma, self.spring_constant(sigma) * (alpha - 1) * overlap ** (alpha - 2), 0.0)


POTENTIALS = {
    potential.name: potential
    for potential in (
        Potential("harmonic", 2.0, False, "BT eq. 3 with k = 1"),
        Potential("harmonic-relative", 2.0, True, "VOT eq. 1 with α = 2, ke = 1"),
        Potential("hertzian", 2.5, False, "Hertz, with k = 1 at δ = d"),
        Potential("hertzian-relative", 2.5, True, "VOT eq. 1 with α = 5/2, ke = 1"),
    )
}


def power_law(exponent: float, relative: bool) -> Potential:
    """Return the potential of an exponent; its name, unless it has one in POTENTIALS, is ``power-α[-relative]``.

    Parameters
    ----------
    exponent : float
        α.
    relative : bool
        Whether the overlap counts relative to σ.

    Raises
    ------
    InputError
        If the exponent is not a number of at least 2.
    """
    EXPONENT.check("potential: the exponent", exponent)
    for known in POTENTIALS.values():
        if (known.exponent, known.relative) == (exponent, relative):
            return known
    name = f"power-{float(exponent)!r}{'-relative' * relative}"
    return Potential(name, float(exponent), relative, f"VOT eq. 1 with α = {exponent:g}")


def potential(name: str) -> Potential:
    """Return the potential called ``name``."""
    found = re.fullmatch(r"power-(\d+\.\d+)(-relative)?", name)
    law = power_law(float(found[1]), bool(found[2])) if found else POTENTIALS.get(name)
    if law is None or law.name != name:
        known = ", ".join(POTENTIALS)
        raise InputError(f"potential: {name!r} is unknown; known are {known}, power-3.0, power-3.0-relative, …")
    return law
