"""The spectrum compared with bare MUMPS, with one solve for each frequency, and with SciPy, as ratios.

    mpirun -n R python benchmarks/spectrum.py PACKING.h5 [--direct 60] [--splu] [--law stokes] [--rtol 1e-6]

All is measured in this run, imports and compilation excluded: bare MUMPS is KSP with PETSc's defaults,
factorise and solve, on K + iωB at ω = 0.01, the median of ten, half of them after the rest; symbolic
analysis excluded. SciPy's splu has its defaults, one matrix, and counts 60 times.
"""

import argparse
import resource
import time

import numpy as np
from direct_sweep import bare_mumps, superlu
from mpi4py import MPI

import petscjam as pj
from petscjam.parallel.petsc import petsc
from petscjam.response.matrices import assembled
from petscjam.response.problem import LinearProblem
from petscjam.rows.damping import LAWS
from petscjam.rows.kinematics import SIMPLE_SHEAR


def seconds(work, *arguments, **options):
    """Return wall-clock seconds and the result."""
    start = time.perf_counter()
    result = work(*arguments, **options)
    return time.perf_counter() - start, result


def main():
    """Measure and print."""
    parser = argparse.ArgumentParser()
    parser.add_argument("packing")
    parser.add_argument("--direct", type=int, default=0, help="frequencies of a direct sweep to compare with")
    parser.add_argument("--splu", action="store_true")
    parser.add_argument("--law", choices=LAWS, default="contact")
    parser.add_argument("--no-prestress", action="store_true")
    parser.add_argument("--rtol", type=float, default=1e-6)
    options = parser.parse_args()
    comm, PETSc = MPI.COMM_WORLD, petsc()
    packing, law, prestress = pj.Packing.read(options.packing), LAWS[options.law](), not options.no_prestress
    settings = {"damping": law, "prestress": prestress, "comm": comm}
    small = pj.prepare_packing(64, 1e-2, 1)
    pj.spectrum(small, **settings)  # imports
    problem = LinearProblem(packing, law, [SIMPLE_SHEAR], prestress, comm)
    with assembled(problem.K, problem.B, problem.number(problem.active), comm) as pencil:
        A = pencil.combine(1, 0.01j)
        f = A.createVecLeft()
        f.array[:] = -(pencil.k + 0.01j * pencil.b)[:, 0]
        before = bare_mumps(A, f, PETSc, 5)
        whole, s = seconds(pj.spectrum, packing, rtol=options.rtol, displacements=False, **settings)
        bare = np.median(before + bare_mumps(A, f, PETSc, 5))
        slow = superlu(A, f) if options.splu and comm.size == 1 else np.nan
        unknowns = A.size[0]
    direct = np.nan
    if options.direct:
        omegas = np.geomspace(1e-8, 1e2, options.direct)
        direct, g = seconds(pj.complex_modulus, packing, omegas, **settings)
        true = abs(s(omegas) / g.values - 1)
    peak = comm.gather(resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 1024)
    if comm.rank == 0:
        print(f"{len(packing)} disks, {unknowns} unknowns, {law}, prestress {prestress}, {comm.size} rank(s)")
        print(f"bare MUMPS, a matrix        {bare:8.3f} s")
        print(
            f"spectrum, {s.factorisations:2d} factorisations {whole:8.2f} s   "
            f"{whole / (s.factorisations * bare):.2f} × factorisations × bare MUMPS"
        )
        grid = np.geomspace(1e-8, 1e2, 1001)
        print(f"error bound over 1e-8…1e2   {s.error(grid).max():8.1e}")
        if options.direct:
            above = (true > s.error(omegas)).sum()
            print(f"{options.direct} direct frequencies      {direct:8.2f} s   {direct / whole:.1f} × slower")
            print(f"worst true error            {true.max():8.1e}, {above} above the bound")
        if options.splu and comm.size == 1:
            print(f"60 × splu                   {60 * slow:8.1f} s   {60 * slow / whole:.0f} × slower")
        print(f"MUMPS memory, largest rank  {s.performance['mumps_MB']:8.0f} MB")
        print("peak memory of each rank   ", *(f"{mb:.0f}" for mb in peak), "MB")


if __name__ == "__main__":
    main()
