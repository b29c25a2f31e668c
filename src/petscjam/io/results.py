"""Results in HDF5: one group for each packing, added one by one, so that a killed run can be resumed."""

from __future__ import annotations

from ast import literal_eval
from collections.abc import Iterable, Mapping
from contextlib import suppress
from dataclasses import Field, fields
from os import PathLike, path
from typing import TYPE_CHECKING, Any, NamedTuple

import numpy as np

from petscjam.base.errors import InputError, shown
from petscjam.base.files import atomic_h5, check_output, check_shapes, check_type, marked, open_h5
from petscjam.base.types import Array, per_decade
from petscjam.geometry.box import Box
from petscjam.geometry.packing import Packing
from petscjam.io.kinds import KINDS, PREFIX, SPECTRUM, class_of, kind_of
from petscjam.response.inertial import InertialSpectrum
from petscjam.response.origin import Judged, Origin, Result
from petscjam.response.result import ComplexModulus
from petscjam.response.spectrum import Spectrum
from petscjam.rows.damping import FOREIGN, LAWS, DampingLaw, StoredLaw, as_stored
from petscjam.rows.kinematics import strain_mode

if TYPE_CHECKING:
    import h5py

SCHEMA = 2
SETTINGS = ("strain", "damping", "prestress")
ORIGIN = tuple(item.name for item in fields(Origin) if item.name not in (*SETTINGS, "versions"))  # group `packing`


def _formats() -> list[str]:
    return [PREFIX + kind for kind in KINDS]


def group_name(packing: Packing, name: str) -> str:
    """Return the group of a packing: its name and the start of its checksum.

    Parameters
    ----------
    packing : Packing
    name : str
    """
    return f"{name}-{packing.checksum[:8]}"


def append_result(
    result: Result, file: str | PathLike[str], group: str, *, fresh: bool = False, run: str = "", made_with: str = ""
) -> None:
    """Add ``result``, of one of the ``KINDS``, to ``file`` as ``group``; the file is complete at every moment.

    With ``fresh`` it replaces the content of the file. ``run`` identifies the last writer, ``made_with`` the
    settings of the result.

    Parameters
    ----------
    result : Result
        Of one of the ``KINDS``.
    file : str or PathLike
    group : str
    fresh : bool
        Whether it replaces the content of the file.
    run : str
        Who wrote last.
    made_with : str
        The call that made the result.

    Raises
    ------
    InputError
        If the file cannot be read or written, or contains results of another kind.
    """
    kind = PREFIX + kind_of(type(result))
    with atomic_h5(file, existing=path.exists(file) and not fresh) as h5:
        there = marked(h5)[0]
        if "format" in h5.attrs and there != kind:
            raise InputError(f"{file}: holds {there!r}, not {kind!r}")
        h5.attrs.update(format=kind, schema=SCHEMA, run=run)
        node = h5.create_group(group)
        node.attrs["made_with"] = made_with
        _write_fields(node, result)
        if isinstance(result, Judged):  # for other readers
            node.attrs.update(stable=result.stable, state=result.state)


def run_of(file: str | PathLike[str]) -> str | None:
    """Return the run that wrote last to ``file``; None if it is unknown."""
    with suppress(InputError), open_h5(file) as h5:
        return h5.attrs.get("run")
    return None


def read_results(file: str | PathLike[str]) -> dict[str, Any]:
    """Return every result of ``file`` by the name of its group: all of one of the ``KINDS``.

    Raises
    ------
    InputError
        If the file is missing, damaged, or holds no results.
    """
    with open_h5(file) as h5:
        kind, schema = marked(h5)
        if kind == SPECTRUM and schema == SCHEMA:
            model = _read_model(h5)
            return {model.origin.name: ComplexModulus.sampled(model, per_decade(10, *model.span))}
        if kind is None or kind not in _formats() or schema != SCHEMA:
            raise InputError(f"holds {kind!r} with schema {schema}, not results with schema {SCHEMA}")
        made = class_of(kind.removeprefix(PREFIX))
        return {name: made(**_values(node, made)) for name, node in h5.items()}


class Item(NamedTuple):
    """Packing and settings of a result; ``made_with`` is empty for moduli."""

    name: str
    made_with: str
    checksum: str
    damping: str
    prestress: bool


def inventory(file: str | PathLike[str]) -> list[Item]:
    """Return packing and settings of each result of ``file``, without reading the result.

    Raises
    ------
    InputError
        If the file is missing, damaged, or holds no results.
    """
    with open_h5(file) as h5:
        kind, schema = marked(h5)
        if kind not in _formats() or schema != SCHEMA:
            raise InputError(f"holds {shown(kind)}, not results")
        items = []
        for name, node in h5.items():
            origin = _origin(node)
            said = str(origin.damping), origin.prestress
            items.append(Item(name, node.attrs["made_with"], origin.checksum, *said))
        return items


def read_moduli(file: str | PathLike[str]) -> dict[str, ComplexModulus]:
    """Return every result of ``file`` by the name of its group.

    A file of :func:`write_spectrum` gives one, with ten frequencies per decade.

    Raises
    ------
    InputError
        If the file is missing, damaged, or not one of moduli.
    """
    results = read_results(file)
    for g in results.values():
        if not isinstance(g, ComplexModulus):
            raise InputError(f"{file}: holds results of another kind ({type(g).__name__}), not moduli")
    return results


def read_modulus(file: str | PathLike[str]) -> ComplexModulus:
    """Return the one result of ``file``; :func:`read_moduli` returns several.

    Raises
    ------
    InputError
        If the file is missing, damaged, not one of moduli, or holds more than one result.
    """
    results = list(read_moduli(file).values())
    if len(results) != 1:
        raise InputError(f"{file}: holds {len(results)} results; read them with read_moduli")
    return results[0]


def done(
    file: str | PathLike[str],
    laws: Iterable[Mapping[str, Any]],
    omega: Array,
    kept: Array,
    rtol: float | None,
    mass: float | None,
) -> set[tuple[str, str, bool]]:
    """Return checksum, damping and pre-stress of the results in ``file``, if they were made with these settings.

    Parameters
    ----------
    laws : iterable of mappings
        Strain, damping and pre-stress of this run.
    omega, kept : arrays
        Frequencies, and those at which displacements are stored.
    rtol : float or None
        Of the reduced model; None for direct solves.
    mass : float or None
        Of every disk.

    Raises
    ------
    InputError
        If they were made with other settings.
    """
    laws, there = list(laws), set()
    for name, g in read_moduli(file).items():
        own = {"strain": g.strain, "damping": str(g.damping), "prestress": g.prestress}
        reason = None
        if own not in laws:
            other = next((key for key in SETTINGS if all(own[key] != law[key] for law in laws)), "damping")
            reason = f"with {other} = {own[other]}, not {laws[0][other]}"
        elif (g.model is None) != (rtol is None):
            reason = "with " + ("one solve a frequency" if g.model is None else "the reduced model")
        elif g.model is not None and rtol is not None and g.model.rtol > rtol:
            reason = f"with rtol = {g.model.rtol:g}, not {rtol:g}"
        elif not (mass is None if g.mass is None else (g.mass == mass).all()):
            reason = f"with {g.inertia or 'no mass'}, not {'none' if mass is None else f'{mass:g}'}"
        elif not np.array_equal(g.omega, omega):
            reason = "at other frequencies (omega)"
        elif not np.array_equal(g.field_omega, kept):
            reason = "with other frequencies kept (fields)"
        if reason:
            raise InputError(f"{file}: {name} was made {reason}; it cannot be resumed")
        there.add((g.origin.checksum, str(g.damping), g.prestress))
    return there


def write_spectrum(model: Spectrum, file: str | PathLike[str], *, overwrite: bool = False) -> None:
    """Write a reduced model: a small file, unless the model has displacements.

    Parameters
    ----------
    model : Spectrum
    file : str or PathLike
    overwrite : bool

    Raises
    ------
    InputError
        If the file exists and ``overwrite`` is not set, or cannot be written.
    """
    check_output(file, overwrite=overwrite)
    with atomic_h5(file) as h5:
        h5.attrs.update(format=SPECTRUM, schema=SCHEMA)
        _write_fields(h5, model)


def read_spectrum(file: str | PathLike[str]) -> Spectrum:
    """Return the reduced model of a file of :func:`write_spectrum`, or the one in a file of moduli.

    Raises
    ------
    InputError
        If the file is missing, damaged, or holds no reduced model, or several.
    """
    with open_h5(file) as h5:
        if marked(h5) == (SPECTRUM, SCHEMA):
            return _read_model(h5)
    model = read_modulus(file).model
    if model is None:
        raise InputError(f"{file}: was made with one solve for each frequency; it holds no reduced model")
    return model


def _write_fields(node: h5py.Group, result: Result) -> None:
    for item in fields(result):
        _write(node, item.name, getattr(result, item.name), item.metadata.get("unit"))


def _write(node: h5py.Group, name: str, value: object, unit: str | None = None) -> None:
    if isinstance(value, np.ndarray):
        node[name] = value
        if unit:
            node[name].attrs["unit"] = unit
    elif isinstance(value, Origin):
        node.create_group("packing").attrs.update(
            {key: getattr(value, key) for key in ORIGIN if getattr(value, key) is not None}
        )
        for key in (*SETTINGS, "versions"):
            _write(node, key, getattr(value, key))
    elif isinstance(value, dict):
        node.create_group(name).attrs.update(value)
    elif isinstance(value, Packing):
        geometry = node.create_group(name)
        geometry["positions"], geometry["radii"] = value.positions, value.radii
        geometry["cell"] = value.box.cell
        geometry.attrs["potential"] = value.potential_name
    elif isinstance(value, Spectrum):
        _write_fields(node.create_group(name), value)
    elif isinstance(value, DampingLaw):
        stored = as_stored(value)
        node.create_group(name).attrs.update(
            {"law": value.name, **value.settings, **({FOREIGN: stored} if stored else {})}
        )
    elif isinstance(value, tuple) and all(isinstance(line, str) for line in value):
        node.attrs[name] = "\n".join(value)
    elif value is not None:
        node.attrs[name] = value
        if unit:
            node.attrs[f"{name} unit"] = unit


def _read_model(node: h5py.Group) -> Spectrum:
    kind = InertialSpectrum if "M" in node else Spectrum
    values = _values(node, kind)
    if "rounding_only" not in node.attrs:  # an older file: it has no error bound if the residual is a rounding error
        values["rounding_only"] = False
        values["definite"] &= bool(values["gains"].any() or values["estimate"])
    pairs = {name: tuple(values[name].tolist()) for name in ("span", "forcing", "affine")}
    return kind(**{**values, **pairs})


def _values(node: h5py.Group, kind: type[Result]) -> dict[str, Any]:
    there = {*node, *node.attrs, "origin", "rounding_only"}
    if missing := {item.name for item in fields(kind) if item.name not in there and not _may_be_none(item)}:
        raise InputError(f"{node.name} lacks {', '.join(sorted(missing))}")
    values = {item.name: _value(node, item) for item in fields(kind)}
    for key in kind.settings:
        if getattr(values["origin"], key) is None:
            raise InputError(f"{node.name} lacks {key}")
    _check(node.name, kind, values)
    return values


def _check(where: str, kind: type[Result], values: Mapping[str, Any]) -> None:
    """Refuse values of another type or shape than ``kind`` has, or that are not finite."""
    for item in fields(kind):
        value = values[item.name]
        check_type(f"{where}: {item.name}", value, str(item.type))
        if item.metadata.get("finite") and value is not None and not np.isfinite(value).all():
            raise InputError(f"{where}: {item.name} is not finite")
        if (words := item.metadata.get("words")) and value not in words:
            raise InputError(f"{where}: {item.name} is {shown(value)}, not one of {', '.join(words)}")
    axes = {item.name: item.metadata.get("axes") for item in fields(kind)}
    check_shapes(where, {name: text for name, text in axes.items() if text}, values)


def _may_be_none(item: Field[Any]) -> bool:
    return "None" in str(item.type)


def _value(node: h5py.Group, item: Field[Any]) -> Any:
    if item.name == "origin":
        return _origin(node)
    if item.name not in node:
        value = _plain(node.attrs.get(item.name))
        if item.type == "float" and isinstance(value, int):
            return float(value)
        return tuple(value.splitlines()) if str(item.type).startswith("tuple[str") else value
    inside = node[item.name]
    if item.name == "model":
        return _read_model(inside)
    if item.name == "geometry":
        cell, potential = Box(inside["cell"][()]), inside.attrs["potential"]
        return Packing(inside["positions"][()], inside["radii"][()], cell, potential)
    if not hasattr(inside, "keys"):
        return inside[()]
    return {key: _plain(value) for key, value in inside.attrs.items()}


def _origin(node: h5py.Group) -> Origin:
    packing = {key: value for key, value in node["packing"].attrs.items() if key in ORIGIN}
    settings = {key: node.attrs[key] for key in ("strain", "prestress", "versions") if key in node.attrs}
    values = {key: _plain(value) for key, value in {**packing, **settings}.items()}
    law = node["damping"] if "damping" in node else node.attrs.get("damping")
    values["damping"] = None if law is None else _law(law)
    for item in fields(Origin):
        if item.name not in values and not _may_be_none(item):
            raise InputError(f"{node.name}: packing lacks {item.name}")
        check_type(f"{node.name}: {item.name} of the packing", values.get(item.name), str(item.type))
    if "strain" in values:
        strain_mode(values["strain"])
    return Origin(**values)


def _law(said: Any) -> DampingLaw:
    """Return the law of a group, or of the text in older files of moduli."""
    if isinstance(said, str):
        name, _, rest = said.rstrip(")").partition(" (")
        settings = {key: literal_eval(value) for key, value in (pair.split("=") for pair in rest.split(", ") if pair)}
    else:
        settings = {key: _plain(value) for key, value in said.attrs.items()}
        name, foreign = settings.pop("law"), settings.pop(FOREIGN, "")
        if name not in LAWS and foreign:
            return StoredLaw.read(name, foreign)
    if name not in LAWS:
        raise InputError(f"the law {shown(name)} is unknown; known are {', '.join(LAWS)}")
    law = LAWS[name](**settings)
    for item in fields(law):
        check_type(f"damping: {item.name}", getattr(law, item.name), str(item.type))
    return law


def _plain(value: Any) -> Any:
    return value.item() if isinstance(value, np.generic) else value
