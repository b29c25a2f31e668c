"""Signals: the work stops where it can, finished results are kept, and --resume does the rest."""

import os
import random
import signal
import subprocess
import sys
import time
from pathlib import Path

import h5py
import numpy as np
import pytest

import petscjam as pj
from petscjam.base.interrupt import Interrupted, check, deferred, listening
from petscjam.cli import main
from petscjam.md.simulation import Simulation
from petscjam.parallel.comm import on_root, raise_together
from petscjam.parallel.solver import DirectSolver

STATUS = {signal.SIGINT: 130, signal.SIGTERM: 143}
SHORT = {"n": 64, "rate": 1e-2, "strain": 1.0, "seed": 1}


def content(path):
    """Everything in a file, or the files of a folder, but what tells the time or the memory that it took."""
    if path.is_dir():
        return {file.name: content(file) for file in sorted(path.glob("*.h5"))}
    found = {}

    def take(name, item):
        if "performance" not in name:
            found.update({f"{name}@{key}": np.array(value).tobytes() for key, value in item.attrs.items()})
            if isinstance(item, h5py.Dataset):
                found[name] = np.array(item[()]).tobytes()

    with h5py.File(path) as file:
        file.visititems(take)
    return found


def signal_at(monkeypatch, owner, name, count, number=signal.SIGINT):
    """Let this process get a signal at the ``count``-th call of a method."""
    usual, calls = getattr(owner, name), []

    def method(self, *arguments):
        calls.append(name)
        if len(calls) == count:
            os.kill(os.getpid(), number)
        return usual(self, *arguments)

    monkeypatch.setattr(owner, name, method)


def test_a_signal_waits_for_a_check():
    reached = []
    with pytest.raises(KeyboardInterrupt), deferred():
        os.kill(os.getpid(), signal.SIGINT)
        reached.append(1)
        check()
        reached.append(2)
    assert reached == [1]
    assert signal.getsignal(signal.SIGINT) is signal.default_int_handler


def test_a_signal_is_not_forgotten_where_nothing_checks():
    with pytest.raises(KeyboardInterrupt), deferred():
        os.kill(os.getpid(), signal.SIGINT)


def test_an_error_does_not_hide_a_signal():
    with pytest.raises(KeyboardInterrupt), deferred():
        os.kill(os.getpid(), signal.SIGINT)
        raise ValueError


def test_an_inner_block_leaves_the_signal_to_the_outer_one():
    reached = []
    with pytest.raises(KeyboardInterrupt), deferred():
        with deferred():
            os.kill(os.getpid(), signal.SIGINT)
        reached.append(1)
    assert reached == [1]


def test_handlers_of_others_stay(monkeypatch):
    got = []
    usual = signal.signal(signal.SIGINT, lambda *_: got.append(1))
    try:
        with deferred():
            os.kill(os.getpid(), signal.SIGINT)
    finally:
        signal.signal(signal.SIGINT, usual)
    assert got == [1]


@pytest.mark.parametrize("count", [1, 8, 63, 64])
def test_a_run_interrupted_within_a_row_goes_on_bit_for_bit(tmp_path, monkeypatch, count):
    whole = pj.md.shear(**SHORT, output=tmp_path / "a.h5")
    with monkeypatch.context() as patch:
        signal_at(patch, Simulation, "sample", count)
        with pytest.raises(KeyboardInterrupt):
            pj.md.shear(**SHORT, output=tmp_path / "b.h5")
    stopped = pj.md.result.read(tmp_path / "b.h5")
    assert 0 < len(stopped.strain) < len(whole.strain)
    pj.md.shear(**SHORT, output=tmp_path / "b.h5", resume=True)
    assert content(tmp_path / "a.h5") == content(tmp_path / "b.h5")


@pytest.mark.parametrize("error", [MemoryError, RuntimeError, KeyboardInterrupt])
def test_an_error_within_a_row_leaves_the_last_whole_one(tmp_path, monkeypatch, error):
    pj.md.shear(**SHORT, output=tmp_path / "a.h5")
    usual, calls = Simulation.sample, []

    def sample(self, *arguments):
        calls.append(1)
        if len(calls) == 58:
            raise error
        return usual(self, *arguments)

    with monkeypatch.context() as patch:
        patch.setattr(Simulation, "sample", sample)
        with pytest.raises(error):
            pj.md.shear(**SHORT, output=tmp_path / "b.h5")
    stopped = pj.md.result.read(tmp_path / "b.h5")
    assert stopped.blocks["samples"].sum() == 5 * len(stopped.strain)
    pj.md.shear(**SHORT, output=tmp_path / "b.h5", resume=True)
    assert content(tmp_path / "a.h5") == content(tmp_path / "b.h5")


@pytest.mark.parametrize("number", STATUS)
def test_the_command_says_what_stopped_it(tmp_path, monkeypatch, capsys, number):
    signal_at(monkeypatch, Simulation, "sample", 8, number)
    out = tmp_path / "run.h5"
    arguments = ["shear", "--particles", "64", "--rate", "1e-2", "--strain", "1", "-o", str(out)]
    assert main(arguments) == STATUS[number]
    error = capsys.readouterr().err
    assert error == f"petscjam: stopped by {number.name}; finished results are kept\n"
    assert out.exists()


@pytest.mark.parallel([1, 2])
def test_ranks_stop_together_and_go_on(comm, monkeypatch):
    packing = pj.import_packing(Path(__file__).parent / "data" / "jambashbulk-N16-P1e-3-0001.txt")
    expected = pj.spectrum(packing, (1e-3, 1.0), comm=comm)
    with monkeypatch.context() as patch:
        if comm.rank == comm.size - 1:
            signal_at(patch, DirectSolver, "factor", 2)
        with pytest.raises(KeyboardInterrupt):
            pj.spectrum(packing, (1e-3, 1.0), comm=comm)
    again = pj.spectrum(packing, (1e-3, 1.0), comm=comm)
    omega = np.geomspace(1e-3, 1.0, 5)
    assert again(omega) == pytest.approx(expected(omega), rel=1e-9)


@pytest.mark.parallel(2)
def test_a_signal_to_one_rank_reaches_those_that_wait_for_it(comm):
    def work():
        os.kill(os.getpid(), signal.SIGINT)
        check()

    with listening(signal.SIGINT):
        with pytest.raises(Interrupted):
            on_root(comm, work)
        with pytest.raises(Interrupted):
            raise_together(comm, Interrupted(signal.SIGTERM) if comm.rank else None)


@pytest.mark.parallel(2)
def test_moduli_on_two_ranks_stop_and_resume(comm, tmp_path, monkeypatch, capsys):
    folder = Path(comm.bcast(str(tmp_path)))
    pj.prepare_library(folder / "lib", [16], [1e-2], [1, 2, 3], comm=comm)
    wanted = ["moduli", str(folder / "lib"), "--omega", "1e-3:1:4", "--beta", "0.1,1"]
    assert main([*wanted, "-o", str(folder / "a.h5")]) == 0
    with monkeypatch.context() as patch:
        signal_at(patch, DirectSolver, "factor", 5, signal.SIGTERM)
        assert main([*wanted, "-o", str(folder / "b.h5")]) == 143
    assert main([*wanted, "-o", str(folder / "b.h5"), "--resume"]) == 0
    if comm.rank == 0:
        assert content(folder / "a.h5") == content(folder / "b.h5")


VERBS = {
    "shear": "shear --particles 256 --rate 1e-2 --strain 4 -o {out}",
    "moduli": "moduli {lib} --omega 1e-4:10:9 --beta 0.1,1 -o {out}",
    "prepare": "prepare --particles 256 --pressure 1e-2,1e-3 --seeds 1:3 -o {out}",
}


def stop_at_random(verb, tmp_path, environment, stops, seed):
    """Stop a command as often by each signal, at random moments, and resume; compare with one without a signal."""
    pj.prepare_library(tmp_path / "lib", [64], [1e-2], range(1, 7))
    out, reference = tmp_path / f"{verb}-stopped.h5", tmp_path / f"{verb}.h5"
    draw, left = random.Random(seed), {signal.SIGINT: stops, signal.SIGTERM: stops}

    def command(output, *more):
        words = VERBS[verb].format(lib=tmp_path / "lib", out=output).split()
        program = subprocess.Popen(
            [sys.executable, "-m", "petscjam", *words, *more],
            env=environment,
            stdout=subprocess.DEVNULL,
            stderr=subprocess.PIPE,
            text=True,
        )
        while program.poll() is None and not listens(program.pid):
            time.sleep(0.01)
        return program

    for _ in range(2):  # the first one may compile
        clear(reference)
        program, start = command(reference), time.monotonic()
        assert program.communicate()[1].count("Traceback") == 0
        assert program.returncode == 0
        longest = time.monotonic() - start
    for _ in range(10 * stops + 10):  # a signal that comes too late stops nothing
        number = max(left, key=left.get)
        if left[number] == 0:
            break
        program = command(out, "--resume")
        time.sleep(draw.uniform(0, longest))
        program.send_signal(number)
        error = program.communicate(timeout=300)[1]
        finished = program.returncode in (0, -number)  # when Python ends, handlers are gone
        assert finished or program.returncode == STATUS[number], error
        said = [line for line in error.splitlines() if line.startswith("petscjam:")]
        line = f"petscjam: stopped by {number.name}; finished results are kept"
        assert said == [line] * (not finished)
        assert "Traceback" not in error
        left[number] -= not finished
        if finished:
            assert content(out) == content(reference)
            clear(out)
    program = command(out, "--resume")
    assert (program.communicate()[0], program.returncode) == (None, 0)
    assert content(out) == content(reference)
    assert not any(left.values())


def listens(pid):
    """Whether the process catches SIGTERM."""
    try:
        status = Path(f"/proc/{pid}/status").read_text()
    except OSError:
        return False
    caught = next(line for line in status.splitlines() if line.startswith("SigCgt"))
    return bool(int(caught.split()[1], 16) & 1 << (signal.SIGTERM - 1))


def clear(path):
    for file in [*path.glob("*")] if path.is_dir() else [path]:
        file.unlink(missing_ok=True)


@pytest.mark.parametrize("verb", VERBS)
def test_a_few_signals_at_random_moments(verb, tmp_path, environment):
    stop_at_random(verb, tmp_path, environment, stops=1, seed=1)


@pytest.mark.slow
@pytest.mark.parametrize("verb", VERBS)
def test_many_signals_at_random_moments(verb, tmp_path, environment):
    stop_at_random(verb, tmp_path, environment, stops=20, seed=2)
