"""Numbers of NumPy in messages and in text files stand there as Python's: 1.4, not NumPy 2's np.float64(1.4).

conftest.py sees to the messages and files of every other test; here the numbers come from the user.
"""

from pathlib import Path

import numpy as np
import pytest

import petscjam as pj
from petscjam.base.errors import shown
from petscjam.io.lammps_shear import write_lammps
from petscjam.md.frames import write_frame
from petscjam.md.model import Model
from petscjam.md.state import State, random_state

DATA = Path(__file__).parent / "data" / "jambashbulk-N16-P1e-3-0001.txt"
f8, i8 = np.float64, np.int64


@pytest.fixture(scope="module")
def packing():
    return pj.import_packing(DATA)


@pytest.mark.parametrize(
    ("value", "expected"),
    [
        (f8(1.4), "1.4"),
        (i8(4), "4"),
        (np.float32(0.5), "0.5"),
        (np.True_, "True"),
        (np.str_("x"), "'x'"),
        ((f8(1.5), (i8(2), "x")), "(1.5, (2, 'x'))"),
        (np.array([1.0, 2.0]), "[1.0, 2.0]"),
        ("1.4", "'1.4'"),
        (None, "None"),
    ],
)
def test_a_value_in_a_message_is_pythons(value, expected):
    assert shown(value) == expected


@pytest.mark.parametrize(
    ("call", "words"),
    [
        (lambda p: pj.ContactDamping(beta=f8(-1)), "not -1.0"),
        (lambda p: pj.prepare_packing(i8(4), 1e-3, 1), "not 4"),
        (lambda p: pj.prepare_packing(16, f8(-1), 1), "not -1.0"),
        (lambda p: pj.prepare_packing(16, 1e-3, f8(0.5)), "not 0.5"),
        (lambda p: pj.prepare_packing(16, 1e-3, 1, ratio=f8(-1)), "not -1.0"),
        (lambda p: pj.prepare_packing(16, 1e-3, 1, budget=i8(0)), "not 0"),
        (lambda p: pj.prepare_library("no", [i8(16)], [1e-3], [i8(1), i8(1)]), "(16, 0.001, 1) are the same"),
        (lambda p: pj.spectrum(p, (f8(1), f8(2), f8(3))), "not (1.0, 2.0, 3.0)"),
        (lambda p: pj.spectrum(p, rtol=f8(0.5)), "not 0.5"),
        (lambda p: pj.spectrum(p, damping=f8(1)), "1.0 is not a law"),
        (lambda p: pj.lowest_modes(p, count=i8(0)), "not 0"),
        (lambda p: Model.of("CD", f8(-1)), "not -1.0"),
        (lambda p: Model.of("CD", 1.0).step(f8(-1), "heun"), "not -1.0"),
        (lambda p: random_state(i8(3), 0.8, 0), "not 3"),
        (lambda p: random_state(16, f8(-1), 0), "not -1.0"),
    ],
)
def test_a_message_shows_the_number_that_was_given(packing, call, words):
    with pytest.raises(pj.InputError) as caught:
        call(packing)
    assert words in str(caught.value)


def test_files_of_sheared_disks(tmp_path):
    s = random_state(16, 0.8, 0)
    numbers = map(f8, (s.length, 0.25, 1e-3, 7.5))
    state = State(s.positions, s.velocities, s.spins, s.radii, *numbers)
    frame = write_frame(state, tmp_path, i8(3)).read_text()
    assert f' 0 0 0 {2 * s.radii.max():.12g}"' in frame
    assert " Time=7.5 strain=0.25 rate=0.001 " in frame
    numbers = {"rate": f8(1e-3), "strain": f8(0.1), "dt": f8(0.01), "every": i8(5)}
    write_lammps(state, Model.of("CD_n", f8(2)), tmp_path / "lammps", **numbers)
    assert "variable rate index 0.001\nvariable dt index 0.01\n" in (tmp_path / "lammps/in.shear").read_text()
    assert "disks at a strain of 0.25" in (tmp_path / "lammps/disks.data").read_text()


def test_files_of_moduli(packing, tmp_path):
    law = pj.ContactDamping(beta=f8(0.5))
    made = pj.spectrum(packing, (f8(1e-2), f8(1e2)), damping=law)
    for fmt, words in (("csv", str(pj.ContactDamping(beta=0.5))), ("gt", f"{float(made.eta_inf)} delta(t)")):
        pj.export_rheology(made, tmp_path / fmt, fmt)
        assert words in (tmp_path / fmt).read_text()


def test_a_library(tmp_path):
    pj.prepare_library(tmp_path / "lib", np.array([16]), np.array([1e-2]), np.arange(1, 3), ratio=f8(1.3))
    for file in ("index.csv", "library.json"):
        assert "np." not in (tmp_path / "lib" / file).read_text()
    assert len(pj.read_library(tmp_path / "lib").rows) == 2
