"""Without tangential damping there is no critical regime: G* = G0(1 + iωτ1), Kelvin–Voigt (BT eq. 18).

Exact without pre-stress, for every packing; with pre-stress approximate (BT Fig. 4a).

mpirun -n 2 python -m mpi4py examples/03_kelvin_voigt.py    (-m mpi4py: an error on one rank ends both)
"""

import numpy as np
from mpi4py import MPI

import petscjam as pj

comm = MPI.COMM_WORLD
packing = comm.bcast(pj.prepare_packing(n=128, pressure=1e-3, seed=1) if comm.rank == 0 else None)
omega = np.geomspace(1e-4, 1e2, 7)

for prestress in (False, True):
    g = pj.complex_modulus(packing, omega, damping=pj.ContactDamping(beta=0.0), prestress=prestress, comm=comm)
    error = np.abs(g.values / (g.G0 * (1 + 1j * omega)) - 1).max()
    if comm.rank == 0:
        print(
            f"{'with' if prestress else 'without'} pre-stress: G0 = {g.G0:.6f}, farthest from Kelvin–Voigt {error:.1e}"
        )
    assert prestress or error < 1e-9
