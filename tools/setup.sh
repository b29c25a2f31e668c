#!/usr/bin/env bash
# Make .venv on Debian: Debian's complex PETSc, SLEPc, MUMPS and Open MPI, the rest from PyPI.
# Usage: tools/setup.sh [EXTRA...]    (extras of pyproject.toml; default: test dev)
set -euo pipefail
cd "$(dirname "$0")/.."
[ $# -gt 0 ] || set -- test dev

packages=(python3 python3-venv python3-petsc4py-complex python3-slepc4py-complex
    python3-mpi4py python3-h5py-mpi openmpi-bin libopenblas0-pthread)

if ! [ -e /etc/debian_version ] || ! command -v apt-get >/dev/null; then
    echo "tools/setup.sh needs Debian's apt-get; docs/install.md tells how to use another complex PETSc." >&2
    exit 1
fi

missing=()
for package in "${packages[@]}"; do
    [ "$(dpkg-query -W -f='${db:Status-Status}' "$package" 2>/dev/null)" = installed ] || missing+=("$package")
done
if [ ${#missing[@]} -gt 0 ]; then
    echo "Installing with apt-get: ${missing[*]}"
    as_root() { if [ "$(id -u)" = 0 ]; then "$@"; else sudo "$@"; fi; }
    as_root apt-get update -q
    as_root env DEBIAN_FRONTEND=noninteractive apt-get install -q -y --no-install-recommends "${missing[@]}"
fi

[ -x .venv/bin/python ] || /usr/bin/python3 -m venv --system-site-packages .venv

# Debian keeps complex PETSc and SLEPc outside Python's path; a .pth file puts them on it.
site=$(.venv/bin/python -c 'import sysconfig; print(sysconfig.get_path("purelib"))')
for library in petsc slepc; do
    printf '%s\n' /usr/lib/${library}dir/${library}*/*-complex/lib/python3/dist-packages | sort -V | tail -n 1
done >"$site/complex-petsc.pth"

# --no-deps for the package itself: tools/requirements.py says why.
pip=(.venv/bin/python -m pip --disable-pip-version-check install -q)
.venv/bin/python tools/requirements.py "$@" >.venv/requirements.txt
"${pip[@]}" -c tools/constraints-debian.txt -r .venv/requirements.txt
"${pip[@]}" --no-deps --no-build-isolation -e .

.venv/bin/python tools/check_stack.py
