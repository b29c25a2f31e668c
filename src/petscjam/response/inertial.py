"""The reduced model with inertia: G* at every frequency, with an error bound from the friction.

docs/theory.md, Inertia, has the proof.

Axes: w frequency, m motion (0 is Q₀), r direction of the residual.
"""

from __future__ import annotations

from dataclasses import dataclass, field

import numpy as np
from numpy.typing import ArrayLike

from petscjam.base.errors import InputError
from petscjam.base.types import Array
from petscjam.response.origin import stored
from petscjam.response.spectrum import ROUNDING, Complex, Spectrum, positive


@dataclass(frozen=True, eq=False)
class InertialSpectrum(Spectrum):
    """G*(ω) of (K, B, M). Its error is bounded also if K has negative modes. It has no relaxation times.

    Attributes
    ----------
    residual_K, residual_B : (M, R)
        Forms times the motions, along orthonormal directions that span the residual; residual_M the same of M.
    M : (M, M)
        The mass matrix between the motions.
    friction : (R, R)
        B⁻¹ between these directions.
    """

    residual_K: Array = field(metadata=stored(axes="M R", finite=True))
    residual_B: Array = field(metadata=stored(axes="M R", finite=True))
    M: Array = field(kw_only=True, metadata=stored(axes="M M", finite=True))
    residual_M: Array = field(kw_only=True, metadata=stored(axes="M R", finite=True))
    friction: Array = field(kw_only=True, metadata=stored(axes="R R", finite=True))

    def part_errors(self, omegas: ArrayLike) -> tuple[Array, Array]:
        """Return bounds on |ΔG′|/|G′| and |ΔG″|/|G″| at ``omegas``, from the bound on |ΔG*|."""
        absolute = self.error(omegas) * abs(self(omegas))
        return absolute / abs(self(omegas).real), absolute / abs(self(omegas).imag)

    def residuals(self, omegas: ArrayLike) -> Array:
        """Return ‖(K + iωB − ω²M)q − f‖/‖f‖ of the model at ``omegas``. The error of G* is quadratic in it."""
        omega = positive(omegas)
        left = np.linalg.norm(self._residual(omega.ravel()), axis=1).reshape(omega.shape)
        return left / np.hypot(self.forcing[0], omega * self.forcing[1])

    def resonances(self) -> Array:
        """Return the frequencies of the resonances in the span: Im s of the poles s with |Re s| < |Im s|."""
        from scipy.linalg import eigvals

        K, B, M = (form[1:, 1:] for form in (self.K, self.B, self.M))
        none, one = np.zeros_like(K), np.eye(len(K))
        s = eigvals(np.block([[none, one], [-K, -B]]), np.block([[one, none], [none, M]]))
        peaks = s.imag[abs(s.real) < s.imag]
        return np.sort(peaks[(peaks > self.span[0]) & (peaks < self.span[1])])

    def own_limits(self) -> tuple[Array, Array]:
        """Return NaN: the limits are solved for."""
        return np.full((2, 2), np.nan), np.full((2, 2), np.nan)

    def _pencil(self, w: Array) -> Complex:
        return super()._pencil(w) - w[:, None, None] ** 2 * self.M

    def _force(self, Q: Complex, w: Array) -> Complex:
        return super()._force(Q, w) - w**2 * (Q @ self.M[:, 0])

    def _storage(self, Q: Complex, w: Array) -> Array:
        kinetic: Array = np.einsum("wm,mn,wn->w", Q.conj(), self.M, Q).real
        return super()._storage(Q, w) - w**2 * kinetic

    def _residual(self, w: Array) -> Complex:
        """Return the components of the residual, (W, R)."""
        Q, w = self._motion(w), w[:, None]
        return Q @ self.residual_K + 1j * w * (Q @ self.residual_B) - w**2 * (Q @ self.residual_M)

    def _truncation(self, w: Array) -> Array:
        """Return the bound r†B⁻¹r/ω, in units of a modulus."""
        r = self._residual(w)
        return self._scale * np.einsum("wr,rs,ws->w", r.conj(), self.friction, r).real / w

    def _rounding(self, w: Array) -> tuple[Array, Array]:
        storage, loss = super()._rounding(w)
        Q = self._motion(w)
        parts = abs(np.stack([Q.real, Q.imag], axis=1)) @ np.sqrt(abs(np.diag(self.M)))
        kinetic = ROUNDING * self._scale * w**2
        return storage + kinetic * (parts**2).sum(1), loss + 2 * kinetic * parts.prod(1)

    @property
    def _maxwell(self) -> tuple[Array, Array, float]:
        raise InputError(
            "with inertia the response is no sum of relaxations: there is no relaxation spectrum, G(t), J(t)"
        )

    @property
    def _creep(self) -> tuple[Array, Array, float]:
        return self._maxwell
