"""The results of a reduced model: G* at every frequency with an error bound, relaxation times, G(t) and J(t).

The model is the pencil (K, B) restricted to a few motions: Q₀ with strain 1 and motions without strain.
docs/theory.md, Reduced model, has the proofs.

Axes: w frequency, m motion (0 is Q₀), k node (a frequency at which K + iωB was factored), j relaxation,
i disk, x Cartesian.
"""

from __future__ import annotations

from dataclasses import dataclass, field, replace
from functools import cached_property
from typing import Any, ClassVar, NamedTuple

import numpy as np
from numpy.typing import ArrayLike, NDArray

from petscjam.base.errors import InputError, SolverError
from petscjam.base.types import Array, numbers
from petscjam.geometry.packing import Packing
from petscjam.response.origin import Judged, frequencies, stored
from petscjam.rows.damping import StokesDrag
from petscjam.rows.inertia import said
from petscjam.rows.kinematics import strain_mode

EPS = float(np.finfo(float).eps)
ROUNDING = (
    32 * EPS
)  # rounding error of a sum over contacts, relative to the sum of moduli: twice the largest observed value
LARGEST_GAIN_ERROR = 0.1  # nodes with a larger error are not used
GAIN_ALLOWANCE = 100  # factor on the error that is added to a gain
EDGE = 1e-9  # relative tolerance of the ends of the span
INSTANT = 1e-13  # fraction of friction in a motion, below which it relaxes at once

Complex = NDArray[np.complex128]


class Relaxation(NamedTuple):
    """Relaxation times (J,), ascending, in τ1, and their weights (J,), moduli in units of stress."""

    times: Array
    weights: Array


@dataclass(frozen=True, eq=False)
class Spectrum(Judged):
    """G*(ω) of one packing at every frequency: ``s(omegas)``. Units: stress k (BT) or ke/d² (VOT), time τ1.

    Attributes
    ----------
    span : (float, float)
        Lowest and highest frequency of the model, 1/τ1.
    rtol : float
        Requested bound on |ΔG*|/|G*| in the span.
    K, B : (M, M)
        The pencil between the motions.
    residual_K, residual_B : (M,)
        The residual of the model at any ω has the length |(residual_K + iω residual_B)·(1, y)|.
    nodes : (F,)
        Frequencies of the factorisations, in the order in which they were chosen.
    gains : (F,) complex
        Rᵀ(K + iω_kB)⁻¹R, R the direction of the residual.
    gain_errors : (F,)
        Relative component of the residual of each node perpendicular to R, by rounding, 0 … 1.
    limits : (2, 2)
        G0, η0 and G∞, η∞: of the model or, if the span ends too far from a plateau, from direct solves.
    limit_errors : (2, 2)
        Relative error of each (:meth:`own_limits`); for direct solves, the residual.
    forcing : (float, float)
        ‖K_uγ‖ and ‖B_uγ‖.
    affine : (float, float)
        K_γγ and B_γγ, of the affine motion.
    area, pressure : float
        Of the cell; the pressure enters the bulk modulus with pre-stress.
    definite : bool
        Whether K is known to have none: then :meth:`error` is a bound, else an estimate.
    rounding_only : bool
        Whether the residual in the span is a rounding error: then its length is an upper limit, and there is no
        bound outside the span.
    estimate : float
        Relative error of |G*| that is only an estimate, and part of every error (members of a family).
    mass : (D,) or None
        Mass of each disk, k τ1²; None without inertia.
    performance : dict
        Ranks, seconds, MUMPS memory (MB) and flops of a factorisation, largest residual of a solve.
    motions : (M, N, 2) or None
        Displacements of the motions; None in a model without them.
    geometry : Packing or None
        The packing, stored with the motions.
    """

    span: tuple[float, float] = field(metadata=stored("1/tau1", "2", finite=True))
    rtol: float = field(metadata=stored(finite=True))
    K: Array = field(metadata=stored(axes="M M", finite=True))
    B: Array = field(metadata=stored(axes="M M", finite=True))
    residual_K: Array = field(metadata=stored(axes="R", finite=True))
    residual_B: Array = field(metadata=stored(axes="R", finite=True))
    nodes: Array = field(metadata=stored("1/tau1", "F", finite=True))
    gains: Complex = field(metadata=stored(axes="F"))
    gain_errors: Array = field(metadata=stored(axes="F"))
    limits: Array = field(metadata=stored(axes="2 2", parts=("G0", "eta0", "G_inf", "eta_inf")))
    limit_errors: Array = field(metadata=stored(axes="2 2"))
    forcing: tuple[float, float] = field(metadata=stored(axes="2", finite=True))
    affine: tuple[float, float] = field(metadata=stored(axes="2", finite=True))
    area: float = field(metadata=stored(finite=True))
    pressure: float = field(metadata=stored(finite=True))
    definite: bool
    rounding_only: bool = False
    estimate: float = 0.0
    performance: dict[str, Any] = field(default_factory=dict)
    motions: Array | None = field(default=None, metadata=stored("length per unit strain", "M N 2"))
    geometry: Packing | None = None
    mass: Array | None = field(default=None, metadata=stored("stress*tau1**2", "D", finite=True))
    settings: ClassVar[tuple[str, ...]] = ("strain", "damping")

    def __call__(self, omegas: ArrayLike) -> Complex:
        """Return G* at ``omegas`` (any shape), 1/τ1."""
        omega = positive(omegas)
        return self._modulus(omega.ravel()).reshape(omega.shape)

    def row(self) -> dict[str, float | str]:
        """Return span, size and limits of the model."""
        low, high = self.span
        limits = {"G0": self.G0, "eta0": self.eta0, "G_inf": self.G_inf, "eta_inf": self.eta_inf}
        return {"span": f"{low:.3g} … {high:.3g}", "motions": str(len(self.K)), **limits, "state": self.state}

    @property
    def fluid(self) -> float:
        """Viscosity of the fluid on the strain rate: it adds iωηF to G*, separately from K and B."""
        return self.damping.fluid * strain_mode(self.strain).shears_fluid

    @property
    def inertia(self) -> str:
        """The masses as text; empty without inertia."""
        return said(self.mass)

    @property
    def factorisations(self) -> int:
        """Number of factorisations of K + iωB."""
        return len(self.nodes)

    def error(self, omegas: ArrayLike) -> Array:
        """Return a bound on |ΔG*|/|G*| at ``omegas``: truncation of the model, and an estimate of rounding.

        It is valid at any frequency and grows outside ``span``; it is infinite there if the residual in the span
        is a rounding error, and for members of a family. If ``definite`` is False it is an estimate.
        """
        omega = positive(omegas)
        w = omega.ravel()
        storage, loss = self._rounding(w)
        absolute = self._truncation(w) + np.hypot(storage, loss)
        return (self.estimate + _relative(absolute, np.abs(self._modulus(w)))).reshape(omega.shape)

    def truncation(self, omegas: ArrayLike) -> Array:
        """Return the part of :meth:`error` from the truncation to a few motions, at ``omegas``."""
        omega = positive(omegas)
        w = omega.ravel()
        with np.errstate(divide="ignore", invalid="ignore"):  # without any resistance
            return (self._truncation(w) / abs(self._modulus(w))).reshape(omega.shape)

    def part_errors(self, omegas: ArrayLike) -> tuple[Array, Array]:
        """Return bounds on |ΔG′|/|G′| and |ΔG″|/|G″| at ``omegas``. They may be larger than the bound on |G*|.

        For members of a family ``estimate`` is used for each part as for |G*|.
        """
        omega = positive(omegas)
        w = omega.ravel()
        G = self._modulus(w)
        square = self._residual(w) ** 2
        rise, fall = self._gain_parts(w)
        whole, rounding = self._truncation(w), self._rounding(w)
        with np.errstate(divide="ignore", invalid="ignore"):
            least = np.hypot(*rounding) / abs(G)  # rounding errors change soft motions, and so both parts
        parts = []
        for part, first, second, rounded in (
            (abs(G.real), rise, fall, rounding[0]),
            (abs(G.imag), fall, rise, rounding[1]),
        ):
            apart = self._scale * (abs(square.real) * first + abs(square.imag) * second)
            known = self.gains.any() and not self.rounding_only  # the phase of ρ
            bound = np.minimum(whole, apart) if known else whole + self.estimate * part
            parts.append(_relative(bound + np.maximum(rounded, least * part), part).reshape(omega.shape))
        return parts[0], parts[1]

    def residuals(self, omegas: ArrayLike) -> Array:
        """Return ‖(K + iωB)q − f‖/‖f‖ of the model at ``omegas``. The error of G* is quadratic in it."""
        omega = positive(omegas)
        return abs(self._residual(omega.ravel())).reshape(omega.shape) / np.hypot(
            self.forcing[0], omega * self.forcing[1]
        )

    def power_balance(self, omegas: ArrayLike) -> Array:
        """Return |A_γγ + A_γu·q − Q†KQ − iωQ†BQ| / |G*V| at ``omegas``: zero except for rounding errors."""
        omega = positive(omegas)
        w = omega.ravel()
        Q = self._motion(w)
        B = np.einsum("wm,mn,wn->w", Q.conj(), self.B, Q).real
        energy = self._storage(Q, w) + 1j * w * B
        schur = self._force(Q, w)
        whole = energy + 1j * w * self.fluid / self._scale
        return (abs(schur - energy) / abs(whole)).reshape(omega.shape)

    def displacement(self, omega: float) -> Complex:
        """Return the non-affine displacements (N, 2) per unit strain at ``omega``; NaN for removed rattlers.

        Raises
        ------
        InputError
            If the model has no motions.
        """
        if self.motions is None:
            raise InputError("this model was stored without its motions; make it again with displacements=True")
        return np.tensordot(self._motion(frequencies(omega))[0], self.motions, axes=1)

    # ---- in time

    def relaxation(self) -> Relaxation:
        """Return the relaxation times and weights g_j: G* = G0 + iωη∞ + Σ_j g_j iωτ_j/(1 + iωτ_j).

        They are the exact poles of the model, with its own G0 and η∞ (:meth:`own_limits`). Negative times belong
        to growing motions of an unstable packing.
        """
        rates, weights, _ = self._maxwell
        rising = np.argsort(1 / rates)
        return Relaxation(1 / rates[rising], weights[rising])

    def G(self, t: ArrayLike) -> Array:
        """Return the stress relaxation modulus after a step of strain, at ``t`` ≥ 0 in τ1.

        G(t) = G0 + Σ_j g_j exp(−t/τ_j). The step itself adds η∞δ(t).
        """
        rates, weights, _ = self._maxwell
        return self._G0 + np.exp(-np.multiply.outer(_times(t), rates)) @ weights

    def J(self, t: ArrayLike) -> Array:
        """Return the creep compliance, strain per unit stress, at ``t`` ≥ 0 in τ1 after a step of stress."""
        t, (rates, strengths, instant) = _times(t), self._creep
        with np.errstate(divide="ignore", invalid="ignore"):
            crept = np.where(rates == 0, t[..., None], -np.expm1(-np.multiply.outer(t, rates)) / rates)
        return instant + crept @ strengths

    @property
    def G0(self) -> float:
        """Modulus at ω → 0."""
        return float(self.limits[0, 0])

    @property
    def eta0(self) -> float:
        """Viscosity at ω → 0."""
        return float(self.limits[0, 1])

    @property
    def G_inf(self) -> float:
        """Modulus at ω → ∞."""
        return float(self.limits[1, 0])

    @property
    def eta_inf(self) -> float:
        """Viscosity at ω → ∞."""
        return float(self.limits[1, 1])

    def resonances(self) -> Array:
        """Return the frequencies of the resonances in the span: none without inertia."""
        return np.empty(0)

    def own_limits(self) -> tuple[Array, Array]:
        """Return G0, η0 and G∞, η∞ of the model, (2, 2), and their relative errors, (2, 2).

        An error is the distance to G′ and G″/ω at the end of the span, and their error there: an estimate, not a
        bound, because the model may lack relaxations far slower or faster than the span.
        """
        rates, weights, eta_inf = self._maxwell
        G0, ends = self._G0, np.array(self.span)
        limits = np.array([[G0, eta_inf + (weights / rates).sum()], [G0 + weights.sum(), eta_inf]])
        there = self(ends)
        with np.errstate(divide="ignore", invalid="ignore"):
            away = abs(np.stack([there.real, there.imag / ends], axis=1) / limits - 1)
        return limits, away + np.stack(self.part_errors(ends), axis=1)

    def kramers_kronig(self, omegas: ArrayLike) -> Array:
        """Return the difference of G* at ``omegas`` from its sum over relaxations, relative to |G*|.

        G0 + iωη∞ + Σ_j g_j iωτ_j/(1 + iωτ_j) obeys the Kramers–Kronig relations exactly.
        """
        omega = positive(omegas)
        rates, weights, eta_inf = self._maxwell
        s = 1j * omega[..., None]
        return abs((self._G0 + 1j * omega * eta_inf + (weights * s / (s + rates)).sum(-1)) / self(omega) - 1)

    # ---- others from this one

    def with_fluid(self, eta_fluid: float) -> Spectrum:
        """Return the spectrum for another viscosity ηF of the fluid (Stokes drag): adds iωΔηF to G*, without a solve.

        Raises
        ------
        InputError
            If the law is another one, or the fluid does not resist this strain mode.
        """
        if not (isinstance(self.damping, StokesDrag) and strain_mode(self.strain).shears_fluid):
            raise InputError(f"the fluid has no effect with {self.damping}, {self.strain}")
        law, limits = StokesDrag(eta_fluid), self.limits.copy()
        limits[:, 1] += law.fluid - self.damping.fluid
        with np.errstate(divide="ignore", invalid="ignore"):
            limit_errors = self.limit_errors * abs(self.limits / limits)
        other = replace(self, origin=replace(self.origin, damping=law), limits=limits, limit_errors=limit_errors)
        worst = float(other.error(np.geomspace(*self.span, 201)).max())
        if worst > max(self.rtol, self.error(np.geomspace(*self.span, 201)).max()):
            other = replace(other, notes=(*self.notes, f"with ηF = {eta_fluid:g} the errors reach {worst:.1e}"))
        return other

    # ---- computations with the model

    @property
    def _G0(self) -> float:
        stiffness, _, force, _ = self._relaxing
        held = abs(stiffness) > INSTANT
        return float(self._scale * (self.K[0, 0] - (force[held] ** 2 / stiffness[held]).sum()) + self._shift)

    @property
    def _scale(self) -> float:
        return strain_mode(self.strain).scale / self.area

    @property
    def _shift(self) -> float:
        return strain_mode(self.strain).pressure_term * self.pressure

    def _motion(self, w: Array) -> Complex:
        """Return Q = (1, y), (W, M), with (K + iωB)y = −(K + iωB)Q₀ on the motions without strain."""
        return relaxed(self._pencil(w))

    def _pencil(self, w: Array) -> Complex:
        """Return K + iωB between the motions, (W, M, M)."""
        A: Complex = self.K + 1j * w[:, None, None] * self.B
        return A

    def _force(self, Q: Complex, w: Array) -> Complex:
        """Return the generalised force of ``Q`` (W, M) on Q₀, that is on the strain."""
        return Q @ self.K[:, 0] + 1j * w * (Q @ self.B[:, 0])

    def _storage(self, Q: Complex, w: Array) -> Array:
        """Return Q†KQ of each ``Q`` (W, M)."""
        energy: Array = np.einsum("wm,mn,wn->w", Q.conj(), self.K, Q).real
        return energy

    def _modulus(self, w: Array) -> Complex:
        return self._scale * self._force(self._motion(w), w) + self._shift + 1j * w * self.fluid

    def _residual(self, w: Array) -> Complex:
        """Return Rᵀr(ω): the residual has one fixed direction R."""
        Q = self._motion(w)
        return Q @ self.residual_K + 1j * w * (Q @ self.residual_B)

    def _truncation(self, w: Array) -> Array:
        """Return the bound |Rᵀr|² max(1, ω_k/ω)(Re − Im) Rᵀ(K + iω_kB)⁻¹R, the smallest over all nodes.

        In units of a modulus; the bound from both parts is used if it is smaller. Members of a family have their
        estimate instead.
        """
        bound = np.zeros(len(w))
        if self.gains.any():
            nodes, rise, fall = self._gains
            gain = (np.maximum(1, nodes / w[:, None]) * (rise + fall)).min(1, initial=np.inf)
            gain = np.minimum(gain, np.hypot(*self._gain_parts(w)))
            bound = self._scale * abs(self._residual(w)) ** 2 * gain
            if not self.rounding_only:
                return bound
        inside = (w >= self.span[0] * (1 - EDGE)) & (w <= self.span[1] * (1 + EDGE))
        return np.where(inside, bound, np.inf)

    def _gain_parts(self, w: Array) -> tuple[Array, Array]:
        """Return bounds on Re and −Im of Rᵀ(K + iωB)⁻¹R."""
        nodes, rise, fall = self._gains
        ratio = nodes / w[:, None]
        return (
            (np.maximum(1, ratio) ** 2 * rise).min(1, initial=np.inf),
            (np.maximum(ratio, 1 / ratio) * fall).min(1, initial=np.inf),
        )

    @cached_property
    def _gains(self) -> tuple[Array, Array, Array]:
        """Return the nodes of the bound, and Re and −Im of their gains, increased by the allowance for rounding."""
        known = self.gain_errors < LARGEST_GAIN_ERROR
        gains = self.gains[known]
        allowance = GAIN_ALLOWANCE * self.gain_errors[known] * abs(gains)
        return self.nodes[known], abs(gains.real) + allowance, abs(gains.imag) + allowance

    def _rounding(self, w: Array) -> tuple[Array, Array]:
        """Return the largest change of G′ and G″ by rounding errors of K and B between the motions.

        Each entry is a sum over contacts of products, whose size follows from the diagonals; Q₀ is itself the sum
        of the affine motion and its relaxation.
        """
        Q = self._motion(w)
        parts = abs(np.stack([Q.real, Q.imag], axis=1))
        sizes = (np.sqrt(abs(np.diag(form))) for form in (self.K, self.B))
        K, B = (
            parts @ np.append(size[0] + 2 * np.sqrt(abs(affine)), size[1:])
            for size, affine in zip(sizes, self.affine, strict=True)
        )
        storage = (K**2).sum(1) + w * 2 * B.prod(1)
        loss = 2 * K.prod(1) + w * (B**2).sum(1)
        return ROUNDING * self._scale * storage, ROUNDING * self._scale * loss

    @cached_property
    def _relaxing(self) -> tuple[Array, Array, Array, Array]:
        """Return stiffness, friction, and forces of Q₀ in K and B, of motions that relax independently."""
        stiffness, friction, vectors = _diagonal(self.K[1:, 1:], self.B[1:, 1:], self._middle)
        return stiffness, friction, self.K[0, 1:] @ vectors, self.B[0, 1:] @ vectors

    @cached_property
    def _maxwell(self) -> tuple[Array, Array, float]:
        """Return rates and weights of the relaxations, and η∞ (docs/theory.md, In time)."""
        stiffness, friction, force, drag = self._relaxing
        flows = friction > INSTANT * friction.max(initial=0.0)
        relaxes = flows & (abs(stiffness) > INSTANT)
        c, d = stiffness[relaxes], friction[relaxes]
        rates = c / d
        weights = self._scale * (force[relaxes] - rates * drag[relaxes]) ** 2 / c
        eta_inf = self._scale * (self.B[0, 0] - (drag[flows] ** 2 / friction[flows]).sum())
        return rates, weights, eta_inf + self.fluid

    @cached_property
    def _creep(self) -> tuple[Array, Array, float]:
        """Return rates and strengths of J(s) = Σ strength/(s + rate) + instant, with the strain as a motion."""
        K, B = self.K.copy(), self.B.copy()
        K[0, 0] += self._shift / self._scale
        B[0, 0] += self.fluid / self._scale
        stiffness, friction, vectors = _diagonal(K, B, self._middle)
        flows = friction > INSTANT * friction.max(initial=0.0)
        strain = vectors[0] ** 2 / self._scale
        rates, strengths = stiffness[flows] / friction[flows], strain[flows] / friction[flows]
        return rates, strengths, float((strain[~flows] / stiffness[~flows]).sum())

    @property
    def _middle(self) -> float:
        return float(np.sqrt(self.span[0] * self.span[1]))


def relaxed(A: Complex) -> Complex:
    """Return Q = (1, y), (W, M), of each ``A`` (W, M, M): with zero force on the motions without strain.

    Raises
    ------
    SolverError
        If nothing resists a motion.
    """
    Q = np.ones(A.shape[:2], dtype=complex)
    if A.shape[1] > 1:
        size = np.sqrt(abs(np.einsum("wmm->wm", A)))[:, 1:]
        scaled = A[:, 1:, 1:] / (size[:, :, None] * size[:, None, :])
        try:
            Q[:, 1:] = -np.linalg.solve(scaled, (A[:, 1:, 0] / size)[..., None])[..., 0] / size
        except np.linalg.LinAlgError:
            raise SolverError("the reduced model is singular: there are motions that nothing resists") from None
    return Q


def _diagonal(K: Array, B: Array, omega: float) -> tuple[Array, Array, Array]:
    """Return c, d and vectors (in columns) that turn K into diag(c) and B into diag(d).

    They are normalised by K + ωB, so that |c| ≤ 1 unless K is indefinite: then ω is raised.
    """
    from scipy.linalg import LinAlgError, eigh

    for _ in range(12):
        try:
            c, vectors = eigh(K, K + omega * B)
        except LinAlgError:
            omega *= 10
            continue
        return c, (1 - c) / omega, vectors
    raise SolverError("K + ωB between the motions is not positive at any ω: the packing is unstable")


def positive(omegas: ArrayLike) -> Array:
    """Return frequencies of any shape, checked."""
    return frequencies(omegas, empty=True).reshape(np.shape(omegas))


def _relative(bound: Array, size: Array) -> Array:
    """Return a bound on |Δx|/|x| from one on |Δx| and ``size`` = |x + Δx|; infinite if it is not below ``size``."""
    with np.errstate(divide="ignore", invalid="ignore"):
        return np.where(bound < size, bound / (size - bound), np.inf)


def _times(t: ArrayLike) -> Array:
    t = numbers("t", t).reshape(np.shape(t))
    bad = ~(t >= 0)
    if bad.any():
        raise InputError(f"t: times must be ≥ 0, not {np.atleast_1d(t)[np.argmax(bad)]:g}")
    return t
