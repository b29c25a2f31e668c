#!/usr/bin/env bash
# Sheared disks as in Vagberg, Olsson & Teitel 2017, at sizes for two cores; hours, resumable: runs/vot.
set -euo pipefail
cd "$(dirname "$0")/.."
. tools/mpi-env.sh
out=${1:-runs/vot}
mkdir -p "$out"
shear() { mpirun -n 2 petscjam "$@" --resume; }

# CD at φ = 0.82: Newtonian below Qc, Bagnoldian above (VOT fig. 2)
shear shear --model CD --particles 1024 --phi 0.82 --Q 1,5,20,70,100,150 --rate 1e-5 --strain 2 --dt 0.1 -o "$out/CD"
# CD_rot at Q = 1: Bagnoldian at φ = 0.76, Newtonian at 0.82 (VOT figs. 11, 16)
shear shear --model CD_rot --particles 1024 --phi 0.76,0.82 --rate 1e-4 --strain 10 -o "$out/CD_rot"
shear shear --model CD_rot --particles 1024 --phi 0.76,0.82 --rate 1e-5 --strain 2 -o "$out/CD_rot"
# the Newtonian band at P = 2e-5
shear shear --model CD_rot --particles 1024 --phi 0.809 --rate 4.2e-6 --strain 1.5 -o "$out/newtonian.h5"
# shear bands, from a Newtonian state that is divided into two phases (VOT fig. 28)
newton="--model CD_rot --particles 16384 --phi 0.7984 --integrator single --rate 3e-4 --strain 0.5"
bands="--model CD_rot --integrator single --rate 3e-5 --strain 4 --row-time 80"
shear shear $newton -o "$out/newton.h5"
shear shear $bands --start "$out/newton.h5" --start-bands 0.7880:6.2e-5,0.8090:4.2e-6 -o "$out/bands.h5"
petscjam info "$out/bands.h5"
# a ramp across the coexistence region
shear ramp --model CD_rot --particles 4096 --phi 0.802 --rate 3e-6 --to 1e-4 --kappa 1e-5 -o "$out/ramp.h5"

for name in CD CD_rot bands ramp; do
    file=$out/$name
    [ -d "$file" ] || file=$file.h5
    petscjam plot "$file" --overwrite -o "$out/$name.png"
done
petscjam plot "$out/bands.h5" --maps --overwrite -o "$out/bands-maps.png"
