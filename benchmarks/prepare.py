"""Seconds to prepare and prove packings, after a first one that compiles.

python benchmarks/prepare.py [--methods fire,cg] [--threads T] [N:PRESSURE:SEEDS …]
"""

import argparse
import resource
import time

import numpy as np

import petscjam as pj

CASES = ["1024:1e-2:10", "1024:1e-3:10", "1024:1e-4:10", "1024:1e-5:5", "4096:1e-3:3"]


def main():
    """Measure and print."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("cases", nargs="*", default=CASES, metavar="N:PRESSURE:SEEDS")
    parser.add_argument("--methods", default="fire,cg")
    parser.add_argument("--threads", type=int, default=1)
    options = parser.parse_args()
    head = "N", "p", "method", "mean s", "max s", "forces", "proved", "F/(p d)", "dp/p", "lowest", "peak MB"
    print(("{:>9}" * len(head)).format(*head))
    for case in options.cases:
        n, pressure, seeds = int(case.split(":")[0]), float(case.split(":")[1]), int(case.split(":")[2])
        for method in options.methods.split(","):
            pj.prepare_packing(64, 1e-2, method=method)
            seconds, packings = [], []
            for seed in range(1, seeds + 1):
                start = time.perf_counter()
                packings.append(pj.prepare_packing(n, pressure, seed, method=method, threads=options.threads))
                seconds.append(time.perf_counter() - start)
            made = [packing.certificate for packing in packings]
            forces = np.mean([packing.provenance["evaluations"] for packing in packings])
            peak = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 1024
            print(
                f"{n:9d}{pressure:9.0e}{method:>9}{np.mean(seconds):9.2f}{max(seconds):9.2f}{forces:9.0f}"
                f"{sum(c.proved for c in made):6d}/{seeds:2d}{max(c.max_force for c in made):9.1e}"
                f"{max(c.pressure_error for c in made):9.1e}{min(c.lowest_eigenvalue for c in made):9.1e}"
                f"{peak:9.0f}",
                flush=True,
            )


if __name__ == "__main__":
    main()
