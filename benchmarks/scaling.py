"""Strong and weak scaling of spectra, within one packing and over an ensemble: seconds and a figure.

    python benchmarks/scaling.py [--ranks 1,2] [-o docs/figures/scaling.png]

Packings are prepared once in demo/scaling (p = 1e-2). Within one packing all ranks share a factorisation:
32 768 disks on every number of ranks (strong), 16 384 a rank (weak). Over an ensemble each rank takes whole
packings of 4096 disks: 16 on every number of ranks (strong), 8 a rank (weak). Contact damping with β = 1,
1e-8 … 1e2, rtol 1e-6; the time is that of the slowest rank, imports excluded; best of two.
"""

import argparse
import json
import os
import subprocess
import sys
import time
from pathlib import Path

FOLDER = Path(__file__).parents[1] / "demo" / "scaling"
LAUNCH = os.environ.get("LAUNCH", "mpirun -n").split()
WITHIN, OVER, STRONG, WEAK = "one packing", "ensemble", "strong", "weak"


def tasks(kind, mode, ranks):
    """Return the files of a case: they are shared by all ranks, or dealt."""
    if kind == WITHIN:
        disks = 32768 if mode == STRONG else 16384 * ranks
        return [FOLDER / f"N{disks}_p0.01_s0001.h5"]
    count = 16 if mode == STRONG else 8 * ranks
    return [FOLDER / f"N4096_p0.01_s{seed:04d}.h5" for seed in range(1, count + 1)]


def work(kind, mode):
    """Run one case on the ranks of this program; rank 0 prints its seconds and factorisations."""
    from mpi4py import MPI

    import petscjam as pj

    comm = MPI.COMM_WORLD
    files = tasks(kind, mode, comm.size)
    small = comm.bcast(pj.prepare_packing(64, 1e-2, 1) if comm.rank == 0 else None)
    pj.spectrum(small, comm=comm)  # imports
    within = kind == WITHIN
    packings = [pj.Packing.read(file) for file in (files if within else files[comm.rank :: comm.size])]
    comm.Barrier()
    start = time.perf_counter()
    made = [
        pj.spectrum(p, comm=comm if within else MPI.COMM_SELF, displacements=False).factorisations for p in packings
    ]
    seconds = comm.allreduce(time.perf_counter() - start, MPI.MAX)
    if comm.rank == 0:
        print(json.dumps({"seconds": seconds, "factorisations": made}))


def measure(ranks):
    """Return seconds by case and number of ranks, the best of two."""
    found = {}
    for kind in (WITHIN, OVER):
        for mode in (STRONG, WEAK):
            for count in ranks:
                command = [*LAUNCH, str(count), sys.executable, __file__, "--work", kind, mode]
                runs = [
                    json.loads(subprocess.run(command, check=True, capture_output=True, text=True).stdout)
                    for _ in range(2)
                ]
                best = min(runs, key=lambda run: run["seconds"])
                found[kind, mode, count] = best["seconds"]
                first = found[kind, mode, ranks[0]]
                ideal = ranks[0] / count if mode == STRONG else 1.0
                efficiency = first * ideal / best["seconds"]
                print(
                    f"{kind:12} {mode:7} {count} rank(s) {best['seconds']:7.2f} s   "
                    f"efficiency {efficiency:.2f}   factorisations {best['factorisations']}"
                )
    return found


def draw(found, ranks, path):
    """Draw time against ranks, relative to the first, beside the ideal."""
    from matplotlib.figure import Figure

    figure = Figure(figsize=(8, 3.6), layout="constrained")
    for axes, mode in zip(figure.subplots(1, 2), (STRONG, WEAK), strict=True):
        for kind, marker in ((WITHIN, "o"), (OVER, "s")):
            times = [found[kind, mode, count] / found[kind, mode, ranks[0]] for count in ranks]
            axes.plot(ranks, times, f"-{marker}", label=kind)
        ideal = [ranks[0] / count if mode == STRONG else 1.0 for count in ranks]
        axes.plot(ranks, ideal, "--", color="0.5", label="ideal")
        axes.set(xlabel="ranks", ylabel="time, relative", title=f"{mode} scaling", xticks=ranks, ylim=(0, None))
        axes.legend(frameon=False)
    figure.savefig(path, dpi=150)


def main():
    """Measure, print and draw."""
    parser = argparse.ArgumentParser()
    parser.add_argument("--ranks", default="1,2")
    parser.add_argument("-o", "--output", type=Path, default=FOLDER / "scaling.png")
    parser.add_argument("--work", nargs=2)
    options = parser.parse_args()
    if options.work:
        work(*options.work)
        return
    ranks = [int(count) for count in options.ranks.split(",")]
    sizes = {32768, *(16384 * count for count in ranks)}
    for disks, seeds in [*((size, "1:1") for size in sorted(sizes)), (4096, f"1:{max(16, 8 * max(ranks))}")]:
        command = ["prepare", "--particles", str(disks), "--pressure", "1e-2", "--seeds", seeds, "--resume"]
        subprocess.run([sys.executable, "-m", "petscjam", *command, "-o", str(FOLDER)], check=True)
    draw(measure(ranks), ranks, options.output)


if __name__ == "__main__":
    main()
