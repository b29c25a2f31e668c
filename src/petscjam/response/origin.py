"""Results: their origin, the metadata of their fields, and whether the packing is a solid.

Axes: w frequency.
"""

from __future__ import annotations

from argparse import ArgumentParser
from collections.abc import Callable
from dataclasses import dataclass, field
from typing import Any, ClassVar

import numpy as np
from numpy.typing import ArrayLike

from petscjam.base.errors import InputError
from petscjam.base.ranges import OMEGA
from petscjam.base.types import Array
from petscjam.rows.damping import DampingLaw


def frequencies(omegas: ArrayLike, *, empty: bool = False) -> Array:
    """Return frequencies as an array.

    Parameters
    ----------
    omegas : array_like
        1/τ1.
    empty : bool
        Whether the array may be empty.

    Returns
    -------
    (W,)

    Raises
    ------
    InputError
        If there is none, or one is out of range.
    """
    omega = np.atleast_1d(np.asarray(omegas, dtype=float)).ravel()
    if omega.size == 0 and not empty:
        raise InputError("omega: the range is empty")
    for value in omega[~((omega >= OMEGA.low) & (omega <= OMEGA.high))]:
        OMEGA.check("omega: frequencies", float(value))
    return omega


def stored(unit: str = "", axes: str = "", *, finite: bool = False, words: tuple[str, ...] = ()) -> dict[str, Any]:
    """Return the metadata of a field of a result: its unit in the file, and the checks on reading.

    Parameters
    ----------
    unit : str
        As ``"stress*tau1"``. Default: none, or given in the docstring.
    axes : str
        As ``"W 2"`` (:func:`petscjam.base.files.check_shapes`). Default: not checked.
    finite : bool
        Whether NaN and infinity are refused.
    words : tuple of str
        The values of a text. Default: any.
    """
    return {"unit": unit, "axes": axes, "finite": finite, "words": words}


@dataclass(frozen=True)
class Origin:
    """The packing of a result, the damping law, and the terms of K.

    Attributes
    ----------
    name, checksum : str
    particles, rattlers : int
    phi, pressure, Z : float
        Packing fraction, pressure (stress), contacts of a disk of the backbone.
    potential : str
    diameter : float or None
        Mean diameter, length; None in older files, as the next two.
    balanced : bool or None
        Whether the forces on every disk balance.
    net_force : float or None
        Largest net force on a disk, p·d.
    prestress : bool
        Whether the second term of BT eq. 4 is kept.
    strain : str or None
        Mode of deformation; None if the result does not depend on it. The same for ``damping``.
    damping : DampingLaw or None
    versions : str or None
        Of petscjam and PETSc.
    """

    name: str
    checksum: str
    particles: int
    phi: float
    pressure: float
    Z: float
    rattlers: int
    potential: str
    prestress: bool
    diameter: float | None = None
    balanced: bool | None = None
    net_force: float | None = None
    strain: str | None = None
    damping: DampingLaw | None = None
    versions: str | None = None


@dataclass(frozen=True, eq=False)
class Result:
    """A result of one packing. Each field of a kind of result has metadata (:func:`stored`).

    Attributes
    ----------
    origin : Origin
    notes : tuple of str
        Quantities that could not be computed, and the reasons.
    settings : tuple of str
        Which of ``strain`` and ``damping`` this kind depends on.
    units : str
        Those of the table of this kind.
    figure : str
        ``module:function`` that draws results, by their names, on a figure of matplotlib and returns it; or this
        function as a static method. Empty: no figure.
    exports : str
        ``module:function`` that writes a result for other programs, like :func:`petscjam.export_rheology`.
    """

    origin: Origin
    notes: tuple[str, ...] = field(default=(), kw_only=True)
    settings: ClassVar[tuple[str, ...]] = ()
    units: ClassVar[str] = ""
    figure: ClassVar[Any] = ""
    exports: ClassVar[str] = ""

    def row(self) -> dict[str, float | str]:
        """Return its line of the table, by the heads of the columns."""
        return {}

    @property
    def prestress(self) -> bool:
        """Whether the second term of BT eq. 4 is kept."""
        return self.origin.prestress

    @property
    def strain(self) -> str:
        """Mode of deformation."""
        assert self.origin.strain is not None
        return self.origin.strain

    @property
    def damping(self) -> DampingLaw:
        """Viscous force law."""
        assert self.origin.damping is not None
        return self.origin.damping


@dataclass(frozen=True, eq=False)
class Judged(Result):
    """A result from which the stability of its packing follows: by G0, the modes of K and the balance of forces.

    Attributes
    ----------
    negative_modes, zero_modes : int or None
        Number of such eigenvalues of K on the pinned backbone; None if unknown, with the reason in a note.
    """

    negative_modes: int | None
    zero_modes: int | None

    @property
    def state(self: Any) -> str:
        """``stable``, or the criteria that are violated, or those that are unknown.

        It is stable if G0 > 0 beyond rounding, K has neither negative nor zero modes and, with pre-stress,
        the forces balance: a linear response starts from an equilibrium. Without pre-stress contacts are springs
        at rest, which are always in equilibrium.
        """
        G0 = np.nan if self.G0 is None else self.G0
        faults = ["G0 < 0"] * (G0 < 0) + ["G0 = 0"] * (G0 == 0)
        unknown = ["G0"] * bool(np.isnan(G0))
        for kind, count in (("negative modes", self.negative_modes), ("zero modes", self.zero_modes)):
            faults += [f"{count} {kind}"] * bool(count)
            unknown += [kind] * (count is None)
        balanced = self.origin.balanced if self.prestress else True  # unknown in older files
        if faults:
            return f"UNSTABLE: {', '.join(faults + ['not in balance'] * (balanced is False))}"
        if balanced is False:
            return "NOT IN BALANCE"
        unknown += ["balance"] * (balanced is None)
        return f"UNKNOWN: {', '.join(unknown)}" if unknown else "stable"

    @property
    def stable(self) -> bool:
        """Whether ``state`` is ``stable``."""
        return self.state == "stable"


@dataclass(frozen=True)
class Verb:
    """The verb of an analysis of packings, ``VERB`` in its module.

    Attributes
    ----------
    analyse : callable or str
        The function, or its ``module:name``: ``analyse(packing, **options, prestress=…, comm=…, name=…,
        progress=…)``, with ``strain`` and ``damping`` if these are ``settings`` of its result.
    output : str
        Content of the file.
    options : callable
        Adds its options to a parser. The ``dest`` of each is an argument of the function; that of an option that
        selects another function, ``module:name``, is ``analyse``.
    laws : str
        The option that selects such a function, if only that function takes damping laws.
    stressed : bool
        Whether the contacts always have their forces: no option leaves pre-stress out.
    """

    analyse: Callable[..., Result] | str
    output: str
    options: Callable[[ArgumentParser], Any] = lambda parser: None
    laws: str = ""
    stressed: bool = False
