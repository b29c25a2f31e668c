"""The rows of the contacts: the only place with signs.

A contact c = (i, j) maps the motion of its two disks and the strain s of the cell to a normal and a tangential
relative displacement (BT eqs. 4–6 with the signs of docs/theory.md)

    Δu∥ = n·(u_j − u_i + s F′r),      Δu⊥ = t·(u_j − u_i + s F′r) − ρi θi − ρj θj,      t = ẑ × n.

Every linear quantity is a weighted sum of squares of these: see :class:`Form`.

Axes: c contact, k normal/tangential, a row (c and k), s strain mode, i disk,
d degree of freedom of a disk (ux, uy, θd), x Cartesian. Rotations are lengths, θ times the mean diameter d:
then torques have the unit of forces, and relative norms do not depend on the unit of length.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field

import numpy as np
from numpy.typing import ArrayLike, NDArray
from scipy.sparse import csr_array

from petscjam.base.errors import InputError
from petscjam.base.types import Array, Integers
from petscjam.geometry.network import ContactNetwork

Field = NDArray[np.complex128]
Mask = NDArray[np.bool_]
Motion = tuple[Field, ArrayLike]  # (q, s): non-affine motion of every disk, and the strains


@dataclass(frozen=True, eq=False)
class StrainMode:
    """A deformation of the cell, F(s) = 1 + s F′ + ½ s² F″ to second order.

    Parameters
    ----------
    name : str
    gradient, curvature : (2, 2)
        F′ and F″ at s = 0. F″ matters at order p, with pre-stress.
    scale, pressure_term : float
        The modulus is ``scale``·A_eff/V + ``pressure_term``·p.
    shears_fluid : bool
        Whether the viscosity of the fluid resists this mode.
    """

    name: str
    gradient: Array
    curvature: Array = field(default_factory=lambda: np.zeros((2, 2)))
    scale: float = 1.0
    pressure_term: float = 0.0
    shears_fluid: bool = True


SIMPLE_SHEAR = StrainMode("simple-shear", np.array([[0.0, 1.0], [0.0, 0.0]]))
PURE_SHEAR = StrainMode("pure-shear", np.diag([0.5, -0.5]), np.diag([0.25, 0.25]))
COMPRESSION = StrainMode(
    "compression", np.eye(2), scale=0.25, pressure_term=0.5, shears_fluid=False
)  # the bulk modulus −V dp/dV, from the second derivative with respect to L → L(1 + s)
STRAINS = {mode.name: mode for mode in (SIMPLE_SHEAR, PURE_SHEAR, COMPRESSION)}

SYMMETRIC_STRAINS = (
    StrainMode("xx", np.diag([1.0, 0.0])),
    StrainMode("yy", np.diag([0.0, 1.0])),
    StrainMode("xy", np.array([[0.0, 0.5], [0.5, 0.0]])),
)  # F = 1 + ε, with ε_xy = s/2: the elastic constants of other programs


def strain_mode(name: str) -> StrainMode:
    """Return the strain mode called ``name``."""
    try:
        return STRAINS[name]
    except KeyError:
        raise InputError(f"strain: {name!r} is unknown; known are {', '.join(STRAINS)}") from None


@dataclass(frozen=True, eq=False)
class Form:
    """The quadratic form Σ_a w_a (A_a·q + a_a·s)² + body Σ_i |u_i|² + s·extra·s.

    K and B have this form. A rank has the rows of all contacts of its disks; ``mine`` and ``my_disks`` mark its
    share in sums over the whole system.

    Attributes
    ----------
    rows : sparse (A, 3N)
        Normal and tangential row of each contact, over (ux, uy, θ) of every disk.
    strain_rows : (A, S)
    weights : (A,)
    body : float
    extra : (S, S)
    mine : (A,) bool
    my_disks : (N,) bool
    """

    rows: csr_array
    strain_rows: Array
    weights: Array
    body: float
    extra: Array
    mine: Mask
    my_disks: Mask

    def relative(self, q: Field, s: ArrayLike) -> Field:
        """Return Δu∥ and Δu⊥, alternating, of each contact, (A,).

        Parameters
        ----------
        q : (N, 3) complex
            Non-affine motion; rotations are θ times the mean diameter.
        s : (S,)
            Strains.
        """
        parts = np.ascontiguousarray(q, dtype=complex).view(float).reshape(-1, 2)  # real and imaginary
        return (self.rows @ parts).view(complex)[:, 0] + self.strain_rows @ np.asarray(s)

    def product(self, left: Motion, right: Motion) -> complex:
        """Return this rank's share of ⟨left, form right⟩.

        Parameters
        ----------
        left, right : (q, s)
            As for :meth:`relative`; ``left`` is conjugated.
        """
        (ql, sl), (qr, sr) = left, right
        contacts = np.vdot(self.relative(ql, sl), self.mine * self.weights * self.relative(qr, sr))
        body = self.body * np.vdot(ql[self.my_disks, :2], qr[self.my_disks, :2])
        cell = self.my_disks[0] * (np.conj(sl) @ self.extra @ np.asarray(sr))
        return complex(contacts + body + cell)

    def apply(self, q: Field, s: ArrayLike) -> Field:
        """Return this rank's share of the generalised force on every disk, (N, 3).

        Parameters
        ----------
        q, s
            As for :meth:`relative`.
        """
        force = (self.rows.T @ (self.mine * self.weights * self.relative(q, s))).reshape(-1, 3)
        force[self.my_disks, :2] += self.body * q[self.my_disks, :2]
        return force

    def diagonal(self) -> Array:
        """Return this rank's share of Σ|w|A² + body, the diagonal without cancellations, (N, 3)."""
        total = (self.rows.power(2).T @ (self.mine * np.abs(self.weights))).reshape(-1, 3)
        total[self.my_disks, :2] += self.body
        return total

    def matrices(self, unknowns: Integers, own: slice = slice(None)) -> tuple[csr_array, Array]:
        """Assemble Σ_a w_a A_aᵀA_a + body and the coupling Σ_a w_a A_aᵀa_a to the strains.

        Parameters
        ----------
        unknowns : (n,)
            Places 3i + d among all degrees of freedom.
        own : slice
            The unknowns whose rows are assembled; all of them must be of ``my_disks``.

        Returns
        -------
        matrix : sparse (rows, n)
        coupling : (rows, S)
        """
        A = self.rows[:, unknowns]
        weighted = A.multiply(self.weights[:, None]).tocsr()
        matrix = A[:, own].T.tocsr() @ weighted
        if self.body:
            first = own.start or 0
            moves = np.flatnonzero(unknowns[own] % 3 < 2)
            drag = np.full(len(moves), self.body)
            matrix = matrix + csr_array((drag, (moves, moves + first)), shape=matrix.shape)
        return matrix, weighted[:, own].T @ self.strain_rows


def displacements(disks: Mask) -> Mask:
    """Mark ux and uy, and not θ, of the marked ``disks`` (N,): (N, 3)."""
    return np.outer(disks, [True, True, False])


def translations(n: int) -> list[Array]:
    """Return the translations of all of ``n`` disks along x and y, (N, 3) each."""
    return [np.tile(direction, (n, 1)) for direction in np.eye(3)[:2]]


def contact_rows(
    network: ContactNetwork, strains: Sequence[StrainMode], *, at_contact_point: bool
) -> tuple[csr_array, Array]:
    """Return the rows of Δu∥ and Δu⊥ (BT eqs. 4–6).

    Parameters
    ----------
    network : ContactNetwork
    strains : sequence of StrainMode
    at_contact_point : bool
        Whether Δu⊥ is taken at the contact point, with rotations.

    Returns
    -------
    rows : sparse (2C, 3N)
        Of Δu∥ and Δu⊥, alternating, of each contact.
    strain_rows : (2C, S)
    """
    n = network.normal
    t = np.stack([-n[:, 1], n[:, 0]], axis=1)
    arms = at_contact_point * network.radii / network.mean_diameter
    values = np.zeros((len(network), 2, 6))
    for k, direction in enumerate((n, t)):
        values[:, k, 0:2] = -direction
        values[:, k, 3:5] = direction
    values[:, 1, 2] = -arms[network.i]
    values[:, 1, 5] = -arms[network.j]
    local = np.arange(3)
    columns = np.concatenate([3 * network.i[:, None] + local, 3 * network.j[:, None] + local], axis=1)
    rows = csr_array(
        (values.ravel(), np.repeat(columns, 2, axis=0).ravel(), np.arange(0, values.size + 1, 6)),
        shape=(2 * len(network), 3 * len(network.radii)),
    )
    rows.sum_duplicates()  # a disk that touches its own image
    affine = np.zeros((len(network), 2, len(strains)))
    for s, mode in enumerate(strains):
        affine[..., s] = network.r @ mode.gradient.T
    return rows, np.einsum("kcx,cxs->cks", np.stack([n, t]), affine).reshape(rows.shape[0], len(strains))


def form(
    network: ContactNetwork,
    my_disks: Mask,
    strains: Sequence[StrainMode],
    weights: Array,
    *,
    at_contact_point: bool = False,
    body: float = 0.0,
    extra: Array,
) -> Form:
    """Return the rows of a form with at least one of ``my_disks``.

    Parameters
    ----------
    network : ContactNetwork
    my_disks : (N,) bool
        Disks of this rank.
    strains : sequence of StrainMode
    weights : (C, 2)
        Of (Δu∥)² and (Δu⊥)².
    at_contact_point : bool
        As in :func:`contact_rows`.
    body : float
        Weight of |u_i|².
    extra : (S, S)
        Form of the strains alone.
    """
    touching = my_disks[network.i] | my_disks[network.j]
    part = network.only(touching)
    rows, strain_rows = contact_rows(part, strains, at_contact_point=at_contact_point)
    mine = np.repeat(my_disks[part.i], 2)
    return Form(rows, strain_rows, weights[touching].ravel(), body, extra, mine, my_disks)


def elastic_form(network: ContactNetwork, my_disks: Mask, strains: Sequence[StrainMode], *, prestress: bool) -> Form:
    """Return K: stiffness k on Δu∥ and, with pre-stress, −f/r on Δu⊥ (BT eq. 4).

    Parameters
    ----------
    network, my_disks, strains
        As for :func:`form`.
    prestress : bool
        Whether K has the second term.
    """
    transverse = -network.force / network.distance * prestress
    weights = np.stack([network.stiffness, transverse], axis=1)
    # a nonlinear F(s) adds the first derivative of the energy, −Σ f n·F″r
    virial = -network.area * network.stress * prestress
    second = np.diag([float(np.sum(virial * mode.curvature)) for mode in strains])
    return form(network, my_disks, strains, weights, extra=second)
