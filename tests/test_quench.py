"""From a sheared run to the linear response: quenched states are packings under their own stresses."""

from dataclasses import replace

import numpy as np
import pytest

import petscjam as pj
from petscjam.base.files import atomic_h5
from petscjam.cli import main
from petscjam.geometry.network import ContactNetwork
from petscjam.geometry.potential import power_law
from petscjam.md.observables import BLOCKS, ROWS
from petscjam.md.quench import quench, snapshot
from petscjam.md.result import Run, write_run
from petscjam.md.settings import Settings
from petscjam.md.state import State, random_state

SETTINGS = {
    "model": "CD",
    "law": "ContactDamping",
    "Q": 2.0,
    "potential": "harmonic-relative",
    "drag": 0.0,
    "spin_drag": 0.0,
    "seed": 3,
    "protocol": "steady",
    "rate": 1e-3,
    "strain0": 0.0,
    "time0": 0.0,
    "start": "random",
    "particles": 64,
    "phi": 0.9,
    "dt": 0.05,
    "integrator": "heun",
    "row_steps": 100,
    "threads": 1,
}


def run_of(state):
    rows = {name: np.zeros(1) for name in ROWS}
    settings = Settings.from_attributes(SETTINGS | {"potential": state.potential_name})
    shapes = {name: ["1", *block.shape.split()] for name, block in BLOCKS.items()}
    blocks = {name: np.zeros([int(n) if n.isdigit() else 1 for n in axes]) for name, axes in shapes.items()}
    return Run(settings, rows, blocks, state)


def written(state, path):
    with atomic_h5(path) as h5:
        write_run(h5, run_of(state))
    return path


def sheared(state, strain):
    """The state after an affine shear."""
    x = state.positions + strain * state.positions[:, 1:] * [1, 0]
    return replace(state, positions=x, strain=state.strain + strain)


def agitated(state, seed=1):
    """The state with its disks displaced and in motion, each by another periodic image."""
    random = np.random.default_rng(seed)
    n, L = len(state), state.length
    images = random.integers(-2, 3, (n, 2)) @ (L * np.array([[1.0, 0.0], [state.strain, 1.0]]))
    x = state.positions + random.normal(0, 0.02, (n, 2)) + images
    return replace(state, positions=x, velocities=random.normal(0, 0.1, (n, 2)), spins=np.ones(n), time=9.0)


@pytest.fixture(scope="module")
def jammed():
    """A flow at phi = 0.88 and a strain of 1.05, the cell tilted by 0.05."""
    p = pj.prepare_packing(n=64, pressure=2e-2, seed=2, potential_name="harmonic-relative")
    scale = 0.5 / p.radii.min()
    x, n = scale * p.positions, len(p)
    start = State(x, np.zeros((n, 2)), np.zeros(n), scale * p.radii, scale * p.box.cell[0, 0], strain=1.0)
    return agitated(sheared(start, 0.05))


@pytest.fixture(scope="module")
def fluid():
    """A flow at phi = 0.6."""
    state = random_state(64, 0.6, 1)
    return replace(state, strain=0.3, rate=1e-3)


def shear_stress(packing):
    return -ContactNetwork.of(packing).stress[0, 1]


# The packing


def test_a_quenched_flow_is_a_proved_minimum_under_shear_stress(jammed):
    p = quench(run_of(jammed))
    c = p.certificate
    assert c.proved
    assert c.max_force < 1e-10
    assert c.stress_error > 0.02  # fixed box: the shear stress is physics, no error
    assert abs(shear_stress(p)) / c.pressure <= c.stress_error
    assert p.box.cell == pytest.approx(jammed.length * np.array([[1, 0], [0.05, 1]]))
    assert p.phi == pytest.approx(jammed.phi)


def test_it_is_the_minimum_nearest_to_the_snapshot(jammed):
    """Any image, and the cell not tilted modulo 1: the same lattice, so the same minimum."""
    L, x = jammed.length, jammed.positions
    cell = pj.Box(L * np.array([[1.0, 0.0], [jammed.strain, 1.0]]))
    other = pj.relax_packing(pj.Packing(cell.wrap(x), jammed.radii, cell, "harmonic-relative"))
    p = quench(jammed)
    assert p.certificate.pressure == pytest.approx(other.certificate.pressure, rel=1e-9)
    assert shear_stress(p) == pytest.approx(shear_stress(other), rel=1e-7)
    # a snapshot of a minimum, whatever its velocities, stays
    apart = p.box.minimum_image(quench(replace(jammed, positions=p.positions)).positions - p.positions)
    bearing = ContactNetwork.of(p).backbone
    assert abs(apart[bearing]).max() < 1e-9


def test_g0_is_the_slope_of_the_quenched_stress(jammed):
    """G0 = dσ/dγ along F = 1 + γ x̂ŷ holds under pre-stress, too, and in a tilted cell."""
    p = quench(jammed)
    G0 = pj.quasistatic_response(p, prestress=True).shear_modulus
    still = replace(jammed, positions=p.positions)
    step = 1e-6
    more, less = (shear_stress(quench(sheared(still, s))) for s in (step, -step))
    assert (more - less) / (2 * step) == pytest.approx(G0, rel=1e-5)


def test_velocities_and_rate_do_not_matter(jammed):
    still = replace(jammed, velocities=np.zeros_like(jammed.velocities), rate=0.5, time=1.0)
    assert quench(still).checksum == quench(jammed).checksum


def test_provenance_says_which_flow(jammed, tmp_path):
    flow = replace(jammed, rate=2e-3)
    quench(run_of(flow)).write(tmp_path / "p.h5")
    known = pj.Packing.read(tmp_path / "p.h5").provenance
    assert {key: known[key] for key in ("model", "Q", "seed", "potential")} == {
        "model": "CD",
        "Q": 2.0,
        "seed": 3,
        "potential": "harmonic-relative",
    }
    assert known["rate"] == 2e-3
    assert known["strain"] == pytest.approx(1.05)
    assert known["phi"] == pytest.approx(flow.phi)
    assert known["quenched"] == snapshot(run_of(flow)).checksum


@pytest.mark.parametrize("relative", [True, False])
@pytest.mark.parametrize("alpha", [2.0, 2.5, 3.0, 2.2])
def test_the_potential_is_that_of_the_run(jammed, tmp_path, alpha, relative):
    """All the way: file of the run, quenched packing, its file, the stiffness that the solver sees."""
    name = power_law(alpha, relative).name
    run = pj.md.read(written(replace(jammed, potential_name=name), tmp_path / "run.h5"))
    assert run.state.potential_name == name
    quench(run).write(tmp_path / "p.h5")
    p = pj.Packing.read(tmp_path / "p.h5")
    assert p.potential_name == name
    assert p.certificate.proved
    network = ContactNetwork.of(p)
    sigma = p.radii[network.i] + p.radii[network.j]
    scale = sigma if relative else 1.0
    overlap = (sigma - network.distance) / scale
    assert network.force == pytest.approx(overlap ** (alpha - 1) / scale)
    assert network.stiffness == pytest.approx((alpha - 1) * overlap ** (alpha - 2) / scale**2)


@pytest.mark.parametrize(("phi", "budget"), [(0.3, 50_000), (0.6, 50_000), (0.8, 50_000)])
def test_a_fluid_is_refused_soon(phi, budget):
    with pytest.raises(pj.InputError, match=rf"quench: at phi = {phi:.6f}: .*not jammed"):
        quench(random_state(64, phi, 1), budget=budget)


def test_bad_method_is_refused(jammed):
    with pytest.raises(pj.InputError, match="newton"):
        quench(jammed, method="newton")


# Files of runs


def test_import_reads_the_last_state_as_it_is(jammed, tmp_path):
    p = pj.import_packing(written(replace(jammed, potential_name="hertzian"), tmp_path / "run.h5"))
    assert (p.positions == jammed.positions).all()
    assert (p.box.cell == jammed.box.cell).all()
    assert p.potential_name == "hertzian"
    assert p.certificate.proved is None
    assert p.provenance["source"] == "run.h5"
    assert p.provenance["model"] == "CD"


def test_import_knows_one_packing_in_a_run(jammed, tmp_path):
    with pytest.raises(pj.InputError, match="no packing 1"):
        pj.import_packing(written(jammed, tmp_path / "run.h5"), index=1)


def test_import_relax_minimises(jammed, tmp_path):
    run, out = written(jammed, tmp_path / "run.h5"), tmp_path / "p.h5"
    assert main(["import", str(run), "--relax", "-o", str(out)]) == 0
    assert pj.Packing.read(out).checksum == pj.relax_packing(jammed.packing()).checksum
    assert pj.Packing.read(out).certificate.proved


def test_truncated_run_is_refused(jammed, tmp_path):
    run = written(jammed, tmp_path / "run.h5")
    run.write_bytes(run.read_bytes()[:-1000])
    with pytest.raises(pj.InputError, match=r"run\.h5"):
        pj.import_packing(run)


# Verbs


def moduli(*arguments):
    return main(["moduli", *map(str, arguments), "--omega", "1e-2:1:3", "--no-rotations"])


def test_moduli_of_a_run_is_one_command(jammed, tmp_path, capfd):
    run, out = written(jammed, tmp_path / "run.h5"), tmp_path / "g.h5"
    assert moduli(run, "-o", out) == 0
    printed = capfd.readouterr().out
    assert printed.count("quenched: ") == 1
    p = pj.Packing.read(tmp_path / "run.quenched.h5")
    assert p.certificate.proved
    assert p.checksum == quench(jammed).checksum
    g = pj.read_modulus(out)
    expected = pj.complex_modulus(p, g.omega, damping=pj.ContactDamping(rotations=False))
    assert (abs(g.values / expected.values - 1) <= g.errors + 1e-12).all()


def test_a_run_is_quenched_once(jammed, tmp_path, capfd):
    run, out = written(jammed, tmp_path / "run.h5"), tmp_path / "g.h5"
    moduli(run, "-o", out)
    stamp = (tmp_path / "run.quenched.h5").stat().st_mtime_ns
    assert main(["nonaffine", str(run), "-o", str(tmp_path / "u.h5")]) == 0
    assert moduli(run, "-o", out, "--resume") == 0
    assert (tmp_path / "run.quenched.h5").stat().st_mtime_ns == stamp
    assert len(pj.read_moduli(out)) == 1
    assert capfd.readouterr().out.count("quenched already") == 2


def test_another_quenched_run_is_not_replaced_by_surprise(jammed, tmp_path, capfd):
    run, out = written(jammed, tmp_path / "run.h5"), tmp_path / "g.h5"
    moduli(run, "-o", out)
    first = pj.Packing.read(tmp_path / "run.quenched.h5").checksum
    written(agitated(jammed, seed=2), run)
    assert moduli(run, "-o", tmp_path / "h.h5") == 2
    assert "run.quenched.h5: exists already" in capfd.readouterr().err
    assert pj.Packing.read(tmp_path / "run.quenched.h5").checksum == first
    assert moduli(run, "-o", tmp_path / "h.h5", "--overwrite") == 0
    assert pj.Packing.read(tmp_path / "run.quenched.h5").checksum != first


def test_runs_of_one_name_are_not_mixed_up(jammed, tmp_path, capfd):
    runs = []
    for folder in ("a", "b"):
        (tmp_path / folder).mkdir()
        runs.append(written(jammed, tmp_path / folder / "run.h5"))
    assert moduli(*runs, "-o", tmp_path / "g.h5") == 2
    assert "runs of one name" in capfd.readouterr().err


def test_a_folder_of_runs(jammed, fluid, tmp_path, capfd):
    """Quenched files lie among the runs, and each is taken once; what is not jammed is left out."""
    written(jammed, tmp_path / "a.h5")
    written(fluid, tmp_path / "b.h5")
    assert moduli(tmp_path, "-o", tmp_path / "g.h5") == 0
    assert f"left out: {tmp_path / 'b.h5'}: quench: at phi = 0.6" in capfd.readouterr().err
    assert main(["nonaffine", str(tmp_path), "-o", str(tmp_path / "u.h5")]) == 0
    assert len(pj.read_results(tmp_path / "u.h5")) == 1


def test_a_fluid_run_alone_is_bad_input(fluid, tmp_path, capfd):
    run = written(fluid, tmp_path / "run.h5")
    assert moduli(run, "-o", tmp_path / "g.h5") == 2
    err = capfd.readouterr().err
    assert err.startswith(f"petscjam: {run}: quench: at phi = 0.600000")
    assert err.count("\n") == 1
    assert sorted(path.name for path in tmp_path.iterdir()) == ["run.h5"]


def test_nothing_is_quenched_for_an_output_that_would_be_refused(jammed, tmp_path):
    run, out = written(jammed, tmp_path / "run.h5"), tmp_path / "g.h5"
    out.write_text("mine")
    assert moduli(run, "-o", out) == 2
    assert not (tmp_path / "run.quenched.h5").exists()
    assert moduli(run, "-o", run, "--overwrite") == 2  # the run itself
    assert moduli(run, "-o", tmp_path / "run.quenched.h5") == 2  # what is quenched
    assert out.read_text() == "mine"


def test_mpirun_quenches_on_one_rank(jammed, tmp_path, mpirun):
    run, one, two = written(jammed, tmp_path / "run.h5"), tmp_path / "one.h5", tmp_path / "two.h5"
    assert moduli(run, "-o", one) == 0
    (tmp_path / "run.quenched.h5").unlink()
    made = mpirun(2, "-m", "petscjam", "moduli", run, "--omega", "1e-2:1:3", "--no-rotations", "-o", two)
    assert made.returncode == 0, made.stderr
    assert made.stdout.count("quenched: ") == 1
    assert pj.read_modulus(two).values == pytest.approx(pj.read_modulus(one).values, rel=1e-9)
