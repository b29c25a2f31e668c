"""Repulsive contact potentials, by name: functions of the overlap, among them harmonic, Hertzian and other powers.

The overlap of a contact is x = σ − r, or 1 − r/σ of a potential that is relative, where σ = ρi + ρj.
"""

from __future__ import annotations

import re
from collections.abc import Callable
from dataclasses import dataclass, field
from typing import NamedTuple

import numpy as np

from petscjam.base.errors import InputError
from petscjam.base.ranges import EXPONENT
from petscjam.base.registry import Registry, loaded
from petscjam.base.types import Array


class Compiled(NamedTuple):
    """Addresses of U, U′ and U″, compiled; None of a power law, for which the loops have separate formulas."""

    U: int | None = None
    dU: int | None = None
    d2U: int | None = None


@dataclass(frozen=True)
class Potential:
    """Repulsive potential U(x) of the overlap x; zero without overlap.

    Parameters
    ----------
    name : str
    relative : bool
        Whether x is 1 − r/σ rather than σ − r.
    source : str
        Publication.
    U, dU, d2U : callable
        U, U′ and U″ for arrays of x ≥ 0; numba compiles them for numbers. U and U′ are 0 at x = 0. The unit of
        energy is such that U″ is about 1, as it is of the harmonic potentials.

    Attributes
    ----------
    exponent : float or None
        α of a power law.
    """

    name: str
    relative: bool
    source: str
    U: Callable[..., Array] = field(compare=False, repr=False)
    dU: Callable[..., Array] = field(compare=False, repr=False)
    d2U: Callable[..., Array] = field(compare=False, repr=False)
    exponent: float | None = field(default=None, init=False)

    def __reduce__(self) -> tuple[Callable[[str], Potential], tuple[str]]:
        return potential, (self.name,)

    def k(self, sigma: Array) -> Array:
        """Return k of x = k (σ − r), for each σ."""
        return 1 / sigma if self.relative else np.ones_like(sigma)

    def unit(self, d: float) -> float:
        """Return the unit of stiffness of disks of diameter ``d``."""
        return d**-2 if self.relative else 1.0

    def overlap(self, pressure: float) -> float:
        """Return the overlap of two disks of diameter 1 whose force is ``pressure``."""
        x = np.geomspace(1e-12, 1, 1000)
        return float(np.interp(pressure, self.dU(x), x))

    def energy(self, r: Array, sigma: Array) -> Array:
        """Energy of pairs at distance ``r``.

        Parameters
        ----------
        r, sigma : arrays
        """
        return self._derivatives(np.maximum(sigma - r, 0), sigma)[0]

    def force(self, r: Array, sigma: Array) -> Array:
        """Repulsive force −dU/dr.

        Parameters
        ----------
        r, sigma : arrays
        """
        return self._derivatives(np.maximum(sigma - r, 0), sigma)[1]

    def stiffness(self, r: Array, sigma: Array) -> Array:
        """Second derivative d²U/dr²; a pair with overlap 0 counts as a contact.

        Parameters
        ----------
        r, sigma : arrays
        """
        return np.where(r <= sigma, self._derivatives(np.maximum(sigma - r, 0), sigma)[2], 0.0)

    def _derivatives(self, delta: Array, sigma: Array) -> tuple[Array, Array, Array]:
        """Return U, −dU/dr and d²U/dr² for δ = σ − r."""
        k = self.k(sigma)
        x = k * delta
        return self.U(x), k * self.dU(x), k**2 * self.d2U(x)

    @property
    def compiled(self) -> Compiled:
        """Addresses of its compiled functions.

        Raises
        ------
        InputError
            If numba cannot compile one of them.
        """
        from petscjam.base.compiled import compiled

        what = f"potential: {self.name!r}"
        return Compiled(*(compiled(function, what).address for function in (self.U, self.dU, self.d2U)))


class PowerLaw(Potential):
    """U = k(σ) δ^α / α, where δ = σ − r and k is 1, or σ^−α if it is relative.

    With these two k results do not depend on the unit of length.

    Parameters
    ----------
    name : str
    exponent : float
        α, at least 2.
    relative : bool
        Whether U is (δ/σ)^α / α.
    source : str
        Publication.
    """

    exponent: float
    compiled = Compiled()

    def __init__(self, name: str, exponent: float, relative: bool, source: str) -> None:
        super().__init__(
            name,
            relative,
            source,
            lambda x: x**exponent / exponent,
            lambda x: x ** (exponent - 1),
            lambda x: (exponent - 1) * x ** (exponent - 2),
        )
        object.__setattr__(self, "exponent", exponent)

    def k(self, sigma: Array) -> Array:
        """Return k of U = k δ^α / α, for each σ."""
        return sigma**-self.exponent if self.relative else np.ones_like(sigma)

    def unit(self, d: float) -> float:
        """Return the stiffness k(d) d^(α − 2) of disks whose overlap is their diameter ``d``."""
        return float(self.k(np.array(d)) * d ** (self.exponent - 2))

    def overlap(self, pressure: float) -> float:
        """Return the overlap of two disks of diameter 1 whose force is ``pressure``."""
        return pressure ** (1 / (self.exponent - 1))

    def _derivatives(self, delta: Array, sigma: Array) -> tuple[Array, Array, Array]:
        k, alpha = self.k(sigma), self.exponent
        return k * delta**alpha / alpha, k * delta ** (alpha - 1), k * (alpha - 1) * delta ** (alpha - 2)


POTENTIALS: Registry[Potential] = Registry(
    {
        potential.name: potential
        for potential in (
            PowerLaw("harmonic", 2.0, False, "BT eq. 3 with k = 1"),
            PowerLaw("harmonic-relative", 2.0, True, "VOT eq. 1 with α = 2, ke = 1"),
            PowerLaw("hertzian", 2.5, False, "Hertz, with k = 1 at δ = d"),
            PowerLaw("hertzian-relative", 2.5, True, "VOT eq. 1 with α = 5/2, ke = 1"),
        )
    },
    "petscjam.potentials",
    loaded(Potential),
)


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
    return PowerLaw(name, float(exponent), relative, f"VOT eq. 1 with α = {exponent:g}")


def potential(name: str) -> Potential:
    """Return the potential called ``name``."""
    found = re.fullmatch(r"power-(\d+\.\d+)(-relative)?", name)
    law = power_law(float(found[1]), bool(found[2])) if found else POTENTIALS.get(name)
    if law is None or law.name != name:
        known = ", ".join(POTENTIALS)
        raise InputError(f"potential: {name!r} is unknown; known are {known}, power-3.0, power-3.0-relative, …")
    return law
