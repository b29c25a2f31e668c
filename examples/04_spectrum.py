"""The whole spectrum from a few factorisations: G* at any frequency, a bound on its error, and functions of time.

mpirun -n 2 python -m mpi4py examples/04_spectrum.py
"""

import numpy as np
from mpi4py import MPI

import petscjam as pj

comm = MPI.COMM_WORLD
packing = comm.bcast(pj.prepare_packing(n=256, pressure=1e-3, seed=1) if comm.rank == 0 else None)

s = pj.spectrum(packing, (1e-8, 1e2), damping=pj.ContactDamping(beta=1.0), rtol=1e-6, comm=comm)
omega = np.geomspace(1e-8, 1e2, 2001)
check = omega[100::300]
solved = pj.complex_modulus(packing, check, damping=pj.ContactDamping(beta=1.0), comm=comm)
true = abs(s(check) / solved.values - 1)

if comm.rank == 0:
    print(f"{s.factorisations} factorisations, {len(omega)} frequencies, |G*| within {s.error(omega).max():.0e}")
    for w, error, bound in zip(check, true, s.error(check), strict=True):
        print(f"ω = {w:8.1e}   error {error:.0e}   bound {bound:.0e}")
    times, weights = s.relaxation()
    print(f"{len(times)} relaxation times from {times[0]:.2g} to {times[-1]:.2g} τ1")
    print("t     ", *(f"{t:10.1e}" for t in np.geomspace(1, 1e5, 6)))
    print("G(t)  ", *(f"{G:10.6f}" for G in s.G(np.geomspace(1, 1e5, 6))))
    print("J(t)  ", *(f"{J:10.4f}" for J in s.J(np.geomspace(1, 1e5, 6))))

assert s.error(omega).max() < 1.1e-6
assert (true <= s.error(check) + 1e-10).all()  # 1e-10: rounding of the solves
assert abs(s.G(1e9) / s.G0 - 1) < 1e-9
