"""The driver of sheared disks: restarts, protocols, starts, errors, grids, and the verbs.

The driver is one for all engines: here are tests for each of them where the numbers of an engine must pass through it.
Long runs, threads, signals and processes are tested with the engine for the CPU alone; ``test_cuda.py`` stops,
continues and batches short runs of the engine for a GPU.
"""

import signal
import subprocess
import sys
from dataclasses import replace
from itertools import product

import h5py
import numpy as np
import pytest
from helpers import any_engine, jammed, names

import petscjam as pj
from petscjam.base.errors import DoubtfulWarning, InputError
from petscjam.base.files import atomic_h5
from petscjam.cli import main
from petscjam.geometry.network import ContactNetwork
from petscjam.geometry.potential import POTENTIALS, Potential, power_law
from petscjam.md import protocols
from petscjam.md.grid import grid, run_grid
from petscjam.md.model import INTEGRATORS, Model
from petscjam.md.result import blocked_error, export_csv, read_folder
from petscjam.md.runs import begin, run
from petscjam.md.simulation import Simulation
from petscjam.md.starts import _along_x, first_state, given_state, rescaled, two_phases
from petscjam.md.state import State, random_state
from petscjam.plots.shear import plot_flow, plot_run
from petscjam.plots.tables import describe_run
from petscjam.rows.damping import ContactDamping, StokesDrag

pytestmark = pytest.mark.parallel(nprocs=1)
SMALL = {"model": "CD_rot", "n": 36, "phi": 0.82, "rate": 1e-2, "strain": 0.6, "seed": 3}


class StoppedError(Exception):
    """Stands for whatever stops a run."""


def stop_at(fraction):
    """Return a progress report that stops the run there."""

    def report(done, text):
        if done > fraction:
            raise StoppedError

    return report


def same(one, other):
    """Return what differs between two runs, bit for bit."""
    rows = [name for name in one.rows if not np.array_equal(one.rows[name], other.rows[name])]
    blocks = [
        name for name, values in one.blocks.items() if not np.array_equal(values, other.blocks[name], equal_nan=True)
    ]
    names = ("positions", "velocities", "spins", "strain", "time")
    return rows + blocks + [n for n in names if not np.array_equal(getattr(one.state, n), getattr(other.state, n))]


@pytest.mark.filterwarnings("ignore::petscjam.base.errors.DoubtfulWarning")
@pytest.mark.parametrize("dt", [None, 0.11])
@pytest.mark.parametrize("integrator", ["heun", "single"])
def test_a_run_stopped_and_resumed_is_the_undisturbed_one(tmp_path, integrator, dt):
    """Contact events and histograms included, whatever the moments at which it was stopped.

    With a large dt steps are divided now and then.
    """
    file, given = tmp_path / "run.h5", {**SMALL, "integrator": integrator, "dt": dt}
    for fraction in (0.1, 0.45, 0.8):
        with pytest.raises(StoppedError):
            pj.md.shear(**given, output=file, resume=True, progress=stop_at(fraction))
        assert pj.md.read(file).strain[-1] == pytest.approx(fraction * 0.6, abs=0.06)
    undisturbed = pj.md.shear(**given)
    assert same(pj.md.shear(**given, output=file, resume=True), undisturbed) == []
    assert same(pj.md.read(file), undisturbed) == []
    assert (undisturbed.rows["parts"].max() > 1) == (dt is not None)


def test_any_cell_survives_the_file_and_a_stop(tmp_path, engine):
    """A file or a checkpoint of older versions has no height: its cell is a square."""
    n, rate = (36, 1e-2) if engine == "cpu" else (16, 0.2)
    file, square = tmp_path / "run.h5", random_state(n, 0.82, 3)
    for height in (square.length, 0.7 * square.length):
        start = replace(square, length=square.area / height, height=height, strain=0.4)
        start = replace(start, positions=square.positions * [start.length / square.length, height / square.height])
        given = {"model": "CD_rot", "rate": rate, "strain": 0.6, "start": start, "overwrite": True, "engine": engine}
        undisturbed = pj.md.shear(**given)
        with pytest.raises(StoppedError):
            pj.md.shear(**given, output=file, progress=stop_at(0.45))
        assert pj.md.read(file).state.height == height
        if height == square.length:
            with h5py.File(file, "r+") as h5:
                h5.attrs["schema"] = 2
                del h5["state"].attrs["height"], h5["checkpoint/height"]
            assert pj.md.read(file).state.height == height
        assert same(pj.md.shear(**given, output=file, resume=True), undisturbed) == []


KILLED = """
import sys, petscjam as pj
from petscjam.md import recording
recording.EVERY = 0.0
def report(done, text):
    print(done, flush=True)
given = dict(rate=1e-2, strain=3.0, seed=3, output=sys.argv[1], resume=True)
pj.md.shear("CD_rot", 36, 0.82, **given, progress=report)
"""


def test_a_kill_loses_at_most_the_last_interval(tmp_path, environment):
    """The file is whole after SIGKILL, and the run that goes on from it is the undisturbed one."""
    file, command = tmp_path / "run.h5", [sys.executable, "-c", KILLED, str(tmp_path / "run.h5")]
    process = subprocess.Popen(command, stdout=subprocess.PIPE, text=True, env=environment)
    while float(process.stdout.readline()) < 0.3:
        pass
    process.send_signal(signal.SIGKILL)
    process.wait()
    assert 0.8 < pj.md.read(file).strain[-1] < 3.0
    given = {**SMALL, "strain": 3.0}
    assert same(pj.md.shear(**given, output=file, resume=True), pj.md.shear(**given)) == []


@pytest.mark.slow
def test_threads_do_not_change_the_numbers(environment):
    """Sums are those of runs of disks, in order: 1 and 2 threads agree bit for bit."""
    text = (
        "import petscjam as pj; "
        "r = pj.md.shear('CD_rot', 10000, 0.82, rate=1e-2, strain=0.05, dt=0.1, threads={});"
        "print(r.state.positions.tobytes().hex(), r.stress.tobytes().hex())"
    )
    environment["NUMBA_NUM_THREADS"] = "2"
    one, two = (
        subprocess.run(
            [sys.executable, "-c", text.format(threads)], capture_output=True, text=True, env=environment, check=True
        ).stdout
        for threads in (1, 2)
    )
    assert one == two


def test_a_longer_run_goes_on_from_its_end(tmp_path):
    """The rows that were there stay."""
    short = pj.md.shear(**SMALL, output=tmp_path / "run.h5")
    longer = pj.md.shear(**{**SMALL, "strain": 0.9}, output=tmp_path / "run.h5", resume=True)
    assert longer.strain[-1] == pytest.approx(0.9)
    assert np.array_equal(longer.stress[: len(short.stress)], short.stress)


@pytest.mark.parametrize(
    ("verb", "short", "longer", "settings"),
    [
        ("shear", "--rate 5e-2 --strain 125", "--rate 5e-2 --strain 250", {"row_steps": 60}),
        ("shear", "--rate 1e-2 --strain 1 --dt 0.02", "--rate 1e-2 --strain 2", {"dt": 0.02}),
        ("shear", "--rate 1e-2 --strain 1 --row-time 3", "--rate 1e-2 --strain 2", {"row_steps": 72}),
        (
            "shear",
            "--rate 1e-2 --strain 0.5 --then 1e-2:0.5",
            "--rate 1e-2 --strain 0.5 --then 1e-2:1.5",
            {"strains": [0.5, 1.5]},
        ),
        ("shear", "--oscillate 0.1:0.1:1", "--oscillate 0.1:0.1:2", {"cycles": 2}),
        ("ramp", "--rate 1e-2 --to 2e-2 --kappa 5e-3 --row-time 3", None, {"row_steps": 72}),
    ],
)
def test_the_command_prolongs_a_run(tmp_path, capsys, verb, short, longer, settings):
    """What was left out is that of the file: rows are as long as they were; the file says how long it is."""
    file = tmp_path / "run.h5"
    command = [verb, "--particles", "16", "--phi", "0.8", "-o", str(file), *short.split()]
    assert main(command) == 0
    before = pj.md.read(file)
    command[7:] = (longer or "--rate 1e-2 --to 2e-2 --kappa 5e-3").split()
    assert main([*command, "--resume"]) == 0, capsys.readouterr().err
    after = pj.md.read(file)
    for name in ("dt", "row_steps"):
        assert after.settings.attributes[name] == before.settings.attributes[name]
    kept = len(before.time)
    assert np.array_equal(after.stress[:kept], before.stress)
    if longer is None:
        assert same(after, before) == []
    else:
        assert after.time[-1] == pytest.approx(2 * before.time[-1], rel=1e-2)
    assert {name: np.array(after.settings.attributes[name]).tolist() for name in settings} == settings


def test_disks_that_never_meet_dissipate_nothing(engine):
    """No heat, and no share of it that the budget misses; the progress says so, too."""
    texts = []
    given = {"rate": 1e-2, "strain": 0.025, "engine": engine}
    alone = pj.md.shear("CD", 16, 1e-4, **given, progress=lambda fraction, text: texts.append(text))
    assert alone.rows["heat"].sum() == 0
    assert alone.missed == 0
    assert texts and "budget" not in texts[-1]


@pytest.mark.parametrize(
    ("other", "named"),
    [
        ("--strain 2 --dt 0.01", "dt = 0.02"),
        ("--strain 2 --row-time 7", "row_steps = 50, not 350"),
        ("--strain 2 --then 1e-3:1", "protocol = steady"),
    ],
)
def test_a_resumed_run_refuses_what_differs(tmp_path, capsys, other, named):
    """An option that is given must be that of the file."""
    command = ["shear", "--particles", "16", "--rate", "1e-2", "-o", str(tmp_path / "run.h5")]
    assert main([*command, "--strain", "0.1", "--dt", "0.02"]) == 0
    before = (tmp_path / "run.h5").read_bytes()
    capsys.readouterr()
    assert main([*command, *other.split(), "--resume"]) == 2
    assert named in (error := capsys.readouterr().err)
    assert error.count("\n") == 1
    assert (tmp_path / "run.h5").read_bytes() == before


def test_only_the_last_of_several_steps_may_be_longer(tmp_path):
    """A change in the middle would be another history."""
    given = {"model": "CD", "n": 16, "output": tmp_path / "run.h5"}
    run(protocols.steps([1e-2, 2e-2], [0.1, 0.1]), **given)
    with pytest.raises(InputError, match="strains = "):
        run(protocols.steps([1e-2, 2e-2], [0.2, 0.1]), **given, resume=True)


@pytest.mark.parametrize(
    "other",
    [
        {"model": "CD"},
        {"Q": 2.0},
        {"dt": 0.04},
        {"phi": 0.8},
        {"rate": 2e-2},
        {"n": 64},
        {"seed": 4},
        {"integrator": "single"},
        {"stokes_drag": 0.1},
        {"model": ContactDamping(beta=0.5)},
    ],
    ids=lambda other: next(iter(other)),
)
def test_a_checkpoint_of_another_run_is_refused(tmp_path, other):
    """The message names what differs, and nothing is lost."""
    file = tmp_path / "run.h5"
    pj.md.shear(**{**SMALL, "strain": 0.05}, output=file)
    before = file.read_bytes()
    with pytest.raises(InputError, match="cannot be resumed"):
        pj.md.shear(**{**SMALL, **other}, output=file, resume=True)
    with pytest.raises(InputError, match="exists already"):
        pj.md.shear(**{**SMALL, **other}, output=file)
    assert file.read_bytes() == before


@pytest.mark.parametrize("keep", [0, 7, 100, 0.5, 0.99])
def test_a_truncated_file_is_refused(tmp_path, keep):
    """And left as it is."""
    file = tmp_path / "run.h5"
    pj.md.shear(**{**SMALL, "strain": 0.05}, output=file)
    whole = file.read_bytes()
    file.write_bytes(whole[: int(keep * len(whole)) if keep < 1 else keep])
    before = file.read_bytes()
    for work in (
        lambda: pj.md.read(file),
        lambda: pj.md.shear(**SMALL, output=file, resume=True),
        lambda: pj.md.shear(start=file),
    ):
        with pytest.raises(InputError, match=r"run\.h5"):
            work()
    assert file.read_bytes() == before


BAD = [
    ("--phi 1.2", "1.2"),
    ("--phi 0", "not 0"),
    ("--Q 0", "not 0"),
    ("--Q -1", "-1"),
    ("--rate 0", "rate"),
    ("--strain -3", "-3"),
    ("--particles 33", "33"),
    ("--particles 4", "4"),
    ("--dt 0.5", "0.5"),
    ("--dt -0.1", "-0.1"),
    ("--dt 0.2 --integrator single", "0.167"),
    ("--model CD_x", "CD_x"),
    ("--threads 0", "not 0"),
    ("--exponent 1", "1"),
    ("--seed -1", "-1"),
    ("--start nowhere.h5", "nowhere.h5"),
    ("--stokes-drag -1", "-1"),
    ("--model CD --beta 0.3", "--beta"),
    ("--oscillate 1:2", "1:2"),
    ("--rate nan", "nan"),
    ("--then 1e-3", "1e-3"),
    ("--phi 1.2,1.3 --particles 36", "1.2"),
    ("--bulk profile", "--bulk"),
    ("--oscillate 0.1:0.1:1 --bulk scale", "--bulk"),
    ("--start nowhere.h5 --seeds 1:2", "--seeds"),
    ("--start a.h5 b/a.h5", "a"),
    ("--start nowhere.h5 --seed 2", "--seed"),
    ("--phi 0.8 --rescale", "rescale"),
    ("--mass 0", "0"),
    ("--mass -1", "-1"),
    ("--mass 1e-6 --dt 0.01", "mass of 1e-06"),
    ("--start-bands 0.79", "0.79"),
    ("--start-bands 0.79:1e-4", "not 1"),
    ("--start-bands 0.79:nan,0.85:1e-5", "nan"),
    ("--start-bands 1.79:2e-4,0.85:1e-5", "1.79"),
    ("--start-bands 0.83:2e-4,0.85:1e-5 --phi 0.82", "0.82"),
    ("--start-bands 0.83:2e-4,0.79:1e-5 --phi 0.82", "0.83"),
    ("--start-bands 0.79:8e-5,0.85:1e-5 --phi 0.82 --rate 1e-4", "8e-05"),
    ("--start-bands 0.79:2e-4,0.85:-1e-5 --phi 0.82 --rate 1e-4", "-1e-05"),
    ("--start-bands 0.79:2.4e-4,0.85:1e-5 --phi 0.82 --rate 1e-4", "0.000125"),
    ("--start-bands 0.79:2e-4,0.85:1e-5 --phi 0.82 --rate 1e-4 --bulk boundary --then 1e-3:1", "boundary"),
]


@pytest.mark.parametrize(("options", "value"), BAD, ids=[options for options, _ in BAD])
def test_bad_input_is_one_line_that_names_the_value(tmp_path, capsys, options, value):
    """Exit status 2, and nothing is written."""
    assert main(["shear", *options.split(), "-o", str(tmp_path / "run.h5")]) == 2
    error = capsys.readouterr().err
    assert error.count("\n") == 1
    assert names(error, value)
    assert not [file for file in tmp_path.rglob("*") if file.is_file()]


@pytest.mark.parametrize("options", ["--kappa 0", "--to -1", "--rate 1e-3 --to 1e-3"])
def test_bad_ramps_are_refused(tmp_path, capsys, options):
    """As bad shearing is."""
    assert main(["ramp", *options.split(), "-o", str(tmp_path / "run.h5")]) == 2
    assert "must be from" in (error := capsys.readouterr().err) or "same strain rate" in error


def test_a_ramp_multiplies_the_rate_by_the_same_factor_and_comes_back():
    """VOT eqs. 38, 39."""
    ramp = protocols.ramp(1e-4, 1e-2, 0.01)
    rates = ramp.rates(np.arange(ramp.duration) + 0.5)
    assert len(rates) == 400
    assert rates[:200] == pytest.approx(1e-4 * 10 ** (0.01 * np.arange(200)))
    assert rates[200:] == pytest.approx(rates[199::-1])


def test_the_budget_of_a_ramp_closes_with_what_the_jumps_bring():
    """Scaled velocities (VOT eqs. 40, 41) carry energy in, and out again on the way down."""
    ramped = pj.md.ramp("CD_rot", 36, 0.82, rate=1e-3, to=1e-1, kappa=0.01, row_time=5)
    heat, jumps, missed = (ramped.rows[name].sum() for name in ("heat", "jumps", "imbalance"))
    rising = ramped.rows["jumps"][: len(ramped.strain) // 2]
    assert rising.sum() > 0.01 * heat
    assert abs(missed) < 0.02 * heat
    assert abs(missed) < 0.5 * rising.sum()
    assert jumps < rising.sum()


def test_shear_that_stops_leaves_the_strain_and_takes_the_motion():
    """Cessation: at a strain rate of 0 the dissipation dies out."""
    stopped = run(protocols.steps([1e-2, 0.0], [0.5, 200.0]), "CD_rot", 36, 0.84, stokes_drag=0.1)
    assert stopped.settings.bulk == "profile"
    assert stopped.strain[-1] == pytest.approx(0.5)
    assert stopped.rows["heat"][-1] < 0.02 * stopped.rows["heat"].max()


def test_the_bulk_is_what_a_start_follows():
    """A start at rest: on the linear profile, or left to the boundary; at a rate: scaled, moved, or left."""
    rest = random_state(36, 0.5, 1)
    flow = pj.md.shear(**{**SMALL, "strain": 0.05}).state

    def start(state, bulk):
        law = Model(pj.ContactDamping(), 1.0)
        return first_state(state, "a state", None, None, 1, law, protocols.steady(0.3, 1.0, bulk))

    for state in (rest, flow):
        wrapped, still = state.wrapped(), start(state, "boundary")
        assert still.rate == 0.3
        assert (still.velocities == wrapped.velocities).all()
        assert (still.spins == state.spins).all()
        assert start(state, "profile").peculiar == pytest.approx(state.peculiar)
    assert start(flow, "scale").velocities == pytest.approx(flow.velocities * 0.3 / flow.rate)


def test_every_start_is_recorded(tmp_path):
    """History matters."""
    file, given = tmp_path / "run.h5", {"rate": 1e-2, "strain": 0.05}
    first = pj.md.shear("CD", 36, 0.84, **given, output=file)
    assert first.settings.start == "random"
    for start, text in (
        (first, "CD from random"),
        (first.state, "a state"),
        (file, "run.h5: CD from random"),
        (str(file), "run.h5"),
    ):
        second = pj.md.shear("CD_rot", **given, start=start)
        assert text in second.settings.start
        assert second.settings.phi == pytest.approx(0.84)
        assert second.strain[0] > 0.05
    with pytest.raises(InputError, match="36 disks, not 64"):
        pj.md.shear(n=64, start=file)
    with pytest.raises(InputError, match=r"not 0\.8"):
        pj.md.shear(phi=0.8, start=first)


@pytest.mark.parametrize("relative", [True, False])
@pytest.mark.parametrize("alpha", [2.0, 2.5, 3.0])
def test_a_start_keeps_its_potential(tmp_path, alpha, relative):
    """The forces of a packing balance in the dynamics, too, and its pressure is p ds²/E, E = ke or k ds^α."""
    name = power_law(alpha, relative).name
    packing = pj.relax_packing(replace(jammed(2e-2, seed=1), potential_name=name))
    ds, p = 2 * packing.radii.min(), ContactNetwork.of(packing).pressure
    packing.write(tmp_path / "p.h5")
    for start in (packing, tmp_path / "p.h5"):
        still = run(
            protocols.steady(1e-9, 1e-9 * 30), "CD", start=start, output=tmp_path / "run.h5", frames=1, overwrite=True
        )
        assert np.abs(still.state.velocities).max() < 1e-7
        assert still.pressure_elastic == pytest.approx(p * ds**2 / (1 if relative else ds**alpha), rel=1e-6)
        assert still.settings.model.potential.name == still.state.potential_name == name
    assert pj.md.read(tmp_path / "run.h5").settings.model.potential == power_law(alpha, relative)
    frame = next((tmp_path / "run.frames").iterdir())
    assert pj.import_packing(frame).potential_name == name
    again = pj.md.shear("CD", rate=1e-3, strain=1e-3, start=tmp_path / "run.h5", output=tmp_path / "b.h5")
    assert again.settings.model.potential.name == name
    longer = pj.md.shear("CD", rate=1e-3, strain=2e-3, output=tmp_path / "b.h5", resume=True)
    assert longer.settings.model.potential.name == name
    other = pj.md.shear("CD", rate=1e-3, strain=1e-3, start=still, exponent=2.2)
    assert other.settings.model.potential.name == power_law(2.2, relative).name
    with pytest.raises(InputError, match=r"potential = .*cannot be resumed"):
        pj.md.shear("CD", rate=1e-3, strain=2e-3, exponent=2.2, output=tmp_path / "b.h5", resume=True)


BANDS = (0.788, 6.2e-3), (0.809, 4e-4)


@pytest.mark.parametrize("strain", [0.0, 0.3])
def test_a_start_of_two_phases(strain):
    """Shares of the height and of the disks, mean velocity, peculiar velocities and spins of both bands."""
    rate, share = 3e-3, (0.809 - 0.7984) / (0.809 - 0.788)
    square = random_state(20_000, 0.7984, 3)
    x, y = square.positions.T * [[1.25], [0.8]]
    L, height = 1.25 * square.length, 0.8 * square.length
    state = replace(square, positions=np.column_stack([x, y]), length=L, height=height)
    c = np.random.default_rng(2).normal(size=(20_000, 3))
    v = 1e-3 * c[:, :2] + rate * np.outer(state.positions[:, 1], [1, 0])
    state = replace(state, velocities=v, spins=c[:, 2], rate=rate, strain=strain)
    made = two_phases(state, BANDS)
    x, y = made.positions.T
    lower = y < share * height
    area = np.pi * state.radii**2
    error = 0.8 * (2 / 20_000) ** 0.5  # of random positions
    assert area[lower].sum() / (share * L * height) == pytest.approx(0.788, abs=4 * error)
    assert area[~lower].sum() / ((1 - share) * L * height) == pytest.approx(0.809, abs=4 * error)
    assert np.array_equal(x, state.positions[:, 0])
    assert np.array_equal(np.argsort(y), np.argsort(state.positions[:, 1]))

    fast, slow = np.array([6.2e-3, 4e-4]) * rate / (share * 6.2e-3 + (1 - share) * 4e-4)
    assert share * fast + (1 - share) * slow == pytest.approx(rate)
    mean = np.where(lower, fast * y, rate * height - slow * (height - y))
    mean -= (mean - rate * y).mean()
    ratio = np.where(lower, fast, slow) / rate
    assert made.velocities[:, 0] == pytest.approx(mean + 1e-3 * ratio * c[:, 0])
    assert made.velocities[:, 1] == pytest.approx(1e-3 * ratio * c[:, 1])
    assert made.spins == pytest.approx(ratio * c[:, 2])
    assert (made.phi, made.rate, made.strain) == (state.phi, rate, strain)


def test_a_start_of_two_phases_does_not_depend_on_the_image():
    state = replace(random_state(100, 0.7984, 3), rate=3e-3, strain=0.3)
    rows = np.arange(100) % 3 - 1
    shift = state.length * np.column_stack([rows * 0.3, rows])
    v = state.rate * shift[:, 1:] * [1, 0]
    other = replace(state, positions=state.positions + shift, velocities=state.velocities + v)
    a, b = (two_phases(some, BANDS) for some in (state, other))
    assert a.velocities == pytest.approx(b.velocities, abs=1e-15)
    assert a.positions == pytest.approx(b.positions, abs=1e-12)


def test_a_run_starts_with_bands_and_restarts(tmp_path):
    """Its energy budget contains the first overlaps; a restart is bit for bit; other bands are refused."""
    given = {"n": 1024, "phi": 0.7984, "rate": 3e-3, "start_bands": BANDS, "integrator": "single", "row_time": 5.0}
    whole = pj.md.shear(**given, strain=0.3)
    assert whole.settings.start == "random; bands of φ = 0.788 at γ̇ = 0.0062, φ = 0.809 at γ̇ = 0.0004"
    assert whole.settings.seed == 1
    assert whole.missed < 0.01
    assert whole.rows["energy"].max() < 0.01 * 1024  # overlaps of 2 % have an energy of 2e-4 a contact
    vx, disks = (whole.blocks[name][0] for name in ("layer_vx", "layer_disks"))
    u = vx / disks
    lower = np.diff(u)[2:14].mean()
    assert lower > 2 * np.diff(u)[20:-2].mean() > 0

    pj.md.shear(**given, strain=0.15, output=tmp_path / "run.h5")
    again = pj.md.shear(**given, strain=0.3, output=tmp_path / "run.h5", resume=True)
    assert np.array_equal(again.state.positions, whole.state.positions)
    assert np.array_equal(again.blocks["layer_stress"], whole.blocks["layer_stress"])
    with pytest.raises(InputError, match=r"start = random; bands .*cannot be resumed"):
        other = given | {"start_bands": ((0.788, 6e-3), BANDS[1])}
        pj.md.shear(**other, strain=0.4, output=tmp_path / "run.h5", resume=True)
    from_run = pj.md.shear(rate=3e-3, strain=3e-3, dt=0.01, start=whole, start_bands=BANDS)
    assert "from random; bands of φ = 0.788" in from_run.settings.start
    assert from_run.settings.start.endswith("φ = 0.809 at γ̇ = 0.0004")


def test_a_resumed_run_keeps_its_start(tmp_path):
    """Another one would be ignored."""
    first, second = (pj.md.shear(**{**SMALL, "strain": 0.02, "seed": seed}).state for seed in (1, 2))
    file = tmp_path / "run.h5"
    packing = quench_like(first)
    given = {"model": "CD", "rate": 1e-3, "strain": 1e-3, "output": file}
    pj.md.shear(**given, start=packing)
    assert pj.md.read(file).settings.seed is None
    pj.md.shear(**given, start=packing, resume=True)
    pj.md.shear(**given, resume=True)
    with pytest.raises(InputError, match=r"start = packing .*cannot be resumed"):
        pj.md.shear(**given, start=quench_like(second), resume=True)


def quench_like(state):
    """A packing of the same disks, not minimised."""
    return replace(state, velocities=0 * state.velocities).packing()


def test_the_viscosity_of_a_fluid_is_in_the_books():
    """ηF/Q times the strain rate adds to the stress, its square to heat and work; nothing else changes."""
    for protocol in (protocols.steady(1e-2, 0.5), protocols.oscillation(0.1, 0.1, 1)):
        dry, wet = (run(protocol, StokesDrag(eta), 36, 0.84, 2.0) for eta in (0.0, 5.0))
        assert np.array_equal(wet.state.positions, dry.state.positions)
        assert wet.stress - dry.stress == pytest.approx(5.0 / 2.0 * dry.rate)
        assert wet.rows["dissipative_yx"] - dry.rows["dissipative_yx"] == pytest.approx(-2.5 * dry.rate)
        assert wet.pressure == pytest.approx(dry.pressure, rel=1e-12)
        duration, area = np.diff(dry.time, prepend=0), dry.state.length**2
        more = wet.rows["heat"] - dry.rows["heat"]
        if protocol.name == "steady":
            assert more == pytest.approx(2.5 * dry.rate**2 * area * duration)
        else:
            assert more.sum() == pytest.approx(2.5 * (0.1 * 0.1) ** 2 / 2 * area * duration.sum(), rel=1e-3)
        assert wet.rows["work"] - dry.rows["work"] == pytest.approx(more)
        assert wet.rows["imbalance"] == pytest.approx(dry.rows["imbalance"], abs=1e-12)


@pytest.mark.parametrize("tilt", [0.0, 0.3])
@pytest.mark.parametrize("degrees", [0, 17, -40])
@pytest.mark.parametrize(
    "vectors", [[[1, 0], [0, -1]], [[-1, 0], [0, 1]], [[0, 1], [1, 0]], [[1, 1], [0, 1]], [[2, 1], [3, 2]]], ids=str
)
def test_squares_by_other_lattice_vectors(vectors, degrees, tilt):
    """Left-handed, in another order, sums, turned: the same lattice, so the same shear."""
    plain, F = jammed(n=36, seed=1), np.array([[1.0, tilt], [0.0, 1.0]])
    straight = pj.Packing(plain.positions @ F.T, plain.radii, plain.box.deformed(F))
    cell = np.array(vectors) @ turn(straight.box.cell, degrees)
    start = pj.Packing(turn(straight.positions, degrees), straight.radii, pj.Box(cell))
    one, two = (pj.md.shear("CD", rate=1e-2, strain=1e-2, start=p) for p in (straight, start))
    assert two.stress == pytest.approx(one.stress, rel=1e-9)
    assert two.pressure == pytest.approx(one.pressure, rel=1e-9)
    assert (f"turned by {-degrees}" in two.settings.start) == (degrees != 0)
    assert "turned" not in one.settings.start


def test_a_cell_sheared_along_y_is_turned():
    """Until its edge lies along x."""
    plain, F = jammed(n=36, seed=1), np.array([[1.0, 0.0], [0.3, 1.0]])
    upright = pj.Packing(plain.positions @ F.T, plain.radii, plain.box.deformed(F))
    lying = pj.Packing(turn(upright.positions, -90), upright.radii, pj.Box(turn(upright.box.cell, -90)))
    one, two = (pj.md.shear("CD", rate=1e-2, strain=1e-2, start=p) for p in (upright, lying))
    assert "turned by -90" in one.settings.start
    assert two.stress == pytest.approx(one.stress, rel=1e-9)
    assert one.strain[0] == pytest.approx(-0.3 + 1e-2)


def turn(vectors, degrees):
    """Turn vectors (…, 2) counter-clockwise."""
    c, s = np.cos(np.radians(degrees)), np.sin(np.radians(degrees))
    return np.asarray(vectors) @ np.array([[c, s], [-s, c]])


def stabilised():
    return jammed(2e-2, 64, 3, shear_stabilised=True)


def deformed():
    """A packing in a long and tilted cell, with shear stress."""
    F, p = np.array([[1.25, 0.3], [0.0, 0.8]]), stabilised()
    return pj.relax_packing(pj.Packing(p.positions @ F.T, p.radii, p.box.deformed(F)))


def turned(packing, degrees, basis=((1, 1), (0, 1))):
    """The same disks turned, in a cell of other lattice vectors."""
    cell = np.array(basis) @ turn(packing.box.cell, degrees)
    return pj.Packing(turn(packing.positions, degrees), packing.radii, pj.Box(cell))


@pytest.mark.parametrize(
    ("make", "degrees", "shape"),
    [(stabilised, 0, "8.86 x 9.48"), (deformed, 0, "11.1 x 7.58"), (deformed, 25, "11.1 x 7.58")],
)
def test_slow_shear_of_any_cell_shows_g0_of_the_linear_response(make, degrees, shape):
    """The slope of the stress, with pre-stress; along the edge of a cell that was turned."""
    packing = make()
    start = turned(packing, degrees) if degrees else packing
    slow = run(protocols.steady(1e-8, 3e-5), "CD", Q=0.5, start=start)
    assert f"{slow.state.length:.3g} x {slow.state.height:.3g}" == shape
    assert ("turned by -25 degrees" in slow.settings.start) == (degrees != 0)
    late = slow.strain - slow.settings.strain0 > 1.5e-5
    G0 = np.polyfit(slow.strain[late], slow.stress_elastic[late], 1)[0]
    assert G0 == pytest.approx(pj.quasistatic_response(packing).shear_modulus, rel=1e-3)


@pytest.mark.parametrize("degrees", [0, 40, 130])
@pytest.mark.parametrize("basis", [((1, 0), (0, 1)), ((1, 0), (3, -1)), ((0, -1), (1, 2))], ids=str)
def test_a_packing_is_a_start_at_rest_in_its_own_cell(basis, degrees):
    """The same contacts, lengths in units of the smallest diameter, and an edge along x."""
    packing, start = deformed(), turned(deformed(), degrees, basis)
    state = given_state(start)[0]
    assert state.phi == pytest.approx(packing.phi)
    assert 2 * state.radii.min() == pytest.approx(1.0)
    assert not state.velocities.any()
    one, two = (ContactNetwork.of(p) for p in (packing, state.packing()))
    assert (one.i.tolist(), one.j.tolist()) == (two.i.tolist(), two.j.tolist())
    assert two.pressure == pytest.approx(one.pressure)
    assert min(state.length, state.height) > 0.7 * np.sqrt(state.area)
    angle = degrees - np.degrees(_along_x(start.box.cell)[3])
    assert two.stress == pytest.approx(turn(turn(one.stress, angle).T, angle))


def test_a_first_lattice_vector_along_x_stays_there(tmp_path, capsys):
    """However long it is; a cell that is then too low is refused."""
    for start in (deformed(), turned(deformed(), 0, ((1, 0), (-2, 1)))):
        state = given_state(start)[0]
        assert state.length == pytest.approx(start.box.cell[0, 0] / (2 * start.radii.min()))
    flat = pj.Packing(jammed().positions, jammed().radii, pj.Box(jammed().box.cell * [1.0, 0.2]))
    flat.write(tmp_path / "flat.h5")
    assert main(["shear", "--start", str(tmp_path / "flat.h5"), "-o", str(tmp_path / "run.h5")]) == 2
    error = capsys.readouterr().err
    assert "a cell of 9.31 x 1.86 is too small for disks of these sizes" in error
    assert error.count("\n") == 1


@pytest.mark.parametrize("name", ["harmonic", "harmonic-relative", "hertzian", "hertzian-relative"])
@pytest.mark.parametrize("unit", [0.01, 30.0])
def test_a_start_does_not_depend_on_the_unit_of_length(name, unit):
    """Nor on a spread of the radii: the stress in units of the stiffness of disks of the smallest diameter."""
    plain = jammed(2e-2, seed=1, polydispersity=0.1, potential_name=name)
    other = pj.Packing(unit * plain.positions, unit * plain.radii, pj.Box(unit * plain.box.cell), name)
    one, two = (pj.md.shear("CD", rate=1e-4, strain=1e-3, start=p) for p in (plain, other))
    assert two.time == pytest.approx(one.time)
    assert two.stress == pytest.approx(one.stress, rel=1e-9)
    for start in (plain, other):
        p, ds = ContactNetwork.of(start).pressure, 2 * start.radii.min()
        assert one.pressure_elastic[0] == pytest.approx(p / start.potential.unit(ds), rel=1e-3)


def test_a_potential_with_a_length_of_its_own_needs_its_unit(monkeypatch):
    law = Potential(
        "stiffening", False, "a test", lambda x: x**2 / 2 + x**3, lambda x: x + 3 * x**2, lambda x: 1 + 6 * x
    )
    monkeypatch.setitem(POTENTIALS, "stiffening", law)
    packing = replace(jammed(), potential_name="stiffening")
    with pytest.raises(InputError, match=r"stiffening depends on the unit .* must be 1, not 0\.833"):
        pj.md.shear("CD", start=packing)
    ds = 2 * packing.radii.min()
    scaled = pj.Packing(packing.positions / ds, packing.radii / ds, pj.Box(packing.box.cell / ds), "stiffening")
    assert pj.md.shear("CD", rate=1e-2, strain=1e-3, start=scaled).state.potential_name == "stiffening"


def test_a_start_at_another_packing_fraction_is_rescaled_if_asked(tmp_path):
    """Cell and positions, not radii and peculiar velocities; the start says so, and a stop does not matter."""
    flow, file = pj.md.shear(**{**SMALL, "strain": 0.1}), tmp_path / "run.h5"
    with pytest.raises(InputError, match=r"packing fraction 0\.82, not 0\.8; rescale changes its cell"):
        pj.md.shear(start=flow, phi=0.8)
    state = rescaled(flow.state, 0.8)
    assert state.phi == pytest.approx(0.8)
    assert state.radii.tolist() == flow.state.radii.tolist()
    assert state.positions / state.length == pytest.approx(flow.state.positions / flow.state.length)
    assert state.peculiar == pytest.approx(flow.state.peculiar, abs=1e-15)
    given = {**SMALL, "phi": 0.8, "start": flow, "rescale": True}
    del given["seed"]
    whole = pj.md.shear(**given)
    assert whole.settings.start.endswith("rescaled from φ = 0.82")
    assert whole.settings.phi == pytest.approx(0.8)
    with pytest.raises(StoppedError):
        pj.md.shear(**given, output=file, progress=stop_at(0.5))
    assert same(pj.md.shear(**given, output=file, resume=True), whole) == []
    for refused in ({"phi": 0.8}, {"start": flow}):
        with pytest.raises(InputError, match="rescale goes with start and phi"):
            pj.md.shear(**refused, rescale=True)


def test_a_change_of_rate_scales_a_start():
    """Velocities and spins in proportion (VOT eqs. 40, 41): so does the peculiar kinetic energy, squared."""
    state = pj.md.shear(**{**SMALL, "strain": 0.1}).state
    faster = run(protocols.steady(3e-2, 1e-9), "CD_rot", start=state).state
    assert faster.rate == 3e-2
    assert np.std(faster.velocities[:, 1]) == pytest.approx(3 * np.std(state.velocities[:, 1]), rel=0.05)


def test_the_error_of_white_noise_is_its_scatter_over_the_root_of_its_length():
    """And that of an autoregressive series is larger by √((1 + a)/(1 − a))."""
    noise = np.random.default_rng(1).standard_normal(2**16)
    assert blocked_error(noise) == pytest.approx(2**-8, rel=0.5)
    assert blocked_error(noise) >= noise.std() / 256
    a, x = 0.9, np.zeros(2**16)
    for k in range(1, len(x)):
        x[k] = a * x[k - 1] + noise[k]
    expected = x.std() / 256 * ((1 + a) / (1 - a)) ** 0.5
    assert expected * 0.8 < blocked_error(x) < expected * 2


def test_time_series_as_text(tmp_path):
    """A column for each row of the file, after lines that say what it is."""
    small = pj.md.shear(**{**SMALL, "strain": 0.1})
    export_csv(small, tmp_path / "run.csv")
    lines = (tmp_path / "run.csv").read_text().splitlines()
    assert lines[0] == "# CD_rot, harmonic-relative, Q = 1"
    lines = [line for line in lines if line[0] != "#"]
    column = lines[0].split(",").index("contacts")
    assert [float(line.split(",")[column]) for line in lines[1:]] == small.contacts.tolist()


def test_a_model_survives_the_file(tmp_path):
    """A law that has no name in VOT, too."""
    law = ContactDamping(beta=0.3, rotations=True)
    made = pj.md.shear(law, 36, 0.82, 2.0, rate=1e-2, strain=0.02, stokes_drag=0.1, output=tmp_path / "a.h5")
    assert pj.md.read(tmp_path / "a.h5").settings.model == Model(law, 2.0, stokes_drag=0.1)
    assert made.settings.model == Model(law, 2.0, stokes_drag=0.1)


@any_engine("model, integrator", product(["CD_rot", "CD_n"], INTEGRATORS), lambda *case: case == ("CD_rot", "single"))
def test_a_mass_of_four_is_a_unit_of_time_of_two(tmp_path, engine, model, integrator):
    """With kd, both drags and the rate in that unit, bit for bit; with the default time step, too."""
    file, (n, rate) = tmp_path / "run.h5", (36, 1e-2) if engine == "cpu" else (16, 5e-2)
    given = {"model": model, "n": n, "phi": 0.84, "strain": 0.3, "integrator": integrator, "engine": engine}
    heavy = {"Q": 0.7, "rate": rate, "mass": 4.0, "stokes_drag": 0.1, "rotational_drag": 0.02, "output": file}
    light = {"Q": 1.4, "rate": 2 * rate, "stokes_drag": 0.05, "rotational_drag": 0.01}
    with pytest.raises(StoppedError):
        pj.md.shear(**given, **heavy, progress=stop_at(0.5))
    one, two = pj.md.shear(**given, **heavy, resume=True), pj.md.shear(**given, **light)
    assert one.settings.dt == 2 * two.settings.dt
    assert (one.state.positions == two.state.positions).all()
    assert (2 * one.state.velocities == two.state.velocities).all()
    assert (one.pressure == two.pressure).all()
    assert (one.rows["kinetic_xx"] == two.rows["kinetic_xx"]).all()
    assert (one.rows["energy"] == two.rows["energy"]).all()
    assert pj.md.read(file).settings.model.mass == 4.0
    assert "mass 4" in describe_run(one) and "mass" not in describe_run(two)
    with pytest.raises(InputError, match=r"mass = 4\.0, not 1\.0; it cannot be resumed"):
        pj.md.shear(**given, **{**heavy, "mass": 1.0}, resume=True)


@pytest.mark.parametrize("integrator", ["heun", "single"])
def test_angles_are_kept_if_asked_and_survive_a_stop(tmp_path, integrator):
    """They change nothing else, and go on from those of a start."""
    file, given = tmp_path / "run.h5", {**SMALL, "integrator": integrator, "frames": 2}
    plain = pj.md.shear(**SMALL, integrator=integrator)
    with pytest.raises(StoppedError):
        pj.md.shear(**given, angles=True, output=file, progress=stop_at(0.45))
    kept = pj.md.shear(**given, angles=True, output=file, resume=True)
    undisturbed = pj.md.shear(**SMALL, integrator=integrator, angles=True)
    assert same(kept, plain) == same(undisturbed, plain) == []
    assert plain.state.angles is None
    assert (kept.state.angles == undisturbed.state.angles).all()
    assert (pj.md.read(file).state.angles == kept.state.angles).all()
    mean = kept.rows["spin"] @ np.diff(kept.time, prepend=0)
    assert kept.state.angles.mean() == pytest.approx(mean, abs=0.02)
    frame = pj.import_packing(tmp_path / "run.frames" / "frame_000002.xyz")
    assert len(frame) == 36
    lines = (tmp_path / "run.frames" / "frame_000002.xyz").read_text().splitlines()
    assert ":angle:R:1 " in lines[1]
    assert [float(line.split()[-1]) for line in lines[2:]] == pytest.approx(kept.state.angles, rel=1e-6)
    with pytest.raises(InputError, match="angles = True, not False; it cannot be resumed"):
        pj.md.shear(**SMALL, integrator=integrator, output=file, resume=True)
    longer = pj.md.shear("CD_rot", rate=1e-2, strain=1e-4, start=file, angles=True)
    assert np.abs(longer.state.angles - kept.state.angles).max() < 1e-2
    assert pj.md.shear("CD_rot", rate=1e-2, strain=1e-4, start=file).state.angles is None


def test_states_are_checked_at_birth():
    """Names the array, and the disk."""
    state = random_state(16, 0.8, 1)
    bad = state.velocities.copy()
    bad[5, 0] = np.nan
    with pytest.raises(InputError, match="velocities of disk 5"):
        State(state.positions, bad, state.spins, state.radii, state.length)


@pytest.mark.parametrize("integrator", ["heun", "single"])
@pytest.mark.parametrize(
    ("model", "Q", "rate", "phi"),
    [
        ("CD_rot", 1.0, 1e-2, 0.3),
        ("CD_rot", 1.0, 1e-3, 0.6),
        ("CD_rot", 0.2, 1e-2, 0.6),
        ("CD_n", 0.2, 1e-2, 0.6),
        ("CD_n", 1.0, 1e-2, 0.7),
        ("CD", 0.1, 0.3, 0.6),
        ("CD", 0.3, 0.3, 0.3),
        ("CD", 30.0, 1e-2, 0.8),
    ],
)
def test_the_default_step_accounts_for_99_percent_of_the_heat(model, Q, rate, phi, integrator):
    """Where disks collide most violently for their damping, too."""
    made = pj.md.shear(model, 256, phi, Q, rate=rate, strain=2.0, integrator=integrator)
    assert made.missed < 0.01
    assert made.warnings == ()


def test_a_budget_that_misses_a_percent_is_told_everywhere(tmp_path, capsys, monkeypatch):
    """In the log, in the file, by info and in figures; in Python as a warning, here of an unstable run."""
    words = "shear --model CD_n --particles 64 --phi 0.6 --Q 0.3 --rate 1e-2 --strain 2 --dt 0.09"
    file = tmp_path / "run.h5"
    assert main([*words.split(), "-o", str(file)]) == 0
    told = f"the energy budget misses {100 * pj.md.read(file).missed:.2g} % of the heat: take a smaller dt"
    printed = capsys.readouterr()
    assert f"petscjam: warning: {file}: {told}\n" in printed.err
    assert f"WARNING: {told}" in printed.out
    for given in (file, tmp_path):
        assert main(["info", str(given)]) == 0
        assert f"WARNING: {told}" in capsys.readouterr().out
    with h5py.File(file) as h5:
        assert list(h5.attrs["warnings"]) == [told]
    shown = [plot_run(pj.md.read(file)), plot_flow({"run": pj.md.read(file)})]
    assert [figure.get_supxlabel() for figure in shown] == [f"warning: {told}", f"warning: run: {told}"]
    monkeypatch.setattr(Simulation, "demand", lambda self: 1)
    with pytest.warns(DoubtfulWarning, match=r"misses .* % of the heat"):
        hot = pj.md.shear("CD", 256, 0.9, 0.1, rate=0.3, strain=10.0, dt=0.0087, integrator="single")
    assert hot.missed > 0.1


def test_a_step_that_is_too_large_is_told(tmp_path, capsys):
    """And divided: the numbers are good."""
    words = "shear --model CD --particles 64 --phi 0.84 --Q 0.3 --rate 1e-2 --strain 0.5 --dt 0.12"
    file = tmp_path / "run.h5"
    assert main([*words.split(), "-o", str(file)]) == 0
    made = pj.md.read(file)
    told = f"dt = 0.12 is too large for the contacts in {(made.rows['parts'] > 1).sum()} of"
    assert told in capsys.readouterr().err
    assert made.rows["parts"].max() == 4
    assert made.rows["steps"].sum() > 2 * made.time[-1] / 0.12
    assert made.missed < 0.01


def test_older_files_are_read(tmp_path):
    """Schema 1 knew an exponent, relative to σ, and no parts of steps; its runs are starts."""
    file = tmp_path / "run.h5"
    made = pj.md.shear(**{**SMALL, "strain": 0.05}, exponent=2.5, output=file)
    with atomic_h5(file, existing=True) as h5:
        h5.attrs["schema"] = 1
        h5["settings"].attrs["exponent"] = 2.5
        del h5["settings"].attrs["potential"], h5["rows/parts"]
    assert same(pj.md.read(file), made) == []
    assert pj.md.read(file).state.potential_name == "hertzian-relative"
    with pytest.raises(InputError, match=r"run\.h5: .*older petscjam"):
        pj.md.shear(**SMALL, output=file, resume=True)


def test_verbs(tmp_path, capsys):
    """Shear, ramp, info, plot, maps, frames, csv, LAMMPS."""
    file = tmp_path / "run.h5"
    words = "shear --model CD_rot --particles 36 --phi 0.82 --Q 1 --rate 1e-2 --strain 0.6 --seed 3 --frames 2"
    assert main([*words.split(), "-o", str(file)]) == 0
    assert same(pj.md.read(file), pj.md.shear(**SMALL)) == []
    assert len(list((tmp_path / "run.frames").iterdir())) == 2
    maps = ["plot", file, "--maps", "-o", tmp_path / "maps.png"]
    for verb in (["info", file], ["plot", file], maps, ["export", file], ["export", file, "--to", "lammps"]):
        assert main([str(word) for word in verb]) == 0
    assert {"run.png", "maps.png", "run.csv", "run.lammps"} <= {path.name for path in tmp_path.iterdir()}
    words = "ramp --particles 36 --phi 0.8 --rate 1e-3 --to 1e-1 --kappa 0.05 --row-time 5"
    assert main([*words.split(), "-o", str(tmp_path / "ramp.h5")]) == 0
    assert main(["plot", str(tmp_path / "ramp.h5")]) == 0
    assert "energy budget" in capsys.readouterr().out


@pytest.mark.parallel(nprocs=[1, 2, 3])
def test_a_grid_gives_the_same_runs_on_any_number_of_ranks(comm, tmp_path):
    """Each point once, in a file of its own."""
    folder = comm.bcast(tmp_path) / "grid"
    points = grid(["CD_rot", "CD"], [36], [0.8, 0.84], [1.0], [1e-2], [1])
    done = []

    def work(rate, **settings):
        return begin(protocols.steady(rate, 0.05), **settings)

    made, failures = run_grid(points, folder, work, comm=comm, log=lambda file, _: done.append(file.name))
    assert (made, failures) == (4, [])
    everywhere = [name for some in comm.allgather(done) for name in some]
    assert sorted(everywhere) == sorted(f"{point.name}.h5" for point in points)
    runs = read_folder(folder)
    assert same(runs[points[2].name], pj.md.shear("CD", 36, 0.8, rate=1e-2, strain=0.05)) == []


@pytest.mark.parallel(nprocs=[1, 2])
def test_a_point_that_fails_stops_no_other(comm, tmp_path):
    """It is named; the others are made."""
    folder = comm.bcast(tmp_path) / "grid"
    points = grid(["CD"], [36], [0.8, 1.5], [1.0], [1e-2], [1])

    def work(rate, **settings):
        return begin(protocols.steady(rate, 0.02), **settings)

    made, failures = run_grid(points, folder, work, comm=comm, log=lambda file, _: None)
    assert made == 1
    assert [failure.split(":")[0] for failure in failures] == [points[1].name]
    with pytest.raises(InputError, match="exists already"):
        run_grid(points, folder, work, comm=comm, log=lambda file, _: None)


def test_ramps_over_seeds_and_over_starts_are_one_command(mpirun, tmp_path, capsys):
    """Dealt over the ranks into a folder, each as alone; a start gives its number of disks, φ and name."""
    ramp = ["ramp", "--model", "CD", "--rate", "1e-3", "--to", "2e-3", "--kappa", "0.01"]
    done = mpirun(2, "-m", "petscjam", *ramp, "--particles", "36", "--seeds", "1:2", "-o", tmp_path / "seeds")
    assert done.returncode == 0, done.stderr
    assert [file.stem[-5:] for file in sorted((tmp_path / "seeds").glob("*.h5"))] == ["seed1", "seed2"]
    pj.md.shear("CD", 36, 0.84, rate=1e-3, strain=0.01, output=tmp_path / "flow.h5")
    jammed(n=64).write(tmp_path / "packing.h5")
    starts = ["--start", tmp_path / "flow.h5", tmp_path / "packing.h5"]
    done = mpirun(2, "-m", "petscjam", *ramp, *starts, "-o", tmp_path / "starts")
    assert done.returncode == 0, done.stderr
    assert "2 of 2 runs" in done.stdout
    runs = read_folder(tmp_path / "starts")
    assert sorted(runs) == ["CD-Q1-rate0.001-flow", "CD-Q1-rate0.001-packing"]
    for name, file in (("flow", "flow.h5"), ("packing", "packing.h5")):
        alone = pj.md.ramp("CD", rate=1e-3, to=2e-3, kappa=0.01, start=tmp_path / file)
        assert same(runs[f"CD-Q1-rate0.001-{name}"], alone) == []
    (tmp_path / "other").mkdir()
    jammed(n=64).write(tmp_path / "other" / "packing.h5")
    words = [*ramp, *starts, tmp_path / "other" / "packing.h5", "-o", tmp_path / "more"]
    assert main([str(word) for word in words]) == 2
    assert "several starts are called packing" in capsys.readouterr().err
    assert not (tmp_path / "more").exists()


def test_one_run_on_two_ranks_is_made_once(mpirun, tmp_path):
    """The second rank waits."""
    words = ["--particles", "36", "--rate", "1e-2", "--strain", "0.05", "-o"]
    done = mpirun(2, "-m", "petscjam", "shear", *words, tmp_path / "run.h5")
    assert done.returncode == 0, done.stderr
    assert done.stdout.count("energy budget") == 1
