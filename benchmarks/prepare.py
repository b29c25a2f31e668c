"""Seconds to prepare packings by conjugate gradients and by FIRE, after a first one that compiles.

python benchmarks/prepare.py [N:PRESSURE:SEEDS …]
"""

import sys
import time

import numpy as np

import petscjam as pj

CASES = ["1024:1e-2:10", "1024:1e-3:10", "1024:1e-4:5", "1024:1e-5:5", "4096:1e-3:3"]


def main():
    """Measure and print."""
    print(
        f"{'N':>6} {'p':>6}  method   mean s   max s  worst force/(p d)  worst pressure error  negative modes"
    )
    for case in sys.argv[1:] or CASES:
        n, pressure, seeds = int(case.split(":")[0]), float(case.split(":")[1]), int(case.split(":")[2])
        for method in ("cg", "fire"):
            pj.prepare_packing(64, 1e-2, method=method)
            seconds, certificates = [], []
            for seed in range(1, seeds + 1):
                start = time.perf_counter()
                certificates.append(pj.prepare_packing(n, pressure, seed, method=method).certificate)
                seconds.append(time.perf_counter() - start)
            force, error, modes = (
                max(getattr(c, name) for c in certificates)
                for name in ("max_force", "pressure_error", "negative_modes")
            )
            print(f"{n:6d} {pressure:6.0e}  {method:6s} {np.mean(seconds):8.2f} {max(seconds):7.2f} "
                  f"{force:18.1e} {error:21.1e} {modes:15d}", flush=True)  # fmt: skip


if __name__ == "__main__":
    main()
