"""Outputs that cannot be written, or must not be: refused before any work, and nothing is left behind."""

import os
import stat
import subprocess
import sys
from pathlib import Path

import helpers
import pytest
from helpers import SIXTEEN

import petscjam as pj
from petscjam.base.errors import InputError
from petscjam.base.files import check_output, write_atomically
from petscjam.cli import main

pytestmark = pytest.mark.parallel(nprocs=1)
SHEAR = ["shear", "--particles", "16", "--rate", "1e-2", "--strain", "0.2"]


@pytest.fixture
def packing(tmp_path):
    pj.import_packing(SIXTEEN).write(tmp_path / "p.h5")
    return tmp_path / "p.h5"


@pytest.fixture
def run(tmp_path):
    assert main([*SHEAR, "-o", str(tmp_path / "run.h5")]) == 0
    return tmp_path / "run.h5"


def refused(capfd, *arguments):
    """Run, expect exit status 2, one line on standard error and no change of any file; return the line."""
    here = Path(arguments[-1]).parent
    before = content(here)
    err = helpers.refused(capfd, *arguments)
    assert content(here) == before
    return err


def content(folder):
    files = [path for path in folder.rglob("*") if not path.is_fifo()]
    return {path: path.read_bytes() if path.is_file() else os.path.realpath(path) for path in files}


# An input is never an output


@pytest.mark.parametrize("make", [lambda a, b: b.symlink_to(a), lambda a, b: b.hardlink_to(a), None])
@pytest.mark.parametrize("verb", ["export", "plot", "shear", "import", "moduli"])
def test_an_input_is_no_output(run, tmp_path, capfd, verb, make):
    run = run.rename(tmp_path / "run")  # an ending may be that of another format
    output = run
    if make:
        output = tmp_path / "other"
        make(run, output)
    given = {
        "export": ["export", run, "--to", "csv"],
        "plot": ["plot", run],
        "import": ["import", run],
        "shear": [*SHEAR[:1], *SHEAR[3:], "--start", run],
        "moduli": ["moduli", run],
    }
    assert "is an input, too" in refused(capfd, *given[verb], "--overwrite", "-o", output)


def test_a_file_of_settings_is_no_output(tmp_path, capfd):
    (tmp_path / "a.toml").write_text("particles = 16\n")
    config = ["--config", tmp_path / "a.toml", "--overwrite", "-o", tmp_path / "a.toml"]
    assert "is an input, too" in refused(capfd, "prepare", *config)


def test_a_packing_that_is_given_is_not_quenched_into(run, tmp_path, capfd):
    pj.import_packing(SIXTEEN).write(tmp_path / "run.quenched.h5")
    given = ["moduli", run, tmp_path / "run.quenched.h5", "--overwrite", "-o", tmp_path / "g.h5"]
    assert "is an input, too" in refused(capfd, *given)


# Where an output lies


@pytest.mark.parametrize("verb", [["prepare", "--particles", "16"], SHEAR, ["import", SIXTEEN]])
def test_outputs_that_cannot_be_written(tmp_path, capfd, verb):
    os.mkfifo(tmp_path / "pipe")
    (tmp_path / "link").symlink_to(tmp_path / "none" / "p.h5")
    (tmp_path / "round").symlink_to(tmp_path / "round")
    for name, words in (
        ("none/p.h5", "there is no folder"),
        ("link", "there is no folder"),
        ("round", "is a link that points to itself"),
        ("pipe", "is a device or a pipe"),
        ("x" * 250, "the name is too long"),
        ("µ" * 120, "the name is too long"),
    ):
        assert words in refused(capfd, *verb, "--overwrite", "-o", tmp_path / name)
    assert (tmp_path / "pipe").is_fifo()


def test_no_device_is_replaced():
    with pytest.raises(InputError, match="is a device"):
        check_output("/dev/null", overwrite=True)


@pytest.mark.skipif(os.geteuid() == 0, reason="root may write everywhere")
def test_a_folder_that_cannot_be_written(tmp_path, capfd):
    (tmp_path / "closed").mkdir(mode=0o500)
    assert "is not writable" in refused(capfd, *SHEAR, "-o", tmp_path / "closed" / "run.h5")


def test_the_longest_name_can_be_written(tmp_path):
    name = "x" * (os.pathconf(tmp_path, "PC_NAME_MAX") - 24)
    check_output(tmp_path / name, overwrite=False)
    write_atomically(tmp_path / name, b"new")


@pytest.mark.parametrize("verb", [["prepare", "--particles", "16"], SHEAR, ["moduli", SIXTEEN]])
def test_an_empty_name_is_no_folder(tmp_path, capfd, monkeypatch, verb):
    monkeypatch.chdir(tmp_path)
    assert main([*map(str, verb), "-o", ""]) == 2
    assert main(["info", ""]) == 2
    assert capfd.readouterr().err.count("the name is empty") == 2
    assert list(tmp_path.iterdir()) == []


def test_a_refused_command_leaves_no_folder(run, tmp_path, capfd):
    new = tmp_path / "new" / "folder"
    for verb in (
        ["prepare", "--particles", "16,17", "--pressure", "1e-2", "--ratio", "-1"],
        [*SHEAR, "--Q=-1,-2"],
        ["figure", "bt2", "--preset", "none"],
    ):
        refused(capfd, *verb, "-o", new)
    refused(capfd, *SHEAR, "--frames", "2", "--start", SIXTEEN, "-o", tmp_path / "r.h5")
    assert not new.parent.exists()


# How an output is written


def test_the_mode_stays(tmp_path):
    file = tmp_path / "a"
    write_atomically(file, b"old")
    file.chmod(0o640)
    write_atomically(file, b"new")
    assert stat.S_IMODE(file.stat().st_mode) == 0o640
    assert file.read_bytes() == b"new"


@pytest.mark.parametrize("data", [b"longer than before", b"x"])
def test_hard_links_stay(tmp_path, data):
    write_atomically(tmp_path / "a", b"of some length")
    (tmp_path / "b").hardlink_to(tmp_path / "a")
    write_atomically(tmp_path / "a", data)
    assert (tmp_path / "b").read_bytes() == data
    assert (tmp_path / "a").samefile(tmp_path / "b")
    assert len(list(tmp_path.iterdir())) == 2


def test_a_hard_link_on_a_full_disk_leaves_the_whole(tmp_path):
    code = """
import errno, os, sys
from petscjam.base import files as storage
from petscjam.base.errors import InputError
write, calls = storage._write_through, []
def full(file, data):
    calls.append(1)
    if len(calls) > 1:
        raise OSError(errno.ENOSPC, "No space left on device")
    write(file, data)
storage._write_through = full
try:
    storage.write_atomically(sys.argv[1], b"new")
except InputError as error:
    print(error)
"""
    (tmp_path / "a").write_bytes(b"old")
    (tmp_path / "b").hardlink_to(tmp_path / "a")
    command = [sys.executable, "-c", code, tmp_path / "a"]
    said = subprocess.run(command, capture_output=True, text=True, check=True).stdout
    (part,) = tmp_path.glob(".a.*.part")
    assert said == f"{tmp_path / 'a'}: cannot be overwritten; the complete file is {part}: No space left on device\n"
    assert part.read_bytes() == b"new"


def test_a_link_in_the_place_of_a_temporary_file_is_not_followed(tmp_path):
    (tmp_path / "precious").write_bytes(b"old")
    (tmp_path / f".a.{os.getpid()}.part").symlink_to(tmp_path / "precious")
    write_atomically(tmp_path / "a", b"new")
    assert (tmp_path / "precious").read_bytes() == b"old"
    assert not (tmp_path / "a").is_symlink()


# Frames


def frames(folder):
    return sorted(file.name for file in folder.with_suffix(".frames").iterdir())


def test_the_frames_are_those_of_the_run(tmp_path, capfd):
    out = tmp_path / "r.h5"
    assert main([*SHEAR, "--frames", "4", "-o", str(out)]) == 0
    assert len(frames(out)) == 4
    assert main([*SHEAR, "--frames", "2", "--overwrite", "-o", str(out)]) == 0
    assert len(frames(out)) == 2
    (out.with_suffix(".frames") / "notes.txt").touch()
    assert main([*SHEAR, "--overwrite", "-o", str(out)]) == 0
    assert frames(out) == ["notes.txt"]


def test_frames_of_another_run_are_not_mixed_in(tmp_path, capfd):
    out = tmp_path / "r.h5"
    assert main([*SHEAR, "--frames", "4", "-o", str(out)]) == 0
    out.unlink()
    assert "is of another run" in refused(capfd, *SHEAR, "--frames", "2", "-o", out)


def test_a_resumed_run_keeps_its_frames(tmp_path):
    out = tmp_path / "r.h5"
    assert main([*SHEAR, "--frames", "2", "-o", str(out)]) == 0
    assert main([*SHEAR, "--frames", "2", "--resume", "-o", str(out)]) == 0
    assert len(frames(out)) == 2
