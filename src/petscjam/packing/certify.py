"""Judge a packing: residual forces, pressure, and the number of unstable modes.

Axes: c contact, i disk of the backbone, x Cartesian.
"""

from __future__ import annotations

from dataclasses import replace
from typing import TYPE_CHECKING

import numpy as np

from petscjam.errors import SolverError
from petscjam.network import ContactNetwork
from petscjam.packing.packing import Certificate, Packing

if TYPE_CHECKING:
    from scipy.sparse import csc_matrix


def hessian(network: ContactNetwork, prestress: bool = True) -> csc_matrix:
    """Return K_uu of the backbone, sparse and real, (2n, 2n); row 2i + x belongs to its i-th disk.

    K = Σ k n⊗n − (f/r) t⊗t on relative displacements (BT eq. 4), the second term if ``prestress``.

    Raises
    ------
    InputError
        If there is no backbone, or it falls apart into pieces.
    """
    from scipy.sparse import coo_matrix

    network = network.without_rattlers()
    place = np.cumsum(network.backbone) - 1
    i, j = place[network.i], place[network.j]
    nn = np.einsum("cx,cy->cxy", network.normal, network.normal)
    block = network.stiffness[:, None, None] * nn
    if prestress:
        block -= (network.force / network.distance)[:, None, None] * (np.eye(2) - nn)
    a, b = np.concatenate([[i, i], [j, j], [i, j], [j, i]], axis=1)
    blocks = np.concatenate([block, block, -block, -block])
    rows = np.broadcast_to((2 * a)[:, None, None] + [[0], [1]], blocks.shape)
    columns = np.broadcast_to((2 * b)[:, None, None] + [0, 1], blocks.shape)
    size = 2 * int(network.backbone.sum())
    return coo_matrix((blocks.ravel(), (rows.ravel(), columns.ravel())), shape=(size, size)).tocsc()


def negative_modes(packing: Packing | ContactNetwork, prestress: bool = True) -> int:
    """Count the negative eigenvalues of K_uu on the backbone, one disk pinned.

    The pivots of LDLᵀ have the signs of the eigenvalues (Sylvester). K is shifted up by a little more
    than the factorisation can round, so that zero modes do not count.

    Raises
    ------
    SolverError
        If the factorisation exchanged rows, or rounded more than the shift.
    """
    from scipy.sparse import identity
    from scipy.sparse.linalg import splu

    network = packing if isinstance(packing, ContactNetwork) else ContactNetwork.of(packing)
    K = hessian(network, prestress)[2:, 2:]
    eps = float(np.finfo(float).eps)
    shift = 1e4 * eps * abs(K.diagonal()).max()
    lu = splu(
        (K + shift * identity(K.shape[0])).tocsc(),
        permc_spec="MMD_AT_PLUS_A",
        diag_pivot_thresh=0.0,
        options={"SymmetricMode": True},
    )
    if (lu.perm_r != lu.perm_c).any():
        raise SolverError("certify: the factorisation of K exchanged rows; its pivots do not count modes")
    rounding = eps * (abs(lu.L) @ (abs(lu.U) @ np.ones(K.shape[0]))).max()
    if rounding > shift:
        raise SolverError(
            f"certify: the factorisation of K rounds by up to {rounding:.1e}, its shift is only {shift:.1e}"
        )
    return int((lu.U.diagonal() < 0).sum())


def certify(packing: Packing, target_pressure: float | None = None) -> Packing:
    """Return ``packing`` with a certificate of what is measured on it.

    Raises
    ------
    InputError
        If the packing is not jammed.
    SolverError
        If its negative modes cannot be counted.
    """
    network = ContactNetwork.of(packing)
    pressure = network.pressure
    modes = negative_modes(network)
    certificate = Certificate(
        max_force=float(np.linalg.norm(network.residual_force, axis=1).max())
        / (pressure * packing.mean_diameter),
        rattlers=network.rattlers,
        Z=network.Z,
        pressure=pressure,
        pressure_error=None if target_pressure is None else abs(pressure / target_pressure - 1),
        negative_modes=modes,
    )
    return replace(packing, certificate=certificate)
