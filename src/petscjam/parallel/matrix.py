"""Distributed complex PETSc matrices from rows of real or complex numbers."""

from __future__ import annotations

from typing import Any

from numpy.typing import NDArray

from petscjam.parallel.petsc import petsc


def symmetric_matrix(indptr: NDArray, indices: NDArray, values: NDArray, size: int, comm: Any) -> Any:
    """Return the PETSc matrix with these local rows, flagged symmetric and not Hermitian.

    MUMPS then takes LDLᵀ, which PETSc refuses on a Hermitian matrix in a complex build.
    """
    PETSc = petsc()
    local = len(indptr) - 1
    csr = (indptr.astype(PETSc.IntType), indices.astype(PETSc.IntType), values.astype(PETSc.ScalarType))
    matrix = PETSc.Mat().createAIJ(((local, size), (local, size)), csr=csr, comm=comm)
    matrix.setOption(PETSc.Mat.Option.SYMMETRIC, True)
    matrix.setOption(PETSc.Mat.Option.SYMMETRY_ETERNAL, True)
    matrix.setOption(PETSc.Mat.Option.HERMITIAN, False)
    return matrix
