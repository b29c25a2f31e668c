"""One direct solver for a sequence of matrices on one pattern: KSP with MUMPS LDLᵀ.

Symbolic analysis is done once, for the first matrix; every matrix has its own numerical factorisation.
"""

from __future__ import annotations

import os
from collections.abc import Iterator
from contextlib import contextmanager, nullcontext
from tempfile import TemporaryDirectory
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from petscjam.base.errors import SolverError
from petscjam.base.interrupt import check
from petscjam.parallel.comm import Comm
from petscjam.parallel.memory import scratch_folder
from petscjam.parallel.petsc import destroying, petsc, stage

if TYPE_CHECKING:
    from petsc4py.PETSc import Mat, Vec

Complex = NDArray[np.complex128]
OUT_OF_WORKSPACE = (-8, -9)
LARGEST_WORKSPACE = 2000  # ICNTL(14), per cent above the estimate
GOOD_RESIDUAL = 1e-12
LARGEST_RESIDUAL = 1e-8  # a solution with a larger residual is refused
ROUNDING = 1e-13  # residual of a stable solve, relative to ‖A‖‖x‖


class DirectSolver:
    """Factor matrices and solve with them; PETSc options of ``prefix`` select another solver.

    Attributes
    ----------
    factorisations : int
        How many were made.
    ksp : PETSc.KSP
    """

    def __init__(self, comm: Comm, prefix: str, definite: bool, out_of_core: bool, block_low_rank: float) -> None:
        PETSc = petsc()
        self.factorisations = 0
        self._comm = comm
        self._definite, self._out_of_core, self._block_low_rank = definite, out_of_core, block_low_rank
        self._A: Any = None
        self.ksp = PETSc.KSP().create(comm)
        self.ksp.setOptionsPrefix(prefix)
        self.ksp.setType(PETSc.KSP.Type.PREONLY)
        pc = self.ksp.getPC()
        pc.setType(PETSc.PC.Type.CHOLESKY)
        pc.setFactorSolverType(PETSc.Mat.SolverType.MUMPS)

    def factor(self, A: Mat) -> None:
        """Factor ``A``, with more workspace if MUMPS needs it.

        Raises
        ------
        SolverError
            If MUMPS fails, with its code and advice.
        Interrupted
            If a signal has come.
        """
        check(self._comm)
        first = self._A is None
        self._A = A
        if A.size[0] == 0:
            return
        self.ksp.setOperators(A, A)
        if first:
            self.ksp.setFromOptions()
            self._configure()
        with stage("factor"):
            self.ksp.setUp()
            while self._code() in OUT_OF_WORKSPACE and self._factor().getMumpsIcntl(14) < LARGEST_WORKSPACE:
                self._enlarge(A)
        self.factorisations += 1
        if self._code() < 0:
            raise SolverError(f"MUMPS could not factor the matrix: {_advice(self._code(), self._factor())}")

    def solve(
        self, rhs: NDArray[Any], cause: str = "", *, soft: bool = False, largest: float = LARGEST_RESIDUAL
    ) -> tuple[Complex, float]:
        """Solve Ax = f, refined while its residual is above 1e-12 and falls by half.

        Parameters
        ----------
        rhs : (n,)
            This rank's rows of f.
        cause : str
            The cause of a large residual, for the message; default: what the solver knows.
        soft : bool
            Whether soft motions may make x large: then a residual of 1e-13 ‖A‖‖x‖, the accuracy of a stable
            solve, is accepted, too.
        largest : float
            Largest ‖Ax − f‖/‖f‖; infinite if the caller tests the solution.

        Returns
        -------
        x : (n,)
            This rank's rows.
        residual : float
            ‖Ax − f‖/‖f‖.

        Raises
        ------
        SolverError
            If the solve fails or the residual is larger.
        """
        if self._A.size[0] == 0:
            return rhs, 0.0
        f, x = self._A.createVecLeft(), self._A.createVecRight()
        r = f.duplicate()
        with destroying(f, x, r), stage("solve"):
            f.array[:] = rhs
            norm = f.norm() or 1.0
            self.ksp.solve(f, x)
            if self.ksp.reason < 0:
                raise SolverError(f"the solve failed (KSP reason {self.ksp.reason})")
            residual, before = self._residual(x, f, r) / norm, float("inf")
            while GOOD_RESIDUAL < residual < before / 2:
                before, correction = residual, x.duplicate()
                with destroying(correction):
                    self.ksp.solve(r, correction)
                    x.axpy(1.0, correction)
                residual = self._residual(x, f, r) / norm
            accepted = max(largest, ROUNDING * self._A.norm() * x.norm() / norm) if soft else largest
            if not (residual < accepted or largest == np.inf):
                raise SolverError(f"{cause or self._weakness}: a solve leaves the residual {residual:.1e}")
            return x.array.copy(), float(residual)

    @property
    def _weakness(self) -> str:
        """The likely cause of a large residual."""
        compressed = "the factor is compressed too far, or " if self._block_low_rank else ""
        return f"{compressed}there are motions that nothing resists"

    @property
    def memory(self) -> float:
        """Memory of the factors on the rank that needs most, MB (MUMPS INFOG(21)); 0 without MUMPS."""
        return float(self._factor().getMumpsInfog(21)) if self._mumps() else 0.0

    @property
    def flops(self) -> float:
        """Floating-point operations of the latest factorisation, all ranks (MUMPS RINFOG(3)); 0 without."""
        return float(self._factor().getMumpsRinfog(3)) if self._mumps() else 0.0

    def _residual(self, x: Vec, f: Vec, r: Vec) -> float:
        self._A.mult(x, r)
        r.aypx(-1.0, f)
        return float(r.norm())

    def _factor(self) -> Mat:
        return self.ksp.getPC().getFactorMatrix()

    def _configure(self) -> None:
        """Set the options of MUMPS before its analysis.

        It does not pivot (CNTL(1) = 0) if K and B are positive semi-definite: then LDLᵀ of K + iωB without
        pivoting is stable, its entries grow by a factor below 3 (Higham, Math. Comp. 67, 1591, 1998), and it is
        faster.
        """
        if not self._mumps():
            return
        self.ksp.pc.setFactorSetUpSolverType()
        factor = self._factor()
        if self._definite:
            factor.setMumpsCntl(1, 0.0)
        if self._out_of_core:
            factor.setMumpsIcntl(22, 1)
        if self._block_low_rank:
            factor.setMumpsIcntl(35, 2)
            factor.setMumpsCntl(7, self._block_low_rank)

    def _mumps(self) -> bool:
        pc = self.ksp.pc
        return (
            self._A is not None
            and self._A.size[0] > 0
            and pc.type in ("cholesky", "lu")
            and pc.getFactorSolverType() == "mumps"
        )

    def _code(self) -> int:
        return int(self._factor().getMumpsInfog(1)) if self._mumps() else 0

    def _enlarge(self, A: Mat) -> None:
        """Factor again with four times the extra workspace.

        PETSc does not factor again after an error of MUMPS, so this starts from the analysis, which reads the
        workspace from the options.
        """
        name = f"{self.ksp.prefix}mat_mumps_icntl_14"
        options = petsc().Options()
        before = options.getString(name) if options.hasName(name) else None
        options.setValue(name, max(4 * self._factor().getMumpsIcntl(14), 100))
        self.ksp.reset()
        self.ksp.setOperators(A, A)
        self._configure()
        self.ksp.setUp()
        options.delValue(name)
        if before is not None:
            options.setValue(name, before)
            options.hasName(name)  # else PETSc would report it as unused


@contextmanager
def direct_solver(
    comm: Comm, prefix: str, *, definite: bool, out_of_core: bool = False, block_low_rank: float = 0.0
) -> Iterator[DirectSolver]:
    """Yield a :class:`DirectSolver`, and destroy it at the end.

    Parameters
    ----------
    comm : MPI communicator
    prefix : str
        Of the PETSc options.
    definite : bool
        Whether real and imaginary parts of the matrices are positive semi-definite.
    out_of_core : bool
        Store the factor on disk, in the folder MUMPS_OOC_TMPDIR.
    block_low_rank : float
        Relative accuracy to which the factor is compressed; refinement corrects the solution. 0: exact.
    """
    solver = DirectSolver(comm, prefix, definite, out_of_core, block_low_rank)
    with _scratch() if out_of_core else nullcontext(), destroying(solver.ksp):
        yield solver


@contextmanager
def _scratch() -> Iterator[None]:
    """Make a separate folder for factors out of core, and remove it at the end, also after an error."""
    before = os.environ.get("MUMPS_OOC_TMPDIR")
    with TemporaryDirectory(prefix="petscjam-", dir=scratch_folder(), ignore_cleanup_errors=True) as own:
        os.environ["MUMPS_OOC_TMPDIR"] = own
        try:
            yield
        finally:
            if before is None:
                del os.environ["MUMPS_OOC_TMPDIR"]
            else:
                os.environ["MUMPS_OOC_TMPDIR"] = before


def _advice(code: int, factor: Mat) -> str:
    if code in OUT_OF_WORKSPACE:
        return (
            f"workspace too small (INFOG(1) = {code}) even with ICNTL(14) = {factor.getMumpsIcntl(14)} %; "
            "use more ranks, or more memory a rank"
        )
    if code == -13:
        return "out of memory (INFOG(1) = -13); use more ranks, or MUMPS out of core (mat_mumps_icntl_22 1)"
    if code == -90:
        folder = os.environ.get("MUMPS_OOC_TMPDIR")
        return f"the factor could not be kept in {folder} (INFOG(1) = -90); is the disk full?"
    if code in (-6, -10):
        return f"the matrix is singular (INFOG(1) = {code}): there are free motions that nothing resists"
    return f"INFOG(1) = {code}, INFOG(2) = {factor.getMumpsInfog(2)} (MUMPS manual, section on errors)"
