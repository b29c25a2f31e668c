"""Print the versions of the stack: python tools/check_stack.py, or mpirun -n 2 python tools/check_stack.py 2.

Fails where PETSc is missing, has real scalars or lacks MUMPS, or where mpirun belongs to another MPI.
"""

import sys

import h5py
import mpi4py
import numpy
import petsc4py
import slepc4py
from mpi4py import MPI

from petscjam.parallel.comm import world
from petscjam.parallel.petsc import petsc, slepc

comm = world()
if len(sys.argv) > 1 and comm.size != int(sys.argv[1]):
    sys.exit(f"{sys.argv[1]} ranks were started, {comm.size} came: mpirun is not that of mpi4py")
PETSc, SLEPc = petsc(), slepc()
if comm.rank == 0:
    versions = [".".join(map(str, library.Sys.getVersion())) for library in (PETSc, SLEPc)]
    print(f"Python {sys.version.split()[0]}, complex PETSc {versions[0]} with MUMPS, SLEPc {versions[1]}")
    name, version = MPI.get_vendor()
    print(f"{name} {'.'.join(map(str, version))}, {comm.size} rank(s)")
    bindings = (petsc4py, slepc4py, mpi4py, h5py, numpy)
    print(", ".join(f"{module.__name__} {module.__version__}" for module in bindings))
