"""Local maps, profiles and bands of sheared disks, frames of a movie, and figures of all that."""

from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from matplotlib.figure import Figure

import petscjam as pj
from petscjam.base.errors import InputError
from petscjam.md import NoBandsError, bands
from petscjam.md.banding import Shape
from petscjam.md.engine import BINS
from petscjam.md.fields import _overlap, local_maps, profile
from petscjam.md.frames import write_frame
from petscjam.md.observables import ROWS
from petscjam.md.result import Run
from petscjam.md.settings import Settings
from petscjam.md.state import State, random_state
from petscjam.plots import shear
from petscjam.plots.tables import describe_run

RATE, LENGTH, LAYERS, BLOCKS = 3e-5, 60.0, 60, 12
FAST, SLOW = 6.2e-5, 4.2e-6
SHARE = (RATE - SLOW) / (FAST - SLOW)
STRESS = np.array([[2.1e-5], [-7e-6], [2e-5]])  # P_xx, P_xy, P_yy
DILUTE, DENSE, MIDDLE, WIDTH = 0.788, 0.809, 0.85, 0.06  # the last two in units of the height


def flowing(n=400, phi=0.8, seed=0, gradient=((0.0, 0.0), (0.0, 0.0)), strain=0.0, rate=RATE):
    """Disks anywhere in the flow vx = γ̇ y, with another velocity gradient on top that has no period."""
    state = random_state(n, phi, seed)
    v = state.positions @ np.asarray(gradient).T
    v[:, 0] += rate * state.positions[:, 1]
    return replace(state, velocities=v, strain=strain, rate=rate)


def with_image(state, images):
    """The same state by other images of its disks."""
    a, b = np.asarray(images).T
    x, v = state.positions.copy(), state.velocities.copy()
    x += np.column_stack([a * state.length + b * state.strain * state.height, b * state.height])
    v[:, 0] += b * state.rate * state.height
    return replace(state, positions=x, velocities=v)


def two_bands(middle=MIDDLE, share=SHARE, width=WIDTH, fast=FAST, slow=SLOW):
    """vx, φ and the mean strain rate of two bands with interfaces; a middle for each block if they move."""
    s, mean = (np.arange(LAYERS) + 0.5) / LAYERS, share * fast + (1 - share) * slow
    shapes = [Shape(float(at), share, width) for at in np.broadcast_to(middle, BLOCKS)]
    vx = np.array([mean * s + (fast - slow) * shape.velocity(s) for shape in shapes]) * LENGTH
    return vx, np.array([DENSE + (DILUTE - DENSE) * shape.weight(s) for shape in shapes]), mean


def synthetic_run(vx=None, density=None, noise=0.0, protocol="steady", seed=0, rows=200, rate=RATE, **settings):
    """A run that nobody computed, with numbers of the usual size."""
    rng = np.random.default_rng(seed)
    strain = np.linspace(0, 10, rows + 1)[1:]
    rates = np.full(rows, rate) if np.ndim(rate) == 0 else np.asarray(rate)
    state = replace(flowing(2480, 0.8, seed), length=LENGTH, height=LENGTH, strain=10.0)
    settle = 1 + np.exp(-strain)
    Q = settings.get("Q", 1.0)
    newton = 0.6 * rates / Q * settle * (1 + 0.05 * rng.normal(size=rows))
    data = {name: np.zeros(rows) for name in ROWS}
    data |= {
        "time": strain / np.abs(rates),
        "strain": strain,
        "rate": rates,
        "elastic_xx": newton,
        "elastic_yy": newton,
        "elastic_xy": -0.34 * newton * (1 + 0.03 * rng.normal(size=rows)),
        "dissipative_xx": 0.1 * newton,
        "dissipative_yy": 0.1 * newton,
        "dissipative_xy": -0.05 * newton,
        "contacts": 2.9 + 0.1 * rng.normal(size=rows),
        "energy": 1e-3 * (1 + 0.1 * rng.normal(size=rows)),
        "spin": -0.49 * rates * (1 + 0.02 * rng.normal(size=rows)),
        "spin_variance": 40 * rates**2,
        "dvx2": 6 * rates**2,
        "vy2": rates**2 * (1 + 0.1 * rng.normal(size=rows)),
    }
    data["work"] = 0.05 * newton * 3600
    data["heat"] = data["work"] - np.diff(data["energy"], prepend=data["energy"][0])
    data["imbalance"] = 1e-10 * rng.normal(size=rows)
    y = (np.arange(LAYERS) + 0.5) * LENGTH / LAYERS
    vx = RATE * y if vx is None else vx
    density = 0.8 + 0.01 * np.cos(6.28 * y / LENGTH) if density is None else density
    shape, samples = (BLOCKS, LAYERS), np.full(BLOCKS, 50)
    disks = rng.integers(1000, 1500, shape).astype(float)
    angle = (np.arange(BINS) + 0.5) * 3.6 - 180
    glancing = np.exp(-(((np.abs(angle) - 90) / 20) ** 2)) + 0.05
    tangential = rng.normal(size=(BLOCKS, 500)) * 8
    rotational = -0.8 * tangential + 3 * rng.normal(size=(BLOCKS, 500)) + 1
    normal = 0.7 * rng.normal(size=(BLOCKS, 500))
    scatter = np.stack([tangential, rotational, tangential + rotational, normal], axis=-1)
    blocks = {
        "strain": np.linspace(0, 10, BLOCKS + 1)[1:],
        "samples": samples,
        "making": rng.poisson(3000 * glancing * (np.abs(angle) > 90), (BLOCKS, BINS)),
        "breaking": rng.poisson(3000 * glancing * (np.abs(angle) < 90), (BLOCKS, BINS)),
        "layer_disks": disks,
        "layer_vx": disks * (vx + noise * rng.normal(size=shape)),
        "layer_area": 50 * LENGTH * (density + 0.003 * rng.normal(size=shape)),
        "layer_stress": 50 * LENGTH * STRESS * (1 + 0.03 * rng.normal(size=(BLOCKS, 3, LAYERS))),
        "pairs": np.full(BLOCKS, 500),
        "first": scatter.sum(1),
        "second": np.einsum("bsi,bsj->bij", scatter, scatter),
        "scatter": scatter,
    }
    usual = {"model": "CD_rot", "particles": 1024, "phi": 0.8, "Q": Q, "rate": float(rates[0]), "strain0": 0.0}
    usual |= {"time0": 0.0, "kappa": 1e-5, "protocol": protocol, "seed": seed, "dt": 0.05, "integrator": "heun"}
    usual |= {"law": "contact", "potential": "harmonic-relative", "start": "random"}
    return Run(Settings.from_attributes(usual | settings), data, blocks, state)


# --- local maps ---------------------------------------------------------------------------------------


@given(st.floats(0.1, 6), st.floats(0.2, 1), st.floats(1.1, 4))
def test_the_overlap_of_two_circles_is_the_measured_one(distance, r, R):
    rng = np.random.default_rng(1)
    x, y = rng.random((2, 20_000)) * 2 - 1
    inside = (x**2 + y**2 < 1) & ((r * x + distance) ** 2 + (r * y) ** 2 < R**2)
    assert _overlap(np.array([distance]), R, np.array([r]))[0] == pytest.approx(
        inside.mean() * 4 * r**2, abs=0.06 * r**2
    )


@pytest.mark.parametrize("distance", [3.0, 3.5, 4.0, 0.0])
def test_touching_and_concentric_circles_are_no_trouble(distance):
    whole = _overlap(np.array([distance]), 3.5, np.array([0.5]))[0]
    assert whole == pytest.approx({3.0: np.pi / 4, 0.0: np.pi / 4, 4.0: 0.0}.get(distance, whole), abs=1e-12)
    assert distance != 3.5 or 0.4 * np.pi / 4 < whole < np.pi / 8


def test_the_map_is_that_of_a_loop_over_images():
    state, radius = flowing(60, 0.5, 3, gradient=rough(3), strain=0.37), 3.0
    state = replace(state, length=1.1 * state.length, height=state.height / 1.1)
    phi, rate = local_maps(state, radius)
    shifts = [(a, b) for a in (-3, -2, -1, 0, 1, 2, 3) for b in (-3, -2, -1, 0, 1, 2, 3)]
    L, H = state.length, state.height
    for i in range(0, len(state), 7):
        area, rows, values = 0.0, [], []
        for j in range(len(state)):
            for a, b in shifts:
                r = state.positions[j] + np.array([a * L + b * state.strain * H, b * H]) - state.positions[i]
                area += _overlap(np.array([np.hypot(*r)]), radius, state.radii[j : j + 1])[0]
                if np.hypot(*r) <= radius:
                    rows.append([1, *r])
                    values.append(state.velocities[j, 0] + b * state.rate * H)
        assert phi[i] == pytest.approx(area / (np.pi * radius**2), rel=1e-12)
        assert rate[i] == pytest.approx(np.linalg.lstsq(rows, values, rcond=None)[0][2], rel=1e-8)


def rough(seed):
    return np.random.default_rng(seed).normal(size=(2, 2)) * RATE


@given(st.integers(0, 5), st.floats(-3, 3), st.floats(-1e-3, 1e-3))
def test_uniform_shear_has_one_rate_everywhere(seed, strain, rate):
    """Across the boundaries, too, and whatever the images are."""
    state = flowing(64, 0.8, seed, strain=strain, rate=rate)
    moved = with_image(state, np.random.default_rng(seed).integers(-2, 3, (64, 2)))
    assert local_maps(moved)[1] == pytest.approx(np.full(64, rate), abs=1e-12)


@given(st.integers(0, 5), st.floats(-3, 3))
def test_the_map_does_not_depend_on_the_images(seed, strain):
    rng = np.random.default_rng(seed)
    state = flowing(64, 0.8, seed, strain=strain)
    state = replace(state, velocities=state.velocities + RATE * rng.normal(size=(64, 2)))
    moved = with_image(state, rng.integers(-2, 3, (64, 2)))
    for here, there in zip(local_maps(state), local_maps(moved), strict=True):
        assert here == pytest.approx(there, rel=1e-8)
    for here, there in zip(local_maps(state), local_maps(state.wrapped()), strict=True):
        assert here == pytest.approx(there, rel=1e-8)


def test_the_local_rate_is_not_misled_by_a_gradient_along_the_flow():
    state = flowing(400, 0.8, gradient=((5e-5, 2e-5), (0, 0)))
    x = state.positions
    far = (np.abs(x - state.length / 2) < state.length / 2 - 4).all(1)  # the added flow breaks at the edges
    assert far.sum() > 50
    assert local_maps(state)[1][far] == pytest.approx(RATE + 2e-5, rel=1e-9)


def test_the_local_density_of_a_crystal_is_that_of_the_crystal():
    """A square lattice that fills the cell: the area of disks in a wide circle."""
    m = 20
    x = np.stack(np.meshgrid(np.arange(m), np.arange(m)), -1).reshape(-1, 2) * 1.0
    state = State(x, 0 * x, np.zeros(m * m), np.full(m * m, 0.5), float(m))
    phi, _ = local_maps(state, 6.0)
    assert phi == pytest.approx(np.full(m * m, phi[0]), rel=1e-12)
    assert phi[0] == pytest.approx(np.pi / 4, rel=0.02)


@given(st.floats(1, 2), st.floats(-2, 2))
def test_one_disk_or_two_have_no_strain_rate(dx, dy):
    x = np.array([[1.0, 1.0], [20.0, 20.0], [20.0 + dx, 20.0 + dy]])
    state = State(x, np.sin(x), np.zeros(3), np.full(3, 0.5), 40.0, rate=RATE)
    phi, rate = local_maps(state)
    assert np.isnan(rate).all()
    assert phi == pytest.approx(np.array([1, 2, 2]) * 0.25 / 16)


def test_a_circle_smaller_than_a_disk_is_refused():
    with pytest.raises(InputError, match=r"above that of a disk, 0\.7, not 0\.5"):
        local_maps(flowing(), 0.5)


# --- profiles and bands -------------------------------------------------------------------------------


def test_the_profile_of_uniform_shear():
    p = profile(synthetic_run())
    assert p.vx == pytest.approx(RATE * p.y, rel=1e-12)
    assert p.rate == pytest.approx(np.full(LAYERS, RATE), rel=1e-9)
    assert p.vx_error == pytest.approx(np.zeros(LAYERS), abs=1e-15)


def test_the_profile_of_a_cell_of_another_shape():
    """Layers fill its height; the disks of a layer lie along its length."""
    run = synthetic_run()
    p, other = profile(run), profile(replace(run, state=replace(run.state, length=2 * LENGTH)))
    assert other.y.tolist() == p.y.tolist()
    assert other.rate.tolist() == p.rate.tolist()
    assert other.phi == pytest.approx(p.phi / 2)
    layers = profile(replace(run, state=replace(run.state, height=2 * LENGTH)))
    assert layers.y == pytest.approx(2 * p.y)
    assert layers.rate[1:-1] == pytest.approx(p.rate[1:-1] / 2)
    assert layers.phi == pytest.approx(p.phi / 2)


def test_the_profile_leaves_out_the_start():
    run = synthetic_run()
    wrong = run.blocks["layer_vx"].copy()
    wrong[run.blocks["strain"] <= 4] = 1e3
    late = profile(replace(run, blocks={**run.blocks, "layer_vx": wrong}), after=4.0)
    assert late.vx == pytest.approx(RATE * late.y, rel=1e-12)
    with pytest.raises(InputError, match=r"none of 12 blocks ends after a strain of 11"):
        profile(run, after=11)


def test_the_packing_fraction_of_all_layers_is_that_of_the_cell():
    run = synthetic_run()
    kept = run.blocks["layer_area"].sum(1) / (50 * LENGTH**2)
    assert profile(run, after=0).phi.mean() == pytest.approx(kept.mean(), rel=1e-12)


def test_the_errors_of_the_profile_are_those_of_means_over_blocks():
    """Equal weights: the jackknife is std/√B; over many layers they agree with the noise put in."""
    noise, run = 1e-6, synthetic_run(noise=1e-6)
    even = {**run.blocks, "layer_vx": run.blocks["layer_vx"] / run.blocks["layer_disks"]}
    even["layer_disks"] = np.ones((BLOCKS, LAYERS))
    p = profile(replace(run, blocks=even), after=0)
    assert p.vx_error == pytest.approx(even["layer_vx"].std(0, ddof=1) / BLOCKS**0.5, rel=1e-9)
    assert np.sqrt((p.vx_error**2).mean()) == pytest.approx(noise / BLOCKS**0.5, rel=0.1)
    assert np.sqrt((p.rate_error**2).mean()) == pytest.approx(noise / (2 * BLOCKS) ** 0.5, rel=0.1)


def test_one_block_has_no_errors():
    assert np.isnan(profile(synthetic_run(), after=9.5).vx_error).all()


def test_an_empty_layer_is_named():
    run = synthetic_run()
    disks = run.blocks["layer_disks"].copy()
    disks[:, 7] = 0
    with pytest.raises(InputError, match="layer 7 contains no disk"):
        profile(replace(run, blocks={**run.blocks, "layer_disks": disks}))


def in_the_middles(share=SHARE, width=WIDTH, fast=FAST, slow=SLOW):
    """γ̇, φ and their lever rule in the middles of two bands."""
    weight = Shape(0.0, share, width).weight(np.array([0.0, 0.5]))
    lever = (share - weight[1]) / (weight[0] - weight[1])
    return slow + (fast - slow) * weight, DENSE + (DILUTE - DENSE) * weight, np.array([lever, 1 - lever])


@pytest.mark.parametrize(
    ("middle", "share", "width", "sign"), [(0.0, 0.3, 0.02, 1), (0.31, 0.5, 0.1, -1), (0.5, 0.7, 0.05, 1)]
)
def test_two_bands_are_found_where_they_are(middle, share, width, sign):
    vx, phi, mean = two_bands(middle, share, width)
    run = synthetic_run(sign * vx, phi, rate=sign * mean)
    b = bands(run)
    rates, phis, shares = in_the_middles(share, width)
    assert b.rate == pytest.approx(sign * rates, rel=1e-2)
    assert b.share == pytest.approx(shares, abs=2e-3)
    assert b.width == pytest.approx(width * LENGTH, rel=2e-2, abs=0.1)
    assert b.phi == pytest.approx(phis, abs=2e-3)
    assert b.rate @ b.share == pytest.approx(sign * mean)
    assert b.phi @ b.share_phi == pytest.approx(profile(run).phi.mean())
    assert np.abs((b.middles / LENGTH - middle + 0.5) % 1 - 0.5) == pytest.approx(np.zeros(len(b.middles)), abs=2e-3)
    assert b.skill > 0.99
    assert b.profile.vx == pytest.approx(b.fitted[0], abs=1e-6)


@pytest.mark.parametrize("drift", [0.0, 0.02])
def test_the_errors_of_bands_are_those_of_repeated_runs(drift):
    """The deviations from the numbers put in, in standard errors, have mean 0 and variance 1; also with a drift."""
    vx, phi, _ = two_bands(MIDDLE + drift * np.arange(BLOCKS))
    rates, phis, shares = in_the_middles()
    pulls = []
    for seed in range(40):
        b = bands(synthetic_run(vx, phi, noise=3e-5, seed=seed), after=0)
        e = b.errors
        moved = (b.middles[-1] - b.middles[0]) % LENGTH
        assert moved == pytest.approx(11 * drift * LENGTH, abs=1.0) or moved > LENGTH - 1
        pulls.append(
            np.concatenate(
                [
                    (b.rate - rates) / e.rate,
                    (b.phi - phis) / e.phi,
                    (b.share - shares)[:1] / e.share[:1],
                    (b.share_phi - shares)[:1] / e.share_phi[:1],
                    ((b.stresses - [2.1e-5, 7e-6, 2e-5]) / e.stresses).ravel(),
                    [(b.width - WIDTH * LENGTH) / e.width],
                ]
            )
        )
    assert np.abs(np.mean(pulls, axis=0)).max() < 0.6  # of 13 means of 40, each ± 0.17
    assert np.std(pulls, axis=0) == pytest.approx(np.full(13, 1.1), abs=0.35)  # errors from 12 blocks, ± 0.13


def test_homogeneous_flow_has_no_bands():
    """Neither noise, nor a random walk of vx in y, nor density waves are bands."""
    rng = np.random.default_rng(1)
    for noise in (3e-6, 3e-4):
        with pytest.raises(NoBandsError, match="homogeneous"):
            bands(synthetic_run(noise=noise))
    walk = rng.normal(size=(BLOCKS, LAYERS))
    walk = np.cumsum(walk - walk.mean(1, keepdims=True), axis=1)
    y = (np.arange(LAYERS) + 0.5) * LENGTH / LAYERS
    with pytest.raises(NoBandsError, match="homogeneous"):
        bands(synthetic_run(RATE * y + 1e-4 * walk))
    vx, phi, mean = two_bands(fast=3.5e-5, slow=2.5e-5, share=0.5)
    with pytest.raises(NoBandsError, match="by strain rate"):
        bands(synthetic_run(vx, phi, rate=mean))
    vx, phi, mean = two_bands()
    with pytest.raises(NoBandsError, match="by φ"):
        bands(synthetic_run(vx, phi * 0 + 0.8))


def test_runs_without_bands_to_look_for_are_refused():
    vx, phi, _ = two_bands()
    run = synthetic_run(vx, phi)
    with pytest.raises(NoBandsError, match="60 layers and 3 blocks"):
        bands(run, after=8)
    few = {name: run.blocks[name][..., :6] for name in ("layer_disks", "layer_vx", "layer_area", "layer_stress")}
    with pytest.raises(NoBandsError, match="6 layers and 9 blocks"):
        bands(replace(run, blocks={**run.blocks, **few}))
    with pytest.raises(NoBandsError, match="changes"):
        bands(synthetic_run(vx, phi, rate=np.linspace(1e-5, 3e-5, 200)))


def test_bands_of_older_runs_have_no_stresses():
    vx, phi, _ = two_bands()
    run = synthetic_run(vx, phi)
    older = replace(run, blocks={name: values for name, values in run.blocks.items() if name != "layer_stress"})
    new, old = bands(run), bands(older)
    assert np.isnan(old.stresses).all()
    assert (old.rate == new.rate).all()
    assert ("P_yy" in describe_run(run), "P_yy" in describe_run(older)) == (True, False)


# --- frames -------------------------------------------------------------------------------------------


def test_a_frame_holds_the_state(tmp_path):
    state = with_image(flowing(100, 0.8, strain=7.8), np.ones((100, 2)))
    spins = np.random.default_rng(5).normal(size=100)
    path = write_frame(replace(state, spins=spins, time=12.5), tmp_path / "movie", 12)
    assert path == tmp_path / "movie" / "frame_000012.xyz"
    header = path.read_text().splitlines()[1]
    assert 'pbc="T T F" Time=12.5 strain=7.8 rate=3e-05' in header
    data = np.loadtxt(path, skiprows=2, usecols=range(1, 14))
    s = np.linalg.solve(state.box.cell.T, data[:, :2].T)
    assert (s > -1e-9).all() and (s < 1 + 1e-9).all()
    assert data[:, 3] == pytest.approx(state.radii)
    assert data[:, 4] == pytest.approx(RATE * data[:, 1], rel=1e-6)  # of that image
    assert data[:, 9] == pytest.approx(spins, rel=1e-6)
    assert data[:, 11:13] == pytest.approx(np.array(local_maps(state)).T, rel=1e-6)


@pytest.mark.parametrize("name", ["harmonic", "hertzian-relative", "power-3.0-relative"])
def test_a_frame_says_how_its_disks_repel(tmp_path, name):
    state = replace(flowing(16, 0.7), potential_name=name)
    assert pj.import_packing(write_frame(state, tmp_path, 0)).potential_name == name


@pytest.mark.parametrize("height", [None, 8.0, 14.0])
def test_a_frame_is_a_packing_for_the_importer(tmp_path, height):
    state = replace(flowing(100, 0.8, strain=-3.3), height=height)
    packing = pj.import_packing(write_frame(state, tmp_path, 0))
    assert packing.potential_name == state.potential_name == "harmonic-relative"
    assert packing.box.cell == pytest.approx(state.box.cell)
    apart = state.box.minimum_image(packing.positions - state.positions)
    assert np.abs(apart).max() < 1e-9


def test_the_species_of_a_frame_are_the_sizes(tmp_path):
    lines = write_frame(flowing(16, 0.7), tmp_path, 0).read_text().splitlines()[2:]
    assert [line.split()[0] for line in lines] == ["H"] * 8 + ["He"] * 8


def test_a_folder_that_is_a_file_is_refused(tmp_path):
    (tmp_path / "movie").write_text("")
    with pytest.raises(InputError, match=r"movie.*frame_000001\.xyz: File exists"):
        write_frame(flowing(16, 0.7), tmp_path / "movie", 1)


# --- figures ------------------------------------------------------------------------------------------


@pytest.fixture
def drawn(monkeypatch):
    """The figures that were to be saved; each is drawn once, so that nothing in it is broken."""
    figures = []

    def keep(figure, path):
        figure.canvas.draw()
        figures.append(figure)
        return figure

    monkeypatch.setattr(shear, "finished", keep)
    return figures


def texts(figure):
    return [t.get_text() for t in figure.findobj(lambda a: hasattr(a, "get_text"))]


def banded_run():
    vx, phi, _ = two_bands()
    return synthetic_run(vx, phi, noise=2e-5)


def test_the_figures_are_written(tmp_path):
    shear.plot_run(banded_run(), tmp_path / "run.png")
    shear.plot_maps(flowing(), tmp_path / "maps.pdf")
    assert (tmp_path / "run.png").read_bytes()[:4] == b"\x89PNG"
    assert (tmp_path / "maps.pdf").read_bytes()[:4] == b"%PDF"


def test_the_sheet_of_a_banded_run_says_so(drawn):
    shear.plot_run(banded_run(), None)
    shear.plot_run(synthetic_run(noise=2e-5), None)
    assert any("two bands:" in t for t in texts(drawn[0]))
    assert not any("two bands:" in t for t in texts(drawn[1]))
    assert "two bands:" in describe_run(banded_run())
    assert "two bands:" not in describe_run(synthetic_run(noise=2e-5))


def test_the_angles_are_a_density(drawn):
    shear.plot_run(synthetic_run(), None)
    outline = drawn[0].axes[7].patches[-1].get_data()
    assert (outline.values * np.diff(outline.edges)).sum() == pytest.approx(1)
    assert outline.edges[[0, -1]] == pytest.approx([-180, 180])


def test_the_imbalance_is_summed_and_told_by_the_heat(drawn):
    run = synthetic_run()
    rows = {**run.rows, "heat": np.full(200, 2e-4), "imbalance": np.full(200, -1e-9)}
    shear.plot_run(replace(run, rows=rows), None)
    assert drawn[0].axes[3].lines[0].get_ydata() == pytest.approx(np.full(200, 5e-6))


@pytest.mark.parametrize("there_and_back", [False, True])
def test_a_run_to_and_fro_is_drawn_against_time(drawn, there_and_back):
    run = synthetic_run()
    strain = 10 * np.sin(run.strain) if there_and_back else run.strain
    shear.plot_run(replace(run, rows={**run.rows, "strain": strain}), None)
    assert drawn[0].axes[0].lines[0].get_xdata() == pytest.approx(run.time if there_and_back else strain)


@pytest.mark.parametrize("change", ["no events", "no scatter", "two rows", "backwards", "no rotation"])
def test_poor_runs_are_drawn(drawn, change):
    run = synthetic_run()
    blocks, rows = dict(run.blocks), dict(run.rows)
    if change == "no events":
        blocks["making"] = blocks["breaking"] = np.zeros((BLOCKS, BINS), int)
        for key in ("work", "heat", "energy"):
            rows[key] = np.zeros(200)
    elif change == "no scatter":
        blocks |= {"scatter": np.full((BLOCKS, 5, 4), np.nan), "pairs": np.zeros(BLOCKS, int)}
    elif change == "two rows":
        rows = {key: values[-2:] for key, values in rows.items()}
    elif change == "backwards":
        rows |= {"strain": -rows["strain"], "rate": -rows["rate"]}
        blocks["strain"] = -blocks["strain"]
    else:
        rows["spin"] = np.zeros(200)
        blocks["scatter"] = blocks["scatter"] * [1, 0, 1, 1]
    shear.plot_run(replace(run, rows=rows, blocks=blocks), None)
    shown = [axes.axison for axes in drawn[0].axes]
    assert shown == [True] * 8 + [change != "no rotation"] * 2 + [True, False]


def test_every_disk_of_a_map_has_its_colour_and_images(drawn):
    state = flowing(100, 0.8, strain=0.3)
    shear.plot_maps(state, None)
    phi, rate = local_maps(state)
    which, centre = state.box.images(state.positions, state.radii[:, None], pj.Box.square(state.length))
    assert set(which) == set(range(100))
    for axes, values in zip(drawn[0].axes, (phi, rate), strict=False):
        assert np.array_equal(axes.collections[0].get_array(), values[which])
    apart = (centre - state.positions[which]) @ np.linalg.inv(state.box.cell)
    assert apart == pytest.approx(np.rint(apart), abs=1e-9)
    # As many as a search through many images finds.
    L, x = state.length, state.positions
    found = 0
    for a in range(-4, 5):
        for b in range(-4, 5):
            c = x + L * np.array([a + 0.3 * b, b])
            found += ((c > -state.radii[:, None]) & (c < L + state.radii[:, None])).all(1).sum()
    assert found == len(which)


def ramp():
    up = np.geomspace(1e-6, 1e-3, 60)
    rate = np.concatenate([up, up[-2::-1]])
    run = synthetic_run(rows=119, rate=rate, protocol="ramp")
    newton = np.where(np.arange(119) < 60, rate > 1e-4, rate > 3e-5)
    stress = np.where(newton, 0.6 * rate, 3e3 * rate**2)
    rows = {key: 0 * rate if key.startswith(("dissipative", "kinetic")) else run.rows[key] for key in ROWS}
    rows |= {"elastic_xy": -0.34 * stress, "elastic_xx": stress, "elastic_yy": stress}
    return replace(run, rows=rows)


def test_a_ramp_has_an_up_and_a_down(drawn):
    run = ramp()
    shear.plot_ramp(run, None)
    up, down, *slopes = drawn[0].axes[0].lines
    assert up.get_xdata() == pytest.approx(np.geomspace(1e-6, 1e-3, 60)[: len(up.get_xdata())])
    assert len(up.get_xdata()) + len(down.get_xdata()) == 119
    assert np.all(np.diff(down.get_xdata()) <= 0)
    for line, slope in zip(slopes, (2, 1), strict=True):
        x, y = line.get_data()
        assert np.diff(np.log(y)) / np.diff(np.log(x)) == pytest.approx(slope)
    with pytest.raises(InputError, match="not a ramp, but of the protocol 'steady'"):
        shear.plot_ramp(synthetic_run(), None)


def test_flow_curves_take_what_varies_as_abscissa(drawn):
    rates = [1e-5, 1e-4, 1e-3]
    shear.plot_flow({f"{r}{q}": synthetic_run(rate=r, Q=q) for r in rates for q in (1.0, 10.0)}, None)
    shear.plot_flow({f"{phi}": synthetic_run(phi=phi) for phi in (0.78, 0.8, 0.82)}, None)
    first = drawn[0].axes[0].containers
    assert len(first) == 2
    assert first[0][0].get_xdata() == pytest.approx(rates)
    assert any("$Q$ = 10" in t for t in texts(drawn[0]))
    assert "\\phi" in drawn[1].axes[0].get_xlabel()


def test_runs_alike_are_one_point(drawn):
    runs = [synthetic_run(seed=seed) for seed in range(4)]
    shear.plot_flow({str(k): run for k, run in enumerate(runs)}, None)
    (curve,) = drawn[0].axes[0].containers
    means = [run.mean("stress").value for run in runs]
    assert curve[0].get_ydata() == pytest.approx([np.mean(means)])
    (segment,) = curve[2][0].get_segments()
    assert np.diff(segment[:, 1])[0] / 2 == pytest.approx(np.std(means, ddof=1) / 2)


def test_flow_curves_refuse_what_is_not_steady():
    with pytest.raises(InputError, match="there are no runs"):
        shear.plot_flow({}, None)
    with pytest.raises(InputError, match=r"a\.h5 is not a steady run, but a ramp"):
        shear.plot_flow({"a.h5": ramp()}, None)


def test_disks_that_do_not_turn_have_no_panels_of_spin(drawn):
    run = synthetic_run()
    shear.plot_flow({"a": replace(run, rows={**run.rows, "spin": np.zeros(200)})}, None)
    labels = [axes.get_ylabel() for axes in drawn[0].axes if axes.axison]
    assert labels[:2] == [r"shear stress $\Sigma$  ($m/\tau_e^2$)", r"friction $\mu = \Sigma/P$"]
    assert len(labels) == 7
    assert not any("theta" in label for label in labels)
    assert isinstance(drawn[0], Figure)
