"""Results: their origin, the metadata of their fields, and whether the packing is a solid.

Axes: w frequency.
"""

from __future__ import annotations

from argparse import ArgumentParser
from collections.abc import Callable, Iterator
from dataclasses import Field, dataclass, field, fields
from typing import TYPE_CHECKING, Any, ClassVar

import numpy as np
from numpy.typing import ArrayLike

from petscjam.base.errors import InputError
from petscjam.base.ranges import OMEGA
from petscjam.base.tables import Table, Tabular, optional
from petscjam.base.types import Array, numbers
from petscjam.rows.damping import DampingLaw

if TYPE_CHECKING:
    import xarray


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
    omega = numbers("omega", omegas)
    if omega.size == 0 and not empty:
        raise InputError("omega: the range is empty")
    for value in omega[~((omega >= OMEGA.low) & (omega <= OMEGA.high))]:
        OMEGA.check("omega: frequencies", float(value))
    return omega


def stored(
    unit: str = "", axes: str = "", *, finite: bool = False, words: tuple[str, ...] = (), parts: tuple[str, ...] = ()
) -> dict[str, Any]:
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
    parts : tuple of str
        Columns of the flat table for real and imaginary part, or for the entries of an axis of fixed length. Default:
        the name with ``real`` and ``imag``, or with numbers from 1.
    """
    return {"unit": unit, "axes": axes, "finite": finite, "words": words, "parts": parts}


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
class Result(Tabular):
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
    lines : str
        Axes of the flat table, as ``"A W"``: it has a line for each of their points. Default: the axes of the first
        array.
    """

    origin: Origin
    notes: tuple[str, ...] = field(default=(), kw_only=True)
    settings: ClassVar[tuple[str, ...]] = ()
    units: ClassVar[str] = ""
    figure: ClassVar[Any] = ""
    exports: ClassVar[str] = ""
    lines: ClassVar[str] = ""

    def row(self) -> dict[str, float | str]:
        """Return its line of the table, by the heads of the columns."""
        return {}

    def facts(self) -> dict[str, Any]:
        """Return the packing, the settings and the line of the table, by name."""
        p = self.origin
        facts: dict[str, Any] = {"packing": p.name, "disks": p.particles, "pressure": p.pressure}
        facts |= {"strain": p.strain} if p.strain else {}
        facts |= {"law": p.damping} if p.damping else {}
        return {**facts, "pre-stress": p.prestress, **self.row()}

    def flat(self) -> Table:
        """Return a line for each point of the axes ``lines``, with the packing and the settings on each line.

        Arrays with other axes are left out: :meth:`to_xarray` has them.
        """
        p, columns = self.origin, dict[str, Any]()
        arrays = [item for item in self._arrays() if getattr(self, item.name) is not None]
        said, sizes = self.lines or next((item.metadata["axes"] for item in arrays), ""), self._sizes()
        axes = [axis for axis in said.split() if axis in sizes]
        shape = tuple(sizes[axis] for axis in axes)
        for key, value in _described(p).items():
            columns[key] = np.full(shape, value, dtype=object if isinstance(value, str) or value is None else None)
        units = {"pressure": "stress", "net_force": "pressure*diameter", "diameter": "length"}
        for item in fields(self):
            value, own = getattr(self, item.name), item.metadata.get("axes", "").split()
            free = [k for k, axis in enumerate(own) if axis.isdigit()]
            named = [axis for axis in own if not axis.isdigit()]
            if isinstance(value, float | int | str) or (value is not None and own and set(named) <= set(axes)):
                for name, part in _parts(item, value, free):
                    columns[name] = np.broadcast_to(_aligned(part, named, axes), shape)
                    units[name] = item.metadata.get("unit", "")
        if isinstance(self, Judged):
            columns["state"] = np.full(shape, self.state, dtype=object)
        return Table({name: values.ravel() for name, values in columns.items()}, units)

    def to_xarray(self) -> xarray.Dataset:
        """Return all arrays as a Dataset of xarray, with units; the attributes are the packing and the settings.

        An axis has the name of the array that has no other axis, or else a letter as in the docstring of the class.

        Raises
        ------
        MissingError
            Without xarray.
        """
        xr, sizes = optional("xarray", "tables"), self._sizes()
        arrays = [item for item in self._arrays() if getattr(self, item.name) is not None]
        names = {axis: axis for axis in sizes}
        for item in reversed(arrays):
            if item.metadata["axes"] in sizes:
                names[item.metadata["axes"]] = item.name
        found: dict[str, Any] = {}
        for item in arrays:
            axes = item.metadata["axes"].split()
            dims = [names.get(axis, f"{item.name}_{k}") for k, axis in enumerate(axes)]
            dims = [f"{dim}_{k}" if dim in dims[:k] else dim for k, dim in enumerate(dims)]
            found[item.name] = (dims, np.asarray(getattr(self, item.name)), {"units": item.metadata["unit"]})
        attributes = {key: value for key, value in _described(self.origin).items() if value is not None}
        for item in fields(self):
            if isinstance(getattr(self, item.name), float | int | str):
                attributes[item.name] = getattr(self, item.name)
        return xr.Dataset(found, attrs=attributes)

    def _sizes(self) -> dict[str, int]:
        arrays = [(getattr(self, item.name), item.metadata["axes"].split()) for item in self._arrays()]
        return {
            axis: size
            for value, axes in arrays
            if value is not None
            for axis, size in zip(axes, np.shape(value), strict=True)
            if not axis.isdigit()
        }

    def _arrays(self) -> list[Field[Any]]:
        return [item for item in fields(self) if item.metadata.get("axes")]

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


def _described(origin: Origin) -> dict[str, Any]:
    """Return packing and settings by the names of the columns, the law with its numbers."""
    found = {item.name: getattr(origin, item.name) for item in fields(origin) if item.name != "damping"}
    if origin.damping is not None:
        found |= {"law": origin.damping.name, **origin.damping.settings}
    return found


def _parts(item: Field[Any], value: Any, free: list[int]) -> Iterator[tuple[str, Any]]:
    """Yield the columns of a field: one for each entry of the ``free`` axes, and for real and imaginary part."""
    value = np.asarray(value) if free or not isinstance(value, str) else value
    if free:
        entries = list(np.ndindex(*(value.shape[k] for k in free)))
        parts = item.metadata["parts"] or [f"{item.name}_{'_'.join(str(n + 1) for n in entry)}" for entry in entries]
        pieces = [np.moveaxis(value, free, range(len(free)))[entry] for entry in entries]
    else:
        parts, pieces = [item.name], [value]
    for name, piece in zip(parts, pieces, strict=True):
        if np.iscomplexobj(piece):
            both = () if free else item.metadata["parts"]
            yield from zip(both or (f"{name}_real", f"{name}_imag"), (piece.real, piece.imag), strict=True)
        else:
            yield name, piece


def _aligned(values: Any, own: list[str], axes: list[str]) -> Any:
    """Return ``values`` with axes ``own`` with an axis for each of ``axes``, in their order."""
    order = [own.index(axis) for axis in axes if axis in own]
    array = np.asarray(values, dtype=object if isinstance(values, str) else None)
    return array.transpose(order).reshape([array.shape[own.index(a)] if a in own else 1 for a in axes])


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
