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
from petscjam.ranges import OMEGA

if TYPE_CHECKING:
    from petscjam.response.spectrum import Spectrum


def frequencies(omegas: ArrayLike, *, empty: bool = False) -> Array:
    """Return ``omegas`` as an array, or refuse an empty one and any that is out of range."""
    omega = np.atleast_1d(np.asarray(omegas, dtype=float)).ravel()
    if omega.size == 0 and not empty:
        raise InputError("omega: the range is empty")
    for value in omega[~((omega >= OMEGA.low) & (omega <= OMEGA.high))]:
        OMEGA.check("omega: frequencies", float(value))
    return omega


class Judged:
    """A result that tells whether its packing is a solid, by G0, the modes of K and the balance of forces."""

    @property
    def state(self: Any) -> str:
        """``stable``, or what the packing lacks for that, or what is not known.

        It is stable if G0 > 0 beyond rounding, K has neither negative nor zero modes and, with pre-stress,
        the forces balance: a linear response starts from an equilibrium. Without pre-stress contacts are
        springs at rest, which are in one anywhere.
        """
        faults = ["G0 < 0"] * (self.G0 < 0) + ["G0 = 0"] * (self.G0 == 0)
        unknown = ["G0"] * bool(np.isnan(self.G0))
        for kind, count in (("negative modes", self.negative_modes), ("zero modes", self.zero_modes)):
            faults += [f"{count} {kind}"] * bool(count)
            unknown += [kind] * (count is None)
        balanced = self.packing.get("balanced") if self.prestress else True  # older files do not tell
        if faults:
            return f"UNSTABLE: {', '.join(faults + ['not in balance'] * (balanced is False))}"
        if balanced is False:
            return "NOT IN BALANCE"
        unknown += ["balance"] * (balanced is None)
        return f"UNKNOWN: {', '.join(unknown)}" if unknown else "stable"

    @property
    def stable(self) -> bool:
        """Whether ``state`` is ``stable``."""
        return self.state == "stable"


@dataclass(frozen=True, eq=False)
class ComplexModulus(Judged):
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
    negative_modes, zero_modes : int or None
        Such eigenvalues of K on the pinned backbone; None where a note says why.
    strain, damping : str
    prestress : bool
    packing : dict
        Name, checksum, particles, phi, diameter, pressure, Z, rattlers, potential, balanced, net_force (p·d).
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
    zero_modes: int | None
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
