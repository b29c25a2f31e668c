"""Figures of packings and of libraries, and the fits in them."""

import json
import subprocess
import sys
from dataclasses import replace

import numpy as np
import pytest
from helpers import jammed, sixteen
from matplotlib.collections import EllipseCollection, LineCollection
from matplotlib.figure import Figure

import petscjam as pj
from petscjam.analysis.jamming import fit_phi_J, fit_power
from petscjam.plots import plot_library, plot_packing
from petscjam.plots.library import _draw_curves, _draw_density, _draw_excess, _draw_lowest, _sizes, _summary
from petscjam.plots.packing import draw_packing

SIGNATURES = {"png": b"\x89PNG", "pdf": b"%PDF", "svg": b"<?xml", "": b"\x89PNG"}
TILTED = pj.Box([[3.0, 0.5], [-7.0, 4.0]])


@pytest.fixture(scope="module")
def packing():
    return jammed(seed=3)


def row(n=64, p=1e-3, **others):
    """A packing with two contacts more than it needs."""
    return {
        "particles": n,
        "pressure": p,
        "target": p,
        "potential": "harmonic",
        "phi": 0.84 + 2 * p,
        "Z": 4 + 2 / n,
        "rattlers": 0,
        "contacts": 2 * n + 1,
        "lowest_eigenvalue": 1e-3,
        "proved": True,
    } | others


def drawn(packing):
    axes = Figure(figsize=(6, 6)).subplots()
    draw_packing(axes, packing, 6)
    backbone, rattlers = (c for c in axes.collections if isinstance(c, EllipseCollection))
    lines = next((c for c in axes.collections if isinstance(c, LineCollection)), None)
    return axes, backbone, rattlers, lines


def test_importing_the_figures_loads_no_matplotlib():
    code = "import json, sys, petscjam.plots; print(json.dumps('matplotlib' in sys.modules))"
    assert not json.loads(subprocess.run([sys.executable, "-c", code], capture_output=True, check=True).stdout)


# --- the file -----------------------------------------------------------------------------------------


@pytest.mark.parametrize("suffix", SIGNATURES)
@pytest.mark.parametrize("what", ["packing", "library"])
def test_the_suffix_is_the_format(packing, tmp_path, suffix, what):
    target = (tmp_path / "figure").with_suffix(f".{suffix}" if suffix else "")
    if what == "packing":
        plot_packing(packing, target)
    else:
        plot_library([row(), row(p=1e-2)], target)
    assert target.read_bytes().startswith(SIGNATURES[suffix])
    assert list(tmp_path.iterdir()) == [target]


@pytest.mark.parametrize("suffix", ["xyzzy", "h5"])
def test_an_unknown_format_leaves_the_file_as_it_was(packing, tmp_path, suffix):
    target = tmp_path / f"figure.{suffix}"
    target.write_bytes(b"precious")
    with pytest.raises(pj.InputError, match=f"'{suffix}' is not a format"):
        plot_packing(packing, target)
    assert target.read_bytes() == b"precious"


def test_a_figure_that_fails_leaves_the_file_as_it_was(packing, tmp_path, monkeypatch):
    target = tmp_path / "figure.png"
    target.write_bytes(b"precious")

    def half(self, file, **options):
        file.write(b"half a picture")
        raise MemoryError

    monkeypatch.setattr(Figure, "savefig", half)
    with pytest.raises(MemoryError):
        plot_packing(packing, target)
    assert target.read_bytes() == b"precious"
    assert list(tmp_path.iterdir()) == [target]


def test_a_missing_folder_is_named(packing, tmp_path):
    with pytest.raises(pj.InputError, match="nowhere"):
        plot_packing(packing, tmp_path / "nowhere" / "figure.png")


# --- a packing ----------------------------------------------------------------------------------------


def test_the_images_are_all_that_come_near_a_tilted_cell():
    points = np.random.default_rng(1).normal(scale=9, size=(6, 2))
    which, where = TILTED.images(points, 0.7)
    assert TILTED.fractional(where - points[which]) == pytest.approx(np.rint(TILTED.fractional(where - points[which])))
    shifts = np.mgrid[-20:21, -20:21].reshape(2, -1).T @ TILTED.cell
    inside = np.array([[a, b] for a in np.linspace(0, 1, 60) for b in np.linspace(0, 1, 60)]) @ TILTED.cell
    for i, point in enumerate(points):
        near = [x for x in point + shifts if np.linalg.norm(inside - x, axis=1).min() < 0.7]
        found = where[which == i]
        assert len(np.unique(found.round(9), axis=0)) == len(found)
        for x in near:
            assert np.linalg.norm(found - x, axis=1).min() < 1e-9


def test_a_contact_across_an_edge_is_drawn_at_both():
    pair = pj.Packing([[0.1, 5.0], [9.3, 5.0]], [0.5, 0.5], pj.Box.square(10.0))
    _, _, _, lines = drawn(pair)
    ends = np.sort([segment[:, 0] for segment in lines.get_segments()], axis=1)
    assert ends[np.argsort(ends[:, 0])] == pytest.approx(np.array([[-0.7, 0.1], [9.3, 10.1]]))


@pytest.mark.parametrize("lattice", [[[1, 0], [0, 1]], [[1, 0], [3, 1]], [[0, -1], [1, 0]], [[2, 1], [1, 1]]])
def test_every_force_inside_the_cell_is_drawn_once(packing, lattice):
    """However it is tilted: the midpoints of the lines within the cell are those of the contacts."""
    box = pj.Box(np.array(lattice) @ packing.box.cell)
    packing = replace(packing, box=box)
    network = pj.ContactNetwork.of(packing)
    _, _, _, lines = drawn(packing)
    s = box.fractional([segment.mean(0) for segment in lines.get_segments()])
    inside = ((s >= 0) & (s < 1)).all(1)
    assert inside.sum() == len(network)
    lengths = [np.linalg.norm(a - b) for a, b in np.array(lines.get_segments())[inside]]
    assert np.sort(lengths) == pytest.approx(np.sort(network.distance))


def test_lines_are_as_wide_as_the_force(packing):
    network = pj.ContactNetwork.of(packing)
    _, _, _, lines = drawn(packing)
    middles = np.array(lines.get_segments()).mean(1)
    force = np.empty(len(middles))
    for c in range(len(network)):
        shift = packing.box.fractional(middles - packing.positions[network.i[c]] - network.r[c] / 2)
        force[np.abs(shift - np.rint(shift)).max(1) < 1e-9] = network.force[c]
    width = np.array(lines.get_linewidths())
    assert width / width.max() == pytest.approx(force / network.force.max())


def test_rattlers_are_dashed_and_the_others_are_not():
    lattice = 0.99 * np.mgrid[0:4, 0:4].reshape(2, -1).T
    packing = pj.Packing([*lattice, [0.5, 0.5], [3.5, 3.4]], [0.5] * 16 + [0.1] * 2, pj.Box.square(3.96))
    network = pj.ContactNetwork.of(packing)
    assert network.rattlers == 2
    axes, backbone, rattlers, _ = drawn(packing)
    for collection, some in ((backbone, network.backbone), (rattlers, ~network.backbone)):
        s = packing.box.fractional(collection.get_offsets())
        inside = ((s >= 0) & (s < 1)).all(1)
        assert inside.sum() == some.sum()
    assert backbone.get_linestyle()[0][1] is None
    assert rattlers.get_linestyle()[0][1] is not None
    assert axes.get_title().endswith("2 rattlers")


def test_everything_is_cut_at_the_cell(packing):
    _, *collections = drawn(packing)
    assert all(collection.get_clip_path() is not None for collection in collections)


def test_many_disks_have_no_outlines(packing, monkeypatch):
    monkeypatch.setattr("petscjam.plots.packing.OUTLINED", 10)
    _, backbone, rattlers, lines = drawn(packing)
    assert backbone.get_linewidth() == rattlers.get_linewidth() == [0]
    assert all(collection.get_rasterized() for collection in (backbone, rattlers, lines))


@pytest.mark.parametrize(("proved", "text"), [(None, "not judged"), (True, "proved minimum"), (False, "not proved")])
def test_the_verdict_is_written(packing, proved, text):
    judged = replace(packing, certificate=replace(packing.certificate, proved=proved))
    assert [t.get_text() for t in drawn(judged)[0].texts] == [text]


def test_disks_that_do_not_touch_are_drawn_too(tmp_path):
    plot_packing(pj.Packing([[1.0, 1.0], [3.0, 3.0]], [0.5, 0.5], pj.Box.square(4.0)), tmp_path / "gas.png")
    assert drawn(pj.Packing([[1.0, 1.0]], [0.5], pj.Box.square(4.0)))[3] is None


def test_a_tilted_packing_from_elsewhere(tmp_path):
    plot_packing(sixteen(), tmp_path / "sixteen.png")


HISTORY = {
    "evaluations": [1, 10, 20, 30],
    "phi": [0.86, 0.86, 0.85, 0.85],
    "pressure": [0.1, 0.02, 0.0, 0.01],
    "force": [1.0, 1e-3, 0.0, 1e-10],
}


@pytest.mark.parametrize(
    ("history", "beside"),
    [
        (HISTORY, True),
        (HISTORY | {"phi": [0.86]}, False),
        ({"evaluations": [1, 2]}, False),
        ({name: [] for name in HISTORY}, False),
        ("none", False),
    ],
)
def test_a_history_is_drawn_beside_the_packing(packing, tmp_path, history, beside):
    from PIL import Image

    told = replace(packing, provenance={**packing.provenance, "history": history})
    plot_packing(told, tmp_path / "told.png")
    width, height = Image.open(tmp_path / "told.png").size
    assert (width > 1.3 * height) == beside


# --- a library ----------------------------------------------------------------------------------------


def test_a_library_of_packings(tmp_path):
    rows = []
    for seed, p in enumerate([1e-2, 1e-2, 3e-2, 3e-2]):
        packing = pj.prepare_packing(32, p, seed)
        network = pj.ContactNetwork.of(packing)
        inside = int((network.backbone[network.i] & network.backbone[network.j]).sum())
        rows.append(
            row(
                32,
                network.pressure,
                target=p,
                phi=packing.phi,
                Z=network.Z,
                rattlers=network.rattlers,
                contacts=inside,
                proved=None,
            )
        )
    plot_library(rows, tmp_path / "library.png")
    (size,) = _sizes(rows)
    backbone = 32 - np.array([r["rattlers"] for r in rows])
    assert size.excess == pytest.approx(np.array([r["Z"] for r in rows]) - 4 + 2 / backbone)


@pytest.mark.parametrize(
    "change",
    [
        {},
        {"lowest_eigenvalue": None},
        {"lowest_eigenvalue": -1e-3},
        {"proved": False},
        {"target": None},
        {"contacts": 127},
    ],
)
def test_a_library_of_one_packing(tmp_path, change, recwarn):
    plot_library([row(**change)], tmp_path / "one.png")
    assert not recwarn.list


def test_a_packing_with_no_contact_to_spare_has_no_excess():
    (size,) = _sizes([row(contacts=2 * 61 - 1, rattlers=3)])
    assert size.excess.tolist() == [0.0]


def test_means_leave_out_what_is_not_proved():
    (size,) = _sizes([row(phi=0.84), row(phi=0.86), row(phi=0.85, proved=None), row(phi=0.1, proved=False)])
    mean, error = size.mean(size.phi)
    assert mean == pytest.approx([0.85])
    assert error == pytest.approx([0.01 / np.sqrt(3)])


def test_missing_and_negative_eigenvalues_are_counted():
    values = [None, np.nan, -1e-4, 0.0, 1e-4, 4e-4]
    (size,) = _sizes([row(lowest_eigenvalue=value) for value in values])
    axes = Figure().subplots()
    _draw_lowest([axes], [size], lambda p: "black")
    assert axes.get_title(loc="left") == r"N = 64, 2 without a value, 2 with $\lambda \leq 0$"
    steps, median = axes.lines
    assert steps.get_xydata() == pytest.approx(np.array([[0.01, 0], [0.01, 0.5], [0.02, 1]]))
    assert median.get_xdata() == pytest.approx([0.015])


def test_what_a_logarithm_hides_is_counted():
    (size,) = _sizes([row(contacts=2 * 64 - 1 + spare) for spare in (0, 0, 2)])
    axes = Figure().subplots()
    _draw_curves(axes, [(size, size.excess, "N")], lambda p: np.zeros((len(np.atleast_1d(p)), 4)), "hidden")
    assert [text.get_text() for text in axes.get_legend().get_texts()] == ["N", "2 hidden"]


def test_the_title_counts_verdicts():
    assert _summary([row()]) == "1 packing: 1 proved"
    assert _summary([row(), row(proved=None), row(proved=False)]).endswith(": 1 proved, 1 not proved, 1 not judged")


def test_packings_that_are_not_jammed_are_counted_and_not_drawn(tmp_path):
    rows = [row(), row(p=0.0, target=None, proved=None), row(contacts=0, rattlers=64, proved=None)]
    plot_library(rows, tmp_path / "loose.png")
    (size,) = _sizes(rows)
    assert size.p.tolist() == [1e-3]
    assert _summary(rows) == "3 packings: 1 proved, 2 not judged; 2 not jammed, not drawn"


def legend(draw, rows, a):
    axes = Figure().subplots()
    draw(axes, _sizes(rows), lambda p: np.zeros((*np.shape(p), 4)), a)
    entries = axes.get_legend().get_texts()
    return [[text.get_text() for text in texts] for texts in (entries, axes.texts)]


@pytest.mark.parametrize(("a", "slopes"), [(1.0, ("1", "1/2")), (2 / 3, ("2/3", "1/3"))])
def test_the_laws_follow_the_potential(a, slopes):
    """Rows that obey φ − 0.84 ~ p^a and Z − Z_iso ~ p^(a/2) exactly."""
    rows = []
    for overlap in (1e-4, 1e-3, 1e-2):
        p = overlap ** (1 / a)
        contacts = 2 * 1024 - 1 + 1024 * overlap**0.5
        rows += [row(1024, p, phi=0.84 + 2 * overlap, contacts=contacts)] * 2
    entries, guides = legend(_draw_density, rows, a)
    assert float(entries[0].split("$ = ")[1].split()[0]) == pytest.approx(0.84)
    assert guides == [f"slope {slopes[0]}"]
    entries, guides = legend(_draw_excess, rows, a)
    assert float(entries[1].split()[1]) == pytest.approx(a / 2, abs=1e-4)
    assert guides == [f"slope {slopes[1]}"]


def test_the_exponent_is_that_of_the_potential(monkeypatch, tmp_path):
    found = []
    monkeypatch.setattr("petscjam.plots.library._draw_density", lambda *given: found.append(given[-1]))
    for name in ("harmonic", "hertzian-relative"):
        plot_library([row(potential=name)], tmp_path / f"{name}.png")
    assert found == pytest.approx([1, 2 / 3])


def test_sizes_of_one_pressure_are_named_where_others_have_a_phi_J():
    entries, _ = legend(_draw_density, [row(), row(p=1e-2), row(n=128)], 1.0)
    assert r"N = 128 not drawn: fewer than two pressures, no $\phi_J$" in entries


@pytest.mark.parametrize(
    ("rows", "message"),
    [
        ([], "no packings"),
        ([{"phi": 1.0}], "packing 0 lacks potential, particles"),
        ([row(p=0.0)], "no packing is jammed"),
        ([row(contacts=0, rattlers=64)], "no packing is jammed"),
        ([row(), row(potential="hertzian")], "harmonic, hertzian"),
    ],
)
def test_rows_that_make_no_library(tmp_path, rows, message):
    with pytest.raises(pj.InputError, match=message):
        plot_library(rows, tmp_path / "none.png")


# --- fits ---------------------------------------------------------------------------------------------

P = np.logspace(-5, -2, 7)


def pulls(fit):
    """(found − true)/error of fits to 400 sets of data."""
    random = np.random.default_rng(7)
    return np.array([fit(random) for _ in range(400)])


@pytest.mark.parametrize("known", [True, False])
def test_the_exponent_is_found_within_its_error(known):
    y = 3.7 * np.sqrt(P)
    error = 0.02 * y

    def pull(random):
        fit = fit_power(P, y + error * random.normal(size=7), error if known else None)
        return (fit.exponent - 0.5) / fit.exponent_error, (fit.prefactor - 3.7) / fit.prefactor_error

    found = pulls(pull)
    assert (np.abs(found.mean(0)) < 0.2).all()
    assert (np.abs(found) < 1).mean(0) == pytest.approx([0.68, 0.68], abs=0.1)


@pytest.mark.parametrize("exponent", [1.0, 1.5])
def test_phi_J_is_found_within_its_error(exponent):
    phi = 0.8416 + 2.3 * P**exponent
    error = np.logspace(-4, -5, 7)

    def pull(random):
        fit = fit_phi_J(P, phi + error * random.normal(size=7), error, exponent=exponent, decades=3)
        return (fit.phi_J - 0.8416) / fit.phi_J_error, (fit.slope - 2.3) / fit.slope_error

    found = pulls(pull)
    assert (np.abs(found.mean(0)) < 0.2).all()
    assert (np.abs(found) < 1).mean(0) == pytest.approx([0.72, 0.72], abs=0.1)


def test_without_noise_the_fits_are_exact():
    assert fit_power(P, 3.7 * P**-1.25)[::2] == pytest.approx((-1.25, 3.7), rel=1e-12)
    assert fit_phi_J(P, 0.84 + 2 * P)[:3:2] == pytest.approx((0.84, 2), rel=1e-9)


def test_errors_too_small_for_the_scatter_are_scaled_up():
    y = P * np.exp(0.1 * np.random.default_rng(1).normal(size=7))
    assert fit_power(P, y, 1e-6 * y).exponent_error == pytest.approx(fit_power(P, y).exponent_error)


def test_errors_larger_than_the_scatter_are_believed():
    assert fit_power(P, P, 0.2 * P).exponent_error == pytest.approx(2 * fit_power(P, P, 0.1 * P).exponent_error)


def test_a_missing_error_weighs_all_the_same():
    y = P * np.exp(0.1 * np.random.default_rng(1).normal(size=7))
    assert fit_power(P, y, np.append(0.1 * y[:-1], np.nan)) == fit_power(P, y)


def test_phi_J_comes_from_the_lowest_decades():
    bent = 0.84 + 2 * P + np.where(P > 1.1e-4, 1.0, 0.0)
    fit = fit_phi_J(P, bent, decades=1)
    assert fit.phi_J == pytest.approx(0.84)
    assert fit.highest == pytest.approx(1e-4)


def test_two_points_without_errors_have_a_line_and_no_error():
    fit = fit_power([1, 10], [2, 20])
    assert (fit.exponent, fit.prefactor) == pytest.approx((1, 2))
    assert np.isnan([fit.exponent_error, fit.prefactor_error]).all()


@pytest.mark.parametrize(("x", "y"), [([1, 1], [2, 3]), ([], []), ([1, -2], [1, 1]), ([1, 2], [0, 1])])
def test_no_power_law(x, y):
    with pytest.raises(pj.InputError, match="fit: "):
        fit_power(x, y)


@pytest.mark.parametrize("p", [[1e-3], [], [1e-3, 1e-3], [0.0, 1e-3]])
def test_no_phi_J(p):
    with pytest.raises(pj.InputError, match="fit: "):
        fit_phi_J(p, np.full(len(p), 0.84))
