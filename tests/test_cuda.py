"""The engine for a GPU, in numba's simulator unless NUMBA_ENABLE_CUDASIM=0: what other engines do not have.

Both ways to run (a block, the whole card), batches, lists that are made within a launch, the card that is not there;
and all numbers after these compared with those of the engine for the CPU. ``test_md_physics.py`` has the tests of all
engines.
"""

import os
import subprocess
import sys
from dataclasses import replace

import numpy as np
import pytest
from test_md_physics import COSH
from test_shear import SMALL, StoppedError, same, stop_at

import petscjam as pj
from petscjam.base.errors import InputError, SolverError
from petscjam.base.interrupt import Interrupted
from petscjam.cli import main
from petscjam.geometry.potential import POTENTIALS, power_law
from petscjam.md import cuda, protocols, simulation
from petscjam.md.cuda import CudaSimulation, abreast
from petscjam.md.engine import JUMPS, LAYERED
from petscjam.md.grid import grid, run_grid
from petscjam.md.model import BULK, Model
from petscjam.md.runs import begin, run
from petscjam.md.simulation import Simulation

pytestmark = pytest.mark.parallel(nprocs=1)
RATE, DT = 0.05, 0.05


@pytest.fixture(scope="module")
def flow():
    """Twenty-two disks in flow."""
    return pj.md.shear("CD_rot", 22, 0.84, rate=RATE, strain=1.0, seed=3).state


@pytest.fixture(params=[False, True], ids=["block", "grid"])
def wide(request, monkeypatch):
    """Both ways: a run for each block, and one run for the whole card."""
    if request.param:
        monkeypatch.setattr(cuda, "MOST", 1)
    return request.param


def course(engine, steps, rate=RATE):
    """Strains and rates of some steps."""
    rates = np.broadcast_to(rate, steps)
    return np.cumsum(np.append(engine.strain, rates * engine.dt))[1:], rates


def everything(engine, steps, rate=RATE, bulk="scale"):
    """What an engine tells before and after some steps."""
    layers, moments, scatter = np.zeros((LAYERED, 5)), np.zeros((5, 4)), np.full(4, np.nan)
    told = {"before": engine.energy()}
    engine.advance(*course(engine, steps, rate), bulk)
    told |= {"sample": engine.sample(layers, moments, scatter), "layers": layers, "moments": moments}
    sums, told["counts"], told["angles"] = engine.collect()
    state = engine.state.wrapped()
    told |= {"sums": sums, "after": engine.energy(), "x": state.positions, "v": state.velocities, "spins": state.spins}
    told["clock"] = state.strain, state.rate, state.time, engine.steps, engine.substeps, engine.most
    return told, scatter


def agree(one, two, tolerance=1e-12):
    """Whether two engines tell the same, but for rounding."""
    assert one.keys() == two.keys()
    for name in one:
        a, b = np.asarray(one[name], dtype=float), np.asarray(two[name], dtype=float)
        scale = np.abs(a) if name == "sums" else np.abs(a).max()
        assert (np.abs(a - b) <= tolerance * np.maximum(1.0, scale)).all(), (name, a, b)


CASES = {
    "drags": {"law": "CD_rot", "stokes_drag": 0.2, "rotational_drag": 0.05},
    "absolute power": {"law": "CD_rot", "potential": power_law(3.0, relative=False)},
    "any potential": {"law": "CD_rot", "potential": COSH},
}


@pytest.mark.parametrize("case", CASES)
def test_a_launch_of_one_evaluation_a_step_tells_what_the_cpu_tells(flow, monkeypatch, case):
    """Sums, too, which the slow twin has for Heun's scheme alone."""
    monkeypatch.setitem(POTENTIALS, "cosh", COSH)
    model = Model.of(**{"Q": 1.0} | CASES[case])
    state = replace(flow, potential_name=model.potential.name)
    wide_lists(monkeypatch)
    engines = [kind(state, model, DT, "single", 1) for kind in (Simulation, CudaSimulation)]
    (one, _), (two, scatter) = (everything(engine, 12) for engine in engines)
    agree(one, two)
    assert one["counts"][:2].sum() > 0
    assert np.isfinite(scatter).all()


def wide_lists(monkeypatch):
    """Let no list become invalid: with one evaluation a step the builds change the rounding of forces."""
    for module in (simulation, cuda):
        monkeypatch.setattr(module, "SKINS", (0.3, 0.3))


def test_new_lists_and_changes_of_the_rate(flow, wide):
    """A list lasts a few steps, the rate changes in every step, with every bulk."""
    for bulk in BULK:
        engines = [kind(flow, Model.of("CD_rot", 1.0), DT, "heun", 1) for kind in (Simulation, CudaSimulation)]
        (one, _), (two, _) = (everything(engine, 20, RATE * (2 + np.sin(np.arange(20))), bulk) for engine in engines)
        agree(one, two, 1e-11)
        assert engines[1].rebuilds > 3
        assert one["sums"][JUMPS] != 0


@pytest.mark.parametrize("integrator", ["heun", "single"])
def test_strong_damping_divides_steps(wide, integrator, monkeypatch):
    wide_lists(monkeypatch)
    dense = pj.md.shear("CD", 16, 0.95, rate=RATE, strain=0.2).state
    model, dt = Model.of("CD", 0.3), {"heun": 0.19, "single": 0.14}[integrator]
    engines = [kind(dense, model, dt, integrator, 1) for kind in (Simulation, CudaSimulation)]
    (one, _), (two, _) = (everything(engine, 6) for engine in engines)
    agree(one, two, 1e-11)
    assert engines[1].substeps == engines[0].substeps > 6


def test_the_budget_closes_while_the_number_of_parts_changes(wide):
    """It changes with the lists, in the middle of launches, too."""
    given = {"model": "CD", "n": 16, "phi": 0.84, "Q": 0.3, "rate": 0.1, "strain": 0.5, "dt": 0.12}
    made = {engine: pj.md.shear(**given, engine=engine) for engine in ("cpu", "cuda")}
    assert made["cuda"].rows["parts"].max() > 1
    assert made["cuda"].rows["steps"].sum() > 1.2 * made["cuda"].time[-1] / 0.12
    assert made["cuda"].missed < 2 * made["cpu"].missed + 0.01


def test_cells_of_any_height_masses_and_any_number_of_disks(flow, wide):
    """A cell of 1 × 2, and a mass for each disk."""
    x, n = flow.positions, len(flow)
    above = {
        "positions": np.concatenate([x, x + np.array([flow.strain, 1.0]) * flow.length]),
        "height": 2 * flow.length,
    }
    both = {name: np.concatenate(2 * [getattr(flow, name)]) for name in ("velocities", "spins", "radii")}
    both["velocities"][n:, 0] += flow.rate * flow.length
    tall, masses = replace(flow, **above, **both), np.linspace(0.5, 2.0, 2 * n)
    for state in (tall, replace(flow, strain=1e3 + 0.3)):
        m = masses[: len(state)]
        engines = [kind(state, Model.of("CD_rot", 1.0), 0.02, "heun", 1, m) for kind in (Simulation, CudaSimulation)]
        (one, _), (two, _) = (everything(engine, 5, bulk="boundary") for engine in engines)
        agree(one, two, 1e-11)


@pytest.mark.parametrize(
    ("wide", "integrator"),
    [
        (False, "heun"),
        (True, "single"),
        pytest.param(False, "single", marks=pytest.mark.slow),
        pytest.param(True, "heun", marks=pytest.mark.slow),
    ],
    indirect=["wide"],
)
def test_a_stopped_run_continues_bit_for_bit(tmp_path, flow, wide, integrator):
    """Disks of a large run are sorted at a strain of 1."""
    given = {"model": "CD_rot", "rate": 1e-2, "strain": 0.05, "integrator": integrator, "dt": 0.05, "angles": True}
    given |= {"engine": "cuda", "start": replace(flow, strain=0.97)}
    file = tmp_path / "run.h5"
    with pytest.raises(StoppedError):
        pj.md.shear(**given, output=file, progress=stop_at(0.4))
    whole = pj.md.shear(**given)
    assert same(pj.md.shear(**given, output=file, resume=True), whole) == []
    assert same(pj.md.read(file), whole) == []
    assert whole.missed < 0.1
    cpu = pj.md.shear(**given | {"engine": "cpu"})
    for name in ("elastic_xx", "heat", "energy", "work", "contacts", "dvx2"):
        assert whole.rows[name] == pytest.approx(cpu.rows[name], rel=1e-9 if integrator == "heun" else 1e-3), name
    assert whole.state.angles == pytest.approx(cpu.state.angles, rel=1e-9 if integrator == "heun" else 1e-3)
    for name in ("made", "broken"):
        assert whole.rows[name].sum() == cpu.rows[name].sum()


def test_a_run_of_the_cpu_continues_on_a_gpu_and_back(tmp_path):
    file, given = (
        tmp_path / "run.h5",
        SMALL | {"n": 16, "dt": 0.05, "row_time": 3.0, "output": tmp_path / "run.h5", "resume": True},
    )
    for strain, engine in ((0.03, "cpu"), (0.06, "cuda"), (0.09, "cpu")):
        pj.md.shear(**given | {"strain": strain, "engine": engine})
    mixed, cpu = pj.md.read(file), pj.md.shear(**given | {"strain": 0.09, "output": None})
    assert mixed.rows["energy"] == pytest.approx(cpu.rows["energy"], rel=1e-8)


def test_a_grid_gives_the_runs_that_each_point_gives_alone(comm, tmp_path, monkeypatch):
    """Side by side, of two sizes; one fails and stops no other; there is room for two at a time."""
    monkeypatch.setattr(cuda, "places", lambda n: 2)
    folder, files = tmp_path / "grid", []
    points = grid(["CD_rot"], [16, 18], [0.7, 0.84, 1.5], [1.0], [0.1], [1])

    def work(rate, **settings):
        return begin(protocols.steady(rate, 0.1), dt=0.1, engine="cuda", **settings)

    made, failures = run_grid(points, folder, work, comm=comm, engine="cuda", log=lambda file, _: files.append(file))
    assert (made, len(files)) == (4, 4)
    assert [failure.split(":")[0] for failure in failures] == [p.name for p in points if p.phi == 1.5]
    for file in files:
        settings = pj.md.read(file).settings
        alone = pj.md.shear("CD_rot", settings.particles, settings.phi, rate=0.1, strain=0.1, dt=0.1, engine="cuda")
        assert same(pj.md.read(file), alone) == []


def test_a_grid_says_which_runs_are_too_large_for_a_batch(tmp_path, monkeypatch, capsys):
    monkeypatch.setattr(cuda, "MOST", 16)
    monkeypatch.setattr(CudaSimulation, "MOST", 16)
    words = "shear --particles 16,18 --phi 0.7 --rate 0.1 --strain 0.1 --dt 0.1 --engine cuda"
    assert main([*words.split(), "-o", str(tmp_path / "grid")]) == 0
    assert "1 of 2 runs have more than 16 disks" in capsys.readouterr().err
    assert len(list((tmp_path / "grid").glob("*.h5"))) == 2


def test_a_signal_leaves_the_complete_rows_of_all_runs(tmp_path, monkeypatch):
    files, left = [tmp_path / f"{seed}.h5" for seed in (1, 2)], [7]  # the first row ends with the sixth launch

    def check():
        left[0] -= 1
        if left[0] < 0:
            raise Interrupted(2)

    given = {"model": "CD", "n": 16, "phi": 0.8, "dt": 0.1, "engine": "cuda"}

    def start(file, **more):
        return begin(protocols.steady(0.1, 0.6), output=file, seed=int(file.stem), **given, **more)

    done = {}
    with monkeypatch.context() as patch:
        patch.setattr(cuda, "check", check)
        patch.setattr(cuda, "places", lambda n: 2)
        with pytest.raises(Interrupted):
            list(abreast(files, start, done.__setitem__))
    assert done == {}
    assert all(0 < len(pj.md.read(file).strain) < 2 for file in files)
    assert list(abreast(files, lambda file: start(file, resume=True), done.__setitem__)) == []
    for file in files:
        assert same(done[file], run(protocols.steady(0.1, 0.6), seed=int(file.stem), **given)) == []


def test_disks_that_fly_apart_are_an_error(flow):
    """So is a disk with very many neighbours."""
    engine = CudaSimulation(flow, Model.of("CD", 1.0), DT)
    with pytest.raises(SolverError, match="take a smaller dt"):
        engine.advance(*course(engine, 50, 1e6 * (-1) ** np.arange(50)), "profile")
    few = replace(flow, radii=np.append(2.0, np.full(21, 0.1)), positions=np.zeros((22, 2)), length=12.0, height=12.0)
    crowd = replace(few, **{name: np.concatenate(2 * [getattr(few, name)]) for name in VALUES})
    with pytest.raises(InputError, match="more than 32 neighbours"):
        CudaSimulation(crowd, Model.of("CD", 1.0), 0.01).energy()


VALUES = "positions", "velocities", "spins", "radii"
HERE = {name: value for name, value in os.environ.items() if name != "NUMBA_ENABLE_CUDASIM"}


@pytest.mark.parametrize("points", ["0.8", "0.7,0.8"])
def test_without_a_gpu_one_line_says_what_is_missing(tmp_path, points):
    """For one run and for a grid."""
    code = "import sys; from petscjam.cli import main; sys.exit(main(sys.argv[1:]))"
    words = ["shear", "--particles", "16", "--phi", points, "--engine", "cuda", "-o", str(tmp_path / "run")]
    done = subprocess.run([sys.executable, "-c", code, *words], capture_output=True, text=True, env=HERE)
    if done.returncode == 0:
        pytest.skip("there is a GPU")
    assert done.returncode == 2
    assert done.stderr.count("\n") == 1
    assert "cuda" in done.stderr
    assert not [file for file in tmp_path.rglob("*") if file.is_file()]


def test_an_unknown_engine_is_one_line(tmp_path, capsys):
    assert main(["shear", "--engine", "abacus", "-o", str(tmp_path / "run.h5")]) == 2
    assert capsys.readouterr().err == "petscjam: shear: no engine 'abacus'; there are cpu, cuda\n"
