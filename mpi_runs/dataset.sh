#!/usr/bin/env bash
# An open dataset: certified packings with G*(ω) for three modes of strain and their lowest modes, an index, checksums
# and a licence. bash mpi_runs/dataset.sh makes it, and continues where an earlier start stopped; LAUNCH, PYTHON,
# FOLDER, OMEGA and MODES may be set in the environment, and options of petscjam prepare may be given: --particles 32
# --seeds 1:2 makes a small one.
set -euo pipefail
cd "$(dirname "$0")/.."
. tools/mpi-env.sh
launch=${LAUNCH-mpirun -n 2}
folder=${FOLDER:-runs/dataset}
kept=(--resume --log "$folder/commands.log")
omega=${OMEGA:-1e-8:1e2:61} modes=${MODES:-20}

mkdir -p "$folder"
$launch petscjam prepare --config mpi_runs/dataset.toml "$@" "${kept[@]}" -o "$folder/packings"
for strain in simple-shear pure-shear compression; do
    $launch petscjam moduli "$folder/packings" --strain-mode $strain --omega "$omega" "${kept[@]}" -o "$folder/moduli-$strain.h5"
done
$launch petscjam modes "$folder/packings" --count "$modes" "${kept[@]}" -o "$folder/modes.h5"
petscjam report "$folder" --overwrite -o "$folder/report.html"
${PYTHON:-python} tools/dataset.py "$folder"
