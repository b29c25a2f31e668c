"""The slow twin: contacts, K, B and G* with plain loops and dense algebra.

Written independently of the fast code, for tests and to be read together with the paper. The solver does not use
it. Degrees of freedom: u of every disk (2N), θ of every disk (N), the strain γ last.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np


class Contact(NamedTuple):
    """Disks i and j, and the vector (rx, ry) from i to the image of j in contact with it."""

    i: int
    j: int
    rx: float
    ry: float
    force: float
    stiffness: float


def contacts(positions, radii, cell, potential, images=3):
    """Return every contact, from all pairs and all images.

    Parameters
    ----------
    positions : (N, 2)
    radii : (N,)
    cell : (2, 2)
        Rows are lattice vectors.
    potential : Potential
        U′ and U″ of the overlap: σ − r, or 1 − r/σ if it is relative.
    images : int
        As many to each side.
    """
    found = []
    for i in range(len(radii)):
        for j in range(i, len(radii)):
            for a in range(-images, images + 1):
                for b in range(-images, images + 1):
                    if i == j and (a, b) <= (0, 0):
                        continue  # a contact with its own image counts once
                    rx = positions[j][0] - positions[i][0] + a * cell[0][0] + b * cell[1][0]
                    ry = positions[j][1] - positions[i][1] + a * cell[0][1] + b * cell[1][1]
                    sigma = radii[i] + radii[j]
                    r = (rx * rx + ry * ry) ** 0.5
                    if r <= sigma:
                        x, unit = (1 - r / sigma, sigma) if potential.relative else (sigma - r, 1.0)
                        force, stiffness = potential.dU(x) / unit, potential.d2U(x) / unit**2
                        found.append(Contact(i, j, rx, ry, force, stiffness))
    return found


def without_rattlers(found, n):
    """Remove, repeatedly, the contacts of disks with fewer than three.

    Parameters
    ----------
    found : list of contacts
    n : int
        Disks.
    """
    while True:
        count = [0] * n
        for c in found:
            count[c.i] += 1
            count[c.j] += 1
        kept = [c for c in found if count[c.i] >= 3 and count[c.j] >= 3]
        if len(kept) == len(found):
            return kept
        found = kept


def affine(strain, rx, ry):
    """Return F′r.

    Parameters
    ----------
    strain : str
        Name of the strain mode.
    rx, ry : float
    """
    return {"simple-shear": (ry, 0.0), "pure-shear": (rx / 2, -ry / 2), "compression": (rx, ry)}[strain]


def rows(c, radii, strain, arms):
    """Return the rows of Δu∥ and Δu⊥, (3N + 1,) each.

    Parameters
    ----------
    c : contact
    radii : (N,)
    strain : str
    arms : float
        Lever arms in radii; 0: at the centres.
    """
    n = len(radii)
    r = (c.rx**2 + c.ry**2) ** 0.5
    nx, ny = c.rx / r, c.ry / r
    ax, ay = affine(strain, c.rx, c.ry)
    parallel, transverse = np.zeros(3 * n + 1), np.zeros(3 * n + 1)
    for sign, disk in ((-1, c.i), (1, c.j)):
        parallel[2 * disk] += sign * nx
        parallel[2 * disk + 1] += sign * ny
        transverse[2 * disk] += sign * -ny
        transverse[2 * disk + 1] += sign * nx
        transverse[2 * n + disk] -= arms * radii[disk]
    parallel[-1] = nx * ax + ny * ay
    transverse[-1] = -ny * ax + nx * ay
    return parallel, transverse


def hessian(found, radii, strain="simple-shear", prestress=True):
    """Return K, (3N + 1, 3N + 1): BT eqs. 4 and 11, with the curvature of F if F is not linear.

    Parameters
    ----------
    found : list of contacts
    radii : (N,)
    strain : str
    prestress : bool
        Keep the second term of BT eq. 4.
    """
    K = np.zeros((3 * len(radii) + 1,) * 2)
    for c in found:
        parallel, transverse = rows(c, radii, strain, arms=0)
        K += c.stiffness * np.outer(parallel, parallel)
        if prestress:
            r = (c.rx**2 + c.ry**2) ** 0.5
            K -= c.force / r * np.outer(transverse, transverse)
            if strain == "pure-shear":
                K[-1, -1] -= c.force * r / 4
    return K


def contact_damping(found, radii, beta, rotations=True, strain="simple-shear", midway=False):
    """Return B of BT eq. 6, (3N + 1, 3N + 1).

    Parameters
    ----------
    found : list of contacts
    radii : (N,)
    beta : float
    rotations : bool
    strain : str
    midway : bool
        Whether the lever arms are ρ r/(ρi + ρj), as in the disk engine (VOT eq. 6), instead of ρ.
    """
    B = np.zeros((3 * len(radii) + 1,) * 2)
    for c in found:
        arm = (c.rx**2 + c.ry**2) ** 0.5 / (radii[c.i] + radii[c.j]) if midway else 1.0
        parallel, transverse = rows(c, radii, strain, arms=rotations * arm)
        B += np.outer(parallel, parallel) + beta * np.outer(transverse, transverse)
    return B


def stokes_drag(n, area, eta_fluid, strain="simple-shear"):
    """Return B of BT eq. 8 in terms of the non-affine displacement, (3N + 1, 3N + 1).

    Parameters
    ----------
    n : int
        Disks.
    area, eta_fluid : float
    strain : str
    """
    B = np.diag([1.0] * 2 * n + [0.0] * n + [0.0])
    if strain != "compression":
        B[-1, -1] = eta_fluid * area
    return B


def inertia(masses, radii):
    """Return M, (3N + 1, 3N + 1): the mass of each disk, and its moment of inertia as a homogeneous disk.

    The motion is that relative to the affine one, so the strain has no inertia.

    Parameters
    ----------
    masses, radii : (N,)
    """
    moments = [m * radius**2 / 2 for m, radius in zip(masses, radii, strict=True)]
    return np.diag([*np.repeat(masses, 2), *moments, 0.0])


def modulus(K, B, omega, area, M=0.0):
    """Return G*(ω): solve (K + iωB − ω²M) Q = e_γ (BT eq. 12) in the least-squares sense, G*V = 1/Q_γ.

    Free motions (translations, rotations without resistance) do not enter the least-squares solution.

    Parameters
    ----------
    K, B : (3N + 1, 3N + 1)
    omega, area : float
    M : (3N + 1, 3N + 1)
        Default: no inertia.
    """
    A = K + 1j * omega * B - omega**2 * M
    scale = 1 / np.sqrt(np.abs(np.diag(A)) + (np.diag(A) == 0))
    forcing = np.zeros(len(A))
    forcing[-1] = scale[-1]
    Q = scale * np.linalg.lstsq(scale[:, None] * A * scale, forcing, rcond=1e-13)[0]
    return 1 / (Q[-1] * area)


def stokes_modal_sum(K, omega, area, eta_fluid, mass=0.0):
    """Return G*(ω) under Stokes drag from the modes of K_uu.

    G* = G_affine − Σ_k (v_k·K_uγ)² / (V (λ_k + iω − ω²m)) + iω ηF.

    Parameters
    ----------
    K : (3N + 1, 3N + 1)
    omega, area, eta_fluid : float
    mass : float
        Of every disk.
    """
    n2 = 2 * (len(K) - 1) // 3
    values, vectors = np.linalg.eigh(K[:n2, :n2])
    overlap = vectors.T @ K[:n2, -1]
    return (K[-1, -1] - np.sum(overlap**2 / (values + 1j * omega - omega**2 * mass))) / area + 1j * omega * eta_fluid
