"""Results: where they come from, what their fields mean, and whether the packing is a solid.

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
        Whether there may be none.

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


def stored(unit: str = "", axes: str = "", *, finite: bool = False) -> dict[str, Any]:
    """Return the metadata of a field of a result: what its file says of it, and what is checked on reading.

    Parameters
    ----------
    unit : str
        As ``"stress*tau1"``. Left out: none, or the docstring gives it.
    axes : str
        As ``"W 2"`` (:func:`petscjam.base.files.check_shapes`). Left out: not checked.
    finite : bool
        Whether NaN and infinity are refused.
    """
    return {"unit": unit, "axes": axes, "finite": finite}


@dataclass(frozen=True)
class Origin:
    """The packing of a result, and the law and terms that were asked for.

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
        Mode of deformation; None where it does not matter, as the law.
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
    """What is found of one packing. Each field of a kind of result says what it is (:func:`stored`).

    Attributes
    ----------
    origin : Origin
    notes : tuple of str
        What could not be found, and why.
    settings : tuple of str
        Which of ``strain`` and ``damping`` matter for this kind.
    units : str
        Those of the table of this kind.
    figure : str
        ``module:function`` that draws results, by their names, on a figure of matplotlib and returns it; or
        this function, as a static method. Empty: there is no picture.
    exports : str
        ``module:function`` that writes a result for other programs, as :func:`petscjam.export_rheology` does.
    """

    origin: Origin
    notes: tuple[str, ...] = field(default=(), kw_only=True)
    settings: ClassVar[tuple[str, ...]] = ()
    units: ClassVar[str] = ""
    figure: ClassVar[Any] = ""
    exports: ClassVar[str] = ""

    def row(self) -> dict[str, float | str]:
        """Return what the table shows of it, by the heads of the columns."""
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
    """A result that tells whether its packing is a solid, by G0, the modes of K and the balance of forces.

    Attributes
    ----------
    negative_modes, zero_modes : int or None
        Such eigenvalues of K on the pinned backbone; None where a note says why.
    """

    negative_modes: int | None
    zero_modes: int | None

    @property
    def state(self: Any) -> str:
        """``stable``, or what the packing lacks for that, or what is not known.

        It is stable if G0 > 0 beyond rounding, K has neither negative nor zero modes and, with pre-stress,
        the forces balance: a linear response starts from an equilibrium. Without pre-stress contacts are
        springs at rest, which are in one anywhere.
        """
        G0 = np.nan if self.G0 is None else self.G0
        faults = ["G0 < 0"] * (G0 < 0) + ["G0 = 0"] * (G0 == 0)
        unknown = ["G0"] * bool(np.isnan(G0))
        for kind, count in (("negative modes", self.negative_modes), ("zero modes", self.zero_modes)):
            faults += [f"{count} {kind}"] * bool(count)
            unknown += [kind] * (count is None)
        balanced = self.origin.balanced if self.prestress else True  # older files do not tell
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
        What the file holds.
    options : callable
        Adds its options to a parser. The ``dest`` of each is an argument of the function; that of an option
        that takes another function, ``module:name``, is ``analyse``.
    laws : str
        The option that takes such a function, if damping laws go with that one alone.
    """

    analyse: Callable[..., Result] | str
    output: str
    options: Callable[[ArgumentParser], Any] = lambda parser: None
    laws: str = ""
