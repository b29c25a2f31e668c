"""Facts that correlations obey: loops over pairs, closed forms, dense algebra, limits of the laws."""

from dataclasses import fields, replace
from functools import cache

import numpy as np
import pytest
from helpers import any_prestress, jammed, sixteen, twin_contacts, twin_matrices

import petscjam as pj
from petscjam.analysis.correlations import (
    correlation_length,
    correlations,
    correlations_of,
    lane_correlation,
    minimum,
    zero_crossing,
)
from petscjam.plots import plot_results

CELLS = {
    "square": [[12.0, 0.0], [0.0, 12.0]],
    "tilted": [[12.0, 0.0], [-7.5, 10.0]],
    "second along x": [[3.0, -9.0], [-11.0, 0.0]],
}
any_cell = pytest.mark.parametrize("cell", CELLS.values(), ids=CELLS)


@cache
def model(law=None, span=(1e-10, 1e2), prestress=True):
    return pj.spectrum(jammed(seed=3), span, damping=law, prestress=prestress, rtol=1e-10)


def scattered(cell, n=60, seed=0):
    """Points anywhere, in the cell or in an image of it, and a field."""
    rng = np.random.default_rng(seed)
    positions = rng.uniform(-2, 2, (n, 2)) @ np.array(cell)
    return pj.Packing(positions, np.full(n, 0.1), pj.Box(cell)), rng.normal(size=n)


def places(packing, width):
    """Lane and x of each disk, its length L: by moving disk by disk into the cell."""
    cell = packing.box.cell
    x, other = (cell[0], cell[1]) if cell[0, 1] == 0 else (cell[1], cell[0])
    lanes = int(np.ceil(abs(other[1]) / width))
    found = []
    for px, py in packing.positions:
        while py / other[1] < 0:
            px, py = px + other[0], py + other[1]
        while py / other[1] >= 1:
            px, py = px - other[0], py - other[1]
        found.append((int(py / other[1] * lanes), px % abs(x[0])))
    return [*zip(*found, strict=True), abs(x[0])]


def by_loops(packing, u, width, bin):
    """All pairs, one by one."""
    lane, x, L = places(packing, width)
    bins = int(np.ceil(L / bin))
    sums, pairs = np.zeros(bins // 2 + 1), np.zeros(bins // 2 + 1, dtype=int)
    for i in range(len(u)):
        for j in range(i):
            if lane[i] == lane[j]:
                d = abs(int(x[i] / L * bins) - int(x[j] / L * bins))
                d = min(d, bins - d)
                sums[d] += u[i] * u[j]
                pairs[d] += 1
    with np.errstate(invalid="ignore"):
        return sums / pairs / np.mean(u**2), pairs


# ---- the sum over pairs


@any_cell
@pytest.mark.parametrize("bins", [24, 25])
def test_fft_agrees_with_loops(cell, bins):
    packing, u = scattered(cell)
    bin = places(packing, 1.0)[2] / bins * (1 + 1e-9)
    found = lane_correlation(packing, u, width=1.0, bin=bin)
    C, pairs = by_loops(packing, u, 1.0, bin)
    np.testing.assert_array_equal(found.pairs, pairs)
    np.testing.assert_allclose(found.C, C, rtol=0, atol=1e-12)


@pytest.mark.parametrize(("bin", "error"), [(0.5, 5e-2), (0.05, 2e-3), (0.005, 2e-4)])
def test_bins_converge_to_exact_distances(bin, error):
    packing, _ = scattered(CELLS["tilted"], n=400)
    lane, x, L = (np.array(a) for a in places(packing, 2.0))
    u = 1 + np.cos(2 * np.pi * x / L)  # a mean that does not vanish, for a relative error
    i, j = np.triu_indices(len(u), 1)
    same = lane[i] == lane[j]
    exact = (u[i] * u[j] * np.cos(2 * np.pi * (x[i] - x[j]) / L))[same].sum() / np.mean(u**2)
    found = lane_correlation(packing, u, width=2.0, bin=bin)
    binned = np.nansum(found.C * found.pairs * np.cos(2 * np.pi * found.delta / L))
    assert binned == pytest.approx(exact, rel=error)


def test_every_pair_of_a_lane_is_counted_once():
    packing, u = scattered(CELLS["square"])
    inhabitants = np.bincount(places(packing, 2.0)[0])
    found = lane_correlation(packing, u, width=2.0, bin=0.7)
    assert found.pairs.sum() == (inhabitants * (inhabitants - 1) // 2).sum()


def test_a_plane_wave_on_a_lattice_is_a_cosine():
    x, y = np.meshgrid(np.arange(32) + 0.5, np.arange(8) + 0.5)
    packing = pj.Packing(np.stack([x.ravel(), y.ravel()], 1), np.full(256, 0.4), pj.Box([[32, 0], [0, 8]]))
    k = 2 * np.pi * 3 / 32
    delta, C, pairs = lane_correlation(packing, np.cos(k * x.ravel()), width=1.0, bin=1.0)
    assert np.isnan(C[0])
    assert pairs[0] == 0
    np.testing.assert_allclose(C[1:], np.cos(k * delta[1:]), atol=1e-13)


def test_white_noise_is_not_correlated():
    packing, u = scattered(CELLS["square"], n=20_000)
    _, C, pairs = lane_correlation(packing, u, width=0.5, bin=0.5)
    score = C * np.sqrt(pairs)
    assert abs(score).max() < 5
    assert np.mean(score**2) == pytest.approx(1, abs=0.8)


def test_a_constant_is_fully_correlated():
    packing, u = scattered(CELLS["tilted"])
    C = lane_correlation(packing, np.full_like(u, -3.0), width=3.0, bin=1.0).C
    np.testing.assert_allclose(C, 1, atol=1e-13)


def test_a_lattice_has_many_cells():
    packing, u = scattered(CELLS["square"])
    sheared = replace(packing, box=pj.Box([[12.0, 0.0], [24.0, 12.0]]))
    one, other = (lane_correlation(p, u, width=1.5, bin=0.5).C for p in (packing, sheared))
    np.testing.assert_allclose(one, other, atol=1e-13)


def test_disks_that_are_nan_do_not_count():
    packing, u = scattered(CELLS["square"])
    some = np.arange(len(u)) % 3 > 0
    kept = pj.Packing(packing.positions[some], packing.radii[some], packing.box)
    all_of_them = lane_correlation(packing, np.where(some, u, np.nan), width=2.0, bin=0.5)
    for one, other in zip(all_of_them, lane_correlation(kept, u[some], width=2.0, bin=0.5), strict=True):
        np.testing.assert_allclose(one, other, atol=1e-13)


def test_many_fields_at_once_are_each_its_own():
    packing, u = scattered(CELLS["square"])
    both = lane_correlation(packing, [[u, u**2]], width=2.0, bin=0.5).C
    assert both.shape[:2] == (1, 2)
    np.testing.assert_allclose(both[0, 1], lane_correlation(packing, u**2, width=2.0, bin=0.5).C)


# ---- lengths


def test_zero_crossings_of_known_curves():
    x = np.linspace(0, 0.5, 2001)[1:]
    assert zero_crossing(x, np.cos(2 * np.pi * x)) == pytest.approx(1 / 4, abs=1e-6)
    assert zero_crossing(x, -np.log(2 * np.sin(np.pi * x))) == pytest.approx(1 / 6, abs=1e-6)
    assert np.isnan(zero_crossing(x, np.exp(-x)))


def test_zero_crossing_passes_over_bins_without_pairs():
    assert zero_crossing([0, 1, 2, 3], [-0.5, np.nan, 0.5, -0.5]) == 2.5


def test_minimum_of_a_known_curve():
    assert minimum([0, 1, 2, 3], [np.nan, 0.2, -0.4, 0.1]) == (2.0, -0.4)


def straight(root, L=10.0, omega=(1.0,)):
    """A result whose C falls along a straight line, to zero at ``root``."""
    c = correlations_of(model(), omega)
    delta = np.linspace(0, L / 2, 21)
    line = np.tile(1 - delta / root, (len(omega), 1))
    return replace(c, delta=delta, real=line, imaginary=line / 2, L=L)


def test_jackknife_is_that_of_the_roots():
    roots = np.array([2.0, 2.5, 4.0])
    found = correlation_length({str(root): straight(root) for root in roots})

    def mean_root(some):
        return 1 / np.mean(1 / some)  # of the mean of lines

    left = [mean_root(np.delete(roots, k)) for k in range(3)]
    assert found.length[0] == pytest.approx(mean_root(roots))
    assert found.error[0] == pytest.approx(np.sqrt(2 * np.var(left)))


def test_lengths_grow_with_the_cell():
    found = correlation_length({"a": straight(2.0, L=8.0), "b": straight(3.0, L=12.0)})
    assert (found.L, found.length[0]) == (10.0, pytest.approx(2.5))
    assert found.error[0] < 1e-12


def test_one_packing_has_no_error():
    assert np.isnan(correlation_length({"one": straight(2.0)}).error).all()


def test_unstable_packings_are_left_out_of_the_mean():
    unstable = replace(straight(4.0), G0=-1e-3)
    assert correlation_length({"a": straight(2.0), "b": unstable}).length[0] == pytest.approx(2.0)
    with pytest.raises(pj.InputError, match="stable"):
        correlation_length({"b": unstable})


def test_frequencies_of_a_mean_agree():
    with pytest.raises(pj.InputError, match="same frequencies"):
        correlation_length({"a": straight(2.0), "b": straight(2.0, omega=(2.0,))})


# ---- the response


def dense(packing, omega, law, prestress):
    """u_y of Q* = (1/G*)(q, 1) from the dense twin, over the backbone, with zero mean; NaN elsewhere."""
    n = len(packing)
    K, B, _ = twin_matrices(packing, law, prestress=prestress)
    A = K + 1j * omega * B
    scale = 1 / np.sqrt(np.abs(np.diag(A)) + (np.diag(A) == 0))
    forcing = np.zeros(len(A))
    forcing[-1] = scale[-1]
    Q = scale * np.linalg.lstsq(scale[:, None] * A * scale, forcing, rcond=1e-14)[0]
    uy = np.full(n, complex(np.nan, np.nan))
    backbone = sorted({disk for c in twin_contacts(packing) for disk in (c.i, c.j)})
    uy[backbone] = Q[1 : 2 * n : 2][backbone] - Q[1 : 2 * n : 2][backbone].mean()
    return uy


@any_prestress
@pytest.mark.parametrize("law", [pj.ContactDamping(), pj.StokesDrag(eta_fluid=1.0)], ids=str)
def test_both_phases_agree_with_dense_algebra(law, prestress):
    packing, omega = sixteen(), [1e-3, 0.1, 3.0]
    found = correlations(packing, omega, damping=law, prestress=prestress, rtol=1e-12)
    for w, one in enumerate(omega):
        uy = dense(packing, one, law, prestress)
        for part, C in ((uy.real, found.real[w]), (uy.imag, found.imaginary[w])):
            slow = lane_correlation(packing, part, width=found.width, bin=found.bin).C
            np.testing.assert_allclose(C, slow, atol=1e-6)


@pytest.mark.parametrize("law", [pj.ContactDamping(), pj.StokesDrag(eta_fluid=1.0)], ids=str)
def test_both_phases_agree_with_direct_solves_over_twelve_decades(law):
    omega = np.array([1e-10, 1e-5, 0.03, 1e2])
    direct = pj.complex_modulus(jammed(seed=3), omega, damping=law, fields_at=omega)
    found = correlations_of(model(law), omega)
    backbone = pj.ContactNetwork.of(jammed(seed=3)).backbone
    Q = direct.fields[..., 1] / direct.values[:, None]
    Q = np.where(backbone, Q - Q[:, backbone].mean(1, keepdims=True), complex(np.nan, np.nan))
    for part, C in ((Q.real, found.real), (Q.imag, found.imaginary)):
        slow = lane_correlation(jammed(seed=3), part, width=found.width, bin=found.bin).C
        np.testing.assert_allclose(C, slow, atol=1e-6)


def test_damping_as_the_stiffness_gives_one_curve():
    """β = 0 without pre-stress: B = K, so q is real and the same at every ω."""
    found = correlations_of(model(pj.ContactDamping(beta=0.0), prestress=False), [1e-10, 1e-3, 1.0, 100.0])
    every = np.concatenate([found.real, found.imaginary])
    np.testing.assert_allclose(every, np.broadcast_to(every[0], every.shape), atol=1e-6)


def test_laws_agree_where_nothing_flows():
    """At ω → 0 the motion at peak stress is that of K alone."""
    contact, stokes = (correlations_of(model(law), [1e-10]) for law in (None, pj.StokesDrag(eta_fluid=1.0)))
    np.testing.assert_allclose(contact.real, stokes.real, atol=1e-6)


def test_fluid_turns_the_phase():
    """ηF changes no q, but G*, and with it what is at peak stress."""
    s = model(pj.StokesDrag(eta_fluid=1.0))
    one, none = (correlations_of(m, [0.1]) for m in (s, s.with_fluid(0.0)))
    assert abs(one.real - none.real)[:, 1:].max() > 1e-2


def test_settings_and_modulus_come_along():
    s = model()
    c = correlations_of(s, [1e-3, 1.0])
    assert (c.width, c.bin) == (jammed(seed=3).mean_diameter, jammed(seed=3).mean_diameter / 2)
    assert c.L == jammed(seed=3).box.cell[0, 0]
    np.testing.assert_array_equal(c.G, s([1e-3, 1.0]))
    assert len(c.delta) == len(c.pairs) == c.real.shape[1] == c.imaginary.shape[1]


@pytest.mark.parallel(nprocs=[1, 2, 3])
def test_every_number_of_ranks_gives_the_same(comm):
    from mpi4py import MPI

    omega = [1e-10, 1e-3, 10.0]
    together, alone = (
        correlations(jammed(seed=3), omega, damping=pj.StokesDrag(), comm=c) for c in (comm, MPI.COMM_SELF)
    )
    np.testing.assert_allclose(together.real, alone.real, atol=1e-8)
    np.testing.assert_allclose(together.imaginary, alone.imaginary, atol=1e-8)
    for item in fields(together):
        values = comm.allgather(getattr(together, item.name))
        np.testing.assert_array_equal(np.asarray(values[0]), np.asarray(values[comm.rank]))


@pytest.mark.parallel(nprocs=2)
def test_ranks_that_disagree_are_refused(comm):
    with pytest.raises(pj.InputError, match="differ between the ranks"):
        correlations(jammed(seed=3), [1.0], width=1.0 + comm.rank, comm=comm)


# ---- bad input


@pytest.mark.parametrize(
    ("settings", "message"),
    [
        ({"width": 0.0}, "width: .* not 0.0"),
        ({"width": -1.0}, "width: .* not -1.0"),
        ({"width": 100.0}, "width: .* not 100.0"),
        ({"width": "broad"}, "width: .* not 'broad'"),
        ({"bin": 0.0}, "bin: .* not 0.0"),
        ({"bin": np.nan}, "bin: .* not nan"),
        ({"bin": 6.0}, "bin: .* not 6.0"),
        ({"omegas": [0.0]}, "omega: .* not 0"),
        ({"omegas": [1.0, -2.0]}, "omega: .* not -2"),
        ({"omegas": []}, "omega: the range is empty"),
    ],
)
def test_what_makes_no_sense_is_refused(settings, message):
    with pytest.raises(pj.InputError, match=message):
        correlations(jammed(seed=3), **{"omegas": [1.0], **settings})


def test_a_cell_without_lattice_vector_along_x_is_refused():
    packing, u = scattered([[12.0, 0.1], [0.0, 12.0]])
    with pytest.raises(pj.InputError, match="lattice vector along x"):
        lane_correlation(packing, u, width=1.0, bin=1.0)


def test_fields_of_another_packing_are_refused():
    packing, u = scattered(CELLS["square"])
    with pytest.raises(pj.InputError, match=r"values: .* 60"):
        lane_correlation(packing, u[1:], width=1.0, bin=1.0)


def test_an_unknown_part_is_refused():
    with pytest.raises(pj.InputError, match=r"part: .* not 'loss'"):
        correlation_length({"a": straight(2.0)}, "loss")


def test_a_model_without_motions_is_refused():
    with pytest.raises(pj.InputError, match="displacements=True"):
        correlations_of(replace(model(), motions=None), [1.0])


# ---- the figure


def test_figure_is_drawn(tmp_path):
    results = {str(law): correlations_of(model(law), [1e-3, 1.0]) for law in (None, pj.StokesDrag())}
    plot_results(results, tmp_path / "correlations.png")
    assert (tmp_path / "correlations.png").read_bytes().startswith(b"\x89PNG")


def test_figure_of_unstable_packings_alone_says_so(tmp_path, titles):
    plot_results({"a": replace(straight(2.0), negative_modes=1)}, tmp_path / "none.png")
    assert any(title.endswith("UNSTABLE: 1 negative modes") for title in titles)
