"""The per-contact rows: the only place that knows signs.

A contact c = (i, j) turns the motion of its two disks and the strain s of the cell into a normal and
a tangential relative displacement (PHYSICS of BT eqs. 4–6, signs of docs/theory.md)

    Δu∥ = n·(u_j − u_i + s F′r),      Δu⊥ = t·(u_j − u_i + s F′r) − ρi θi − ρj θj,      t = ẑ × n.

Everything linear is a weighted sum of squares of these: see :class:`Form`.

Axes: c contact, k normal/tangential, m local degree of freedom (ux, uy, θ of i, then of j),
s strain mode, i disk, d degree of freedom of a disk (ux, uy, θ), x Cartesian.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray

from petscjam.box import Array, Integers
from petscjam.errors import InputError
from petscjam.network import ContactNetwork

Field = NDArray[np.complex128]


@dataclass(frozen=True, eq=False)
class StrainMode:
    """How the cell deforms: F(s) = 1 + s F′ + ½ s² F″ + …

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
    """The quadratic form Σ_c Σ_k w_ck (A_ck·q + a_ck·s)² + body Σ_i |u_i|² + s·extra·s.

    K and B are both of this kind. A rank holds its :meth:`share`: the contacts that touch its disks;
    ``mine`` and ``my_disks`` mark what it counts in sums over the whole system.

    Attributes
    ----------
    i, j : (C,)
    rows : (C, 2, 6)
    strain_rows : (C, 2, S)
    weights : (C, 2)
    body : float
    extra : (S, S)
    mine : (C,) bool
    my_disks : (N,) bool
    """

    i: Integers
    j: Integers
    rows: Array
    strain_rows: Array
    weights: Array
    body: float
    extra: Array
    mine: NDArray[np.bool_]
    my_disks: NDArray[np.bool_]

    def share(self, my_disks: NDArray[np.bool_]) -> Form:
        """Return the part of a whole form that the owner of ``my_disks`` (N,) needs."""
        touching = my_disks[self.i] | my_disks[self.j]
        i, j, rows, strain_rows, weights = (
            a[touching] for a in (self.i, self.j, self.rows, self.strain_rows, self.weights)
        )
        return Form(i, j, rows, strain_rows, weights, self.body, self.extra, my_disks[i], my_disks)

    def relative(self, q: Field, s: Sequence[complex]) -> Field:
        """Return Δu∥ and Δu⊥ of each contact, (C, 2), for the motion ``q`` (N, 3) at strains ``s``."""
        local = np.concatenate([q[self.i], q[self.j]], axis=1)
        return np.einsum("ckm,cm->ck", self.rows, local) + self.strain_rows @ np.asarray(s)

    def product(self, left: tuple[Field, Sequence], right: tuple[Field, Sequence]) -> complex:
        """Return this rank's share of ⟨left, form right⟩; each side is (q, s), the left conjugated."""
        (ql, sl), (qr, sr) = left, right
        contacts = np.sum(
            (self.weights * self.relative(ql, sl).conj() * self.relative(qr, sr))[self.mine]
        )
        body = self.body * np.vdot(ql[self.my_disks, :2], qr[self.my_disks, :2])
        cell = self.my_disks[0] * (np.conj(sl) @ self.extra @ np.asarray(sr))
        return complex(contacts + body + cell)

    def apply(self, q: Field, s: Sequence[complex]) -> Field:
        """Return this rank's share of the generalised force on every disk, (N, 3)."""
        pull = np.einsum("ckm,ck->cm", self.rows, self.weights * self.relative(q, s))[self.mine]
        force = np.zeros((len(q), 3), dtype=complex)
        np.add.at(force, self.i[self.mine], pull[:, :3])
        np.add.at(force, self.j[self.mine], pull[:, 3:])
        force[self.my_disks, :2] += self.body * q[self.my_disks, :2]
        return force

    def diagonal(self) -> Array:
        """Return this rank's share of the diagonal, (N, 3)."""
        squares = np.einsum("ckm,ck->cm", self.rows**2, np.abs(self.weights))[self.mine]
        total = np.zeros((len(self.my_disks), 3))
        np.add.at(total, self.i[self.mine], squares[:, :3])
        np.add.at(total, self.j[self.mine], squares[:, 3:])
        total[self.my_disks, :2] += self.body
        return total

    def blocks(self) -> Array:
        """Return the 6×6 matrix of each contact, (C, 6, 6)."""
        return np.einsum("ckm,ck,ckn->cmn", self.rows, self.weights, self.rows)

    def forcing(self) -> Array:
        """Return the column of each strain mode by contact, (C, 6, S)."""
        return np.einsum("ckm,ck,cks->cms", self.rows, self.weights, self.strain_rows)


def contact_rows(
    network: ContactNetwork, strains: Sequence[StrainMode], *, at_contact_point: bool
) -> tuple[Array, Array]:
    """Return the rows (C, 2, 6) and their strain columns (C, 2, S)."""
    n = network.normal
    t = np.stack([-n[:, 1], n[:, 0]], axis=1)
    arms = at_contact_point * network.radii
    rows = np.zeros((len(network), 2, 6))
    for k, direction in enumerate((n, t)):
        rows[:, k, 0:2] = -direction
        rows[:, k, 3:5] = direction
    rows[:, 1, 2] = -arms[network.i]
    rows[:, 1, 5] = -arms[network.j]
    affine = np.stack([network.r @ mode.gradient.T for mode in strains], axis=-1)
    return rows, np.einsum("kcx,cxs->cks", np.stack([n, t]), affine)


def whole_form(
    network: ContactNetwork, rows: tuple[Array, Array], weights: Array, body: float, extra: Array
) -> Form:
    """Return the form of the whole system, before it is shared among ranks."""
    contacts, disks = np.ones(len(network), dtype=bool), np.ones(len(network.radii), dtype=bool)
    return Form(network.i, network.j, *rows, weights, body, extra, contacts, disks)


def elastic_form(network: ContactNetwork, strains: Sequence[StrainMode], *, prestress: bool) -> Form:
    """Return K: stiffness k on Δu∥ and, with pre-stress, −f/r on Δu⊥ (BT eq. 4)."""
    rows = contact_rows(network, strains, at_contact_point=False)
    transverse = -network.force / network.distance * prestress
    weights = np.stack([network.stiffness, transverse], axis=1)
    # a nonlinear F(s) adds the first derivative of the energy, −Σ f n·F″r
    second = [-network.area * np.sum(network.stress * mode.curvature) for mode in strains]
    return whole_form(network, rows, weights, 0.0, prestress * np.diag(second))
