"""What holds for every picture: units, ticks, titles, fonts, colours; of the files of tests/fixtures and of others."""

import re
from dataclasses import replace
from itertools import combinations
from pathlib import Path

import numpy as np
import pytest
from matplotlib.figure import Figure
from matplotlib.text import Text
from test_old_files import FORMATS, PICTURES
from test_shear_plots import banded_run, flowing, ramp, synthetic_run

import petscjam as pj
from petscjam.analysis.density import DensityOfStates, smoothed
from petscjam.base.errors import InputError
from petscjam.cli import main
from petscjam.plots import plot_packing, plot_results
from petscjam.plots.figure import PALETTE, house_style, save, settle
from petscjam.plots.legends import MARKERS, MOST, Families, Shades, heading, number
from petscjam.plots.oscillation import loop
from petscjam.plots.shear import plot_flow, plot_maps, plot_ramp, plot_run
from petscjam.plots.tables import table

pytestmark = pytest.mark.parallel(nprocs=1)
UNIT = re.compile(r"\((\S.*)\)$")  # at the end of a label
UNITS = r"""
$k$; $1/k$; $k^{1/2}$; $k^{-1/2}$; $k\tau_1$; $\sqrt{k/m}$; $\sqrt{m/k}$; $d$; $kd$; $m/\tau_e^2$; $1/\tau_e$;
$d_s/\tau_e$; $d_s\dot\gamma$; degrees; 1/degree; $k$),  $J(t)$  ($1/k$
"""
DIMENSIONLESS = r"""
(angular frequency )?\$\\omega\\tau_1\$; (relaxation |friction )?time( after the step)? \$(t|\\tau)/\\tau_[1e]\$
strain \$\\gamma(/\\gamma_0)?\$; \$\\delta/L\$; correlation \$C\$; correlation length \$l/L\$; .*relative error
amplitude \$\\gamma_0\$; Re \[\$G.*\]; harmonics \$\|G_n\|/\|G\^\*\|\$; in the last cycle, if not 0
stress \$\\sigma/\(\\gamma_0\|G\^\*\|\)\$; density of \$\\log_\{10\}\$; index of the mode; participation ratio
floppiness .*; contacts \$Z\$; \$Z - Z.*; packing fraction \$\\phi\$; \$\\phi - \\phi_J\$; fraction of packings.*
force evaluations; (strain rate )?\$\\dot\\gamma\\tau_e\$; \$Q\$; \$\\phi\$; contacts of a disk  \$Z\$; \$R_v.*
friction \$\\mu = \\Sigma/P\$; spin .*; var.*; energy not accounted for / heat; \$y/d_s\$.*; harmonic \$n\$
local packing fraction.*; local strain rate \$\\dot\\gamma.*; \$\\beta\$; \$N\$
"""
DIMENSIONLESS = re.compile("|".join(part.strip() for part in re.split(r"[;\n]", DIMENSIONLESS.strip())))


OMEGA = np.geomspace(1e-4, 1, 9)


def law(beta, p=1e-3, seed=0, **changes):
    """G* that nobody computed, of a stable packing with this β."""
    omega, g = OMEGA, next(iter(pj.read_results(FORMATS / "moduli.h5").values()))
    origin = replace(g.origin, pressure=p, checksum=f"{p} {seed}", damping=pj.ContactDamping(beta), **changes)
    scatter = 1 + 0.1 * np.random.default_rng(seed).normal()
    values = scatter * (p**0.5 + 1j * (1 + beta) * omega)
    none = {"field_omega": np.empty(0), "fields": np.empty((0, 24, 2)), "geometry": None, "model": None}
    zeros = {"errors": np.zeros(len(omega)), "residuals": np.zeros(len(omega))}
    return replace(g, origin=origin, omega=omega, values=values, G0=p**0.5, eta0=1 + beta, **none, **zeros)


BETAS = [0.0, *np.geomspace(1e-3, 10, 28).tolist()]
DRAWN = {  # besides the fixtures
    "29 betas": lambda: plot_results({f"{k}": law(beta) for k, beta in enumerate(reversed(BETAS))}),
    "pressures": lambda: plot_results({f"{p}{s}": law(1.0, p, seed=s) for p in (1e-2, 1e-3, 1e-4) for s in range(3)}),
    "sizes and laws": lambda: plot_results(
        {f"{n}{b}": law(b, particles=n) for n in (64, 256, 1024) for b in (0.0, 0.5)}
    ),
    "banded run": lambda: plot_run(banded_run()),
    "maps": lambda: plot_maps(flowing()),
    "ramp": lambda: plot_ramp(ramp()),
    "flow curves": lambda: plot_flow(
        {f"{r}{phi}": synthetic_run(rate=r, phi=phi) for r in np.geomspace(1e-5, 1e-2, 4) for phi in (0.78, 0.8, 0.82)}
    ),
    "many rates": lambda: plot_flow(
        {f"{r}{Q}": synthetic_run(rate=r, Q=Q) for r in np.geomspace(1e-5, 1e-2, 10) for Q in np.geomspace(1, 900, 9)}
    ),
    "short axes": lambda: short_axes(),
}


def short_axes():
    """Axes on which matplotlib's own labels overlap."""
    figure = Figure(figsize=(2.2, 2.0), layout="constrained")
    axes = figure.subplots()
    axes.loglog([0.22, 0.48], [1.02e-5, 1.9e-5])
    axes.set(xlabel=r"$\phi$", ylabel=r"$\phi$")
    settle(figure)
    return figure


@pytest.fixture(scope="module")
def pictures():
    """The figure of a fixture or of DRAWN, drawn once."""
    made = {}

    def figure(name):
        if name not in made:
            if name in DRAWN:
                made[name] = DRAWN[name]()
            else:
                from petscjam.io.kinds import recognise
                from petscjam.plots.files import CONTENTS

                contents = CONTENTS[recognise(FORMATS / name)]
                made[name] = contents.draw(contents.read(FORMATS / name), None)
            made[name].draw_without_rendering()
        return made[name]

    return figure


ALIKE = ["hertzian", "exported", ".frames", "stokes", "spectrum", "relaxations", "drag", "older", "ramp.h5"]
ALIKE += ["banded", "flow curves", "moduli", "sizes", "many rates"]
every = pytest.mark.parametrize(  # those like another one are for the slow tests
    "name",
    [
        pytest.param(name, marks=pytest.mark.slow if any(part in name for part in ALIKE) else ())
        for name in [*PICTURES.split(), *DRAWN]
        if not name.endswith(".gsd")
    ],
)


def axis_labels(figure):
    for axes in figure.axes:
        if axes.axison and (axes.get_xticks().size or axes.get_yticks().size):
            if axes.get_label() != "<colorbar>" and axes.xaxis.get_tick_params().get("labelbottom", True):
                yield axes.get_xlabel()
            yield axes.get_ylabel()


@every
def test_every_axis_has_a_unit_or_none_to_have(pictures, name):
    figure = pictures(name)
    labels = list(axis_labels(figure))
    named = {text.get_text() for text in figure.findobj(Text)}
    for label in labels:
        if not label:  # the label of a whole column, or of maps with a colour bar
            assert any(DIMENSIONLESS.fullmatch(text) for text in named)
            continue
        unit = UNIT.search(label)
        known = unit and unit[1].split("  (")[-1] in [u.strip() for u in UNITS.replace("\n", " ").split(";")]
        assert known or DIMENSIONLESS.fullmatch(label), label


@every
def test_no_tick_labels_overlap(pictures, name):
    figure = pictures(name)
    for axes in figure.axes:
        for axis in (axes.xaxis, axes.yaxis) if axes.axison else ():
            low, high = sorted(axis.get_view_interval())
            labels = [
                label
                for tick in (*axis.get_major_ticks(), *axis.get_minor_ticks())
                for label in (tick.label1, tick.label2)
                if low <= tick.get_loc() <= high and label.get_visible() and label.get_text()
            ]
            for a, b in combinations(labels, 2):
                assert not a.get_window_extent().overlaps(b.get_window_extent()), (a.get_text(), b.get_text())


@every
def test_titles_are_sentences_within_the_picture(pictures, name):
    figure = pictures(name)
    texts = [text for text in figure.findobj(Text) if text.get_text() and text.get_visible()]
    for text in (text for text in texts if text.get_fontfamily() != ["monospace"]):
        assert not re.search(r"\w\(\w+=|=(True|False|None)\b|<.*(object|function)|array\(|e[-+]\d\d", text.get_text())
    whole = [part._suptitle for part in (figure, *figure.subfigs) if part._suptitle]
    titles = [*whole, *(axes.title for axes in figure.axes)]
    for title in (title for title in titles if title.get_text()):
        box = title.get_window_extent()
        assert -1 <= box.x0 and box.x1 <= figure.bbox.width + 1, title.get_text()


@pytest.mark.parametrize("name", ["viscosity.h5", "29 betas"])
def test_fonts_are_embedded_and_text_is_text(pictures, tmp_path, name):
    save(pictures(name), tmp_path / "a.pdf")
    pdf = (tmp_path / "a.pdf").read_bytes()
    assert b"/FontFile2" in pdf  # TrueType, embedded
    assert b"/Subtype /Type0" in pdf and b"/Subtype /CIDFontType2" in pdf  # Type 42
    assert b"/Subtype /Type3" not in pdf
    save(pictures(name), tmp_path / "a.svg")
    assert "<text" in (tmp_path / "a.svg").read_text()


# --- colours --------------------------------------------------------------------------------------------

# Of linear RGB: Machado, Oliveira, Fernandes, IEEE Trans. Vis. Comput. Graph. 15, 1291 (2009), severity 1
BLIND = {
    "protanopia": [[0.152286, 1.052583, -0.204868], [0.114503, 0.786281, 0.099216], [-0.003882, -0.048116, 1.051998]],
    "deuteranopia": [[0.367322, 0.860646, -0.227968], [0.280085, 0.672501, 0.047413], [-0.01182, 0.04294, 0.968881]],
    "tritanopia": [[1.255528, -0.076749, -0.178779], [-0.078411, 0.930809, 0.147602], [0.004733, 0.691367, 0.3039]],
}


def lightness_and_hue(colour, matrix):
    """CIE L*a*b* of a colour as it is seen with a matrix of BLIND."""
    from matplotlib.colors import to_rgb

    rgb = np.array(to_rgb(colour))
    linear = np.where(rgb <= 0.04045, rgb / 12.92, ((rgb + 0.055) / 1.055) ** 2.4)
    seen = np.clip(np.array(matrix) @ linear, 0, 1)
    xyz = np.array([[0.4124, 0.3576, 0.1805], [0.2126, 0.7152, 0.0722], [0.0193, 0.1192, 0.9505]]) @ seen
    f = xyz / [0.9505, 1.0, 1.089]
    f = np.where(f > 0.008856, np.cbrt(f), 7.787 * f + 16 / 116)
    return np.array([116 * f[1] - 16, 500 * (f[0] - f[1]), 200 * (f[1] - f[2])])


@pytest.mark.parametrize("matrix", [np.eye(3), *BLIND.values()], ids=["all", *BLIND])
@pytest.mark.parametrize("colours", [PALETTE, [Shades("pressure", range(MOST))(k) for k in range(MOST)]])
def test_the_colour_blind_tell_colours_apart(colours, matrix):
    seen = [lightness_and_hue(colour, matrix) for colour in colours]
    assert min(np.linalg.norm(a - b) for a, b in combinations(seen, 2)) > 9


def test_values_are_told_by_markers_besides():
    shades = Shades("pressure", [1e-2, 1e-3, 1e-4])
    assert len({shades.marker(p) for p in shades.values}) == 3
    assert len(set(MARKERS)) == len(MARKERS) >= MOST


# --- colours by setting -----------------------------------------------------------------------------------


def test_many_values_have_a_bar_in_numeric_order(pictures):
    figure = pictures("29 betas")
    axes, bar = figure.axes
    assert bar.get_ylabel() == r"$\beta$"
    ticks = [text.get_text() for text in bar.get_yticklabels()]
    assert (ticks[0], ticks[-1]) == ("0", "10")
    lines = [line for line in axes.lines if len(line.get_xdata()) == 9 and np.isfinite(line.get_ydata()).all()]
    by_colour = {}
    for line in lines:
        by_colour.setdefault(tuple(line.get_color()), []).append(line.get_ydata()[-1])
    assert len(by_colour) == 29
    order = [tuple(Shades("beta", BETAS)(beta)) for beta in BETAS]
    assert np.all(np.diff([max(by_colour[colour]) for colour in order]) > 0)  # G″ grows with β


def test_few_values_have_a_legend(pictures):
    texts = [text.get_text() for text in pictures("pressures").axes[0].get_legend().get_texts()]
    assert texts[-3:] == ["$p$ = $10^{-4}$ $k$", "$p$ = $10^{-3}$ $k$", "$p$ = 0.01 $k$"]
    assert pictures("pressures").axes[0].get_title().startswith("9 packings, $N$ = 24, contact damping")


def test_means_have_error_bands(pictures):
    (axes,) = pictures("pressures").axes
    edges = [np.array(band.get_paths()[0].vertices)[:, 1] for band in axes.collections if len(band.get_paths())]
    expected = {p: np.array([law(1.0, p, seed=s).values for s in range(3)]) for p in (1e-4, 1e-3, 1e-2)}
    for values in expected.values():
        for part in (values.real, values.imag):
            top = (part.mean(0) + part.std(0, ddof=1) / 3**0.5).max()
            assert any(edge.max() == pytest.approx(top) for edge in edges)


def test_other_differences_are_markers():
    families = Families({f"{n}{b}": law(b, particles=n) for n in (64, 256, 1024) for b in (0.0, 0.5)})
    assert families.shades.key == "particles"
    assert [(f.label, f.marker) for f in families.members[:2]] == [(r"$\beta$ = 0", "o"), (r"$\beta$ = 0.5", "s")]
    assert len({f.colour for f in families.members}) == 3


def test_the_heading_is_what_all_have():
    some = {"a": law(0.5), "b": law(0.5, p=1e-2, seed=1)}
    assert heading(some) == "2 packings, $N$ = 24, contact damping, $\\beta$ = 0.5, simple shear, with pre-stress"
    assert "p" in heading({"a": law(0.5)})


def test_the_table_of_a_sweep_is_one_with_a_column():
    lines = table({f"x{k}": law(beta) for k, beta in enumerate(reversed(BETAS))}).splitlines()
    heads = lines[2].split()
    assert heads[:3] == ["packing", "beta", "N"]
    assert [float(line.split()[1]) for line in lines[3:32]] == pytest.approx(BETAS, rel=1e-3)


@pytest.mark.parametrize(
    ("value", "text"),
    [
        (0.0, "0"),
        (0.3, "0.3"),
        (9.99999e-3, "0.01"),
        (1e-3, "$10^{-3}$"),
        (2.5e-7, r"$2.5\times 10^{-7}$"),
        (4096, "4096"),
    ],
)
def test_numbers_of_labels(value, text):
    assert number(value) == text


# --- what is drawn ----------------------------------------------------------------------------------------


def area(y, x):
    return np.sum(np.diff(x) * (y[1:] + y[:-1]) / 2)


def test_a_smooth_density_has_the_moments_of_the_exact_one():
    """Of a packing of 24 disks: the integral is 1, and it is nowhere as rough as the peaks of single modes."""
    some = [r for r in pj.read_results(FORMATS / "figures/modes-density.h5").values()]
    omega = np.linspace(1e-3, min(d.edge for d in some) * 0.999, 3000)
    D, error = smoothed(some, omega)
    assert area(D, omega) == pytest.approx(1, abs=0.1)
    assert (error >= 0).all()
    assert isinstance(some[0], DensityOfStates)


def test_the_error_of_a_mean_density_is_that_over_packings():
    some = [*pj.read_results(FORMATS / "figures/modes-density.h5").values()]
    omega = np.array([0.3, 1.0])
    alone = np.array([smoothed([d, d], omega)[0] for d in some])
    mean, error = smoothed(some, omega)
    assert mean == pytest.approx(alone.mean(0), rel=0.05)  # the kernel is that of two packings in all
    assert error == pytest.approx(alone.std(0, ddof=1) / len(some) ** 0.5, rel=0.2)


def test_the_loop_of_a_linear_solid_is_an_ellipse():
    """Of area πG″/|G*| (in γ0 and γ0|G*|), passed so that work is done."""
    (r,) = pj.read_results(FORMATS / "amplitudes.h5").values()
    linear = replace(r, higher=0 * r.higher)
    gamma, stress = loop(linear, 0, 0)
    G = linear.values[0, 0]
    assert area(stress, gamma) == pytest.approx(np.pi * G.imag / abs(G), rel=1e-3)
    assert stress[np.argmax(gamma)] == pytest.approx(G.real / abs(G), abs=1e-6)
    third = replace(r, higher=np.stack([0.2 * r.values, 0 * r.values]))
    assert area(loop(third, 0, 0)[1], gamma) == pytest.approx(np.pi * G.imag / abs(G), rel=1e-3)
    assert not np.allclose(loop(third, 0, 0)[1], stress)


def test_a_packing_has_a_scale_and_a_legend(pictures):
    axes = pictures("packing.h5").axes[0]
    texts = [text.get_text() for text in axes.get_legend().get_texts()]
    assert texts[0].startswith("mean force") and texts[-1] == "rattler"
    bars = [artist for artist in axes.artists if hasattr(artist, "txt_label")]
    assert [bar.txt_label.get_text() for bar in bars] == ["1 $d$"]
    width = bars[0].size_bar.get_children()[0].get_width()
    assert width == pytest.approx(pj.Packing.read(FORMATS / "packing.h5").mean_diameter)


# --- where and how ----------------------------------------------------------------------------------------


@pytest.mark.parametrize("name", ["moduli.h5", "viscosity.h5", "step-strain.h5", "figures/modes-density.h5"])
def test_a_picture_of_one_panel_is_drawn_in_given_axes(name):
    figure = Figure()
    left, right = figure.subplots(1, 2)
    results = pj.read_results(FORMATS / name)
    assert plot_results(results, ax=right) is figure
    assert right.lines and not left.lines
    assert len(figure.axes) == 2


def test_a_packing_is_drawn_in_given_axes():
    figure = Figure()
    left, right = figure.subplots(1, 2)
    assert plot_packing(pj.Packing.read(FORMATS / "packing.h5"), ax=right) is figure
    assert right.collections and not left.collections


def test_a_picture_of_several_panels_takes_no_axes():
    with pytest.raises(InputError, match="Modes has several panels"):
        plot_results(pj.read_results(FORMATS / "modes.h5"), ax=Figure().subplots())


@pytest.mark.parametrize("dpi", [40, 80])
def test_dpi(tmp_path, dpi):
    from PIL import Image

    command = ["plot", str(FORMATS / "viscosity.h5"), "-o", str(tmp_path / "a.png"), "--dpi", str(dpi)]
    assert main(command) == 0
    assert Image.open(tmp_path / "a.png").size == (round(7.2 * dpi), round(5.2 * dpi))


def test_a_style_counts_more_than_ours(tmp_path, capfd):
    from PIL import Image

    sheet = tmp_path / "mine.mplstyle"
    sheet.write_text("figure.facecolor: 102030\n")
    file = str(FORMATS / "viscosity.h5")
    assert main(["plot", file, "-o", str(tmp_path / "a.png"), "--style", str(sheet), "--dpi", "30"]) == 0
    assert Image.open(tmp_path / "a.png").convert("RGB").getpixel((0, 0)) == (0x10, 0x20, 0x30)
    assert main(["plot", file, "-o", str(tmp_path / "b.png"), "--style", "xyzzy"]) == 2
    assert "--style: 'xyzzy' is neither a file nor a style; known are" in capfd.readouterr().err
    assert not (tmp_path / "b.png").exists()


def test_a_wrong_style_is_refused_before_the_work(tmp_path, capfd):
    assert main(["figure", "bt3", "--style", "xyzzy", "-o", str(tmp_path / "runs")]) == 2
    assert "'xyzzy'" in capfd.readouterr().err
    assert not (tmp_path / "runs").exists()


def test_settings_of_the_user_stay():
    from matplotlib import rc_context, rcParams

    before = dict(rcParams)
    with rc_context({"legend.frameon": False, "pdf.fonttype": 42, "legend.fontsize": 5}), house_style():
        assert rcParams["legend.fontsize"] == 5
        assert rcParams["axes.titlesize"] == 10
    assert dict(rcParams) == before


def test_a_path_is_written_and_none_is_not(tmp_path):
    results = pj.read_results(FORMATS / "viscosity.h5")
    assert isinstance(plot_results(results, tmp_path / "a.png"), Figure)
    plot_results(results)
    assert [file.name for file in Path(tmp_path).iterdir()] == ["a.png"]
