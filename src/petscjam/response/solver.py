"""One direct solver for a sequence of matrices on one pattern: KSP with MUMPS LDLᵀ.

Symbolic analysis is done once, for the first matrix; every new matrix is factored afresh.
"""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager
from typing import Any

from numpy.typing import NDArray

from petscjam.errors import SolverError
from petscjam.parallel.petsc import destroying, petsc, stage

OUT_OF_WORKSPACE = (-8, -9)
LARGEST_WORKSPACE = 2000  # ICNTL(14), per cent above the estimate
PREFIX = "petscjam_"
GOOD_RESIDUAL = 1e-12


class DirectSolver:
    """Factor matrices and solve with them; options prefix ``petscjam_``.

    Attributes
    ----------
    factorisations : int
        How many were made.
    ksp : PETSc.KSP
    """

    def __init__(self, comm: Any) -> None:
        PETSc = petsc()
        self.factorisations = 0
        self._A: Any = None
        self.ksp = PETSc.KSP().create(comm)
        self.ksp.setOptionsPrefix(PREFIX)
        self.ksp.setType(PETSc.KSP.Type.PREONLY)
        pc = self.ksp.getPC()
        pc.setType(PETSc.PC.Type.CHOLESKY)
        pc.setFactorSolverType(PETSc.Mat.SolverType.MUMPS)

    def factor(self, A: Any) -> None:
        """Factor ``A``, with more workspace if MUMPS asks for it.

        Raises
        ------
        SolverError
            If MUMPS fails, with its code and advice.
        """
        self.ksp.setOperators(A, A)
        if self._A is None:
            self.ksp.setFromOptions()
        self._A = A
        with stage("factor"):
            self.ksp.setUp()
            while (code := self._code()) in OUT_OF_WORKSPACE and self._workspace() < LARGEST_WORKSPACE:
                # PETSc does not factor again where MUMPS has failed; start from the analysis
                workspace = max(4 * self._workspace(), 100)
                petsc().Options(PREFIX).setValue("mat_mumps_icntl_14", workspace)
                self.ksp.reset()
                self.ksp.setOperators(A, A)
                self.ksp.setUp()
        self.factorisations += 1
        if code < 0:
            raise SolverError(f"MUMPS could not factor the matrix: {_advice(code, self._factor())}")

    def solve(self, rhs: NDArray) -> tuple[NDArray, float]:
        """Solve for the local rows ``rhs``; return the local rows of x and ‖Ax − f‖/‖f‖.

        One step of iterative refinement is taken where the residual is not yet at rounding.
        """
        f, x = self._A.createVecLeft(), self._A.createVecRight()
        r = f.duplicate()
        with destroying(f, x, r), stage("solve"):
            f.array[:] = rhs
            norm = f.norm() or 1.0
            self.ksp.solve(f, x)
            residual = self._residual(x, f, r) / norm
            if residual > GOOD_RESIDUAL:
                correction = x.duplicate()
                with destroying(correction):
                    self.ksp.solve(r, correction)
                    x.axpy(1.0, correction)
                residual = self._residual(x, f, r) / norm
            return x.array.copy(), float(residual)

    @property
    def memory(self) -> float:
        """Memory of the factorisation on the rank that needs most, in MB (MUMPS INFOG(21))."""
        return float(self._factor().getMumpsInfog(21))

    def _residual(self, x: Any, f: Any, r: Any) -> float:
        self._A.mult(x, r)
        r.aypx(-1.0, f)
        return float(r.norm())

    def _factor(self) -> Any:
        return self.ksp.getPC().getFactorMatrix()

    def _workspace(self) -> int:
        return int(self._factor().getMumpsIcntl(14))

    def _code(self) -> int:
        return int(self._factor().getMumpsInfog(1))


@contextmanager
def direct_solver(comm: Any) -> Iterator[DirectSolver]:
    """Give a :class:`DirectSolver` and free it at the end."""
    solver = DirectSolver(comm)
    with destroying(solver.ksp):
        yield solver


def _advice(code: int, factor: Any) -> str:
    if code in OUT_OF_WORKSPACE:
        return (
            f"workspace too small (INFOG(1) = {code}) even with ICNTL(14) = {factor.getMumpsIcntl(14)} %; "
            "use more ranks, or more memory a rank"
        )
    if code == -13:
        return "out of memory (INFOG(1) = -13); use more ranks, or -petscjam_mat_mumps_icntl_22 1 after --"
    if code in (-6, -10):
        return f"the matrix is singular (INFOG(1) = {code}): there are free motions that nothing resists"
    return f"INFOG(1) = {code}, INFOG(2) = {factor.getMumpsInfog(2)} (MUMPS manual, section on errors)"
