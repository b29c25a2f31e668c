"""The strain at which a sheared packing makes or loses its first contact, against N and p (docs/howto/aqs.md).

    mpirun -n 2 python benchmarks/first_change.py FOLDER

Packings that are stable against shear in every direction are prepared in FOLDER, or taken from it, and sheared up
to their first event, with steps of 2√p/N; those of 256 disks at p = 1e-3 also with half that. A row of the table has
the mean and its error for one size and pressure, and the largest relative difference that halving the step makes. As
in van Deen et al., Phys. Rev. E 90, 020202, the strain is proportional to √p/N for N²p ≫ 1 and to p for N²p ≪ 1.
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
HALVED = "N256_p0.001_"  # sheared with half the step, too


def first_event(packing, part, **common):
    """Shear up to the first event, with steps of ``part``·√p/N."""
    pressure = pj.ContactNetwork.of(packing).pressure
    return pj.aqs(packing, 1.0, part * pressure**0.5 / len(packing), events=1, **common)


def first(path):
    """Return the strain of the first change: of the first event, or where the packing unjams."""
    return path.gamma[path.events[0] if len(path.events) else -1]


def table(whole, half):
    """Print a row for each size and pressure."""
    groups = {}
    for name, path in whole.items():
        kind = path.kind(0) if len(path.events) else "unjams"
        other = half.get(name)
        change = abs(first(other) / first(path) - 1) if other else np.nan
        group = groups.setdefault((path.origin.particles, nominal(path.origin.pressure)), [])
        group.append((kind, first(path), change))
    print(
        "| N | p | packings | N²p | first change at γ | γN/√p | γ/p | lost, made, unstable, unjams | halved step (of) |"
    )
    print("|---|---|---|---|---|---|---|---|---|")
    for (n, p), rows in sorted(groups.items()):
        kinds, strains, changes = zip(*rows, strict=True)
        known = [change for change in changes if np.isfinite(change)]
        halved = f"{max(known):.0e} ({len(known)})" if known else "—"
        mean, error = np.mean(strains), standard_error(strains)
        counts = ", ".join(str(kinds.count(kind)) for kind in ("lost", "made", "instability", "unjams"))
        print(
            f"| {n} | {p:g} | {len(rows)} | {n * n * p:.3g} | {mean:.3g} ± {error:.1g} "
            f"| {mean * n / p**0.5:.3g} ± {error * n / p**0.5:.1g} | {mean / p:.3g} ± {error / p:.1g} | {counts} "
            f"| {halved} |"
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
    outputs = {part: folder / f"step{part}.h5" for part in PARTS}
    for part, output in outputs.items():
        some = files if part == max(PARTS) else [file for file in files if file.name.startswith(HALVED)]
        with progress(output.name, show=comm.rank == 0) as report:
            analysis = PackingAnalysis(first_event, {"part": part})
            _, failures = analyse(Ensemble(some, output, resume=True), analysis, comm=comm, progress=report)
        if comm.rank == 0:
            print("\n".join(failures), flush=True)
    if comm.rank == 0:
        table(*(pj.read_results(output) for output in outputs.values()))


if __name__ == "__main__":
    main(Path(sys.argv[1]))
