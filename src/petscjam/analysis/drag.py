"""Nonlinear drag by the method of equivalent damping (BT eqs. 9 and 23–29), one time for all contacts.

The force on a contact is −k τ1^α ρ0^(1−α) |v|^(α−1) v, v the relative velocity at the contact point. It is
replaced by a linear force −kτv, with τ such that a cycle along the same path dissipates the same energy. Here τ
is τα(ω, δσ) of a single spring under a force of amplitude δσ; in :mod:`petscjam.analysis.contact_drag` each
contact has its own. docs/howto/drag.md derives both. ρ0 is the mean diameter d, and k = τ1 = 1.

Axes: w frequency, c contact of the backbone.
"""

from __future__ import annotations

from argparse import ArgumentParser
from dataclasses import dataclass, field, replace
from typing import Any, ClassVar

import numpy as np
from numpy.typing import ArrayLike, NDArray
from scipy.optimize import brentq
from scipy.special import gamma

from petscjam.base import arguments, ranges
from petscjam.base.errors import InputError
from petscjam.base.types import Array
from petscjam.geometry.packing import Packing
from petscjam.geometry.potential import potential
from petscjam.parallel.comm import agree
from petscjam.response.origin import Judged, Verb, frequencies, stored
from petscjam.response.reduced import spectrum
from petscjam.response.spectrum import EDGE, Spectrum
from petscjam.rows.damping import ContactDamping

LARGEST_LOG = 100 * np.log(10)  # largest |ln τ|, so that squares do not overflow


@dataclass(frozen=True, eq=False)
class NonlinearModulus(Judged):
    """G*(ω; δσ) of one packing under nonlinear drag. Units: stress k, time τ1.

    Attributes
    ----------
    omega : (W,)
        Angular frequencies, 1/τ1.
    values : (W,) complex
        Stress of the fundamental over strain.
    stress : float
        Amplitude δσ of the stress; in compression, of the pressure.
    alpha : float
        Exponent of the force law.
    form : str
        ``uniform``, ``per contact`` or ``direct``, without equivalent damping.
    tau : (W,)
        τα; otherwise the mean with the same dissipation, Σ τ_c|Δu|²/Σ|Δu|².
    spread : (W,)
        Standard deviation of ln τ_c over contacts, weighted by the dissipation of each.
    iterations : (W,) int
        Number of solves.
    converged : (W,) bool
    changes : (W,)
        |ΔG*|/|G*|, to first order, that one more iteration would make; direct: of the last one.
    tau_changes : (W,)
        rms over contacts of ln τ_c of the motion minus ln τ_c of the solve; direct: rms difference of the velocities
        of contacts from those of their friction, weighted by friction, relative to their rms.
    residuals : (W,)
        ‖(K + iωB)q − f‖/‖f‖ of the last solve, or of the reduced model; direct: the largest over harmonics.
    errors : (W,)
        Bound on |ΔG*|/|G*| of the reduced model; NaN without one.
    contact_tau : (W, C)
        τ_c of each contact of the backbone, in the order of :class:`ContactNetwork`; uniform: none; direct: the
        linear friction that dissipates the same along the path of the contact.
    G0 : float or None
        The smallest G′, including that at ω → 0 if known; 0 within rounding. None in older files.
    third : (W,) complex or None
        Third harmonic of the strain over the fundamental, under the stress δσ cos ωt; direct only.
    """

    omega: Array = field(metadata=stored("1/tau1", "W", finite=True))
    values: NDArray[np.complex128] = field(metadata=stored("stress", "W", finite=True))
    stress: float = field(metadata=stored("stress", finite=True))
    alpha: float = field(metadata=stored(finite=True))
    form: str = field(metadata=stored(words=("uniform", "per contact", "direct")))
    tau: Array = field(metadata=stored("tau1", "W"))
    spread: Array = field(metadata=stored(axes="W"))
    iterations: NDArray[np.int64] = field(metadata=stored(axes="W"))
    converged: NDArray[np.bool_] = field(metadata=stored(axes="W"))
    changes: Array = field(metadata=stored(axes="W"))
    tau_changes: Array = field(metadata=stored(axes="W"))
    residuals: Array = field(metadata=stored("1", "W"))
    errors: Array = field(metadata=stored(axes="W"))
    contact_tau: Array = field(metadata=stored("tau1", "W C"))
    G0: float | None = field(metadata=stored("stress"))
    third: NDArray[np.complex128] | None = field(default=None, kw_only=True, metadata=stored("1", "W"))
    settings: ClassVar[tuple[str, ...]] = ("strain",)
    units: ClassVar[str] = "stress in k"
    figure: ClassVar[str] = "petscjam.plots.drag:drag_figure"

    def row(self) -> dict[str, float | str]:
        """Return its line of the table."""
        return {
            "form": self.form,
            "alpha": self.alpha,
            "stress": self.stress,
            "most iterations": f"{self.iterations.max()}",
            "converged": f"{self.converged.sum()} of {len(self.omega)}",
            "change": f"{self.changes.max():.0e}",
            "state": self.state,
        }

    def at(self, stress: float) -> NonlinearModulus:
        """Return the result at another amplitude, exact and without a solve, at other frequencies.

        G* and ωτ depend only on ω^α δσ^(α−1): ω is proportional to δσ^((1−α)/α).
        """
        check_amplitude(stress, self.alpha)
        faster = (stress / self.stress) ** ((1 - self.alpha) / self.alpha)
        return replace(
            self,
            stress=float(stress),
            omega=self.omega * faster,
            tau=self.tau / faster,
            contact_tau=self.contact_tau / faster,
        )


def line_factor(alpha: float) -> float:
    """Return C(α): τ = C(α) |v|^(α−1) for a velocity v cos ωt along a line (BT eq. 25, corrected)."""
    return float(2 / np.sqrt(np.pi) * gamma(1 + alpha / 2) / gamma(1.5 + alpha / 2))


def equivalent_time(omegas: ArrayLike, stress: float, alpha: float) -> Array:
    """Return τα (W,) of a spring k and a dashpot under a force δσρ0 cos ωt (BT eqs. 24 and 25, corrected).

    τ = C(α)(ωu₀)^(α−1), u₀ = δσ/√(1 + (ωτ)²). As h(ln τ) = 0, h has a slope between 1 and α: for any α > 0
    there is one root, between y₀, its value for ωτ ≪ 1, and y₀ − h(y₀)/min(1, α).

    Parameters
    ----------
    omegas : (W,)
        1/τ1.
    stress : float
        δσ, in units of k.
    alpha : float
        Exponent α of the force with the speed.

    Raises
    ------
    InputError
        If a frequency, ``stress`` or ``alpha`` is out of its range, or τ is beyond 10^±100.
    """
    omega = frequencies(omegas)
    check_amplitude(stress, alpha)
    tau = np.empty(len(omega))
    for w, log_omega in enumerate(np.log(omega)):
        start = np.log(line_factor(alpha)) + (alpha - 1) * (np.log(stress) + log_omega)

        def excess(y: float, start: float = start, log_omega: float = log_omega) -> float:
            return y - start - (1 - alpha) / 2 * float(np.logaddexp(0.0, 2 * (y + log_omega)))

        reach = -excess(start) / min(1.0, alpha)
        log_tau = float(brentq(excess, start, start + reach + np.sign(reach), xtol=1e-14))
        if abs(log_tau) > LARGEST_LOG:
            raise InputError(
                f"alpha = {alpha:g}, stress = {stress:g}: the equivalent time at omega = {omega[w]:g} is "
                f"10^{log_tau / np.log(10):.0f} tau1, outside of 10^±100; take them closer to 1"
            )
        tau[w] = np.exp(log_tau)
    return tau


def equivalent_drag(
    source: Packing | Spectrum, omegas: ArrayLike, stress: float, alpha: float, **options: Any
) -> NonlinearModulus:
    """Return G*(ω; δσ) with one τα for all contacts: the linear G* at ωτα (BT, Nonlinear drag).

    Parameters
    ----------
    source : Packing or Spectrum
        For a packing, a reduced model is made from min ωτα to max ωτα.
    omegas : (W,) array_like
        Angular frequencies in 1/τ1, all > 0.
    stress : float
        Amplitude δσ > 0, in units of k.
    alpha : float
        Exponent α > 0; 1 is linear.
    **options
        As for :func:`petscjam.spectrum`: ``strain``, ``prestress``, ``rtol``, ``comm``, ….

    Raises
    ------
    InputError
        As :func:`equivalent_time`; if ωτα is outside the span of the model, or its damping is not contact damping.
    SolverError
        As :func:`petscjam.spectrum`.
    """
    if options.get("comm") is not None:
        agree(options["comm"], source, omegas, stress, alpha)
    check_amplitude(stress, alpha)
    omega = frequencies(omegas)
    k = source.potential.unit(source.mean_diameter) if isinstance(source, Packing) else _unit(source)
    tau = equivalent_time(omega / k, stress / k, alpha)
    low, high = float((omega * tau).min()), float((omega * tau).max())
    if isinstance(source, Packing):
        model = spectrum(source, (low, high), displacements=False, **options)
    elif options:
        raise InputError(f"{', '.join(options)}: the reduced model is made already")
    else:
        model = source
    if not isinstance(model.damping, ContactDamping):
        raise InputError(f"damping: {model.damping} does not act on contacts")
    if not (model.span[0] * (1 - EDGE) <= low and high <= model.span[1] * (1 + EDGE)):
        raise InputError(
            f"spectrum: ωτα goes from {low:.3g} to {high:.3g}, the span of the model from {model.span[0]:.3g} "
            f"to {model.span[1]:.3g}"
        )
    zeros, count = np.zeros(len(omega)), len(omega)
    values = model(omega * tau)
    return NonlinearModulus(
        omega=omega,
        values=values,
        stress=float(stress),
        alpha=float(alpha),
        form="uniform",
        tau=tau,
        spread=zeros,
        iterations=np.zeros(count, dtype=int),
        converged=np.ones(count, dtype=bool),
        changes=zeros,
        tau_changes=zeros,
        residuals=model.residuals(omega * tau),
        errors=model.error(omega * tau),
        contact_tau=np.empty((count, 0)),
        origin=replace(model.origin, damping=None),
        G0=float(np.nanmin([*values.real, model.G0])),
        negative_modes=model.negative_modes,
        zero_modes=model.zero_modes,
        notes=model.notes,
    )


def _unit(model: Spectrum) -> float:
    """Return the stiffness k of the packing's potential (:meth:`petscjam.geometry.potential.Potential.unit`)."""
    law, diameter = potential(model.origin.potential), model.origin.diameter
    if diameter is None and law.unit(2.0) != 1:
        raise InputError(f"spectrum: an older file lacks the diameters of {law.name} disks; make it again")
    return law.unit(diameter or 1.0)


def check_amplitude(stress: float, alpha: float) -> None:
    """Raise an error if a value is out of its range.

    Parameters
    ----------
    stress : float
        δσ, in units of k.
    alpha : float

    Raises
    ------
    InputError
    """
    ranges.STRESS.check("stress:", stress)
    ranges.ALPHA.check("alpha:", alpha)


def _options(parser: ArgumentParser) -> None:
    parser.add_argument(
        "--omega",
        dest="omegas",
        type=arguments.Within(arguments.frequencies, ranges.OMEGA),
        default="1e-6:1e1:29",
        metavar="RANGE",
        help="angular frequencies in 1/tau1: A:B:N or a list A,B,… (default 1e-6:1e1:29)",
    )
    stress, alpha = (arguments.Within(arguments.number, range) for range in (ranges.STRESS, ranges.ALPHA))
    parser.add_argument("--stress", type=stress, required=True, metavar="X", help="amplitude of the stress, in k")
    text = "exponent of the force law, above 0; 1 is linear (default 2/3)"
    parser.add_argument("--alpha", type=alpha, default=2 / 3, metavar="X", help=text)
    forms = parser.add_mutually_exclusive_group()
    for option, form, text in (
        ("--uniform", equivalent_drag, "one time for all contacts, as in the paper, instead of one for each contact"),
        ("--direct", DIRECT, "the nonlinear equations of motion, without effective times"),
    ):
        forms.add_argument(option, dest="analyse", action="store_const", const=form, help=text)


DIRECT = "petscjam.analysis.nonlinear_drag:nonlinear_drag"
VERB = Verb("petscjam.analysis.contact_drag:self_consistent_drag", "G*, effective times, convergence", _options)
