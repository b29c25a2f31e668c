"""tools/setup.sh where only few programs exist: what cannot work is refused before anything is installed."""

import shutil
import subprocess
import sys
from pathlib import Path

import pytest

SETUP = Path(__file__).parents[1] / "tools" / "setup.sh"
TAKEN = ("bash", "dirname", "grep", "sed")  # from this machine; id says that we are no root
APT = {"apt-get": "exit 0", "dpkg": "exit 0", "dpkg-query": "exit 1"}  # no package is installed


@pytest.fixture
def machine(tmp_path):
    """Return a function that runs the script where only ``programs`` exist: shell scripts by name."""
    folder = tmp_path / "bin"
    folder.mkdir()
    for name in TAKEN:
        (folder / name).symlink_to(shutil.which(name))
    (tmp_path / "tools").mkdir()
    script, log = shutil.copy(SETUP, tmp_path / "tools"), tmp_path / "calls"
    log.touch()

    def run(stack=None, programs=()):
        for name, text in {"id": "echo 1000", **dict(programs)}.items():
            (folder / name).write_text(f'#!{folder}/bash\necho "{name} $*" >>{log}\n{text}\n')
            (folder / name).chmod(0o755)
        environment = {"PATH": str(folder)} | ({"STACK": stack} if stack else {})
        done = subprocess.run([folder / "bash", script], env=environment, capture_output=True, text=True)
        assert done.returncode == 1
        assert "install" not in log.read_text()
        assert done.stderr.count("\n") == 1
        return done.stderr

    return run


def test_an_unknown_stack(machine):
    assert machine("conda") == "petscjam: STACK is wheel or debian, not conda.\n"


@pytest.mark.parametrize("shim", ["exit 127", "exit 1"])
def test_a_python_that_does_not_run_is_none(machine, shim):
    said = machine("wheel", {"python3.12": shim, "python3": shim})
    assert "STACK=wheel needs a Python 3.12 or newer" in said


@pytest.mark.skipif(sys.version_info >= (3, 12), reason="this Python may take the wheel")
def test_a_python_that_is_too_old(machine):
    assert "STACK=wheel needs a Python 3.12" in machine("wheel", {"python3": f'exec {sys.executable} "$@"'})


def test_neither_a_python_nor_apt_get(machine):
    said = machine()
    assert "no apt-get here" in said
    assert "Take a Python 3.12 or newer" in said


def test_the_python_of_ubuntu_22_is_too_old(machine):
    said = machine(None, APT | {"dpkg": "exit 1", "apt-cache": "echo '  Candidate: 3.10.4-0ubuntu2'"})
    assert "Python is 3.10.4 here; Debian's packages are for Debian 12, Ubuntu 24.04 and newer." in said


def test_neither_root_nor_sudo(machine):
    said = machine(None, APT | {"apt-cache": "echo '  Candidate: 3.11.2-1'"})
    assert "neither root nor sudo to install python3 " in said


def test_packages_that_apt_get_does_not_know(machine):
    cache = 'case $2 in *petsc*) echo "  Candidate: (none)" ;; *) echo "  Candidate: 3.11.2-1" ;; esac'
    said = machine(None, APT | {"id": "echo 0", "apt-cache": cache})
    assert "apt-get knows no package python3-petsc4py-complex here" in said


def test_every_target_of_make_has_a_recipe_and_a_line_of_help():
    root = SETUP.parents[1]
    listed = subprocess.run(["make", "--no-print-directory", "help"], cwd=root, capture_output=True, text=True)
    assert listed.returncode == 0, listed.stderr
    phony = next(line for line in (root / "Makefile").read_text().replace("\\\n", "").splitlines() if ".PHONY:" in line)
    assert {line.split()[0] for line in listed.stdout.splitlines()} == set(phony.split()[1:])
