"""The degrees of freedom that are unknowns, their owners, and those that are fixed.

Axes: i disk, d degree of freedom of a disk (ux, uy, θ).
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from petscjam.base.types import Array, Integers
from petscjam.geometry.network import ContactNetwork
from petscjam.geometry.packing import Packing
from petscjam.parallel.comm import Comm, total
from petscjam.rows.kinematics import Field, Form, Mask, translations


@dataclass(frozen=True, eq=False)
class Ownership:
    """Strips of the cell assigned to ranks, in order; every rank knows the whole assignment.

    Attributes
    ----------
    order : (N,)
        Disks, by strip.
    owner : (N,)
        The rank of each disk.
    """

    order: Integers
    owner: Integers

    @classmethod
    def of(cls, packing: Packing, ranks: int) -> Ownership:
        """Assign the disks of ``packing`` to ``ranks`` in equal strips along a short lattice vector.

        Parameters
        ----------
        packing : Packing
        ranks : int
        """
        s = packing.positions @ np.linalg.inv(packing.box.reduced)
        order = np.argsort(s[:, 1] % 1.0, kind="stable")
        owner = np.empty(len(packing), dtype=np.int64)
        for rank, disks in enumerate(np.array_split(order, ranks)):
            owner[disks] = rank
        return cls(order, owner)


@dataclass(frozen=True, eq=False)
class Dofs:
    """A numbering of unknowns: those of a disk together, those of a rank together.

    Attributes
    ----------
    index : (N, 3)
        Number of each degree of freedom; −1 if it is not an unknown.
    counts : (ranks,)
        Unknowns of each rank.
    """

    index: Integers
    counts: Integers

    @classmethod
    def number(cls, active: Mask, ownership: Ownership, ranks: int) -> Dofs:
        """Number the ``active`` (N, 3) degrees of freedom.

        Parameters
        ----------
        active : (N, 3) bool
        ownership : Ownership
        ranks : int
        """
        index = np.full(active.shape, -1, dtype=np.int64)
        ordered = active[ownership.order]
        numbers = np.full(active.shape, -1, dtype=np.int64)
        numbers[ordered] = np.arange(ordered.sum())
        index[ownership.order] = numbers
        counts = np.bincount(ownership.owner, weights=active.sum(1), minlength=ranks)
        return cls(index, counts.astype(np.int64))

    @property
    def flat(self) -> Integers:
        """Index of each unknown among all degrees of freedom, (unknowns,)."""
        places = np.empty(self.size, dtype=np.int64)
        used = self.index >= 0
        places[self.index[used]] = np.flatnonzero(used)
        return places

    @property
    def size(self) -> int:
        """Number of unknowns."""
        return int(self.counts.sum())

    def rows_of(self, rank: int) -> tuple[int, int]:
        """First and one past the last row of ``rank``."""
        ends = np.cumsum(self.counts)
        return int(ends[rank] - self.counts[rank]), int(ends[rank])

    def scatter(self, field: NDArray[Any], rank: int) -> NDArray[Any]:
        """Return this rank's unknowns out of ``field`` (N, 3).

        Parameters
        ----------
        field : (N, 3)
        rank : int

        Returns
        -------
        (n,)
        """
        start, stop = self.rows_of(rank)
        mine = (self.index >= start) & (self.index < stop)
        values = np.empty(stop - start, dtype=field.dtype)
        values[self.index[mine] - start] = field[mine]
        return values

    def gather(self, local: NDArray[Any], comm: Comm) -> Field:
        """Return the field (N, 3), on every rank, from each rank's unknowns; zero elsewhere.

        Parameters
        ----------
        local : (n,)
            This rank's unknowns.
        comm : MPI communicator

        Returns
        -------
        (N, 3) complex
        """
        values = np.empty(self.size, dtype=complex)
        comm.Allgatherv(np.ascontiguousarray(local, dtype=complex), [values, self.counts])
        field = np.zeros(self.index.shape, dtype=complex)
        field[self.index >= 0] = values[self.index[self.index >= 0]]
        return field


def unknowns(K: Form, B: Form, network: ContactNetwork, comm: Comm) -> tuple[Mask, Mask]:
    """Return the (N, 3) degrees of freedom that K or B resists, and those of them that are not fixed.

    B is positive semi-definite, so a zero on its diagonal is a zero row (θ without rotations or at β = 0,
    rattlers without contacts). A collective motion that neither K nor B resists makes K + iωB singular, and one
    degree of freedom of it is fixed.

    Parameters
    ----------
    K, B : Form
    network : ContactNetwork
    comm : MPI communicator
    """
    stiffness, friction = total(comm, K.diagonal()), total(comm, B.diagonal())
    resisted = (stiffness > 0) | (friction > 0)
    active, anchor = resisted.copy(), int(np.argmax(network.backbone))
    for motion in free_motions(network):
        if not resists(B, motion * active, comm):
            active[anchor, np.argmax(np.abs(motion[anchor]))] = False
    return resisted, active


def free_motions(network: ContactNetwork) -> list[Array]:
    """Return the collective motions (N, 3) that K does not resist: two translations, and the rotation of gears.

    Disks that rotate in alternating sense, θd = ±d/ρ, roll on each other without sliding if no cycle of contacts
    is odd; in an odd cycle they slide, and B resists this.
    """
    n = len(network.radii)
    gears = np.zeros((n, 3))
    gears[:, 2] = _alternating(network) * network.mean_diameter / network.radii
    return [*translations(n), gears]


def resists(B: Form, motion: NDArray[Any], comm: Comm) -> bool:
    """Return whether B resists ``motion`` (N, 3), beyond rounding errors.

    Parameters
    ----------
    B : Form
    motion : (N, 3)
    comm : MPI communicator
    """
    still = np.zeros(len(B.extra))
    dissipated = total(comm, B.product((motion, still), (motion, still))).real
    separately = np.sum(total(comm, B.diagonal()) * np.abs(motion) ** 2)
    return bool(dissipated > 1e-20 * separately)


def connected(network: ContactNetwork) -> list[Mask]:
    """Return the disks (N,) of each connected piece of the network, without single disks."""
    from scipy.sparse import coo_array
    from scipy.sparse.csgraph import connected_components

    n = len(network.radii)
    graph = coo_array((np.ones(len(network)), (network.i, network.j)), shape=(n, n))
    piece = connected_components(graph, directed=False)[1]
    return [piece == label for label in np.flatnonzero(np.bincount(piece) > 1)]


def _alternating(network: ContactNetwork) -> NDArray[np.float64]:
    """Return ±1 by the parity of the distance to the first backbone disk, 0 where not connected."""
    from scipy.sparse import coo_array
    from scipy.sparse.csgraph import dijkstra

    n = len(network.radii)
    graph = coo_array((np.ones(len(network)), (network.i, network.j)), shape=(n, n)).tocsr()
    start = int(np.argmax(network.backbone))
    steps = dijkstra(graph, directed=False, indices=start, unweighted=True)
    reached = np.isfinite(steps)
    return np.where(reached, 1.0 - 2.0 * (np.where(reached, steps, 0.0) % 2), 0.0)
