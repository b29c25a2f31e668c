"""What a sweep gives: G*(ω), its limits, and how far to trust them.

Axes: w frequency, i disk, x Cartesian.
"""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from petscjam.box import Array
from petscjam.errors import InputError
from petscjam.packing.packing import Packing

if TYPE_CHECKING:
    from petscjam.response.spectrum import Spectrum

ROUNDING = 1e-14  # of G0, relative to the largest modulus


def frequencies(omegas: ArrayLike, *, empty: bool = False) -> Array:
    """Return ``omegas`` as an array, or refuse an empty one and any that is not > 0 and finite."""
    omega = np.atleast_1d(np.asarray(omegas, dtype=float)).ravel()
    if omega.size == 0 and not empty:
        raise InputError("omega: the range is empty")
    bad = ~(np.isfinite(omega) & (omega > 0))
    if bad.any():
        raise InputError(f"omega: frequencies must be > 0 and finite, not {omega[np.argmax(bad)]:g}")
    return omega


@dataclass(frozen=True, eq=False)
class ComplexModulus:
    """G*(ω) = G′ + iG″ of one packing. Units: stress k (BT) or ke/d² (VOT), time τ1.

    Attributes
    ----------
    omega : (W,)
        Angular frequencies, 1/τ1.
    values : (W,) complex
        Per unit strain: G′ = Q†KQ/V and G″ = ωQ†BQ/V, or the same of the reduced model.
    residuals : (W,)
        ‖(K + iωB)q − f‖/‖f‖ of each solve, or of the model's q: the error of G* is quadratic in it.
    power_balance : (W,)
        |A_γγ + A_γu·q − Q†KQ − iωQ†BQ| / |G*V|: zero for an exact solution.
    errors : (W,)
        Certified bound on |ΔG*|/|G*|; NaN where each frequency was solved for.
    part_errors : (2, W)
        The same on |ΔG′|/|G′| and |ΔG″|/|G″|.
    G0, eta0 : float
        ω → 0: G′ and G″/ω; NaN where a note says why.
    G_inf, eta_inf : float
        ω → ∞: G′ and G″/ω.
    limit_residuals : (2,)
        Residuals of the solves for the two limits; of a reduced model, bounds on their relative errors.
    negative_modes : int or None
        Negative eigenvalues of K on the pinned backbone; None where a note says why.
    strain, damping : str
    prestress : bool
    packing : dict
        Name, checksum, particles, phi, pressure, Z, rattlers of the packing.
    notes : tuple of str
        What could not be had, and why.
    field_omega : (F,)
        Frequencies whose displacements are kept.
    fields : (F, N, 2) complex
        Non-affine displacement per unit strain; NaN on rattlers that were taken out. Where the law does
        not see a translation, the mean over the backbone is zero.
    geometry : Packing or None
        The packing, kept with the fields.
    performance : dict
        Factorisations, MUMPS and peak memory (MB) of each rank.
    model : Spectrum or None
        The reduced model that the values are of; None where each frequency was solved for.
    """

    omega: Array
    values: NDArray[np.complex128]
    residuals: Array
    power_balance: Array
    errors: Array
    part_errors: Array
    G0: float
    eta0: float
    G_inf: float
    eta_inf: float
    limit_residuals: Array
    negative_modes: int | None
    strain: str
    damping: str
    prestress: bool
    packing: dict[str, Any]
    notes: tuple[str, ...] = ()
    field_omega: Array = field(default_factory=lambda: np.empty(0))
    fields: NDArray[np.complex128] = field(default_factory=lambda: np.empty((0, 0, 2), complex))
    geometry: Packing | None = None
    performance: dict[str, Any] = field(default_factory=dict)
    model: Spectrum | None = None

    @property
    def rigid(self) -> bool:
        """Whether G0 > 0, beyond rounding."""
        return bool(self.G0 > ROUNDING * abs(self.values).max())

    @property
    def stable(self) -> bool:
        """Whether G0 > 0, beyond rounding, and K has no negative mode; False where either is unknown."""
        return self.rigid and self.negative_modes == 0
