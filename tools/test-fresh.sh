#!/usr/bin/env bash
# Try the project as newcomers do: a bare Debian 12 and 13, a clone of the last commit, demo, lint and tests with each
# stack. Called by make test-fresh, as root; needs debootstrap. Usage: tools/test-fresh.sh [bookworm] [trixie]
# FRESH names a folder to keep the systems in until the next run; MIRROR is where Debian's packages are.
set -euo pipefail
cd "$(dirname "$0")/.."
mirror=${MIRROR:-http://deb.debian.org/debian}
if [ "$(id -u)" != 0 ] || ! command -v debootstrap >/dev/null; then
    echo "tools/test-fresh.sh needs root and debootstrap (apt-get install debootstrap)." >&2
    exit 1
fi
if [ -n "${FRESH:-}" ]; then
    fresh=$FRESH && mkdir -p "$fresh"
else
    fresh=$(mktemp -d -t petscjam-fresh-XXXX)
    trap 'rm -rf --one-file-system "$fresh"' EXIT
fi

# Make the system of a suite, with a user, git, make and Python, and a clone in that user's home.
bare() {
    root=$fresh/$1
    rm -rf --one-file-system "$root"
    echo "== $1: debootstrap"
    debootstrap --variant=minbase --include=ca-certificates,git,make,python3 "$1" "$root" "$mirror" >"$root.log" 2>&1 ||
        { tail -n 5 "$root.log" >&2; exit 1; }
    chroot "$root" useradd --create-home newcomer
    # How this machine reaches the net.
    for file in /etc/resolv.conf /etc/hosts /etc/pip.conf /etc/ssl/certs/ca-certificates.crt; do
        [ ! -e $file ] || install -D -m 644 $file "$root$file"
    done
    git clone -q . "$root/home/newcomer/petscjam"
    chroot "$root" chown -R newcomer: /home/newcomer
}

# Run a command line in the clone: as USER 'command'. Mounts and processes end with it.
as() {
    echo "== $(basename "$root"), $1: $2"
    local inside='mount --rbind /dev "$0/dev" && mount -t sysfs none "$0/sys" && exec chroot --userspec="$1" "$0" \
        env -i HOME=/home/newcomer LIMIT="${LIMIT:-1800}" PATH=/usr/sbin:/usr/bin:/sbin:/bin LANG=C.UTF-8 bash -c "cd ~/petscjam && $2"'
    time unshare --mount --pid --fork --kill-child --mount-proc="$root/proc" bash -c "$inside" "$root" "$1:$1" "$2"
}

# Expect a refusal that contains some words: refuses USER 'command' 'words'.
refuses() {
    local said
    ! said=$(as "$1" "$2" 2>&1) && grep -e "$3" <<<"$said" || { echo "$said"; echo "no refusal with '$3'" >&2; exit 1; }
}

try_bookworm() { # Python 3.11: no wheel
    bare bookworm
    refuses newcomer 'make demo' 'neither root nor sudo'
    refuses root 'make demo STACK=wheel' 'STACK=wheel needs a Python 3.12'
    as root 'make demo && .ci/run'
    as root 'make demo && test -f .venv/requirements.txt'
}

try_trixie() {
    bare trixie
    refuses newcomer 'make demo' 'has no venv: install python3.13-venv'
    as root 'apt-get update -qq && apt-get install -qq -y python3-venv >/dev/null'
    as newcomer 'make demo && .ci/run'
    as newcomer 'test -x .venv/bin/mpiexec'
    as root 'make demo STACK=debian && .ci/run && test ! -e .venv/bin/mpiexec'
}

[ $# -gt 0 ] || set -- bookworm trixie
for suite; do
    "try_$suite"
done
