"""Eigenpairs of distributed real symmetric matrices: SLEPc's Krylov–Schur over one factorisation.

PETSc is complex, so eigenvectors come with arbitrary phases, and mixed in clusters. Their real and imaginary
parts span the same space, and Rayleigh–Ritz in it gives real pairs.

Axes: n local rows, m eigenpair.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from petscjam.box import Array
from petscjam.errors import SolverError
from petscjam.parallel.comm import total
from petscjam.parallel.matrix import apply_real
from petscjam.parallel.petsc import destroying, petsc, slepc, stage

TOLERANCE = 1e-10
RESTARTS = 10_000
NEW = 1e-6  # squared length of a part of a vector outside the others, below which it is rounding


class Pairs(NamedTuple):
    """Eigenvalues (m,), this rank's rows of the vectors (n, m), and residuals (m,)."""

    values: Array
    vectors: Array
    residuals: Array


def lowest_pairs(
    K: Any, count: int, shift: float, *, leave_out: Sequence[NDArray] = (), prefix: str = "petscjam_modes_"
) -> Pairs:
    """Return the pairs of ``K`` next to ``shift``, ascending: the lowest if none lies below it.

    Parameters
    ----------
    K : PETSc.Mat
        Real, flagged symmetric and not Hermitian.
    count : int
        How many, at most the rows of ``K`` less those left out.
    shift : float
        K − shift is factored: it must not be an eigenvalue.
    leave_out : sequence of (n,)
        Orthonormal null vectors to stay clear of, this rank's rows.
    prefix : str
        Of the PETSc options; those of the factor start with ``<prefix>st_``.

    Returns
    -------
    Pairs
        Vectors orthonormal, residuals ‖Kv − λv‖: K has an eigenvalue within this distance of λ.

    Raises
    ------
    SolverError
        If the factorisation or the eigensolver fails.
    """
    SLEPc = slepc()
    eps = SLEPc.EPS().create(K.comm)
    eps.setOperators(K)
    eps.setProblemType(SLEPc.EPS.ProblemType.HEP)
    eps.setWhichEigenpairs(eps.Which.TARGET_MAGNITUDE)
    eps.setTarget(shift)
    eps.getST().setType("sinvert")
    spaces = [_vector(K, column) for column in leave_out]
    with _failing_in_words(), destroying(eps, *spaces):
        eps.setDeflationSpace(spaces)
        _solve(eps, count, prefix)
        return _real_pairs(K, None, eps, count, largest=False)


def largest_pairs(B: Any, K: Any, count: int, *, prefix: str) -> Pairs:
    """Return the largest τ of B v = τ K v, descending.

    Parameters
    ----------
    B, K : PETSc.Mat
        Real, ``K`` positive definite and flagged as above; it is factored. ``B`` may be a shell.
    count : int
    prefix : str

    Returns
    -------
    Pairs
        VᵀKV = 1, residuals ‖Bv − τKv‖/‖Kv‖.

    Raises
    ------
    SolverError
        If the factorisation of K or the eigensolver fails.
    """
    SLEPc = slepc()
    eps = SLEPc.EPS().create(K.comm)
    eps.setOperators(B, K)
    eps.setProblemType(SLEPc.EPS.ProblemType.GHEP)
    eps.setWhichEigenpairs(eps.Which.LARGEST_REAL)
    with _failing_in_words(), destroying(eps):
        _solve(eps, count, prefix)
        return _real_pairs(B, K, eps, count, largest=True)


@contextmanager
def _failing_in_words() -> Iterator[None]:
    """Turn PETSc's errors into ours, outside :func:`destroying`: what failed midway cannot be destroyed."""
    try:
        yield
    except petsc().Error as error:
        raise SolverError(f"SLEPc failed: {error}") from error


def _solve(eps: Any, count: int, prefix: str) -> None:
    """Solve, with MUMPS LDLᵀ unless the options say otherwise.

    The start is drawn by row. It is real, and so is what follows: the length of a complex vector in the
    metric of K rounds to a complex number. Where a search is exhausted it goes on at random.
    """
    eps.setOptionsPrefix(prefix)
    eps.setDimensions(count)
    eps.setTolerances(TOLERANCE, RESTARTS)
    ksp = eps.getST().getKSP()
    ksp.setType("preonly")
    ksp.pc.setType("cholesky")
    ksp.pc.setFactorSolverType("mumps")
    eps.setFromOptions()
    matrix = eps.getOperators()[0]
    start = _vector(
        matrix, np.random.default_rng(0).standard_normal(matrix.size[0])[slice(*matrix.owner_range)]
    )
    with destroying(start), stage("eigensolve"):
        eps.setInitialSpace(start)
        eps.solve()
    if eps.getConverged() < count:
        reason = eps.getConvergedReason()
        raise SolverError(f"SLEPc found {eps.getConverged()} of {count} modes (reason {reason})")


def _real_pairs(A: Any, metric: Any, eps: Any, count: int, *, largest: bool) -> Pairs:
    """Turn the vectors of ``eps`` into real ones, orthonormal in ``metric``, by Rayleigh–Ritz."""
    comm, vector, columns = A.comm.tompi4py(), A.createVecRight(), []
    for k in range(count):
        eps.getEigenpair(k, vector)
        columns += [vector.array.real.copy(), vector.array.imag.copy()]
    vector.destroy()
    V = np.stack(columns, axis=1)
    for _ in range(2):  # the second time takes off what the first rounds
        sizes, rotation = np.linalg.eigh(total(comm, V.T @ _metric(metric, V)))
        kept = sizes > NEW * sizes[-1]
        V = V @ (rotation[:, kept] / np.sqrt(sizes[kept]))
    if V.shape[1] < count:
        raise SolverError(f"SLEPc's {count} vectors span only {V.shape[1]} modes")
    AV = apply_real(A, V)
    ritz = total(comm, V.T @ AV)
    values, rotation = comm.bcast(np.linalg.eigh((ritz + ritz.T) / 2))
    wanted = np.arange(len(values))[:: -1 if largest else 1][:count]
    values, rotation = values[wanted], rotation[:, wanted]
    V, AV = V @ rotation, AV @ rotation
    MV = _metric(metric, V)
    left, size = total(comm, np.stack([((AV - MV * values) ** 2).sum(0), (MV**2).sum(0)])) ** 0.5
    return Pairs(values, V, left / size)


def _metric(metric: Any, V: Array) -> Array:
    """Return ``metric`` (None: 1) times V."""
    return V if metric is None else apply_real(metric, V)


def _vector(matrix: Any, values: NDArray) -> Any:
    vector = matrix.createVecRight()
    vector.array[:] = values
    return vector
