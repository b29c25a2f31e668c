"""Whether a packing is a solid: a modulus that is zero, forces that do not balance, and who says so."""

from dataclasses import replace
from functools import cache

import helpers
import numpy as np
import pytest
from helpers import DATA, any_prestress, any_strain

import petscjam as pj
from petscjam.analysis.statistics import average
from petscjam.cli import main
from petscjam.geometry.network import ContactNetwork
from petscjam.io.results import append_result, read_results
from petscjam.io.rheology import export_average
from petscjam.plots import plot_results
from petscjam.plots.tables import describe_packing, table
from petscjam.preparation.certify import certify
from petscjam.response.problem import LinearProblem
from petscjam.rows.damping import LAWS
from petscjam.rows.kinematics import strain_mode

A = 0.99  # distance of neighbours of diameter 1
OMEGA = np.array([1e-3, 0.1, 10.0])
contact_laws = pytest.mark.parametrize(
    "law", [pj.ContactDamping(), pj.ContactDamping(0.0), pj.ContactDamping(rotations=False)], ids=str
)


def disks(positions, cell):
    return pj.Packing(positions, np.full(len(positions), 0.5), pj.Box(cell))


def rows(count, length=10):
    """Rows of a triangular lattice."""
    x, y = np.meshgrid(np.arange(length), np.arange(count))
    return A * np.stack([x + y % 2 / 2, y * 0.75**0.5], axis=-1).reshape(-1, 2)


@cache
def band():
    """Three rows of a triangular lattice that meet their images in x and none in y: it shears freely."""
    return disks(rows(3), [[10 * A, 0], [0, 10]])


def hexagon(x, y, turn=0.0):
    """Seven disks around (x, y)."""
    angle = np.arange(6) * np.pi / 3 + turn
    return np.array([[x, y], *np.stack([x + A * np.cos(angle), y + A * np.sin(angle)], axis=1)])


@cache
def island():
    """Disks that reach none of their images: they turn and roll as a whole."""
    return disks(hexagon(5, 5), [[10, 0], [0, 10]])


@cache
def two_islands():
    """Two that touch in one contact: besides, one rolls on the other."""
    return disks(np.vstack([hexagon(5, 5), hexagon(5 + 2 * A + 0.9999, 5)]), [[20, 0], [0, 20]])


LATTICES = {  # cell and disks, in units of the distance of neighbours; bulk modulus
    "square": ([1, 1], [[0, 0]], 1 / 2),
    "honeycomb": ([3, 3**0.5], [[0, 0], [1 / 3, 0], [1 / 2, 1 / 2], [5 / 6, 1 / 2]], 1 / (2 * 3**0.5)),
    "kagome": (
        [2, 12**0.5],
        [[0, 0], [1 / 2, 0], [1 / 4, 1 / 4], [1 / 2, 1 / 2], [0, 1 / 2], [3 / 4, 3 / 4]],
        0.75**0.5 / 2,
    ),
}


def lattice(name, times=3, turn=0.0):
    """A lattice that is floppy without pre-stress."""
    sides, places, _ = LATTICES[name]
    cell = A * np.diag(sides)
    cells = np.mgrid[0:times, 0:times].reshape(2, -1).T
    R = np.array([[np.cos(turn), np.sin(turn)], [-np.sin(turn), np.cos(turn)]])
    return disks((cells[:, None] + places).reshape(-1, 2) @ cell @ R, times * cell @ R)


@cache
def jammed(seed=1):
    return helpers.jammed(seed=seed, shear_stabilised=True)


@cache
def shortened(seed=1, digits=4):
    """The same with few digits, as a text file might have them."""
    return replace(jammed(seed), positions=jammed(seed).positions.round(digits))


def net_force(packing):
    """The largest net force on a disk over p·d, pair by pair."""
    x, radii, cell = packing.positions, packing.radii, packing.box.cell
    force, virial = np.zeros_like(x), 0.0
    for i in range(len(x)):
        for j in range(i):
            for shift in np.array([[a, b] for a in (-1, 0, 1) for b in (-1, 0, 1)]) @ cell:
                r = x[j] + shift - x[i]
                overlap = radii[i] + radii[j] - np.hypot(*r)
                if overlap > 0:
                    push = overlap * r / np.hypot(*r)
                    force[i] -= push
                    force[j] += push
                    virial += push @ r
    p = virial / (2 * abs(np.linalg.det(cell)))
    return np.hypot(*force.T).max() / (p * 2 * radii.mean())


# ---- zero


VERBS = {
    "direct": lambda p, **how: pj.complex_modulus(p, OMEGA, **how),
    "spectrum": lambda p, **how: pj.spectrum(p, (1e-3, 10.0), **how),
    "sample": lambda p, **how: pj.ComplexModulus.sampled(pj.spectrum(p, (1e-3, 10.0), **how), OMEGA),
    "nonaffine": lambda p, **how: pj.quasistatic_response(p, **how),
    "viscosity": lambda p, **how: pj.viscosity(p, **how),
    "correlations": lambda p, **how: pj.correlations(p, OMEGA, **how),
    "family": lambda p, **how: pj.beta_family(p, (0.1, 1.0), (1e-3, 10.0), **how)(0.5),
}
any_verb = pytest.mark.parametrize("verb", VERBS)


@any_prestress
@any_verb
def test_a_band_that_percolates_one_way_has_no_modulus(verb, prestress):
    r = VERBS[verb](band(), prestress=prestress)
    assert r.G0 == 0
    assert not r.stable
    assert r.state == "UNSTABLE: G0 = 0" + ", not in balance" * prestress


@pytest.mark.parametrize("unit", [1e-9, 1e9])
@any_verb
def test_so_in_any_unit_of_length(verb, unit):
    p = pj.Packing(unit * band().positions, unit * band().radii, pj.Box(unit * band().box.cell))
    options = {"width": unit, "bin": unit / 2} if verb == "correlations" else {}
    assert VERBS[verb](p, prestress=False, **options).state == "UNSTABLE: G0 = 0"


@any_prestress
@any_verb
def test_a_band_that_stands_upright(verb, prestress):
    """Sheared it tilts and grows longer, to second order: without pre-stress that costs nothing."""
    p = band()
    turned = pj.Packing(p.positions[:, ::-1], p.radii, pj.Box(p.box.cell[::-1, ::-1]))
    r = VERBS[verb](turned, prestress=prestress)
    assert (r.G0 < 0) == prestress
    assert r.state == ("UNSTABLE: G0 < 0, not in balance" if prestress else "UNSTABLE: G0 = 0")


@pytest.mark.parametrize("turn", [0.0, np.pi / 2])
def test_a_disk_between_its_images_along_the_axes_has_no_modulus(turn):
    """Turned by a right angle its affine modulus is rounding, too: zero is judged against all contacts."""
    r = pj.quasistatic_response(lattice("square", 1, turn), prestress=False)
    assert r.G0 == 0
    assert r.state == "UNSTABLE: G0 = 0"


@any_verb
def test_a_soft_solid_is_one(verb):
    r = VERBS[verb](pj.prepare_packing(32, 1e-7, 3, shear_stabilised=True))
    assert 0 < r.G0 < 0.05
    assert r.state == "stable"


def test_a_certificate_knows_the_same_zero(capsys, tmp_path):
    judged = certify(band())
    assert judged.certificate.negative_modes == judged.certificate.zero_modes == 0
    assert judged.certificate.shear_modulus <= 0
    assert "UNSTABLE against shear" in describe_packing(judged)
    (tmp_path / "lib").mkdir()
    judged.write(tmp_path / "lib" / "band.h5")
    assert main(["info", str(tmp_path / "lib")]) == 0
    heads, row = capsys.readouterr().out.splitlines()[2:4]
    end = heads.index("unstable") + len("unstable")
    assert row[:end].split()[-1] == "1"


def test_drag_names_what_is_no_solid():
    uniform = pj.equivalent_drag(band(), OMEGA, 1e-4, 0.7, prestress=False)
    contacts = pj.self_consistent_drag(band(), OMEGA, 1e-4, 0.7, prestress=False, most_iterations=3)
    for r in (uniform, contacts):
        assert r.state.startswith(("UNSTABLE: G0 = 0", "UNSTABLE: G0 < 0"))


@pytest.mark.parametrize("make", [pj.equivalent_drag, pj.self_consistent_drag])
def test_drag_names_a_packing_that_yields_though_every_frequency_is_stiff(make):
    packing = pj.prepare_packing(n=128, pressure=1e-2, seed=2)
    r = make(packing, [1.0], 1e-3, 0.5)
    assert r.values.real.min() > 0
    assert pj.quasistatic_response(packing).G0 < 0
    assert r.state.startswith("UNSTABLE: G0 < 0")


def test_no_zero_enters_a_mean():
    results = {make.__name__: VERBS["sample"](make(), prestress=False) for make in (band, jammed)}
    mean = average(results)
    assert (mean.count, mean.excluded) == (1, ("band",))
    assert mean.mean == pytest.approx(results["jammed"].values)


@pytest.mark.parametrize("verb", ["sample", "nonaffine", "viscosity", "correlations"])
def test_what_is_no_solid_is_drawn_and_called_so(verb, tmp_path, titles):
    result = VERBS[verb](band())
    plot_results({"band": result}, tmp_path / "out.png")
    assert any("UNSTABLE: G0 = 0" in title for title in titles)


# ---- zero modes


@pytest.mark.parallel(nprocs=[1, 2])
@contact_laws
@any_strain
@pytest.mark.parametrize("make", [island, two_islands])
def test_islands_resist_nothing_and_are_answered(comm, make, strain, law):
    how = {"damping": law, "strain": strain, "prestress": False, "comm": comm}
    g, s = pj.complex_modulus(make(), OMEGA, **how), pj.spectrum(make(), (1e-3, 10.0), **how)
    affine = abs(ContactNetwork.of(make()).affine_modulus * (1 + 1j * OMEGA))
    assert (abs(g.values) < 1e-12 * affine).all()
    assert (abs(s(OMEGA)) < 1e-12 * affine).all()
    for r in (g, s):
        assert not r.stable
        assert "floppy modes" in " ".join(r.notes)


@pytest.mark.parametrize("low", [1e-8, 1e-6, 1e-3])
def test_soft_motions_that_only_friction_resists_are_answered(low):
    """Three floppy modes move by 1/ω: solves leave the residual of rounding beside K times that."""
    packing, omega = pj.Packing.read(DATA / "floppy-N14.h5"), np.array([low, 1.0])
    g = pj.complex_modulus(packing, omega, prestress=False)
    s = pj.spectrum(packing, (low, 1e2), prestress=False)
    affine = abs(ContactNetwork.of(packing).affine_modulus * (1 + 1j * omega))
    assert (abs(g.values) < 1e-12 * affine).all()
    assert (abs(s(omega)) < 1e-12 * affine).all()
    assert s.zero_modes == 3


@pytest.mark.parametrize(
    ("make", "law", "free"),
    [
        (island, pj.ContactDamping(), 1),
        (two_islands, pj.ContactDamping(), 2),
        (two_islands, pj.ContactDamping(rotations=False), 0),
        (two_islands, pj.ContactDamping(0.0), 3),
        (two_islands, pj.StokesDrag(), 0),
        (jammed, pj.ContactDamping(), 0),
        (jammed, pj.ContactDamping(0.0), 0),
    ],
)
def test_as_many_are_held_as_motions_meet_no_resistance(comm, make, law, free):
    """An island turns and rolls as a whole; of two, one rolls on the other, or slides without friction."""
    packing = make()
    problem = LinearProblem(packing, law, [strain_mode("simple-shear")], False, comm)
    rolls = law.at_contact_point and law.tangential > 0
    felt = problem.backbone.backbone.sum() * (3 if rolls else 2) if not law.body else 2 * len(packing)
    assert problem.active.sum() == felt - 2 * (law.body == 0) - free


@contact_laws
@pytest.mark.parametrize("times", [2, 5])
@pytest.mark.parametrize("name", LATTICES)
def test_floppy_lattices_under_compression(name, times, law):
    """Nothing leaves the affine motion and nothing slides: G* = B(1 + iω), with zero modes all the same."""
    how = {"damping": law, "strain": "compression", "prestress": False}
    expected = LATTICES[name][2] * (1 + 1j * OMEGA)
    g = pj.complex_modulus(lattice(name, times), OMEGA, **how)
    s = pj.spectrum(lattice(name, times), (1e-3, 10.0), **how)
    assert g.values == pytest.approx(expected, rel=1e-10)
    assert s(OMEGA) == pytest.approx(expected, rel=1e-10)
    assert g.zero_modes == s.zero_modes > 0
    for r in (g, s):
        assert r.state.startswith("UNSTABLE: ")
        assert "zero modes" in r.state


def test_a_motion_without_friction_leaves_no_limit_of_high_frequency():
    """Three contacts a disk: B is singular, K is not, and what K would choose there is not guessed."""
    g = pj.complex_modulus(lattice("honeycomb"), OMEGA)
    assert np.isnan([g.G_inf, g.eta_inf]).all()
    assert "B is singular" in " ".join(g.notes)


# ---- balance


@pytest.mark.parametrize("seed", [1, 2])
def test_the_net_force_is_that_of_a_loop(seed):
    network = ContactNetwork.of(shortened(seed))
    assert network.net_force == pytest.approx(net_force(shortened(seed)), rel=1e-9)
    assert network.net_force > 1e-4
    assert not network.balanced


@pytest.mark.parametrize("potential", ["harmonic", "hertzian"])
@pytest.mark.parametrize("pressure", [1e-2, 1e-6])
def test_minima_balance(potential, pressure):
    packing = pj.prepare_packing(64, pressure, 2, potential_name=potential)
    network = ContactNetwork.of(packing)
    assert network.balanced
    assert network.net_force == packing.certificate.max_force


@pytest.mark.parametrize("name", ["jambashbulk-N16-P1e-3-0001.txt", "jaxmd-2d-polyuniform-N64-Lp-1.nc"])
def test_minima_of_other_programs_balance(name):
    assert ContactNetwork.of(pj.import_packing(DATA / name)).balanced


EVERY = {
    **VERBS,
    "modes": lambda p, **how: pj.lowest_modes(p, 5, **how),
    "relaxations": lambda p, **how: pj.relaxation_modes(p, 5, **how),
    "stokes": lambda p, **how: pj.relaxation_modes(p, 5, damping=pj.StokesDrag(), **how),
    "rebuilt": lambda p, **how: pj.mode_sum(p, 5, **how),
    "density": lambda p, **how: pj.density_of_states(p, moments=16, vectors=2, **how),
    "drag": lambda p, **how: pj.self_consistent_drag(p, [1.0], 1e-3, 0.5, **how),
    "uniform": lambda p, **how: pj.equivalent_drag(p, [1.0], 1e-3, 0.5, **how),
    "direct": lambda p, **how: pj.nonlinear_drag(p, [1.0], 1e-3, 0.5, points=8, **how),
}


@any_prestress
@pytest.mark.parametrize("verb", EVERY)
def test_every_result_says_that_forces_do_not_balance(verb, prestress):
    r = EVERY[verb](shortened(), prestress=prestress)
    force = f"{net_force(shortened()):.2g} p·d"
    (note,) = (note for note in r.notes if "not in balance" in note)
    assert force in note
    assert (r.origin.balanced, f"{r.origin.net_force:.2g} p·d") == (False, force)
    if hasattr(r, "stable"):
        assert r.state == ("NOT IN BALANCE" if prestress else "stable")
        assert r.stable != prestress


@any_prestress
@pytest.mark.parametrize("verb", EVERY)
def test_no_result_says_so_of_a_minimum(verb, prestress):
    r = EVERY[verb](jammed(), prestress=prestress)
    assert r.origin.balanced is True
    assert not [note for note in r.notes if "balance" in note]
    assert getattr(r, "stable", True)


WITH_A_FILE = [verb for verb in EVERY if verb not in ("spectrum", "family")]


@pytest.mark.parametrize("verb", WITH_A_FILE)
def test_file_table_and_figure_say_it(verb, tmp_path, titles):
    result = EVERY[verb](shortened())
    append_result(result, tmp_path / "r.h5", "one")
    back = read_results(tmp_path / "r.h5")
    text = table(back)
    assert f"not in balance: net forces on disks reach {net_force(shortened()):.2g} p·d" in text
    assert "  stable" not in text
    if verb != "rebuilt":  # which has no picture of its own
        plot_results(back, tmp_path / "r.png")
        assert f"not in balance: net forces on disks reach {net_force(shortened()):.2g} p·d" in titles


def test_a_figure_counts_them(tmp_path, titles):
    some = {str(k): EVERY["modes"](p) for k, p in enumerate((jammed(), shortened(1), shortened(2)))}
    plot_results(some, tmp_path / "modes.png")
    worst = max(net_force(shortened(seed)) for seed in (1, 2))
    assert f"2 of 3 results: not in balance: net forces on disks reach {worst:.2g} p·d" in titles


def test_the_packing_itself_says_it(tmp_path, titles):
    force = net_force(shortened())
    assert f"{force:.1e} p·d: NOT IN BALANCE" in describe_packing(shortened())
    assert "NOT IN BALANCE" not in describe_packing(jammed())
    pj.plots.plot_packing(shortened(), tmp_path / "p.png")
    assert f"not in balance: net forces reach {force:.2g} p·d" in titles


def test_an_average_leaves_them_out_or_names_them(tmp_path):
    whole, cut = (EVERY["sample"](p) for p in (jammed(), shortened(2)))
    assert average({"whole": whole, "cut": cut}).excluded == ("cut",)
    with pytest.raises(pj.InputError, match="none of 1 packings is stable; cut: NOT IN BALANCE"):
        average({"cut": cut})
    some = {"whole": jammed(), "cut": shortened(2)}
    mean = average({name: EVERY["sample"](p, prestress=False) for name, p in some.items()})
    assert (mean.count, mean.excluded, mean.unbalanced) == (2, (), ("cut",))
    export_average(mean, tmp_path / "mean.csv")
    assert "# not in balance: cut" in (tmp_path / "mean.csv").read_text().splitlines()


@pytest.mark.parametrize("fmt", ["csv", "tts", "gt"])
def test_text_for_rheologists_says_it(tmp_path, fmt):
    pj.export_rheology(EVERY["sample"](shortened()), tmp_path / "g", fmt)
    text = (tmp_path / "g").read_text()
    assert f"NOT IN BALANCE; net forces on disks reach {net_force(shortened()):.2g} p d" in text


def test_a_file_of_older_days_is_not_called_stable():
    """It tells neither zero modes nor balance."""
    g = EVERY["sample"](jammed())
    old = replace(g, zero_modes=None, origin=replace(g.origin, balanced=None, net_force=None))
    assert old.state == "UNKNOWN: zero modes, balance"


def test_elastic_constants_warn():
    with pytest.warns(UserWarning, match=f"not in balance: .* {net_force(shortened()):.2g} p·d"):
        pj.elastic_constants(shortened())


def test_every_law_is_tried_on_what_is_not_in_balance():
    for law in LAWS.values():
        assert pj.complex_modulus(shortened(), [1.0], damping=law()).state == "NOT IN BALANCE"
