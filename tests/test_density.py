"""Facts that a density of states obeys: dense eigenvalues under the same kernel, sums, closed forms."""

from dataclasses import replace
from functools import cache

import numpy as np
import pytest
from helpers import any_prestress, jammed, sixteen, twin_contacts
from scipy.integrate import quad

import petscjam as pj
from petscjam.analysis import density
from petscjam.analysis.density import DensityOfStates, density_of_states, highest, plateau
from petscjam.plots import plot_results
from petscjam.reference import linear as reference
from petscjam.response.origin import Origin

any_packing = pytest.mark.parametrize("which", ["sixteen", "rattlers"])


@cache
def packing(which="rattlers"):
    return sixteen() if which == "sixteen" else jammed(1e-3 if which == "rattlers" else 1e-2, seed=3)


@cache
def frequencies(which, prestress=True):
    """√λ of the dense K of the slow twin, without zeros of rattlers and translations."""
    p = packing(which)
    found = twin_contacts(p)
    K = reference.hessian(found, p.radii, prestress=prestress)[: 2 * len(p), : 2 * len(p)]
    values = np.linalg.eigvalsh(K)
    return np.sqrt(values[2 * (len(p) - len({d for c in found for d in (c.i, c.j)})) + 2 :])


@cache
def states(which="rattlers", prestress=True, moments=64, vectors=32, seed=1):
    return density_of_states(packing(which), moments=moments, vectors=vectors, seed=seed, prestress=prestress)


def unit_vectors(monkeypatch, which, moments=64, **options):
    """The density from every displacement of the backbone in turn, in place of random vectors."""
    p = packing(which)
    places = np.argwhere(np.outer(pj.ContactNetwork.of(p).backbone, [True, True]))

    def start(seed, v, backbone):
        u = np.zeros((len(p), 2))
        u[tuple(places[v])] = 1.0
        return density.projected(u, backbone)

    monkeypatch.setattr(density, "start_vector", start)
    return density_of_states(p, moments=moments, vectors=len(places), **options)


def kernel(phi, moments):
    """Jackson's kernel as the square it is: |Σ a_j e^{ijφ}|²/2π, a_j ~ sin(π(j + 1)/(M + 1))."""
    j = np.arange(moments)
    a = np.sin(np.pi * (j + 1) / (moments + 1))
    return abs(np.exp(1j * np.multiply.outer(phi, j)) @ (a / np.linalg.norm(a))) ** 2 / (2 * np.pi)


def smoothed(omega, modes, edge, moments):
    """D of the frequencies ``modes``: a kernel around the angle of each, and around its mirror image."""
    theta, at = 2 * np.arcsin(omega / edge), 2 * np.arcsin(modes / edge)
    both = kernel(theta[:, None] - at, moments) + kernel(theta[:, None] + at, moments)
    return both.mean(1) / (edge / 2 * np.cos(theta / 2))


def made_of(modes, edge, moments):
    """A density with known modes."""
    m = np.arange(moments)
    exact = np.cos(np.outer(m, 2 * np.arcsin(np.asarray(modes) / edge))).mean(1)
    found = np.tile(exact, (2, 1))
    grid = density.frequency_grid(edge, moments)
    return DensityOfStates(
        **density.series(found, edge, grid),
        moments=found,
        edge=edge,
        modes=len(modes),
        negative_modes=0,
        origin=Origin("made", "0" * 16, len(modes), 0.9, 1e-3, 4.0, 0, "harmonic", True),
    )


# ---- dense eigenvalues


@any_prestress
@any_packing
def test_all_unit_vectors_give_the_dense_eigenvalues(monkeypatch, which, prestress):
    d = unit_vectors(monkeypatch, which, prestress=prestress)
    exact = smoothed(d.omega, frequencies(which, prestress), d.edge, 64)
    assert d.density == pytest.approx(exact, rel=1e-9, abs=1e-9)


@any_prestress
@pytest.mark.parametrize("which", ["rattlers", "jammed"])
def test_random_vectors_agree_within_their_errors(which, prestress):
    d = states(which, prestress)
    off = (d.density - smoothed(d.omega, frequencies(which, prestress), d.edge, 64)) / d.error
    assert abs(off).max() < 4.5
    assert 0.3 < np.sqrt((off**2).mean()) < 1.7


def test_the_error_falls_with_the_number_of_vectors():
    few, many = states(vectors=8), states(vectors=128)
    assert few.error.mean() / many.error.mean() == pytest.approx(4.0, rel=0.25)


@any_packing
def test_an_odd_number_of_moments_cuts_the_same_series(which):
    assert states(which, moments=63).moments == pytest.approx(states(which).moments[:, :63], abs=1e-12)


@any_packing
def test_modes_are_counted_without_rattlers_and_translations(which):
    assert states(which).modes == len(frequencies(which))


def test_a_packing_of_this_file_has_rattlers():
    assert states("rattlers").origin.rattlers > 0


# ---- sums over modes


@any_prestress
def test_the_second_moment_of_all_unit_vectors_is_the_trace(monkeypatch, prestress):
    """⟨ω²⟩ = tr K/(2n − 2), the trace by the slow twin."""
    d = unit_vectors(monkeypatch, "sixteen", moments=2, prestress=prestress)
    square = d.edge**2 * (1 - d.moments[:, 1].mean()) / 2
    assert square == pytest.approx((frequencies("sixteen", prestress) ** 2).mean(), rel=1e-12)


def test_every_vector_counts_every_mode_once():
    assert states().moments[:, 0] == pytest.approx(1.0, abs=1e-14)


def test_the_density_integrates_to_one():
    d = states()
    assert quad(lambda w: d.at(w).density[0], 0, d.edge, limit=500)[0] == pytest.approx(1.0, rel=1e-6)


@pytest.mark.parametrize("where", [0.1, 0.5, 0.9])
def test_the_cumulative_density_is_the_integral(where):
    d = states()
    end = where * d.edge
    share = quad(lambda w: d.at(w).density[0], 0, end, limit=500)[0]
    assert d.at(end).cumulative[0] == pytest.approx(share, rel=1e-8)


def test_the_density_is_positive(monkeypatch):
    assert (unit_vectors(monkeypatch, "sixteen").density > 0).all()


@pytest.mark.parametrize("mode", [0.3, 1.0, 1.7])
def test_the_resolution_is_the_deviation_of_one_mode(mode):
    d = made_of([mode], 2.0, 400)
    omega = np.linspace(mode - 0.1, mode + 0.1, 4001)
    D = d.at(omega).density
    deviation = np.sqrt(np.sum((omega - mode) ** 2 * D) / np.sum(D))
    assert deviation == pytest.approx(d.at(mode).resolution[0], rel=0.05)


# ---- the bound on λ


@any_prestress
@any_packing
def test_no_eigenvalue_lies_above_the_bound_and_little_is_wasted(which, prestress):
    bound, top = highest(pj.ContactNetwork.of(packing(which))), frequencies(which, prestress)[-1] ** 2
    assert top <= bound < 1.15 * top


def test_the_bound_of_a_square_lattice_is_its_highest_eigenvalue():
    """λ = 4k sin²(q/2) along rows of an even number of disks."""
    grid = 0.99 * np.mgrid[0:6, 0:4].reshape(2, -1).T
    lattice = pj.Packing(grid, np.full(24, 0.5), pj.Box(0.99 * np.diag([6, 4])))
    assert highest(pj.ContactNetwork.of(lattice)) == pytest.approx(4.0, rel=1e-12)


def test_a_bound_that_is_too_low_is_noticed(monkeypatch):
    monkeypatch.setattr(density, "highest", lambda network: 0.9 * frequencies("sixteen")[-1] ** 2)
    with pytest.raises(pj.SolverError, match="the moments grow"):
        density_of_states(packing("sixteen"))


# ---- the plateau


@pytest.mark.parametrize("onset", [0.05, 0.1, 0.2])
def test_the_plateau_of_evenly_spread_modes(onset):
    found = plateau(made_of(np.linspace(onset, 1.9, 20_000), 2.0, 1000))
    assert found.height == pytest.approx(1 / (1.9 - onset), rel=1e-3)
    assert found.onset == pytest.approx(onset, rel=1e-2)


def test_the_onset_is_the_highest_below_the_plateau():
    """A soft peak in the gap does not count, however high."""
    modes = np.concatenate([np.full(800, 0.03), np.linspace(0.1, 1.9, 20_000)])
    assert plateau(made_of(modes, 2.0, 1000)).onset == pytest.approx(0.1, rel=1e-2)


@pytest.mark.parametrize("onset", [0.0, 0.003])
def test_an_onset_that_is_not_resolved_is_not_a_number(onset):
    assert np.isnan(plateau(made_of(np.linspace(onset, 1.9, 20_000), 2.0, 1000)).onset)


def test_the_height_has_the_error_of_its_vectors():
    """Of 16 densities, eight vectors each, the heights scatter as each says."""
    found = [plateau(states("jammed", vectors=8, seed=seed)) for seed in range(16)]
    scatter = np.std([each.height for each in found], ddof=1)
    assert np.mean([each.height_error for each in found]) == pytest.approx(scatter, rel=0.5)


# ---- ranks, seeds


@pytest.mark.parallel(nprocs=[1, 2, 3])
@any_prestress
def test_the_density_does_not_depend_on_the_ranks(comm, prestress):
    together = density_of_states(packing(), moments=100, vectors=3, prestress=prestress, comm=comm)
    alone = density_of_states(packing(), moments=100, vectors=3, prestress=prestress, comm=comm.Split(comm.rank))
    assert together.moments == pytest.approx(alone.moments, abs=1e-12)
    assert together.density == pytest.approx(alone.density, abs=1e-10)
    assert together.error == pytest.approx(alone.error, abs=1e-10)


@pytest.mark.parallel(nprocs=[2, 3])
def test_every_rank_has_the_same_arrays(comm):
    d = density_of_states(packing(), moments=100, vectors=3, comm=comm)
    assert len(set(comm.allgather(d.density.tobytes() + d.error.tobytes()))) == 1


@pytest.mark.parallel(nprocs=2)
@pytest.mark.parametrize("what", ["moments", "vectors", "seed", "prestress"])
def test_different_arguments_on_different_ranks_are_refused(comm, what):
    with pytest.raises(pj.InputError, match="differ between the ranks"):
        density_of_states(packing(), **{what: 2 + comm.rank}, comm=comm)


def test_more_vectors_keep_those_before():
    assert (states(vectors=5).moments == states(vectors=8).moments[:5]).all()


def test_another_seed_draws_other_vectors():
    assert abs(states(seed=2).moments[:, 1:] - states().moments[:, 1:]).min() > 0


# ---- other frequencies


def test_other_frequencies_are_of_the_same_function():
    d = states()
    again = replace(d, omega=d.omega[:0]).at(d.omega)
    for name in ("omega", "density", "error", "cumulative", "resolution"):
        assert (getattr(again, name) == getattr(d, name)).all()


@pytest.mark.parametrize("bad", [-0.1, 10.0, np.nan])
def test_frequencies_outside_are_refused(bad):
    with pytest.raises(pj.InputError, match=f"^omega: .*{bad:g}"):
        states().at([0.1, bad])


# ---- bad input


@pytest.mark.parametrize("what", ["moments", "vectors"])
@pytest.mark.parametrize("bad", [1, 0, -3, 2.5, "8"])
def test_fewer_than_two_moments_or_vectors_are_refused(what, bad):
    with pytest.raises(pj.InputError, match=f"^{what}: .*{bad}"):
        density_of_states(packing(), **{what: bad})


def test_a_negative_seed_is_refused():
    with pytest.raises(pj.InputError, match=r"^seed: .*-1"):
        density_of_states(packing(), seed=-1)


@cache
def shaken():
    """A packing off its minimum: K has negative modes with pre-stress."""
    noise = np.random.default_rng(1).standard_normal((64, 2))
    return replace(packing("jammed"), positions=packing("jammed").positions + 2e-3 * noise, provenance={})


def test_negative_modes_are_refused():
    with pytest.raises(pj.InputError, match=r"^packing: K has \d+ negative modes"):
        density_of_states(shaken())


def test_negative_modes_that_nobody_could_count_are_noticed(monkeypatch):
    monkeypatch.setattr(density.LinearProblem, "negative_modes", None)
    with pytest.raises(pj.SolverError, match="the moments grow"):
        density_of_states(shaken())


def test_one_disk_is_refused():
    one = pj.Packing([[0.0, 0.0]], [0.5], pj.Box(0.99 * np.eye(2)))
    with pytest.raises(pj.InputError, match="one disk has only translations"):
        density_of_states(one, prestress=False)


def triangles(n):
    """The triangular lattice of ``n`` disks, one row that leans, and its frequencies by Bloch's theorem."""
    a = 0.99
    rows = a * np.array([[1, 0], [0.5, 0.75**0.5]])
    packing = pj.Packing(np.arange(n)[:, None] * rows[0], np.full(n, 0.5), pj.Box([n * rows[0], rows[1]]))
    found = []
    for k in range(1, n):
        q = 2 * np.pi * k / n
        D = np.zeros((2, 2))
        for r, phase in ((rows[0], q), (rows[1], 0.0), (rows[1] - rows[0], -q)):
            normal = r / a
            D += 2 * (1 - np.cos(phase)) * np.outer(normal, normal)
        found += np.linalg.eigvalsh(D).tolist()
    return packing, np.sqrt(np.sort(found))


@pytest.mark.parametrize("n", [2, 3, 4])
def test_few_disks(n):
    """Random signs that are all alike are a translation, and are drawn again."""
    lattice, modes = triangles(n)
    d = density_of_states(lattice, moments=64, vectors=400, prestress=False)
    exact = smoothed(d.omega, modes, d.edge, 64)
    assert d.modes == len(modes) == 2 * n - 2
    assert np.isfinite(d.moments).all()
    assert (abs(d.density - exact) <= 4.5 * d.error + 1e-9 * exact.max()).all()


def test_start_vectors_of_few_disks_have_length_one_and_no_preference():
    """Over many draws ⟨v vᵀ⟩ is what is left of 1 without translations."""
    backbone = np.array([True, True, False, True])
    v = np.array([density.start_vector(1, k, backbone)[backbone, :2].ravel() for k in range(4000)])
    assert np.linalg.norm(v, axis=1) == pytest.approx(1, abs=1e-14)
    e = np.tile(np.eye(2), 3) / 3**0.5
    assert v.T @ v / len(v) == pytest.approx((np.eye(6) - e.T @ e) / 4, abs=0.02)


# ---- the figure


def test_the_figure_is_written(tmp_path):
    plot_results({"with": states(), "without": states(prestress=False)}, tmp_path / "density.png")
    assert (tmp_path / "density.png").read_bytes().startswith(b"\x89PNG")
