"""The number of factorisations of spectra, and their error bounds compared with true errors, over a library.

    mpirun -n R python benchmarks/error_bounds.py FOLDER [--rtol 1e-6] [--frequencies 8]

Every packing under contact damping with β = 1 and 0.01 and under Stokes drag, with and without pre-stress;
1e-8 … 1e2. At random frequencies G* is compared with a direct solve. Packings are distributed over the ranks.
"""

import argparse
from collections import Counter
from pathlib import Path

import numpy as np
from mpi4py import MPI

import petscjam as pj

COMPARED = {"β = 1": pj.ContactDamping(1.0), "β = 0.01": pj.ContactDamping(0.01), "Stokes": pj.StokesDrag(1.0)}
SPAN = 1e-8, 1e2


def judge(file, rtol, frequencies):
    """Yield law, pre-stress, factorisations, largest bound, and (true, bound) at each frequency."""
    packing = pj.Packing.read(file)
    rng = np.random.default_rng(int(packing.checksum, 16))
    for name, law in COMPARED.items():
        for prestress in (True, False):
            settings = {"damping": law, "prestress": prestress, "comm": MPI.COMM_SELF}
            s = pj.spectrum(packing, SPAN, rtol=rtol, displacements=False, **settings)
            omega = np.exp(rng.uniform(*np.log(SPAN), frequencies))
            g = pj.complex_modulus(packing, omega, **settings)
            true = abs(s(omega) / g.values - 1)
            worst = s.error(np.geomspace(*SPAN, 641)).max()
            yield name, prestress, s.factorisations, worst, true, s.error(omega)


def main():
    """Measure and print."""
    parser = argparse.ArgumentParser()
    parser.add_argument("folder", type=Path)
    parser.add_argument("--rtol", type=float, default=1e-6)
    parser.add_argument("--frequencies", type=int, default=8)
    options = parser.parse_args()
    comm = MPI.COMM_WORLD
    files = sorted(options.folder.glob("*.h5"))
    mine = [row for file in files[comm.rank :: comm.size] for row in judge(file, options.rtol, options.frequencies)]
    rows = [row for rank in comm.gather(mine) or [] for row in rank]
    if comm.rank:
        return
    print(f"{len(files)} packings, rtol {options.rtol:g}, {SPAN[0]:g} to {SPAN[1]:g}")
    print(f"{'law':10} {'pre-stress':10} {'factorisations: spectra':50} largest bound")
    for name in COMPARED:
        for prestress in (True, False):
            some = [row for row in rows if row[:2] == (name, prestress)]
            counts = sorted(Counter(row[2] for row in some).items())
            text = ", ".join(f"{count}: {spectra}" for count, spectra in counts)
            kept, worst = "with" if prestress else "without", max(row[3] for row in some)
            print(f"{name:10} {kept:10} {text:50} {worst:.1e}")
    true, bound = (np.concatenate([row[k] for row in rows]) for k in (4, 5))
    seen = true > 1e-10
    print(f"most factorisations: {max(row[2] for row in rows)}")
    above = true > bound
    print(
        f"{len(true)} direct solves at random frequencies: {above.sum()} above the bound, "
        f"by at most {np.max(true - bound, where=above, initial=0):.1e}"
    )
    loose = bound[seen] / true[seen]
    print(
        f"bound over true error where that is above 1e-10 ({seen.sum()} of them): "
        f"median {np.median(loose):.2f}, most {loose.max():.1f}"
    )


if __name__ == "__main__":
    main()
