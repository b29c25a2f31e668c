#!/usr/bin/env bash
# Make .venv-newest: the newest PETSc and SLEPc from PyPI, compiled on Debian's MUMPS. About 20 minutes.
set -euo pipefail
cd "$(dirname "$0")/.."
version=${PETSC_VERSION:-3.26.1}
packages=(gcc g++ gfortran make python3-dev python3-venv openmpi-bin libopenmpi-dev
    libmumps-dev libscalapack-openmpi-dev libopenblas-dev)

missing=()
for package in "${packages[@]}"; do
    [ "$(dpkg-query -W -f='${db:Status-Status}' "$package" 2>/dev/null)" = installed ] || missing+=("$package")
done
if [ ${#missing[@]} -gt 0 ]; then
    as_root() { if [ "$(id -u)" = 0 ]; then "$@"; else sudo "$@"; fi; }
    as_root apt-get update -q
    as_root env DEBIAN_FRONTEND=noninteractive apt-get install -q -y --no-install-recommends "${missing[@]}"
fi

[ -x .venv-newest/bin/python ] || /usr/bin/python3 -m venv .venv-newest
python=.venv-newest/bin/python
pip=("$python" -m pip --disable-pip-version-check install -q)
# Libraries compiled here know the folder of the others; one from pip's cache may know another folder.
compile=("${pip[@]}" --no-cache-dir)

mumps=$(dirname "$(dpkg -L libmumps-dev libmumps-headers-dev 2>/dev/null | grep -m 1 '/zmumps_c\.h$')")
export PETSC_CONFIGURE_OPTIONS="--with-scalar-type=complex --with-debugging=0 --with-x=0 \
--with-mumps-include=$mumps \
--with-mumps-lib=[-lsmumps,-ldmumps,-lcmumps,-lzmumps,-lmumps_common,-lpord] \
--with-scalapack-lib=-lscalapack-openmpi"

. tools/mpi-env.sh
"${pip[@]}" numpy mpi4py cython wheel 'setuptools>=77'
"${compile[@]}" "petsc==$version"
PETSC_DIR=$("$python" -c 'import petsc; print(petsc.get_petsc_dir())')
export PETSC_DIR
# Without -g0 the compiler of the bindings needs 7 GB.
CFLAGS=-g0 "${compile[@]}" --no-build-isolation "petsc4py==$version"
"${compile[@]}" "slepc==$version"
SLEPC_DIR=$("$python" -c 'import slepc; print(slepc.get_slepc_dir())')
export SLEPC_DIR
CFLAGS=-g0 "${compile[@]}" --no-build-isolation "slepc4py==$version"
"${pip[@]}" --no-build-isolation -e '.[test]'

"$python" tools/check_stack.py
