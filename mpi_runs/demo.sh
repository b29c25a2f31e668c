#!/usr/bin/env bash
# A small example: one packing, G*(ω) over ten decades on two ranks, a figure. Called by make demo.
set -euo pipefail
cd "$(dirname "$0")/.."
. tools/mpi-env.sh
mkdir -p demo
set -x

# --resume keeps existing results.
petscjam prepare --particles 1024 --pressure 1e-3 --seed 1 --resume -o demo/packing.h5
mpirun -n 2 petscjam moduli demo/packing.h5 --omega 1e-8:1e2:61 --damping contact --beta 1 \
    --fields 1e-8,1e-3,1e2 \
    --resume -o demo/modulus.h5
petscjam plot demo/modulus.h5 --overwrite -o demo/modulus.png

{ set +x; } 2>/dev/null
echo "Made: demo/packing.h5 (1024 disks at p = 1e-3), demo/modulus.h5 (G* at 61 frequencies), demo/modulus.png"
