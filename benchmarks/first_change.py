"""The strain at which a sheared packing makes or loses its first contact, against N and p (docs/howto/aqs.md).

    mpirun -n 2 python benchmarks/first_change.py FOLDER

Packings that are stable against shear in every direction are prepared in FOLDER, or taken from it, and sheared up
to their first event, with steps of 2√p/N and of half that. A row of the table has the mean and its error for one
size and pressure, and the largest relative difference that halving the step makes. As in van Deen et al., Phys. Rev. E
90, 020202, the strain is proportional to √p/N for N²p ≫ 1 and to p for N²p ≪ 1.
"""

import sys
from pathlib import Path

import numpy as np
from mpi4py import MPI

import petscjam as pj
from petscjam.analysis.statistics import nominal, standard_error
from petscjam.base.progress import progress
from petscjam.io.jobs import Ensemble, PackingAnalysis, analyse
from petscjam.parallel.petsc import start

SEEDS = {(16, 64, 256): range(1, 21), (1024,): range(1, 11)}
PRESSURES = {(16, 64, 256): (1e-2, 1e-3, 1e-4, 1e-5), (1024,): (1e-2, 1e-3, 1e-4)}
PARTS = (2.0, 1.0)


def first_event(packing, part, **common):
    """Shear up to the first event, with steps of ``part``·√p/N."""
    pressure = pj.ContactNetwork.of(packing).pressure
    return pj.aqs(packing, 1.0, part * pressure**0.5 / len(packing), events=1, **common)


def table(results):
    """Print a row for each size and pressure."""
    groups = {}
    for name, path in results[0].items():
        strains = [some[name].gamma[some[name].events[0]] for some in results]
        origin = path.origin
        groups.setdefault((origin.particles, nominal(origin.pressure)), []).append((path.kind(0), *strains))
    print(
        "| N | p | packings | N²p | strain γ of the first change | γN/√p | γ/p | lost, made, unstable | halved step |"
    )
    print("|---|---|---|---|---|---|---|---|---|")
    for (n, p), rows in sorted(groups.items()):
        kinds = [row[0] for row in rows]
        whole, half = np.array([row[1:] for row in rows]).T
        mean, error = whole.mean(), standard_error(whole)
        counts = ", ".join(str(kinds.count(kind)) for kind in ("lost", "made", "instability"))
        print(
            f"| {n} | {p:g} | {len(rows)} | {n * n * p:.3g} | {mean:.3g} ± {error:.1g} "
            f"| {mean * n / p**0.5:.3g} ± {error * n / p**0.5:.1g} | {mean / p:.3g} ± {error / p:.1g} | {counts} "
            f"| {np.abs(half / whole - 1).max():.0e} |"
        )


def main(folder):
    """Prepare packings, shear them, print the table."""
    comm = MPI.COMM_WORLD
    start(comm)
    for sizes, seeds in SEEDS.items():
        with progress("prepare", show=comm.rank == 0) as report:
            pj.prepare_library(
                folder / "packings",
                sizes,
                PRESSURES[sizes],
                seeds,
                shear_stabilised=True,
                comm=comm,
                resume=True,
                progress=report,
            )
    files = sorted((folder / "packings").glob("*.h5"))
    outputs = [folder / f"step{part}.h5" for part in PARTS]
    for part, output in zip(PARTS, outputs, strict=True):
        with progress(output.name, show=comm.rank == 0) as report:
            analysis = PackingAnalysis(first_event, {"part": part})
            _, failures = analyse(Ensemble(files, output, resume=True), analysis, comm=comm, progress=report)
        if comm.rank == 0:
            print("\n".join(failures), flush=True)
    if comm.rank == 0:
        table([pj.read_results(output) for output in outputs])


if __name__ == "__main__":
    main(Path(sys.argv[1]))
