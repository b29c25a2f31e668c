"""Eigenpairs of distributed real symmetric matrices: SLEPc's Krylov–Schur over one factorisation.

A Krylov space contains one vector of each set of equal eigenvalues, and others only by rounding errors. So the
search continues, with the known vectors deflated, until a count of all eigenvalues shows that none is missing.

PETSc is complex, so eigenvectors have arbitrary phases, and clusters of them are mixed. Their real and imaginary
parts span the same space, and Rayleigh–Ritz in it gives real pairs.

Axes: n local rows, m eigenpair.
"""

from __future__ import annotations

import time
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from typing import TYPE_CHECKING, Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from petscjam.base.errors import SolverError
from petscjam.base.interrupt import check
from petscjam.base.progress import Report
from petscjam.base.types import Array
from petscjam.parallel.comm import Comm, on_root, total
from petscjam.parallel.matrix import apply_real
from petscjam.parallel.memory import give_back_memory
from petscjam.parallel.petsc import destroying, petsc, slepc, stage

if TYPE_CHECKING:
    from petsc4py.PETSc import Mat, Vec
    from slepc4py.SLEPc import EPS

TOLERANCE = 1e-10
RESTARTS = 10_000
NEW = 1e-6  # squared length of the component of a vector outside the others, below which it is a rounding error
EQUAL = 1e-9  # relative difference up to which eigenvalues are equal
APART = 1e-6  # smallest relative distance of σ from the last eigenvalue for the count
WIDER = (1, 1e2, 1e4)  # factor of this distance until the rounding error of the count is smaller
SPARE = 1  # pairs in addition to ``count``, to find a gap for the count
COPIES = 64  # largest number of pairs equal to the last that are searched for, or ``count``
TRIES = 3  # searches without a new pair before the error


class Pairs(NamedTuple):
    """Eigenvalues (m,), this rank's rows of the vectors (n, m), and residuals (m,)."""

    values: Array
    vectors: Array
    residuals: Array


class Search(NamedTuple):
    """At least ``count`` pairs, whether it is proved that none is missing, the reason if not, and the cost."""

    pairs: Pairs
    complete: bool | None
    notes: list[str]
    performance: dict[str, Any]


def search_all(
    search: Callable[[int, Array | None], Pairs],
    count_below: Callable[[float, float], int],
    count: int,
    most: int,
    comm: Comm,
    *,
    least: Callable[[Array], float],
    left_out: Sequence[float] = (),
    progress: Report | None = None,
) -> Search:
    """Return the lowest ``count`` pairs and those equal to the last, and prove that none is missing.

    At least as many eigenvalues as Ritz values lie below any σ (Courant and Fischer). If the numbers are equal,
    none is missing; σ is above the last of the ``count`` pairs. If more than ``COPIES``, and than ``count``, that
    equal the last are missing, σ is just below these instead, and an arbitrary part of them is found.

    Parameters
    ----------
    search : callable
        Function of the number to search for and of the known vectors (n, m) or None: all known pairs, ascending.
    count_below : callable
        Function of σ and its allowed rounding error: the number of eigenvalues below σ. SolverError if the
        rounding error is larger. Called on rank 0.
    count, most : int
        Number of wanted pairs, and of all pairs.
    comm : MPI communicator
    least : callable
        Function of the eigenvalues found: the difference that may be a rounding error.
    left_out : sequence of float
        Eigenvalues that are in the count but not in the search.
    progress : callable
        Called with a fraction and a text.

    Raises
    ------
    SolverError
        If the searches do not find the missing pairs.
    """
    found, wanted, sigma, before, vain = None, min(count + SPARE, most), np.inf, 0, 0
    complete: bool | None = True
    notes: list[str] = []
    seconds = []

    def count_on_root(sigma: float, room: float) -> int:
        below = on_root(comm, count_below, sigma, room)
        give_back_memory()
        return below

    while True:
        times = [time.perf_counter()]
        found = search(wanted, None if found is None else found.vectors)
        if progress:
            progress(0.8, f"{len(found.values)} eigenpairs, residual {found.residuals.max():.0e}")
        times.append(time.perf_counter())
        there = len(found.values)
        vain = 0 if (found.values < sigma).sum() > before else vain + 1
        missing = max(min(count + SPARE, most) - there, 0)
        if not missing and there < most:
            try:
                missing, sigma, notes = _missing(found.values, count, count_on_root, least(found.values), left_out)
            except SolverError as error:
                complete, notes = None, [f"the modes could not be counted: {error}"]
        seconds.append(np.diff([*times, time.perf_counter()]))
        if not missing:
            break
        if vain == TRIES:
            raise SolverError(f"the eigensolver missed {missing} of the lowest modes, {TRIES} times")
        before = int((found.values < sigma).sum())
        wanted = min(missing, count + SPARE, most - there)
    performance: dict[str, Any] = {"eigensolves": len(seconds)}
    performance["eigensolve_seconds"], performance["count_seconds"] = np.sum(seconds, axis=0).tolist()
    return Search(found, complete, notes, performance)


def _missing(
    values: Array, count: int, count_below: Callable[[float, float], int], least: float, left_out: Sequence[float]
) -> tuple[int, float, list[str]]:
    """Return the number of missing eigenvalues below a σ above the lowest ``count``, σ, and notes."""
    known, last = np.sort([*values, *left_out]), values[count - 1]
    room, enough = max(APART * abs(last), least), max(COPIES, count)

    def missing_below(*gaps: tuple[float, float]) -> tuple[int, float]:
        """Return the number that is missing below the first gap (centre and half width) that allows a count."""
        reason = ""
        for centre, half in gaps:
            try:
                number = count_below(centre, 0.8 * half) - int((known < centre).sum())
            except SolverError as error:
                reason = str(error)
            else:
                if number >= 0:
                    return number, centre
                reason = f"{-number} more were found than counted"
        raise SolverError(reason)

    def end(side: int) -> float:
        """Return the lowest (side −1) or highest (1) known value that equals the last."""
        beyond = np.sort(side * known[side * known >= side * last])
        return float(side * beyond[np.argmax(np.append(np.diff(beyond), np.inf) > 2 * room)])

    above = known[known >= last]
    halves = np.diff(above) / 2
    gaps = [(x + half, half) for x, half in zip(above[:-1], halves, strict=True) if half > room]
    missing, sigma = missing_below(*gaps, *((above[-1] + wide * room, wide * room) for wide in WIDER))
    if missing <= enough:
        return missing, sigma, []
    earlier, first = missing_below((end(-1) - room, room))
    if earlier:
        return earlier, first, []
    missing, sigma = missing_below((end(1) + room, room))
    if missing <= enough:
        return missing, sigma, []
    wanted, found = ((some > first) & (some < sigma) for some in (values[:count], values))
    equal = missing + found.sum()
    return 0, sigma, [f"the last {wanted.sum()} are of {equal} equal ones: the choice among these is arbitrary"]


def settled(A: Mat, metric: Mat | None, pairs: Pairs, count: int, probe: Array, least: float) -> Pairs:
    """Return the lowest ``count`` pairs, with vectors that depend only on the matrices, except for their signs.

    The vectors of equal eigenvalues make vᵀ diag(``probe``) v stationary; ``probe`` (n,) has no symmetry.

    Parameters
    ----------
    A, metric : PETSc.Mat
        Of A v = x M v; None for M = 1.
    pairs : Pairs
    count : int
    probe : (n,)
        Numbers without symmetry, this rank's rows.
    least : float
        Difference of eigenvalues that may be a rounding error.
    """
    comm = A.comm.tompi4py()
    values, vectors, residuals = pairs.values, pairs.vectors.copy(), pairs.residuals.copy()
    differ = np.diff(values) > np.maximum(EQUAL * abs(values[1:]), least)
    for members in np.split(np.arange(len(values)), np.flatnonzero(differ) + 1):
        if len(members) > 1:
            V = vectors[:, members]
            V = V @ comm.bcast(np.linalg.eigh(total(comm, V.T @ (probe[:, None] * V)))[1])
            vectors[:, members] = V
            residuals[members] = _residuals(apply_real(A, V), _metric(metric, V), values[members], comm)
    return Pairs(values[:count], vectors[:, :count], residuals[:count])


def lowest_pairs(
    K: Mat,
    count: int,
    shift: float,
    *,
    leave_out: Sequence[Array] = (),
    known: Array | None = None,
    prefix: str = "petscjam_modes_",
) -> Pairs:
    """Return the pairs of ``K`` next to ``shift``, ascending: the lowest if none lies below it.

    Parameters
    ----------
    K : PETSc.Mat
        Real, flagged symmetric and not Hermitian.
    count : int
        At most the number of rows of ``K`` less those left out and known.
    shift : float
        K − shift is factored: it must not be an eigenvalue.
    leave_out : sequence of (n,)
        Orthonormal null vectors to deflate, this rank's rows.
    known : (n, m)
        Orthonormal vectors found before: they are not searched for, and are among those returned.
    prefix : str
        Of the PETSc options; those of the factor start with ``<prefix>st_``.

    Returns
    -------
    Pairs
        Vectors orthonormal, residuals ‖Kv − λv‖: K has an eigenvalue within this distance of λ. Fewer than
        ``count`` and those known if the search ends before.

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
    return _solved(eps, K, None, count, leave_out, known, prefix)


def pencil_pairs(A: Mat, M: Mat, count: int, *, known: Array | None = None, prefix: str) -> Pairs:
    """Return the lowest x of A v = x M v, ascending.

    Parameters
    ----------
    A, M : PETSc.Mat
        Real, ``M`` positive definite and flagged as above; it is factored. ``A`` may be a shell.
    count : int
    known : (n, m)
        As in :func:`lowest_pairs`, orthonormal in the metric M.
    prefix : str

    Returns
    -------
    Pairs
        VᵀMV = 1, residuals ‖Av − xMv‖/‖Mv‖.

    Raises
    ------
    SolverError
        If the factorisation of M or the eigensolver fails.
    """
    SLEPc = slepc()
    eps = SLEPc.EPS().create(M.comm)
    eps.setOperators(A, M)
    eps.setProblemType(SLEPc.EPS.ProblemType.GHEP)
    eps.setWhichEigenpairs(eps.Which.SMALLEST_REAL)
    return _solved(eps, A, M, count, (), known, prefix)


def _solved(
    eps: EPS, A: Mat, metric: Mat | None, count: int, leave_out: Sequence[Array], known: Array | None, prefix: str
) -> Pairs:
    """Solve, with MUMPS LDLᵀ unless the options say otherwise; return the pairs known and found.

    The initial vector is random, seeded by row. It is real, and so are the following vectors, because the length
    of a complex vector in the metric of K is complex by rounding. An exhausted search continues with a random
    vector.
    """
    start, stop = A.owner_range
    V = np.empty((stop - start, 0)) if known is None else known
    first = np.random.default_rng(V.shape[1]).standard_normal(A.size[0])[start:stop]
    spaces = [_vector(A, column) for column in (first, *leave_out, *V.T)]
    eps.setOptionsPrefix(prefix)
    eps.setDimensions(count)
    eps.setTolerances(TOLERANCE, RESTARTS)
    ksp = eps.getST().getKSP()
    ksp.setType("preonly")
    ksp.pc.setType("cholesky")
    ksp.pc.setFactorSolverType("mumps")
    eps.setFromOptions()
    eps.setInitialSpace(spaces[0])
    eps.setDeflationSpace(spaces[1:])
    with _failing_in_words(), destroying(eps, *spaces):
        check(A.comm.tompi4py())
        with stage("eigensolve"):
            eps.solve()
        new = min(eps.getConverged(), count)
        if new == 0:
            raise SolverError(f"SLEPc found none of {count} modes (reason {eps.getConvergedReason()})")
        vector = spaces[0]
        columns = [*V.T]
        for k in range(new):
            eps.getEigenpair(k, vector)
            columns += [vector.array.real.copy(), vector.array.imag.copy()]
        return _real_pairs(A, metric, np.stack(columns, axis=1), V.shape[1] + new)


@contextmanager
def _failing_in_words() -> Iterator[None]:
    """Turn PETSc's errors into ours, outside :func:`destroying`: after an error objects cannot be destroyed."""
    try:
        yield
    except petsc().Error as error:
        raise SolverError(f"SLEPc failed: {error}") from None


def _real_pairs(A: Mat, metric: Mat | None, V: Array, count: int) -> Pairs:
    """Return the lowest pairs in the span of ``V`` by Rayleigh–Ritz, orthonormal in ``metric``."""
    comm = A.comm.tompi4py()
    for _ in range(2):  # the second pass removes the rounding errors of the first
        sizes, rotation = comm.bcast(np.linalg.eigh(total(comm, V.T @ _metric(metric, V))))
        kept = sizes > NEW * sizes[-1]
        V = V @ (rotation[:, kept] / np.sqrt(sizes[kept]))
    AV = apply_real(A, V)
    ritz = total(comm, V.T @ AV)
    values, rotation = comm.bcast(np.linalg.eigh((ritz + ritz.T) / 2))
    values, rotation = values[:count], rotation[:, :count]
    V, AV = V @ rotation, AV @ rotation
    return Pairs(values, V, _residuals(AV, _metric(metric, V), values, comm))


def _residuals(AV: Array, MV: Array, values: Array, comm: Comm) -> Array:
    """Return ‖Av − xMv‖/‖Mv‖ of each pair."""
    left, size = total(comm, np.stack([((AV - MV * values) ** 2).sum(0), (MV**2).sum(0)])) ** 0.5
    return left / size


def _metric(metric: Mat | None, V: Array) -> Array:
    """Return ``metric`` (None: 1) times V."""
    return V if metric is None else apply_real(metric, V)


def _vector(matrix: Mat, values: NDArray[Any]) -> Vec:
    vector = matrix.createVecRight()
    vector.array[:] = values
    return vector
