"""Facts about exponents and their errors: closed forms, laws put in, how often an error covers the truth."""

from functools import cache
from itertools import pairwise

import numpy as np
import pytest
from helpers import sixteen

import petscjam as pj
from petscjam.analysis.scaling import (
    PRIOR,
    Curve,
    collapse,
    critical,
    finite_size,
    local_exponents,
    local_slope,
    overlap,
    power_law,
    quality,
)

P = np.geomspace(1e-5, 1e-2, 7)


def packings(random, n=8, x=P, exponent=0.5, scatter=0.2):
    """n packings at each x that scatter about 3x^exponent."""
    return [3 * p**exponent * np.exp(scatter * random.standard_normal(n)) for p in x]


def within(pulls):
    return np.mean(np.abs(pulls) < 1)


# ---- power laws


def test_an_exponent_is_found_within_its_error_as_often_as_an_error_promises():
    random = np.random.default_rng(1)
    fits = [power_law(P, packings(random), resamples=300) for _ in range(200)]
    pulls = [(fit.exponent - 0.5) / fit.error for fit in fits]
    assert 0.55 < within(pulls) < 0.8
    assert abs(np.mean(pulls)) < 0.2


def test_so_it_is_where_few_packings_scatter_more_near_jamming():
    random = np.random.default_rng(2)
    scatter = np.geomspace(0.3, 0.1, 7)
    pulls = []
    for _ in range(200):
        samples = [np.concatenate(packings(random, 6, [p], scatter=s)) for p, s in zip(P, scatter, strict=True)]
        fit = power_law(P, samples, resamples=300, estimator="median")
        pulls.append((fit.exponent - 0.5) / fit.error)
    assert 0.55 < within(pulls) < 0.8


def test_the_error_is_the_standard_error_of_a_straight_line():
    n, scatter = 200, 0.1
    fit = power_law(P, packings(np.random.default_rng(3), n, scatter=scatter))
    log = np.log(P)
    assert fit.error == pytest.approx(scatter / np.sqrt(n * ((log - log.mean()) ** 2).sum()), rel=0.06)


@pytest.mark.parametrize("n", [2, 3, 8])
def test_the_error_between_two_points_is_that_of_their_means_however_few_packings(n):
    samples = [np.linspace(1, 1.02, n), np.linspace(10, 10.1, n)]
    relative = [s.std(ddof=1) / np.sqrt(n) / s.mean() for s in samples]
    fit = power_law([1, 2], samples, resamples=20_000)
    assert fit.error == pytest.approx(np.hypot(*relative) / np.log(2), rel=0.02)
    assert np.isnan(fit.chi2)


def test_a_bend_shows_in_chi2_and_a_straight_line_does_not():
    random = np.random.default_rng(4)
    straight = np.mean([power_law(P, packings(random, 20), resamples=200).chi2 for _ in range(200)])
    assert straight == pytest.approx(1, abs=0.15)
    bent = [(1 + p / 1e-4) * y for p, y in zip(P, packings(random, 20), strict=True)]
    assert power_law(P, bent).chi2 > 10


def bent(x):
    """y = x below 1 and √x above: three packings, whose mean and median it is."""
    return [np.array([0.99, 1, 1.01]) * (p if p < 1 else p**0.5) for p in x]


def test_a_window_holds_both_its_ends_and_nothing_else():
    x = np.array([100.0, 0.01, 1.0, 0.1, 10.0])
    low, high = power_law(x, bent(x), (0.01, 0.1)), power_law(x, bent(x), (1.0, 100.0))
    assert (low.exponent, high.exponent) == pytest.approx((1, 0.5))
    assert (low.points, high.points) == (2, 3)
    assert (low.window, high.window) == ((0.01, 0.1), (1, 100))


def test_local_exponents_slide_over_a_bend():
    x = np.geomspace(1e-3, 1e3, 7)
    fits = local_exponents(x, bent(x), 3, resamples=50)
    assert [fit.window for fit in fits] == [(x[m], x[m + 2]) for m in range(5)]
    assert [fit.exponent for fit in fits] == pytest.approx([1, 1, 0.75, 0.5, 0.5], abs=0.01)


def test_a_median_does_not_mind_an_outlier():
    samples = [p**0.5 * np.array([0.9, 0.98, 1, 1.02, 1.1]) for p in P]
    samples[-1][-1] *= 100
    assert power_law(P, samples, estimator="median").exponent == pytest.approx(0.5, abs=1e-12)
    assert power_law(P, samples).exponent > 0.55


def test_a_point_that_scatters_weighs_less():
    """Of many packings: by the inverse of its variance, as in the fit of numpy."""
    n = 4000
    scatter = np.array([0.01, 0.02, 0.01, 0.05, 0.01, 0.1, 0.01])
    random = np.random.default_rng(5)
    samples = [p**0.5 * (1 + s * random.standard_normal(n)) for p, s in zip(P, scatter, strict=True)]
    means = [np.log(s.mean()) for s in samples]
    slope = np.polyfit(np.log(P), means, 1, w=1 / scatter)[0]
    fit = power_law(P, samples)
    assert fit.exponent == pytest.approx(slope, abs=0.15 * fit.error)
    assert abs(np.polyfit(np.log(P), means, 1)[0] - slope) > fit.error


def test_packings_in_common_count_as_a_prior():
    """Two packings at each x: a variance is (own + PRIOR·common)/(1 + PRIOR)."""
    x, sure = np.array([1.0, 2.0, 4.0]), np.array([0.995, 1.005])
    samples = [sure, sure, 1.5 * np.array([0.9, 1.1])]
    own = np.array([0.005, 0.005, 0.1]) ** 2  # of ln mean
    weights = (own + PRIOR * own.mean()) / (1 + PRIOR)
    expected = np.polyfit(np.log(x), np.log([1, 1, 1.5]), 1, w=weights**-0.5)[0]
    assert power_law(x, samples, resamples=20_000).exponent == pytest.approx(expected, rel=2e-3)


def test_units_do_not_matter():
    samples = packings(np.random.default_rng(6))
    one, other = power_law(P, samples), power_law(2.4 * P, [7 * y for y in samples])
    assert (other.exponent, other.error, other.chi2) == pytest.approx((one.exponent, one.error, one.chi2))
    assert other.prefactor == pytest.approx(7 * 2.4**-one.exponent * one.prefactor)


def test_neither_the_order_of_packings_nor_that_of_points_matters():
    samples = packings(np.random.default_rng(7))
    turned = power_law(P[::-1], [np.roll(y, 3) for y in samples[::-1]])
    assert vars(turned) == vars(power_law(P, samples))


def test_a_seed_says_which_resamples():
    samples = packings(np.random.default_rng(8))
    assert vars(power_law(P, samples, seed=3)) == vars(power_law(P, samples, seed=3))
    one, other = power_law(P, samples), power_law(P, samples, seed=3)
    assert one.error != other.error
    assert one.exponent == pytest.approx(other.exponent, abs=0.1 * one.error)
    assert one.error == pytest.approx(other.error, rel=0.1)


def test_a_negative_modulus_counts_where_no_mean_of_those_drawn_is_negative():
    samples = [np.append(np.full(11, 3.0), -0.1), np.linspace(5, 7, 12)]
    fit = power_law([1, 2], samples)
    assert fit.exponent == pytest.approx(np.log2(6 / samples[0].mean()))


TWO = [[1, 2, 3], [4, 5, 6]]


@pytest.mark.parametrize(
    ("given", "message"),
    [
        (([1, 2, 3], TWO), "3 x, but 2 sets"),
        (([1, 1], TWO), "1 different x"),
        (([1, 2], TWO, (1.5, 3)), r"1 different x in 1.5 … 3"),
        (([], []), "0 different x"),
        (([0, 2], TWO), "x must be above 0, not 0"),
        (([1, -2], TWO), "not -2"),
        (([1, np.nan], TWO), "not nan"),
        (([1, 2], [[1, 2, np.nan], [3, 4]]), "x = 1: a value is nan"),
        (([1, 2], [[1, 2], [np.inf, 4]]), "x = 2: a value is inf"),
        (([1, 2], [[1, 2], [3]]), "x = 2: 1 packings"),
        (([1, 2], [[1, 2], 3.0]), "x = 2: 0 packings"),
        (([1, 2], [[1, 2], [3, 3, 3]]), "x = 2: 3 packings do not differ"),
        (([1, 2], [[1, 2], [-1, -2]]), "x = 2: a mean over packings is -2, not above 0"),
        (([1, 2], [[1, 2, -1], [3, 4]]), "x = 1: a mean over packings is -1"),
    ],
)
def test_no_power_law(given, message):
    with pytest.raises(pj.InputError, match=message):
        power_law(*given)


@pytest.mark.parametrize(
    ("settings", "message"),
    [({"estimator": "mode"}, "'mode' is not one of mean, median"), ({"resamples": 1}, "1 resamples")],
)
def test_no_such_settings(settings, message):
    with pytest.raises(pj.InputError, match=message):
        power_law([1, 2], TWO, **settings)


@pytest.mark.parametrize("points", [1, 3])
def test_no_local_exponents(points):
    with pytest.raises(pj.InputError, match=f"windows of {points} points, of 2"):
        local_exponents([1, 2], TWO, points)


# ---- slopes


def test_a_local_slope_is_off_by_the_square_of_its_step():
    x = np.array([[0.1, 0.5], [1.2, 10]])  # d ln √(1 + x²)/d ln x = x²/(1 + x²)
    off = [local_slope(lambda x: np.hypot(1, x), x, step) - x**2 / (1 + x**2) for step in (0.1, 0.01)]
    assert off[0] / off[1] == pytest.approx(np.full((2, 2), 100), rel=0.05)
    assert abs(off[1]).max() < 1e-5


def test_a_solid_of_kelvin_and_voigt_has_slopes_0_and_1():
    packing = sixteen()
    s = pj.spectrum(packing, (1e-4, 1e2), damping=pj.ContactDamping(beta=0.0), prestress=False)
    omega = np.geomspace(1e-3, 1e1, 9)
    assert local_slope(lambda w: s(w).real, omega) == pytest.approx(0, abs=1e-7)
    assert local_slope(lambda w: s(w).imag, omega) == pytest.approx(1, abs=1e-7)


@pytest.mark.parametrize(
    ("f", "x", "message"),
    [
        (np.sqrt, [1, 0], "x must be above 0, not 0"),
        (np.negative, [2.0], "f must be above 0, not -2"),
        (lambda x: x + 1j, [1.0], "f is complex"),
        (lambda x: x * np.nan, [1.0], "not nan"),
    ],
)
def test_no_slope(f, x, message):
    with pytest.raises(pj.InputError, match=message):
        local_slope(f, x)


# ---- quality and overlap


def random_curves(random, c=4, q=2, w=9):
    """x, y and the covariance of neighbours along each curve, with gaps of any width."""
    x = [np.sort(random.uniform(0, 3, w)) + 0.7 * i for i in range(c)]
    full = [[(lambda A: A @ A.T)(random.standard_normal((w, w))) for _ in range(q)] for _ in range(c)]
    y = [random.standard_normal((q, w)) for _ in range(c)]
    return x, y, full


def slow_quality(x, y, full):
    """By loops, between neighbouring points of all curves; variances there from whole covariance matrices."""
    edges = sorted(np.concatenate(x))
    total = length = 0.0
    for low, high in pairwise(edges):
        at = (low + high) / 2
        inside = [c for c in range(len(x)) if x[c][0] < at < x[c][-1]]
        for c in inside if len(inside) > 1 else []:
            length += (high - low) * len(y[c])
            for q in range(len(y[c])):
                line, variance = {}, {}
                for o in inside:
                    weight = np.array([np.interp(at, x[o], row) for row in np.eye(len(x[o]))])
                    line[o], variance[o] = weight @ y[o][q], weight @ full[o][q] @ weight
                parts = [1 / variance[o] for o in inside if o != c]
                mean = np.average([line[o] for o in inside if o != c], weights=parts)
                total += (high - low) * (line[c] - mean) ** 2 / (variance[c] + 1 / sum(parts))
    return total / length


def neighbours(full):
    variance = [np.array([np.diag(m) for m in curve]) for curve in full]
    covariance = [np.array([np.append(np.diag(m, 1), 0) for m in curve]) for curve in full]
    return variance, covariance


@pytest.mark.parametrize("seed", range(5))
def test_quality_is_that_of_the_slow_twin(seed):
    x, y, full = random_curves(np.random.default_rng(seed))
    assert quality(x, y, *neighbours(full)) == pytest.approx(slow_quality(x, y, full), rel=1e-10)


@pytest.mark.parametrize("shift", [0.3, 0.5, 1.0, 2.0])
def test_quality_does_not_jump_where_points_meet_or_leave_the_others(shift):
    """On a grid of step ½, some points of curve 1 coincide with points and with ends of curve 0."""
    random = np.random.default_rng(8)
    x, y = [np.arange(0, 3.1, 0.5), np.arange(0, 2.1, 0.5) + shift], random.standard_normal((2, 1, 7))
    flat = [np.full((1, len(points)), 0.1) for points in x]

    def at(nudge):
        return quality([x[0], x[1] + nudge], [y[0], y[1, :, :5]], flat, [0.5 * v for v in flat])

    assert at(-1e-9) == pytest.approx(at(1e-9), rel=1e-7)
    assert at(-1e-9) == pytest.approx(at(0), rel=1e-7)


@pytest.mark.parametrize("alike", [0.0, 0.6, 1.0])
@pytest.mark.parametrize("shift", [0.0, 0.5])
def test_quality_of_curves_that_agree_is_1_however_their_grids_lie(shift, alike):
    """``alike``: correlation of neighbouring points of a curve; the shift is in units of the grid."""
    random = np.random.default_rng(9)
    x = [np.arange(12.0) + shift * c for c in range(2)]
    full = alike ** abs(np.subtract.outer(x[0], x[0]))
    root = np.linalg.svd(full)[0] * np.sqrt(np.linalg.svd(full)[1])
    variance, covariance = neighbours([[full], [full]])
    found = [
        quality(x, [(root @ random.standard_normal(12))[None] for _ in x], variance, covariance) for _ in range(1500)
    ]
    assert np.mean(found) == pytest.approx(1, abs=0.1)


@pytest.mark.parametrize(
    ("curves", "expected"),
    [
        ([(0, 1), (0.4, 1.4)], 0.6),
        ([(0, 4), (3.5, 4.5)], 0.5),
        ([(0, 1), (0.5, 4.5)], 0.5),
        ([(0, 1), (1.5, 2.5)], -0.5),
        ([(0, 1), (0.9, 1.9), (1.6, 2.6)], 0.1),
        ([(0, 10), (1, 2), (3, 4)], 1.0),
        ([(0, 1), (0, 1), (3, 4), (3, 4)], -2.0),  # two pairs that coincide have nothing in common
    ],
)
def test_overlap_is_the_weakest_link(curves, expected):
    for turned in (curves, curves[::-1]):
        assert overlap([np.linspace(*ends, 5) for ends in turned]) == pytest.approx(expected)


# ---- collapse


def moduli(random, mu=0.5, lam=1.0, n=8, points=21, unit=1.0):
    """G′ and G″ of packings that obey BT eqs. 14–17 with G*/p^μ = √(1 + iω/p^λ), and scatter."""
    curves = []
    for p in (1e-4, 1e-3, 1e-2):
        omega = np.geomspace(1e-6, 1, points)
        G = p**mu * np.sqrt(1 + 1j * omega / p**lam)
        scatter = 0.05 * random.standard_normal((n, 2, 1)) + 0.01 * random.standard_normal((n, 2, points))
        curves.append(Curve(unit * omega, 7 * unit * np.stack([G.real, G.imag]) * np.exp(scatter), {"p": p}))
    return curves


def viscosities(random, n=6):
    """η0 of packings that obey η0/N = 1/√(1 + pN²), and scatter."""
    curves = []
    for N in (64, 256, 1024):
        p = 1.26 * np.geomspace(1, 1e4, 9) / N**2
        scatter = 0.1 * random.standard_normal((n, 1)) + 0.05 * random.standard_normal((n, 9))
        curves.append(Curve(p, N / np.sqrt(1 + p * N**2) * np.exp(scatter), {"N": N}))
    return curves


@cache
def collapsed(**settings):
    return collapse(moduli(np.random.default_rng(10)), critical, {"mu": 0.4, "lam": 1.2}, resamples=40, **settings)


def test_storage_and_loss_collapse_with_the_exponents_put_in():
    found = collapsed()
    for name, true in (("mu", 0.5), ("lam", 1.0)):
        assert abs(found.exponents[name] - true) < 2 * found.errors[name] < 0.05
    assert found.quality < 1.5
    assert found.overlap == pytest.approx(1 - found.exponents["lam"] / 6, abs=1e-9)


def test_the_error_of_what_follows_from_the_exponents_comes_from_the_resamples():
    mu, lam = collapsed().resampled.T
    assert abs(np.mean(mu / lam) - 0.5) < 2 * (mu / lam).std()
    assert [mu.std(), lam.std()] == pytest.approx(list(collapsed().errors.values()))


def test_an_exponent_is_not_drawn_to_where_the_grids_coincide():
    """With λ a multiple of 0.3 points of all three curves have the same x."""
    curves = moduli(np.random.default_rng(11), lam=1.05)
    found = collapse(curves, critical, {"mu": 0.5, "lam": 0.95}, resamples=2)
    assert found.exponents["lam"] == pytest.approx(1.05, abs=0.01)


def test_the_error_is_the_standard_error_of_two_plateaus():
    """Flat curves, all of whose points move together: a = ln(y₂/y₁)/ln(N₂/N₁)."""
    random = np.random.default_rng(12)
    heights = [3 * np.exp(0.1 * random.standard_normal(100)), 9 * np.exp(0.2 * random.standard_normal(100))]
    x = np.geomspace(1, 1e4, 12)
    curves = [Curve(x / N**2, h[:, None] * np.ones(12), {"N": N}) for N, h in zip((10, 30), heights, strict=True)]
    found = collapse(curves, finite_size, {"a": 0.5}, resamples=400)
    means = [h.mean() for h in heights]
    errors = [h.std(ddof=1) / 10 / h.mean() for h in heights]
    assert found.exponents["a"] == pytest.approx(np.log(means[1] / means[0]) / np.log(3), abs=1e-4)
    assert found.errors["a"] == pytest.approx(np.hypot(*errors) / np.log(3), rel=0.12)


@pytest.mark.slow
@pytest.mark.parametrize("n", [6, 20])
def test_a_collapse_finds_the_truth_within_its_error_as_often_as_an_error_promises(n):
    random = np.random.default_rng(13)
    pulls = []
    for _ in range(200):
        found = collapse(viscosities(random, n), finite_size, {"a": 0.9}, resamples=40)
        pulls.append((found.exponents["a"] - 1) / found.errors["a"])
    assert 0.55 < within(pulls) < 0.8
    assert abs(np.mean(pulls)) < 0.25


def test_both_exponents_of_finite_size_may_be_free():
    found = collapse(viscosities(np.random.default_rng(14), 20), finite_size, {"a": 0.9, "b": 1.8}, resamples=40)
    assert abs(found.exponents["a"] - 1) < 2 * found.errors["a"] < 0.2
    assert abs(found.exponents["b"] - 2) < 2 * found.errors["b"] < 0.4


def test_exponents_that_only_their_ratio_fixes_have_large_errors():
    """On y ~ √x alone μ = λ/2 for any λ."""
    random = np.random.default_rng(15)
    x = np.geomspace(1e-4, 1, 15)
    curves = [Curve(x, np.sqrt(x) * np.exp(0.02 * random.standard_normal((8, 15))), {"p": p}) for p in (1e-3, 1e-2)]
    found = collapse(curves, critical, {"mu": 0.5, "lam": 1.0}, resamples=40)
    assert found.errors["lam"] > 0.05
    assert (found.resampled[:, 0] - found.resampled[:, 1] / 2).std() < 0.01


@pytest.mark.parametrize("start", [-0.7, -0.3, 0.0, 0.3])
def test_curves_that_agree_best_apart_do_not_collapse(start):
    """One rises, the other falls: the less they share, the less they differ."""
    x, heights = np.geomspace(1, 100, 41), np.linspace(0.9, 1.1, 6)[:, None]
    curves = [Curve(x, heights * x, {"N": 10.0}), Curve(x, heights / x, {"N": 100.0})]
    with pytest.raises(pj.SolverError, match=r"only 0\.3 of their length: they do not collapse"):
        collapse(curves, lambda b, N: (N**b, 1.0), {"b": start}, resamples=2)


def test_units_and_order_do_not_matter_to_a_collapse():
    turned = [
        Curve(curve.x[::-1], np.roll(curve.samples, 3, axis=0)[..., ::-1], curve.parameters)
        for curve in moduli(np.random.default_rng(10), unit=2.4)
    ]
    found = collapse(turned, critical, {"mu": 0.4, "lam": 1.2}, resamples=40)
    assert found.resampled == pytest.approx(collapsed().resampled, abs=1e-3)
    assert list(found.errors.values()) == pytest.approx(list(collapsed().errors.values()), rel=0.02)


def test_a_seed_says_which_resamples_of_a_collapse():
    one, same, other = (
        collapse(viscosities(np.random.default_rng(17)), finite_size, {"a": 1.0}, resamples=20, seed=seed)
        for seed in (0, 0, 1)
    )
    assert one.resampled.tolist() == same.resampled.tolist()
    assert one.exponents == pytest.approx(other.exponents, abs=0.01)
    assert one.resampled.tolist() != other.resampled.tolist()


X, Y = np.array([1.0, 2.0, 3.0]), np.array([[1.0, 2.0, 3.0], [2.0, 3.0, 5.0]])


def two(x=X, samples=Y, **parameters):
    return [Curve(X, Y, {"N": 10.0}), Curve(x, samples, parameters or {"N": 11.0})]


@pytest.mark.parametrize(
    ("curves", "start", "message"),
    [
        (two()[:1], {"a": 1.0}, "1 curves; it takes two"),
        (two(), {}, "no exponent"),
        (two(), {"mu": 1.0}, "unexpected keyword argument 'mu'"),
        (two(p=1.0), {"a": 1.0}, "argument 'p'"),
        (two(N=1e6), {"a": 1.0}, "at the start curves share -"),
        (two(x=[1.0, 2.0]), {"a": 1.0}, r"curve 1: x \(2,\) and samples \(2, 3\)"),
        (two(x=[1.0, 2.0, 2.0]), {"a": 1.0}, "curve 1: the same x twice"),
        (two(x=[0.0, 2.0, 3.0]), {"a": 1.0}, "curve 1: x must be above 0, not 0"),
        (two(x=[np.nan, 2.0, 3.0]), {"a": 1.0}, "curve 1: x must be above 0, not nan"),
        (two(samples=np.full((2, 3), np.nan)), {"a": 1.0}, "curve 1: a value is nan"),
        (two(samples=-Y), {"a": 1.0}, "curve 1: a mean over packings is -5, not above 0"),
        (two(samples=Y[:1]), {"a": 1.0}, "curve 1: 1 packings"),
        (two(samples=Y[[0, 0]]), {"a": 1.0}, "curve 1: 2 packings do not differ"),
        (two(samples=np.stack([Y, 2 * Y], axis=1)), {"a": 1.0}, r"\[1, 2\] quantities"),
    ],
)
def test_no_collapse(curves, start, message):
    with pytest.raises(pj.InputError, match=message):
        collapse(curves, finite_size, start)
