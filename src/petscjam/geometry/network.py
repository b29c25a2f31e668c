"""The contact network of a packing: contacts, forces, and disks without load.

Axes: c contact, i disk, x Cartesian.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from functools import cached_property
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from petscjam.base.errors import InputError, shown
from petscjam.base.tables import Table, Tabular
from petscjam.base.types import Array, Integers
from petscjam.geometry.packing import Packing

NO_MODULUS = 1e-12  # of the affine modulus: smaller moduli are zero (rounding errors are 1e-31 to 1e-16)


@dataclass(frozen=True, eq=False)
class ContactNetwork(Tabular):
    """Contacts c = (i, j), each with the vector r from i to (an image of) j.

    Attributes
    ----------
    i, j : (C,) integers
    r : (C, 2)
    force : (C,)
        Repulsive contact force f.
    stiffness : (C,)
        d²U/dr² of the contact.
    radii : (N,)
    area : float
        Area V of the cell.
    backbone : (N,) bool
        Disks that remain when those with fewer than three contacts are removed repeatedly.
    """

    i: Integers
    j: Integers
    r: Array
    force: Array
    stiffness: Array
    radii: Array
    area: float
    backbone: NDArray[np.bool_]

    def facts(self) -> dict[str, Any]:
        """Return the numbers of disks, contacts and rattlers, Z and the pressure, by name."""
        sizes = {"disks": len(self.radii), "contacts": len(self), "rattlers": self.rattlers}
        return {**sizes, "Z": self.Z, "pressure": self.pressure}

    def flat(self) -> Table:
        """Return a line for each contact: its disks, vector, force and stiffness."""
        x, y = self.r.T
        columns = {"i": self.i, "j": self.j, "rx": x, "ry": y, "force": self.force, "stiffness": self.stiffness}
        return Table(columns, {"rx": "length", "ry": "length"})

    @classmethod
    def of(cls, packing: Packing) -> ContactNetwork:
        """Find the contacts of ``packing``.

        Those of rattlers are included, unless their force is too small to count in the balance of forces,
        max(1e-10·p·d, 4·ε·k·L): the overlap of a rattler that only rests on another disk is a rounding error.

        Raises
        ------
        InputError
            If two disks have the same position, or ``packing`` is none.
        """
        from petscjam.geometry.neighbours import pairs

        if not isinstance(packing, Packing):
            raise InputError(f"a Packing is needed, as Packing.read(file) returns it, not {shown(packing)}")
        radii = packing.radii
        i, j, r = pairs(packing.box, packing.positions, radii)
        sigma, distance = radii[i] + radii[j], np.hypot(r[:, 0], r[:, 1])
        if (distance < 1e-12 * sigma).any():  # images of the same point differ by rounding
            c = int(np.argmin(distance / sigma))
            raise InputError(f"packing: disks {i[c]} and {j[c]} lie on the same point")
        law = packing.potential
        network = cls(
            i,
            j,
            r,
            law.force(distance, sigma),
            law.stiffness(distance, sigma),
            radii,
            packing.box.area,
            backbone(i, j, len(radii)),
        )
        rounding = 4 * np.finfo(float).eps * network.stiffness * np.sqrt(network.area)
        counts = network.force > np.maximum(1e-10 * network.pressure * packing.mean_diameter, rounding)
        return network.only(counts | (network.backbone[i] & network.backbone[j]))

    def __len__(self) -> int:
        return len(self.i)

    @property
    def distance(self) -> Array:
        """Centre-to-centre distance of each contact, (C,)."""
        return np.hypot(self.r[:, 0], self.r[:, 1])

    @property
    def normal(self) -> Array:
        """Unit vector n from i to j, (C, 2)."""
        return self.r / self.distance[:, None]

    @property
    def mean_diameter(self) -> float:
        """Mean diameter d of all disks."""
        return float(2 * self.radii.mean())

    @property
    def rattlers(self) -> int:
        """Number of disks that are not in the backbone."""
        return int((~self.backbone).sum())

    @property
    def Z(self) -> float:
        """Mean number of contacts of a backbone disk, contacts inside the backbone counted."""
        inside = self.backbone[self.i] & self.backbone[self.j]
        return float(2 * inside.sum() / max(int(self.backbone.sum()), 1))

    @property
    def stress(self) -> Array:
        """Pressure tensor Σ f r⊗n / V, (2, 2), positive in compression."""
        return np.einsum("c,cx,cy->xy", self.force / self.distance, self.r, self.r) / self.area

    @property
    def pressure(self) -> float:
        """Half the trace of the pressure tensor."""
        return float(np.trace(self.stress) / 2)

    @property
    def residual_force(self) -> Array:
        """Net elastic force on each disk, (N, 2)."""
        pull = self.force[:, None] * self.normal
        net = np.zeros((len(self.radii), 2))
        np.add.at(net, self.j, pull)
        np.add.at(net, self.i, -pull)
        return net

    @cached_property
    def net_force(self) -> float:
        """Largest net force on a disk, relative to p·d."""
        largest = float(np.linalg.norm(self.residual_force, axis=1).max())
        return largest / (self.pressure * self.mean_diameter) if largest else 0.0

    @property
    def rounding_force(self) -> float:
        """Force on a disk by rounding of positions in double precision, 4·ε·k·L."""
        return float(4 * np.finfo(float).eps * self.stiffness.max(initial=0.0) * self.area**0.5)

    @property
    def balanced(self) -> bool:
        """Whether no net force exceeds max(1e-10·p·d, 4·ε·k·L)."""
        unit = self.pressure * self.mean_diameter
        return self.net_force * unit <= max(1e-10 * unit, self.rounding_force)

    @property
    def affine_modulus(self) -> float:
        """Shear modulus of affine motion, without pre-stress, mean over all directions."""
        return float(self.stiffness @ (self.r**2).sum(1)) / (8 * self.area)

    @property
    def rounding_modulus(self) -> float:
        """Largest modulus that counts as zero: 1e-12 of the affine modulus."""
        return NO_MODULUS * self.affine_modulus

    def only(self, which: NDArray[np.bool_]) -> ContactNetwork:
        """Keep the contacts ``which`` (C,); the disks and the backbone do not change."""
        part = {name: getattr(self, name)[which] for name in ("i", "j", "r", "force", "stiffness")}
        return replace(self, **part)

    def without_rattlers(self) -> ContactNetwork:
        """Keep only the contacts inside the backbone.

        Raises
        ------
        InputError
            If no contact is left, or the backbone is not connected.
        """
        kept = self.only(self.backbone[self.i] & self.backbone[self.j])
        if len(kept) == 0:
            raise InputError(
                f"network: no contacts are left once rattlers are removed (the packing has {len(self)}); "
                "it is not jammed; import --relax --pressure P brings it to a pressure"
            )
        pieces = kept._pieces()
        if pieces > 1:
            raise InputError(f"network: the backbone falls apart into {pieces} pieces; it is not jammed")
        return kept

    def _pieces(self) -> int:
        from scipy.sparse import coo_matrix
        from scipy.sparse.csgraph import connected_components

        n = len(self.radii)
        graph = coo_matrix((np.ones(len(self)), (self.i, self.j)), shape=(n, n))
        return int(connected_components(graph, directed=False)[0] - self.rattlers)


def rounded(values: ArrayLike, rounding: float | Array) -> Array:
    """Return ``values``, set to 0 if they do not exceed ``rounding``.

    Parameters
    ----------
    values : array_like
    rounding : float or array
        Size up to which a value is zero.
    """
    known = np.asarray(values, dtype=float)
    return np.where(abs(known) <= rounding, 0.0, known)


def backbone(i: Integers, j: Integers, n: int) -> NDArray[np.bool_]:
    """Mark, of ``n`` disks, those that remain when all with fewer than three contacts are removed repeatedly.

    Parameters
    ----------
    i, j : (C,)
        Disks of each contact.
    n : int
        Number of disks.

    Returns
    -------
    (n,) bool
    """
    alive = np.ones(n, dtype=bool)
    while True:
        inside = alive[i] & alive[j]
        contacts = np.bincount(i[inside], minlength=n) + np.bincount(j[inside], minlength=n)
        if (contacts[alive] >= 3).all():
            return alive
        alive &= contacts >= 3
