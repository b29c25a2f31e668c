"""Judge a packing: residual forces, pressure, and the number of unstable modes.

Axes: i disk of the backbone, x Cartesian.
"""

from __future__ import annotations

from dataclasses import replace
from typing import TYPE_CHECKING

import numpy as np

from petscjam.errors import SolverError
from petscjam.kinematics import SIMPLE_SHEAR, elastic_form
from petscjam.network import ContactNetwork
from petscjam.packing.packing import Certificate, Packing

EPS = float(np.finfo(float).eps)

if TYPE_CHECKING:
    from scipy.sparse import csc_array


def hessian(network: ContactNetwork, prestress: bool = True) -> csc_array:
    """Return K_uu of the backbone, sparse and real, (2n, 2n); row 2i + x belongs to its i-th disk.

    Raises
    ------
    InputError
        If there is no backbone, or it falls apart into pieces.
    """
    network = network.without_rattlers()
    everybody = np.ones(len(network.radii), dtype=bool)
    K = elastic_form(network, everybody, [SIMPLE_SHEAR], prestress=prestress)  # the mode plays no part
    displacements = np.flatnonzero(np.outer(network.backbone, [True, True, False]))
    A = K.rows[:, displacements]
    return (A.T @ A.multiply(K.weights[:, None])).tocsc()


def negative_modes(packing: Packing | ContactNetwork, prestress: bool = True) -> int:
    """Count the negative eigenvalues of K_uu on the backbone, one disk pinned.

    Raises
    ------
    SolverError
        If they cannot be counted.
    """
    K, shift = _pinned(packing, prestress)
    return _count_below(K, -shift)


def modes(packing: Packing | ContactNetwork, prestress: bool = True) -> tuple[int, int]:
    """Count the negative and the zero eigenvalues of K_uu on the backbone, one disk pinned.

    Zero is what lies within a shift that is a little more than the factorisation can round. Without
    pre-stress K is a sum of squares, and none is negative.

    Raises
    ------
    SolverError
        If they cannot be counted.
    """
    K, shift = _pinned(packing, prestress)
    negative = _count_below(K, -shift) if prestress else 0
    return negative, _count_below(K, shift) - negative


def _pinned(packing: Packing | ContactNetwork, prestress: bool) -> tuple[csc_array, float]:
    """Return K_uu of the backbone without its first disk, and what counts as zero in it."""
    network = packing if isinstance(packing, ContactNetwork) else ContactNetwork.of(packing)
    K = hessian(network, prestress)[2:, 2:]
    return K, 1e4 * EPS * float(abs(K.diagonal()).max(initial=0.0))


def _count_below(K: csc_array, sigma: float) -> int:
    """Count the eigenvalues below ``sigma``: the pivots of LDLᵀ of K − σ have their signs (Sylvester)."""
    from scipy.sparse import eye_array
    from scipy.sparse.linalg import splu

    if K.shape[0] == 0:  # one disk, and its images
        return 0
    try:
        lu = splu(
            (K - sigma * eye_array(K.shape[0])).tocsc(),
            permc_spec="MMD_AT_PLUS_A",
            diag_pivot_thresh=0.0,
            options={"SymmetricMode": True},
        )
    except (RuntimeError, MemoryError) as error:
        raise SolverError(f"the factorisation of K failed: {error}") from error
    if (lu.perm_r != lu.perm_c).any():
        raise SolverError("the factorisation of K exchanged rows; its pivots do not count modes")
    L, U = lu.L, lu.U
    below = int((U.diagonal() < 0).sum())
    for factor in (L, U):
        np.abs(factor.data, out=factor.data)
    rounding = EPS * (L @ (U @ np.ones(K.shape[0]))).max()
    if rounding > abs(sigma):
        raise SolverError(
            f"the factorisation of K rounds by up to {rounding:.1e}, its shift is only {abs(sigma):.1e}"
        )
    return below


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
    certificate = Certificate(
        max_force=float(np.linalg.norm(network.residual_force, axis=1).max())
        / (pressure * packing.mean_diameter),
        rattlers=network.rattlers,
        Z=network.Z,
        pressure=pressure,
        pressure_error=None if target_pressure is None else abs(pressure / target_pressure - 1),
        negative_modes=negative_modes(network),
    )
    return replace(packing, certificate=certificate)
