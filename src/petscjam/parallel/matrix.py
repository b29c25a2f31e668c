"""Distributed complex PETSc matrices from rows of real or complex numbers."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from petscjam.parallel.comm import Comm
from petscjam.parallel.petsc import destroying, petsc

if TYPE_CHECKING:
    from petsc4py.PETSc import Mat


def symmetric_matrix(indptr: NDArray[Any], indices: NDArray[Any], values: NDArray[Any], size: int, comm: Comm) -> Mat:
    """Return the PETSc matrix with these local rows, flagged symmetric and not Hermitian.

    MUMPS then uses LDLᵀ, which PETSc refuses for a Hermitian matrix in a complex build.

    Parameters
    ----------
    indptr, indices, values : arrays
        This rank's rows, in compressed form.
    size : int
        Number of columns.
    comm : MPI communicator

    Returns
    -------
    PETSc.Mat
    """
    PETSc = petsc()
    local = len(indptr) - 1
    csr = (indptr.astype(PETSc.IntType), indices.astype(PETSc.IntType), values.astype(PETSc.ScalarType))
    matrix = PETSc.Mat().createAIJ(((local, size), (local, size)), csr=csr, comm=comm)
    matrix.setOption(PETSc.Mat.Option.SYMMETRIC, True)
    matrix.setOption(PETSc.Mat.Option.SYMMETRY_ETERNAL, True)
    matrix.setOption(PETSc.Mat.Option.HERMITIAN, False)
    return matrix


def apply_real(matrix: Mat, columns: NDArray[Any]) -> NDArray[Any]:
    """Return ``matrix`` times local rows of real columns (n, m), two real columns as one complex vector.

    Parameters
    ----------
    matrix : PETSc.Mat
        Real.
    columns : (n, m)
        This rank's rows.

    Returns
    -------
    (n, m)
    """
    out = np.empty_like(columns)
    x, y = matrix.createVecs()
    with destroying(x, y):
        for first in range(0, columns.shape[1], 2):
            pair = columns[:, first : first + 2]
            x.array[:] = pair[:, 0] + 1j * pair[:, -1]
            matrix.mult(x, y)
            out[:, first] = y.array.real
            if pair.shape[1] == 2:
                out[:, first + 1] = y.array.imag
    return out
