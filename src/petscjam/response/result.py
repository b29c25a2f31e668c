"""G*(ω) at given frequencies, its limits, and their errors.

Axes: w frequency, i disk, x Cartesian.
"""

from __future__ import annotations

from dataclasses import dataclass, field, replace
from typing import Any, ClassVar

import numpy as np
from numpy.typing import ArrayLike, NDArray

from petscjam.base.types import Array
from petscjam.geometry.packing import Packing
from petscjam.response.origin import Judged, frequencies, stored
from petscjam.response.spectrum import Spectrum
from petscjam.rows.inertia import said


@dataclass(frozen=True, eq=False)
class ComplexModulus(Judged):
    """G*(ω) = G′ + iG″ of one packing. Units: stress k (BT) or ke/d² (VOT), time τ1.

    Attributes
    ----------
    omega : (W,)
        Angular frequencies, 1/τ1.
    values : (W,) complex
        Per unit strain: G′ = Q†(K − ω²M)Q/V and G″ = ωQ†BQ/V, or the same of the reduced model; M = 0 without inertia.
    residuals : (W,)
        ‖(K + iωB − ω²M)q − f‖/‖f‖ of each solve, or of the model's q: the error of G* is quadratic in it.
    power_balance : (W,)
        |A_γγ + A_γu·q − Q†(K − ω²M)Q − iωQ†BQ| / |G*V|: zero for an exact solution.
    errors : (W,)
        Bound on |ΔG*|/|G*|; NaN for direct solves.
    part_errors : (2, W)
        The same on |ΔG′|/|G′| and |ΔG″|/|G″|.
    G0, eta0 : float
        ω → 0: G′ and G″/ω; NaN if unknown, with the reason in a note.
    G_inf, eta_inf : float
        ω → ∞: G′ and G″/ω.
    limit_residuals : (2,)
        Residuals of the solves for the two limits; of a reduced model, bounds on their relative errors.
    field_omega : (F,)
        Frequencies at which displacements are stored.
    fields : (F, N, 2) complex
        Non-affine displacement per unit strain; NaN for rattlers that were removed. If the law does not resist a
        translation, the mean over the backbone, weighted by the masses, is zero.
    geometry : Packing or None
        The packing, stored with the fields.
    performance : dict
        Factorisations, MUMPS and peak memory (MB) of each rank.
    model : Spectrum or None
        The reduced model of the values; None for direct solves.
    mass : (D,) or None
        Mass of each disk, k τ1²; None without inertia.
    """

    omega: Array = field(metadata=stored("1/tau1", "W", finite=True))
    values: NDArray[np.complex128] = field(metadata=stored("stress", "W", finite=True, parts=("G_storage", "G_loss")))
    residuals: Array = field(metadata=stored("1", "W"))
    power_balance: Array = field(metadata=stored("1", "W"))
    errors: Array = field(metadata=stored(axes="W"))
    part_errors: Array = field(metadata=stored(axes="2 W", parts=("error_storage", "error_loss")))
    G0: float = field(metadata=stored("stress"))
    eta0: float = field(metadata=stored("stress*tau1"))
    G_inf: float = field(metadata=stored("stress"))
    eta_inf: float = field(metadata=stored("stress*tau1"))
    limit_residuals: Array = field(metadata=stored(axes="2"))
    field_omega: Array = field(default_factory=lambda: np.empty(0), metadata=stored("1/tau1", "F", finite=True))
    fields: NDArray[np.complex128] = field(
        default_factory=lambda: np.empty((0, 0, 2), complex), metadata=stored("length per unit strain", "F N 2")
    )
    geometry: Packing | None = None
    performance: dict[str, Any] = field(default_factory=dict)
    model: Spectrum | None = None
    mass: Array | None = field(default=None, metadata=stored("stress*tau1**2", "D", finite=True))
    settings: ClassVar[tuple[str, ...]] = ("strain", "damping")
    figure: ClassVar[str] = "petscjam.plots.modulus:moduli_figure"
    exports: ClassVar[str] = "petscjam.io.rheology:export_rheology"

    def row(self) -> dict[str, float | str]:
        """Return its line of the table."""
        limits = {"G0": self.G0, "eta0": self.eta0, "G_inf": self.G_inf, "eta_inf": self.eta_inf}
        return {"frequencies": str(len(self.omega)), **limits, "state": self.state}

    @property
    def inertia(self) -> str:
        """The masses as text; empty without inertia."""
        return said(self.mass)

    @classmethod
    def sampled(cls, model: Spectrum, omegas: ArrayLike, fields_at: ArrayLike = ()) -> ComplexModulus:
        """Return G* of ``model`` on a grid, with errors; the result contains the model.

        Parameters
        ----------
        model : Spectrum
        omegas : (W,)
            Angular frequencies, 1/τ1.
        fields_at : (F,)
            Frequencies at which displacements are stored.

        Raises
        ------
        InputError
            On a frequency outside the span of the model, or displacements of a model without motions.
        """
        omega, kept = frequencies(omegas), frequencies(fields_at, empty=True)
        fields = np.array([model.displacement(w) for w in kept], dtype=complex)
        return cls(
            omega=omega,
            values=model(omega),
            residuals=model.residuals(omega),
            power_balance=model.power_balance(omega),
            errors=model.error(omega),
            part_errors=np.array(model.part_errors(omega)),
            G0=model.G0,
            eta0=model.eta0,
            G_inf=model.G_inf,
            eta_inf=model.eta_inf,
            limit_residuals=model.limit_errors.max(1),
            negative_modes=model.negative_modes,
            zero_modes=model.zero_modes,
            origin=model.origin,
            notes=model.notes,
            field_omega=kept,
            fields=fields if len(kept) else np.empty((0, 0, 2), complex),
            geometry=model.geometry if len(kept) else None,
            performance=model.performance,
            model=replace(model, motions=None, geometry=None),
            mass=model.mass,
        )
