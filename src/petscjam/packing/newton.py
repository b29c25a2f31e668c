"""Newton steps on the sparse Hessian, to finish a minimisation once the contacts have settled.

Axes: c contact, i disk (sorted as in z), x Cartesian, s strain of the cell.
"""

from __future__ import annotations

import numpy as np

from petscjam.box import Array
from petscjam.errors import SolverError
from petscjam.kinematics import StrainMode, elastic_form
from petscjam.network import ContactNetwork, backbone
from petscjam.packing.minimise import Enthalpy, Goal
from petscjam.parallel.matrix import symmetric_matrix
from petscjam.parallel.petsc import destroying
from petscjam.parallel.solver import direct_solver

SHIFT = 1e-10  # in units of the largest stiffness


def newton(h: Enthalpy, z: Array, goal: Goal) -> Array:
    """Take Newton steps until ``goal``, or as long as each brings it at least twice as near; return z.

    A step that does not is taken back: contacts opened or closed, or the Hessian is not positive definite,
    and it is for the other methods to go on.
    """
    g = h.gradient(z)
    while not h.reached(goal):
        before, state = h.distance(goal), (h.force, h.energy, h.stress)
        try:
            d = _direction(h, z, g)
        except SolverError:  # singular
            break
        if not np.abs(d).max() < 0.1 * h.diameter:
            break
        g = h.gradient(z + d)
        if not h.distance(goal) < 0.5 * before:
            h.force, h.energy, h.stress = state
            break
        z = z + d
    return z


def _direction(h: Enthalpy, z: Array, g: Array) -> Array:
    """Solve Hessian·d = −g; the strains are eliminated by their Schur complement.

    The Hessian is that of the contacts at hand, with their pre-stress (BT eq. 4), and SHIFT on the disks,
    which keeps finite what nothing resists: translations and rattlers.
    """
    from mpi4py import MPI

    x, F = h.unpack(z)
    network, area = _contacts(h, x, F)
    n = len(x)
    modes = [StrainMode("", E) for E in h.strains]
    K = elastic_form(network, np.ones(n, dtype=bool), modes, prestress=True)
    A = K.rows[:, np.arange(3 * n) % 3 < 2]
    weighted = A.multiply(K.weights[:, None]).tocsr()
    H = (A.T @ weighted).tocsr()
    H.setdiag(H.diagonal() + SHIFT * network.stiffness.max())
    H.sort_indices()
    across = weighted.T @ K.strain_rows
    rhs = np.column_stack([-_pulled(g[: 2 * n], F), -across])
    matrix = symmetric_matrix(H.indptr, H.indices, H.data, 2 * n, MPI.COMM_SELF)
    with destroying(matrix), direct_solver(MPI.COMM_SELF, "newton_", definite=False) as solver:
        solver.factor(matrix)
        u = np.stack([solver.solve(column)[0].real for column in rhs.T], axis=1)
    d = u[:, 0]
    change = np.zeros((2, 2))
    if modes and h.target is not None:
        residual = np.tensordot(h.strains, h.target * np.eye(2) - _tensor(h.stress)) * area
        own = K.strain_rows.T @ (K.weights[:, None] * K.strain_rows) + h.target * area * _volume(h.strains)
        strain = np.linalg.solve(own + across.T @ u[:, 1:], -residual - across.T @ d)
        d = d + u[:, 1:] @ strain
        change = sum(e * E for e, E in zip(strain, h.strains, strict=True)) @ F
    on_disks = d.reshape(n, 2) @ np.linalg.inv(F).T
    return np.append(on_disks, [h.weight * np.sum(change * E) / np.sum(E * E) for E in h.strains])


def _pulled(g: Array, F: Array) -> Array:
    """Turn a gradient in the reference cell into one in true coordinates."""
    return (g.reshape(-1, 2) @ np.linalg.inv(F)).ravel()


def _tensor(stress: Array) -> Array:
    return stress[[[0, 1], [1, 2]]]


def _volume(strains: Array) -> Array:
    """Second derivatives of det(1 + Σ e E) at e = 0."""
    return np.array([[np.trace(A) * np.trace(B) - np.trace(A @ B) for B in strains] for A in strains])


def _contacts(h: Enthalpy, x: Array, F: Array) -> tuple[ContactNetwork, float]:
    """Return the contacts on the neighbour list of ``h``, the disks sorted as in z; and the area.

    Rattlers get no pre-stress: it would turn them over for lack of a hold.
    """
    unsigned_i, unsigned_j, sigma, _, runs, images = h.pairs
    i, j = unsigned_i.astype(int), unsigned_j.astype(int)
    r = x[j] - x[i]
    r[runs[-1] :] += images
    r = r @ F.T
    touching = np.hypot(r[:, 0], r[:, 1]) < sigma
    i, j, r, sigma = i[touching], j[touching], r[touching], sigma[touching]
    distance, law = np.hypot(r[:, 0], r[:, 1]), h.packing.potential
    area = h.cell[3] * float(np.linalg.det(F))
    stays = backbone(i, j, len(x))
    force = law.force(distance, sigma) * (stays[i] & stays[j])
    return ContactNetwork(i, j, r, force, law.stiffness(distance, sigma), h.radii, area, stays), area
