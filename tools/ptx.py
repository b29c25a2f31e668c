"""Compile the kernels of the engine for NVIDIA GPUs without one, and print what ptxas says of registers and memory.

It needs petscjam[cuda] with the wheels of the compiler: pip install "numba-cuda[cu12]".
"""

import re
import subprocess
import sys
import tempfile
from pathlib import Path
from types import SimpleNamespace

import numpy as np
from numba import cuda, from_dtype, types
from numba.cuda import dispatcher

from petscjam.geometry.potential import POTENTIALS
from petscjam.md import cuda_kernels as card

CC = (9, 0)  # H100, H200
dispatcher.get_current_device = lambda: SimpleNamespace(compute_capability=CC)  # device functions ask for it
ptxas = next(Path(sys.prefix).rglob("ptxas"))
arrays = [types.Array(from_dtype(np.dtype(kind)), len(axes), "C") for kind, axes in card.SHAPES.values()]
runs = types.NamedTuple(arrays, card.Runs)
potential = POTENTIALS[sys.argv[1] if sys.argv[1:] else "harmonic-relative"]
for integrator in ("heun", "single"):
    for wide, threads in ((False, 512), (True, 512), (True, 1024)):
        kernels = card.compiled(integrator, potential, True, wide, threads)
        for name, kernel in zip(("advance", "look"), kernels, strict=True):
            ptx, _ = cuda.compile(kernel.py_func, (runs,), device=False, abi="numba", cc=CC)
            with tempfile.TemporaryDirectory() as folder:
                Path(folder, "k.ptx").write_text(ptx)
                command = [
                    ptxas,
                    "-v",
                    "-c",
                    "-arch=sm_90",
                    f"--maxrregcount={card.REGISTERS // threads}",
                    "k.ptx",
                    "-o",
                    "k.o",
                ]
                done = subprocess.run(command, cwd=folder, capture_output=True, text=True)
            said = re.findall(r"\d+ bytes stack.*|Used \d+ registers.*|ptxas (?:fatal|error).*", done.stderr)
            generic = len(re.findall(r"\bld\.(?:volatile\.)?[bfsu]\d", ptx))
            print(
                integrator, "grid" if wide else "block", threads, name, ptx.count("ld.shared"), generic, *said, sep="; "
            )
            if done.returncode:
                sys.exit(1)
