"""Newton steps with the sparse Hessian at the end of a minimisation, when contacts hardly change.

Axes: c contact, i disk (sorted as in z), x Cartesian, s strain of the cell.
"""

from __future__ import annotations

import numpy as np

from petscjam.base.errors import SolverError
from petscjam.base.types import Array
from petscjam.geometry.network import ContactNetwork, backbone
from petscjam.parallel.matrix import symmetric_matrix
from petscjam.parallel.petsc import destroying
from petscjam.parallel.solver import direct_solver
from petscjam.preparation.minimise import METHODS, Enthalpy
from petscjam.preparation.records import Goal
from petscjam.rows.kinematics import StrainMode, displacements, elastic_form

SHIFT = 1e-10  # in units of the largest stiffness
PATIENCE = 3


def descend(h: Enthalpy, z: Array, goal: Goal, closeness: float, method: str) -> Array:
    """Alternate ``method`` and Newton's method until ``goal``; return z.

    Parameters
    ----------
    h, z, goal
        As for :func:`petscjam.preparation.minimise.fire`.
    closeness : float
        Largest force, in p·d, from which Newton's method is tried; if it fails, again at a hundredth of it.
    method : str
        A name from ``METHODS``.

    Returns
    -------
    (2N + S,)
    """
    while True:
        nearer = near(h, closeness)
        z = METHODS[method](h, z, Goal(*map(max, goal, nearer)))
        if h.reached(goal):
            return z
        z = newton(h, z, goal)
        if h.reached(goal):
            return z
        closeness = closeness / 100 if closeness > 1e-12 else 0.0


def near(h: Enthalpy, closeness: float) -> Goal:
    """Return the goal: no force above ``closeness``·p·d, and an error of the stress below ten times as much.

    Parameters
    ----------
    h : Enthalpy
    closeness : float
        In units of p·d; at constant volume p is the pressure at z.

    Returns
    -------
    Goal
    """
    pressure = h.target or 0.0  # at constant volume: in units of the current pressure
    return Goal(closeness * pressure * h.diameter, closeness * h.diameter, 10 * closeness * pressure)


def first_closeness(n: int) -> float:
    """Return the largest force, in p·d, from which Newton's method can converge for ``n`` disks.

    The more disks, the more contacts are about to open or close. Measured.
    """
    return 1e-4 * min(1.0, 1000 / n)


def newton(h: Enthalpy, z: Array, goal: Goal) -> Array:
    """Take Newton steps until ``goal``, or until PATIENCE of them have not halved the distance; return z.

    A step may open or close a few contacts and increase the forces at first; the Hessian of the new contacts
    then decreases them. Steps that do not decrease them in the end, or are not small compared with the overlaps,
    are undone, and FIRE or conjugate gradients continue.

    Parameters
    ----------
    h, z, goal
        As for :func:`petscjam.preparation.minimise.fire`.

    Returns
    -------
    (2N + S,)
    """
    g = h.gradient(z)
    best, at_best, nearest = z, h.now, h.distance(goal)
    vain = 0
    while not h.reached(goal) and vain < PATIENCE:
        try:
            d, overlap = _direction(h, z, g)
        except (SolverError, np.linalg.LinAlgError):  # singular
            break
        if not np.abs(d).max() < 0.1 * overlap:
            break
        z = z + d
        g = h.gradient(z)
        vain = 0 if h.distance(goal) < 0.5 * nearest else vain + 1
        if vain == 0:
            best, at_best, nearest = z, h.now, h.distance(goal)
    h.now = at_best
    return best


def _direction(h: Enthalpy, z: Array, g: Array) -> tuple[Array, float]:
    """Solve Hessian·d = −g; return d and the mean overlap of contacts.

    The strains are eliminated by their Schur complement.

    The Hessian is that of the current contacts with pre-stress (BT eq. 4), plus SHIFT on the disks, which limits
    motions without resistance: translations and rattlers.
    """
    from mpi4py import MPI

    x, F = h.unpack(z)
    network, area = _contacts(h, x, F)
    n = len(x)
    modes = [StrainMode("", E) for E in h.strains]
    K = elastic_form(network, np.ones(n, dtype=bool), modes, prestress=True)
    H, across = K.matrices(np.flatnonzero(displacements(K.my_disks)))
    H.setdiag(H.diagonal() + SHIFT * network.stiffness.max())
    H.sort_indices()
    rhs = np.column_stack([-_pulled(g[: 2 * n], F), -across])
    matrix = symmetric_matrix(H.indptr, H.indices, H.data, 2 * n, MPI.COMM_SELF)
    with destroying(matrix), direct_solver(MPI.COMM_SELF, "petscjam_newton_", definite=False) as solver:
        solver.factor(matrix)
        u = np.stack([solver.solve(column, largest=np.inf)[0].real for column in rhs.T], axis=1)
    d = u[:, 0]
    change = np.zeros((2, 2))
    if modes and h.target is not None:
        residual = np.tensordot(h.strains, h.target * np.eye(2) - _tensor(h.now.stress)) * area
        own = K.strain_rows.T @ (K.weights[:, None] * K.strain_rows) + h.target * area * _volume(h.strains)
        strain = np.linalg.solve(own + across.T @ u[:, 1:], -residual - across.T @ d)
        d = d + u[:, 1:] @ strain
        change = sum(e * E for e, E in zip(strain, h.strains, strict=True)) @ F
    on_disks = d.reshape(n, 2) @ np.linalg.inv(F).T
    on_cell = [h.weight * np.sum(change * E) / np.sum(E * E) for E in h.strains]
    overlap = h.radii[network.i] + h.radii[network.j] - network.distance
    return np.append(on_disks, on_cell), float(overlap.mean())


def _pulled(g: Array, F: Array) -> Array:
    """Transform a gradient from the reference cell to true coordinates."""
    return (g.reshape(-1, 2) @ np.linalg.inv(F)).ravel()


def _tensor(stress: Array) -> Array:
    return stress[[[0, 1], [1, 2]]]


def _volume(strains: Array) -> Array:
    """Second derivatives of det(1 + Σ e E) at e = 0."""
    return np.array([[np.trace(A) * np.trace(B) - np.trace(A @ B) for B in strains] for A in strains])


def _contacts(h: Enthalpy, x: Array, F: Array) -> tuple[ContactNetwork, float]:
    """Return the contacts on the neighbour list of ``h``, the disks sorted as in z; and the area.

    Rattlers have no pre-stress, because with it they have negative modes.
    """
    i, j, sigma = h.pairs.i.astype(int), h.pairs.j.astype(int), h.pairs.sigma
    r = x[j] - x[i]
    r[h.pairs.chunks[-1] :] += h.pairs.image.view(float).reshape(-1, 2)
    r = r @ F.T
    touching = np.hypot(r[:, 0], r[:, 1]) <= sigma
    i, j, r, sigma = i[touching], j[touching], r[touching], sigma[touching]
    distance, law = np.hypot(r[:, 0], r[:, 1]), h.packing.potential
    area = h.cell.area * float(np.linalg.det(F))
    stays = backbone(i, j, len(x))
    force = law.force(distance, sigma) * (stays[i] & stays[j])
    return ContactNetwork(i, j, r, force, law.stiffness(distance, sigma), h.radii, area, stays), area
