"""Means over packings: groups of results, and standard errors.

Axes: k packing, m group, w frequency.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Mapping
from dataclasses import dataclass
from typing import Any, NamedTuple, TypeVar

import numpy as np
from numpy.typing import ArrayLike, NDArray

from petscjam.base.errors import InputError
from petscjam.base.tables import Table, Tabular
from petscjam.base.types import Array, per_decade
from petscjam.response.origin import Result, frequencies
from petscjam.response.result import ComplexModulus
from petscjam.response.spectrum import Spectrum

Modulus = ComplexModulus | Spectrum
R = TypeVar("R", bound=Result)
K = TypeVar("K", float, tuple[Any, ...])


def deviation(samples: ArrayLike) -> Any:
    """Return s = (Σ(x − x̄)²/(n − 1))^½ over the first axis; NaN for one sample; complex ones: of each part."""
    values = np.asarray(samples)
    if np.iscomplexobj(values):
        return deviation(values.real) + 1j * deviation(values.imag)
    return values.std(0, ddof=1) if len(values) > 1 else np.full(values.shape[1:], np.nan)[()]


def standard_error(samples: ArrayLike) -> Any:
    """Return the standard error s/√n of the mean over the first axis (:func:`deviation`)."""
    values = np.asarray(samples)
    return deviation(values) / np.sqrt(len(values))


def means(samples: Iterable[ArrayLike]) -> tuple[Array, Array]:
    """Return the mean of each set of ``samples`` and its standard error, (m,) and (m,)."""
    sets = [np.asarray(some, dtype=float) for some in samples]
    return np.array([some.mean() for some in sets]), np.array([standard_error(some) for some in sets])


def binned_medians(x: ArrayLike, y: ArrayLike, bins: int) -> tuple[Array, Array]:
    """Return the geometric mean of x and the median of y in equal bins of ln x, without empty ones.

    Parameters
    ----------
    x, y : (k,)
        The x are positive.
    bins : int
    """
    x, y = np.asarray(x, dtype=float), np.asarray(y, dtype=float)
    which = np.digitize(x, np.geomspace(x.min(), x.max() * 1.001, bins + 1))
    groups = [which == k for k in np.unique(which)]
    return np.exp([np.log(x[some]).mean() for some in groups]), np.array([np.median(y[some]) for some in groups])


def nominal(pressure: float) -> float:
    """Return ``pressure`` to three digits, the same for all packings of one target pressure."""
    return float(f"{pressure:.2e}")


def grouped(results: Iterable[R], key: Callable[[R], K]) -> dict[K, list[R]]:
    """Return the results by their key, in ascending order.

    Parameters
    ----------
    results : iterable
    key : callable
        Of a result.
    """
    groups: dict[K, list[R]] = {}
    for r in results:
        groups.setdefault(key(r), []).append(r)
    return dict(sorted(groups.items()))


def by_pressure(results: Iterable[R], **same: Any) -> dict[float, list[R]]:
    """Return the results by nominal pressure, in ascending order.

    Parameters
    ----------
    results : iterable
        Results of packings.
    **same
        Attributes of the results to include, compared as text: ``prestress=False``.
    """
    some = [r for r in results if all(str(getattr(r, key)) == str(value) for key, value in same.items())]
    return grouped(some, lambda r: nominal(r.origin.pressure))


class Kind(NamedTuple):
    """The common properties of averaged results; law, with the masses, and grid are empty for results without them."""

    law: str
    prestress: bool
    particles: int
    pressure: float
    omega: tuple[float, ...]


def alike(results: Mapping[str, R]) -> dict[Kind, dict[str, R]]:
    """Return the results, by name, of each :class:`Kind`, in the order of their first result."""
    groups: dict[Kind, dict[str, R]] = {}
    for name, r in results.items():
        law, grid = r.origin.damping, getattr(r, "omega", ())
        said = ", ".join(filter(None, [str(law or ""), getattr(r, "inertia", "")]))
        kind = Kind(said, r.prestress, r.origin.particles, nominal(r.origin.pressure), tuple(grid))
        groups.setdefault(kind, {})[name] = r
    return groups


@dataclass(frozen=True, eq=False)
class Average(Tabular):
    """G* over packings on a common grid. Units as those of the moduli.

    Attributes
    ----------
    omega : (W,)
    mean : (W,) complex
    scatter : (W,) complex
        Standard deviations of G′ and of G″ over packings.
    error : (W,) complex
        Standard errors of the two means.
    count : int
        Number of averaged packings.
    excluded : tuple of str
        Unstable packings, which were left out.
    unbalanced : tuple of str
        Averaged packings that are not in balance: without pre-stress they can be stable.
    """

    omega: Array
    mean: NDArray[np.complex128]
    scatter: NDArray[np.complex128]
    error: NDArray[np.complex128]
    count: int
    excluded: tuple[str, ...] = ()
    unbalanced: tuple[str, ...] = ()

    def facts(self) -> dict[str, Any]:
        """Return the number of packings and of frequencies, by name."""
        return {"packings": self.count, "left out": len(self.excluded), "frequencies": len(self.omega)}

    def flat(self) -> Table:
        """Return a line for each frequency."""
        columns = {"omega": self.omega}
        for name, values in (("G", self.mean), ("scatter", self.scatter), ("error", self.error)):
            columns |= {f"{name}_storage": values.real, f"{name}_loss": values.imag}
        return Table(columns, {"omega": "1/tau1", **{name: "stress" for name in columns if name != "omega"}})


def average(
    results: Mapping[str, Modulus] | Iterable[Modulus], omegas: ArrayLike | None = None, *, unstable: bool = False
) -> Average:
    """Average G* over the results of one law.

    Parameters
    ----------
    results : mapping or sequence of ComplexModulus or Spectrum
        By name, or with the names of their packings.
    omegas : (W,), optional
        Angular frequencies, 1/τ1. Default: the common grid of all results; of spectra, ten per decade of their common
        span.
    unstable : bool
        Include unstable packings. Otherwise ``excluded`` has their names.

    Returns
    -------
    Average

    Raises
    ------
    InputError
        If no result is left, settings differ, or a result has no value at one of the frequencies.
    """
    results = _named(results)
    kept = {name: g for name, g in results.items() if unstable or g.stable}
    if not kept:
        name, other = next(iter(results.items()), ("", None))
        reason = f"; {name}: {other.state}" if other else ""
        raise InputError(f"average: none of {len(results)} packings is stable{reason}")
    if len({(g.damping, g.strain, g.prestress, g.origin.potential, g.inertia) for g in kept.values()}) > 1:
        raise InputError("average: the results have different laws, strains, pre-stress, potentials or masses")
    omega = _grid(kept.values()) if omegas is None else frequencies(omegas)
    values: NDArray[np.complex128] = np.array([_at(name, g, omega) for name, g in kept.items()])
    return Average(
        omega,
        values.mean(0),
        deviation(values),
        standard_error(values),
        len(values),
        excluded=tuple(name for name in results if name not in kept),
        unbalanced=tuple(name for name, g in kept.items() if g.origin.balanced is False),
    )


def _named(results: Any) -> dict[str, Modulus]:
    """Return moduli and spectra by name."""
    if isinstance(results, Result):
        results = [results]
    if not isinstance(results, Mapping):
        given = list(results)
        results = {f"{k + 1}: {g.origin.name}" if isinstance(g, Result) else str(k + 1): g for k, g in enumerate(given)}
    for name, g in results.items():
        if not isinstance(g, Modulus):
            raise InputError(f"average: {name} is a {type(g).__name__}; moduli and spectra have G*")
    return dict(results)


def _grid(kept: Iterable[Modulus]) -> Array:
    """Return the frequencies of the first modulus or, of spectra alone, ten per decade of their common span."""
    spans = []
    for g in kept:
        if isinstance(g, ComplexModulus):
            return g.omega
        spans.append(g.span)
    low, high = max(span[0] for span in spans), min(span[1] for span in spans)
    if low > high:
        raise InputError("average: the spectra have no common frequency")
    return per_decade(10, low, high)


def _at(name: str, g: Modulus, omega: Array) -> NDArray[np.complex128]:
    """Return G* at ``omega``, from the model if this is not the grid of the result."""
    if isinstance(g, ComplexModulus) and np.array_equal(g.omega, omega):
        return g.values
    model = g.model if isinstance(g, ComplexModulus) else g
    if model is None or omega.min() < model.span[0] or omega.max() > model.span[1]:
        raise InputError(f"average: {name} is not known on this grid")
    return model(omega)
