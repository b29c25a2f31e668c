"""The certificate of a packing: residual forces, stress, and whether it is a minimum of the energy.

Force balance is one part of the proof. The other part is a count of the modes of K with pre-stress: SLEPc gives
the lowest eigenvalues, and the pivots of one LDLᵀ of K − σ, σ above these, show that none was missed.

Axes: i disk of the backbone, x Cartesian, s strain.
"""

from __future__ import annotations

from contextlib import suppress
from dataclasses import dataclass, replace
from functools import partial
from typing import TYPE_CHECKING

import numpy as np

from petscjam.base.errors import InputError, SolverError
from petscjam.base.types import Array, Integers
from petscjam.geometry.network import ContactNetwork, rounded
from petscjam.geometry.packing import Certificate, Packing
from petscjam.rows.kinematics import SIMPLE_SHEAR, StrainMode, displacements, elastic_form

EPS = float(np.finfo(float).eps)
EIGENVALUES = 4
GRADIENTS = [StrainMode("", np.outer(a, b)) for a in np.eye(2) for b in np.eye(2)]  # F = 1 + s e_a e_bᵀ

if TYPE_CHECKING:
    from scipy.sparse import csc_array, dia_array


def hessian(network: ContactNetwork, prestress: bool = True) -> csc_array:
    """Return K_uu of the backbone, sparse and real, (2n, 2n); row 2i + x belongs to its i-th disk.

    Parameters
    ----------
    network : ContactNetwork
    prestress : bool
        Keep the second term of BT eq. 4.

    Raises
    ------
    InputError
        If there is no backbone, or it is not connected.
    """
    return _elasticity(network, prestress, [SIMPLE_SHEAR])[0]


def _elasticity(network: ContactNetwork, prestress: bool, strains: list[StrainMode]) -> tuple[csc_array, Array, Array]:
    """Return K_uu of the backbone, K_us (2n, S) and K_ss (S, S)."""
    network = network.without_rattlers()
    everybody = np.ones(len(network.radii), dtype=bool)
    K = elastic_form(network, everybody, strains, prestress=prestress)
    matrix, coupling = K.matrices(np.flatnonzero(displacements(network.backbone)))
    a = K.strain_rows
    return matrix.tocsc(), coupling, a.T @ (K.weights[:, None] * a) + K.extra


def negative_modes(packing: Packing | ContactNetwork, prestress: bool = True) -> int:
    """Count the negative eigenvalues of K_uu on the backbone, one disk pinned.

    Parameters
    ----------
    packing : Packing or ContactNetwork
    prestress : bool
        Keep the second term of BT eq. 4.

    Raises
    ------
    SolverError
        If they cannot be counted.
    """
    K, shift = _pinned(packing, prestress)
    return _count_below(K, -shift)


def count_modes(packing: Packing | ContactNetwork, prestress: bool = True) -> tuple[int, int]:
    """Count the negative and the zero eigenvalues of K_uu on the backbone, one disk pinned.

    Eigenvalues within a shift slightly larger than the rounding error of the factorisation count as zero. Without
    pre-stress K is a sum of squares, and none is negative.

    Parameters
    ----------
    packing, prestress
        As for :func:`negative_modes`.

    Returns
    -------
    negative, zero : int

    Raises
    ------
    SolverError
        If they cannot be counted.
    """
    K, shift = _pinned(packing, prestress)
    negative = _count_below(K, -shift) if prestress else 0
    return negative, _count_below(K, shift) - negative


def _pinned(packing: Packing | ContactNetwork, prestress: bool) -> tuple[csc_array, float]:
    """Return K_uu of the backbone without its first disk, and the largest eigenvalue that counts as zero."""
    network = packing if isinstance(packing, ContactNetwork) else ContactNetwork.of(packing)
    K = hessian(network, prestress)[2:, 2:]
    return K, _zero(K)


def _zero(K: csc_array) -> float:
    return 1e4 * EPS * float(abs(K.diagonal()).max(initial=0.0))


def _count_below(K: csc_array, sigma: float) -> int:
    """Count the eigenvalues below ``sigma``, or within a fifth of it if the factorisation at ``sigma`` fails."""
    for factor in (1.0, 0.9, 1.1, 0.8):
        with suppress(SolverError):
            return pivots_below(K, factor * sigma, abs(sigma))
    return pivots_below(K, 1.2 * sigma, abs(sigma))


def dependent_rows(K: csc_array) -> Integers:
    """Return rows whose removal makes the matrix regular: one for each zero mode of a semi-definite ``K``.

    LDLᵀ has a zero pivot if a row depends on those before it.

    Raises
    ------
    SolverError
        If the zero modes cannot be counted.
    """
    size = _diagonal(K.diagonal() ** -0.5)
    scaled = (size @ K @ size).tocsc()
    zero = _zero(scaled)
    count = _count_below(scaled, zero)
    return np.argsort(pivots(scaled + _diagonal(np.full(K.shape[0], zero)))[0])[:count]


def below_all(K: csc_array) -> float:
    """Return a number below all eigenvalues of ``K``, by counts, or by Gershgorin's circles if those fail."""
    shift, lowest = -_zero(K), -1.1 * float(abs(K).sum(0).max())
    while shift > lowest:
        with suppress(SolverError):
            if _count_below(K, shift) == 0:
                return 1.2 * shift  # the count may be smaller by one
        shift *= 4
    return lowest


def pivots_below(K: csc_array, sigma: float, room: float) -> int:
    """Count the eigenvalues below ``sigma``: the pivots of LDLᵀ of K − σ have their signs (Sylvester).

    Those within the rounding error of ``sigma`` may be counted or not.

    Parameters
    ----------
    K : sparse (n, n)
    sigma : float
    room : float
        Largest allowed error of the eigenvalues by the factorisation.

    Raises
    ------
    SolverError
        If the factorisation fails, or its rounding error exceeds ``room``.
    """
    below, rounding = negative_pivots(K - _diagonal(np.full(K.shape[0], sigma)))
    if rounding > room:
        raise SolverError(
            f"the factorisation of K − {sigma:.1e} has rounding errors up to {rounding:.1e}, more than {room:.1e}"
        )
    return below


def _diagonal(values: Array) -> dia_array:
    from scipy.sparse import dia_array

    return dia_array((values[None], [0]), shape=(len(values), len(values)))


def negative_pivots(A: csc_array) -> tuple[int, float]:
    """Return the number of negative pivots of LDLᵀ of ``A``, and a bound on the norm of its rounding error.

    Raises
    ------
    SolverError
        If the factorisation fails.
    """
    found, rounding = pivots(A)
    return int((found < 0).sum()), rounding


def pivots(A: csc_array) -> tuple[Array, float]:
    """Return the pivot D of each row in LDLᵀ of ``A``, and a bound on the norm of its rounding error.

    Raises
    ------
    SolverError
        If the factorisation fails.
    """
    from scipy.sparse.linalg import splu

    if A.shape[0] == 0:  # one disk, and its images
        return np.empty(0), 0.0
    try:
        lu = splu(A.tocsc(), permc_spec="MMD_AT_PLUS_A", diag_pivot_thresh=0.0, options={"SymmetricMode": True})
    except (RuntimeError, MemoryError) as error:
        raise SolverError(f"the factorisation of K failed: {error}") from None
    if (lu.perm_r != lu.perm_c).any():
        raise SolverError("the factorisation of K exchanged rows; its pivots do not count modes")
    L, U = lu.L, lu.U
    found: Array = U.diagonal()[lu.perm_c]
    for factor in (L, U):
        np.abs(factor.data, out=factor.data)
    return found, EPS * float((L @ (U @ np.ones(A.shape[0]))).max())


@dataclass(frozen=True, eq=False)
class Instability:
    """A motion along which the energy (or, with strain, the enthalpy) decreases.

    Attributes
    ----------
    displacement : (N, 2)
        Non-affine displacement of every disk.
    strain : (2, 2)
        F − 1.
    """

    displacement: Array
    strain: Array


def lowest_eigenpairs(
    K: csc_array, count: int = EIGENVALUES, *, shift: float | None = None
) -> tuple[Array, Array, Array, bool | None]:
    """Return the lowest eigenpairs of K without translations, and a proof that none is missing.

    If one is missing, the search is repeated from below all eigenvalues.

    Parameters
    ----------
    K : sparse (2n, 2n)
    count : int
    shift : float
        The search is for the eigenvalues nearest to it; default: slightly below zero.

    Returns
    -------
    values : (m,)
        Ascending; m = min(count, 2n − 2).
    vectors : (m, 2n)
        Real, normalised.
    residuals : (m,)
        ‖Kv − λv‖. K has an eigenvalue within this distance of λ.
    complete : bool or None
        True: it is proved that these are the lowest. None: the eigenvalues could not be counted.

    Raises
    ------
    SolverError
        If the eigensolver does not converge.
    """
    from mpi4py import MPI

    from petscjam.parallel.eigen import Pairs, lowest_pairs, search_all
    from petscjam.parallel.matrix import symmetric_matrix
    from petscjam.parallel.petsc import destroying

    size = K.shape[0]
    count = min(count, size - 2)
    if count < 1:
        return np.empty(0), np.empty((0, size)), np.empty(0), True
    rows = K.tocsr()
    rows.sort_indices()
    start = -1e-6 * float(np.median(rows.diagonal())) if shift is None else shift
    translations = np.tile(np.eye(2), size // 2) * (size / 2) ** -0.5
    matrix = symmetric_matrix(rows.indptr, rows.indices, rows.data, size, MPI.COMM_SELF)

    def search(wanted: int, known: Array | None) -> Pairs:
        below = start if known is None else min(start, below_all(K))
        return lowest_pairs(matrix, wanted, below, leave_out=translations, known=known)

    with destroying(matrix):
        found = search_all(
            search,
            partial(pivots_below, K),
            count,
            size - 2,
            MPI.COMM_SELF,
            least=lambda _: _zero(K),
            left_out=(0.0, 0.0),
        )
    values, vectors, residuals = found.pairs
    return values[:count], vectors[:, :count].T, residuals[:count], found.complete


def elastic_tensor(network: ContactNetwork) -> tuple[Array, Array]:
    """Second derivative of the energy of relaxed disks with respect to F, and the relaxation of the disks.

    Returns
    -------
    C : (4, 4)
        Per area, in the order xx, xy, yx, yy of F.
    u : (n, 2, 4)
        Non-affine motion of the backbone per unit of each entry of F, its first disk at rest.
    """
    from mpi4py import MPI

    from petscjam.parallel.matrix import symmetric_matrix
    from petscjam.parallel.petsc import destroying
    from petscjam.parallel.solver import direct_solver

    K, across, own = _elasticity(network, True, GRADIENTS)
    u = np.zeros_like(across)
    pinned = K[2:, 2:].tocsr()
    pinned.sort_indices()
    size = pinned.shape[0]
    matrix = symmetric_matrix(pinned.indptr, pinned.indices, pinned.data, size, MPI.COMM_SELF)
    with destroying(matrix), direct_solver(MPI.COMM_SELF, "petscjam_certify_", definite=False) as solver:
        solver.factor(matrix)
        for s in range(len(GRADIENTS)):
            u[2:, s] = -solver.solve(across[2:, s], soft=True)[0].real
    return (own + across.T @ u) / network.area, u.reshape(-1, 2, len(GRADIENTS))


def softest_shear(C: Array) -> float:
    """Lowest modulus of simple shear F = 1 + γ m⊗n, m ⟂ n, over all directions, of C (4, 4).

    As in Dagois-Bohy et al., Phys. Rev. Lett. 109, 095703: a packing is stable against shear if it is stable in
    every direction. The modulus is a trigonometric polynomial of degree 4 in the angle, so 720 angles give its
    minimum to 1e-4 of its variation.
    """
    angle = np.linspace(0, np.pi, 720, endpoint=False)
    m, n = np.array([np.cos(angle), np.sin(angle)]), np.array([-np.sin(angle), np.cos(angle)])
    gradient = np.einsum("aw,bw->wab", m, n).reshape(-1, 4)
    return float(np.einsum("wa,ab,wb->w", gradient, C, gradient).min())


def certify(packing: Packing, target_pressure: float | None = None) -> Packing:
    """Return ``packing`` with its certificate.

    It is a proved minimum if the forces balance to max(1e-10·p·d, 4·ε·k·L), the pressure is within
    max(1e-9·p, 4·ε·k·L/d) of the target, K with pre-stress on the backbone has no negative mode and no zero mode
    except the translations, and its lowest eigenvalue exceeds ten times its residual. A packing that was
    stabilised against shear must also have an isotropic pressure tensor, to the same tolerance, and a positive
    shear modulus in every direction. If the modes cannot be computed, their number is None, and the packing is
    not proved.

    Parameters
    ----------
    packing : Packing
    target_pressure : float
        Default: no target.

    Raises
    ------
    InputError
        If the packing is not jammed.
    """
    return judge(packing, target_pressure)[0]


def judge(packing: Packing, target_pressure: float | None = None) -> tuple[Packing, Instability | None]:
    """Do what :func:`certify` does, and return a motion that decreases the energy if there is one.

    Parameters
    ----------
    packing, target_pressure
        As there.

    Raises
    ------
    InputError, SolverError
        As there.
    """
    network = ContactNetwork.of(packing)
    K = hessian(network)
    pressure, diameter = network.pressure, packing.mean_diameter
    if not pressure > 0:
        raise InputError("packing: no contact has a force; it is not jammed")
    floor = network.rounding_force
    anisotropy = float(abs(network.stress - pressure * np.eye(2)).max())
    miss = 0.0 if target_pressure is None else abs(pressure - target_pressure)
    found = _modes(network, K)
    stabilised = packing.provenance.get("shear_stabilised") is True
    sound = found.negative == found.zero == 0
    shear, way_down = None, None
    if found.negative:
        way_down = Instability(_on_all(found.vectors[0].reshape(-1, 2), network), np.zeros((2, 2)))
    elif sound:
        C, u = elastic_tensor(network)
        shear = float(rounded(softest_shear(C), network.rounding_modulus))
        if stabilised:
            lowest, strain = _softest_cell(C, pressure)
            curvature = float(rounded(lowest, network.rounding_modulus))
            sound = curvature > 0 and shear > 0 and anisotropy <= max(1e-9 * pressure, floor / diameter)
            if curvature <= 0:
                way_down = Instability(_on_all(u @ strain, network), strain.reshape(2, 2))
    certificate = Certificate(
        max_force=network.net_force,
        rattlers=network.rattlers,
        contacts=len(network.without_rattlers()),
        Z=network.Z,
        pressure=pressure,
        pressure_error=None if target_pressure is None else miss / target_pressure,
        stress_error=anisotropy / pressure,
        negative_modes=found.negative,
        zero_modes=found.zero,
        eigenvalues=tuple(found.values.tolist()),
        eigenvalue_error=float(found.residuals.max(initial=0.0)),
        shear_modulus=shear,
        proved=bool(
            sound
            and network.balanced
            and miss <= max(1e-9 * pressure, floor / diameter)
            and (found.values > 10 * found.residuals).all()
        ),
        checksum=packing.checksum,
    )
    return replace(packing, certificate=certificate), way_down


@dataclass(frozen=True, eq=False)
class _Modes:
    """The lowest modes of K, and the numbers of negative and zero ones, without translations; None: unknown."""

    values: Array
    vectors: Array
    residuals: Array
    negative: int | None
    zero: int | None


def _modes(network: ContactNetwork, K: csc_array) -> _Modes:
    """Find the lowest modes and count; no further count is needed if the lowest is well above zero."""
    try:
        values, vectors, residuals, complete = lowest_eigenpairs(K)
        negative = zero = 0
        positive = len(values) == 0 or values[0] > max(10 * residuals[0], 2 * _zero(K))
        if not positive or (complete is None and _count_below(K, values[0] / 2) > 2):
            negative, zero = count_modes(network)
        if negative and complete is None:
            values, vectors, residuals, _ = lowest_eigenpairs(K, shift=below_all(K))
    except SolverError:
        return _Modes(np.empty(0), np.empty((0, K.shape[0])), np.empty(0), None, None)
    return _Modes(values, vectors, residuals, negative, zero)


def _softest_cell(C: Array, pressure: float) -> tuple[float, Array]:
    """Return the lowest curvature of the enthalpy per area along an upper triangular strain, and that."""
    strains = [0, 1, 3]  # xx, xy, yy
    H = C[np.ix_(strains, strains)]
    H[0, 2] += pressure  # second derivative of p·det F
    H[2, 0] += pressure
    values, vectors = np.linalg.eigh(H)
    strain = np.zeros(4)
    strain[strains] = vectors[:, 0]
    return float(values[0]), strain


def _on_all(u: Array, network: ContactNetwork) -> Array:
    everybody = np.zeros((len(network.radii), 2))
    everybody[network.backbone] = u
    return everybody
