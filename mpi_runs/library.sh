#!/usr/bin/env bash
# A library of packings, its table and its figure. Edit mpi_runs/library.toml, then: bash mpi_runs/library.sh
# A second start continues where the first stopped. LAUNCH, PYTHON and FOLDER may be set in the environment; options
# of petscjam prepare may be given, too: bash mpi_runs/library.sh --seeds 1:20
set -euo pipefail
cd "$(dirname "$0")/.."
. tools/mpi-env.sh
launch=${LAUNCH:-mpirun -n 2}
folder=${FOLDER:-runs/library}

$launch petscjam prepare --config mpi_runs/library.toml "$@" --resume -o "$folder"
petscjam info "$folder"
petscjam plot "$folder" --overwrite
