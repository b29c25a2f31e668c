"""Results in HDF5: one group a packing, added one by one, so that a killed run can go on."""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from contextlib import suppress
from dataclasses import Field, asdict, fields
from os import PathLike, path
from typing import Any, NamedTuple

import numpy as np

from petscjam.analysis.correlations import Correlations
from petscjam.analysis.density import DensityOfStates
from petscjam.analysis.drag import NonlinearModulus
from petscjam.analysis.nonaffine import QuasistaticResponse
from petscjam.analysis.rebuilt import Rebuilt
from petscjam.analysis.viscosity import Viscosity
from petscjam.base.errors import InputError, shown
from petscjam.base.files import atomic_h5, check_output, check_shapes, check_type, h5_format, open_h5
from petscjam.base.types import Array, per_decade
from petscjam.geometry.box import Box
from petscjam.geometry.packing import Packing
from petscjam.response.modes import Modes
from petscjam.response.relaxations import RelaxationModes
from petscjam.response.result import ComplexModulus
from petscjam.response.spectrum import Spectrum
from petscjam.rows.damping import LAWS, DampingLaw
from petscjam.rows.kinematics import strain_mode

FORMAT, FORMAT_MODEL, SCHEMA = "petscjam moduli", "petscjam spectrum", 2
KINDS: dict[str, type] = {
    FORMAT: ComplexModulus,
    "petscjam nonaffine": QuasistaticResponse,
    "petscjam viscosity": Viscosity,
    "petscjam modes": Modes,
    "petscjam relaxations": RelaxationModes,
    "petscjam rebuilt": Rebuilt,
    "petscjam density": DensityOfStates,
    "petscjam correlations": Correlations,
    "petscjam drag": NonlinearModulus,
}
UNITS = {
    "omega": "1/tau1",
    "values": "stress",
    "residuals": "1",
    "power_balance": "1",
    "G0": "stress",
    "eta0": "stress*tau1",
    "G_inf": "stress",
    "eta_inf": "stress*tau1",
    "field_omega": "1/tau1",
    "fields": "length per unit strain",
    "nodes": "1/tau1",
    "span": "1/tau1",
    "motions": "length per unit strain",
    "parallel": "length per unit strain",
    "transverse": "length per unit strain",
    "nonaffine": "length per unit strain",
    "shear_modulus": "stress",
    "eigenvalues": "stress",
    "softening": "stress",
    "G_affine": "stress",
    "weights": "stress",
    "times": "tau1",
    "delta": "length",
    "L": "length",
    "width": "length",
    "bin": "length",
    "stress": "stress",
    "tau": "tau1",
    "contact_tau": "tau1",
    "stretching": "stress",
    "pre_stress": "stress",
}
OWN_UNITS: dict[type, dict[str, str]] = {  # where a name means something else
    Modes: {"residuals": "stress", "frequencies": "(stress/mass)^1/2"},
    Rebuilt: {
        "frequencies": "(stress/mass)^1/2",
        "medians": "length per unit strain",
        "direct": "length per unit strain",
    },
    DensityOfStates: {"omega": "(stress/mass)^1/2", "edge": "(stress/mass)^1/2"},
}
SETTINGS = ("strain", "damping", "prestress")
ADDED = {"rounding_only": False}  # what older files lack, and what they mean by it
# As check_shapes reads them: F frequencies of fields, C contacts, which there may be none of, …
SHAPES: dict[type, dict[str, str]] = {
    ComplexModulus: {
        "omega": "W",
        "values": "W",
        "residuals": "W",
        "power_balance": "W",
        "errors": "W",
        "part_errors": "2 W",
        "limit_residuals": "2",
        "field_omega": "F",
        "fields": "F N 2",
    },
    Spectrum: {
        "span": "2",
        "K": "M M",
        "B": "M M",
        "residual_K": "R",
        "residual_B": "R",
        "nodes": "F",
        "gains": "F",
        "gain_errors": "F",
        "limits": "2 2",
        "limit_errors": "2 2",
        "forcing": "2",
        "affine": "2",
        "motions": "M N 2",
    },
    QuasistaticResponse: {"parallel": "C", "transverse": "C", "nonaffine": "n 2", "disks": "n", "contacts": "C 2"},
    Viscosity: {},
    Modes: {
        "eigenvalues": "M",
        "vectors": "M n 2",
        "residuals": "M",
        "disks": "n",
        "participation": "M",
        "floppiness": "M",
        "amplitudes": "M",
        "softening": "M",
    },
    RelaxationModes: {"times": "M", "weights": "M", "vectors": "M n 2", "residuals": "M", "disks": "n"},
    Rebuilt: {
        "counts": "K",
        "medians": "3 K",
        "direct": "3",
        "frequencies": "M",
        "floppiness": "M",
        "participation": "M",
        "softening": "M",
    },
    DensityOfStates: {
        "omega": "W",
        "density": "W",
        "error": "W",
        "cumulative": "W",
        "resolution": "W",
        "moments": "V M",
    },
    Correlations: {
        "omega": "W",
        "delta": "D",
        "real": "W D",
        "imaginary": "W D",
        "pairs": "D",
        "G": "W",
        "errors": "W",
    },
    NonlinearModulus: {
        "omega": "W",
        "values": "W",
        "tau": "W",
        "spread": "W",
        "iterations": "W",
        "converged": "W",
        "changes": "W",
        "tau_changes": "W",
        "residuals": "W",
        "errors": "W",
        "contact_tau": "W C",
    },
}
FINITE = {  # the others may be NaN
    "omega",
    "values",
    "field_omega",
    "span",
    "rtol",
    "K",
    "B",
    "residual_K",
    "residual_B",
    "nodes",
    "forcing",
    "affine",
    "area",
    "pressure",
    "delta",
    "G",
    "L",
    "width",
    "bin",
    "density",
    "cumulative",
    "resolution",
    "moments",
    "edge",
    "stress",
    "alpha",
    "parallel",
    "transverse",
    "nonaffine",
    "eigenvalues",
    "vectors",
    "times",
    "weights",
    "medians",
    "direct",
    "frequencies",
    "participation",
}
PACKING = {
    "name": "str",
    "checksum": "str",
    "particles": "int",
    "phi": "float",
    "pressure": "float",
    "Z": "float",
    "rattlers": "int",
}
DERIVED = ("stable", "state")  # written for other readers, never read back


def group_name(packing: Packing, name: str) -> str:
    """Return the group of a packing: its name and the start of its checksum."""
    return f"{name}-{packing.checksum[:8]}"


def append_result(
    result: Any, file: str | PathLike[str], group: str, *, fresh: bool = False, run: str = "", made_with: str = ""
) -> None:
    """Add ``result``, one of ``KINDS``, to ``file`` as ``group``; the file is whole at every moment.

    With ``fresh`` it replaces whatever the file held. ``run`` tells who wrote last, ``made_with`` how
    the result was made.

    Raises
    ------
    InputError
        If the file cannot be read or written, or holds results of another kind.
    """
    kind = next(name for name, known in KINDS.items() if type(result) is known)
    with atomic_h5(file, existing=path.exists(file) and not fresh) as h5:
        there = h5.attrs.get("format", kind)
        if there != kind:
            raise InputError(f"{file}: holds {there!r}, not {kind!r}")
        h5.attrs.update(format=kind, schema=SCHEMA, run=run)
        node = h5.create_group(group)
        node.attrs["made_with"] = made_with
        for item in fields(result):
            _write(node, item.name, getattr(result, item.name), OWN_UNITS.get(type(result), {}))
        for name in DERIVED:
            if hasattr(result, name):
                node.attrs[name] = getattr(result, name)


def run_of(file: str | PathLike[str]) -> str | None:
    """Return which run wrote last to ``file``; None if that is not known."""
    with suppress(InputError), open_h5(file) as h5:
        return h5.attrs.get("run")
    return None


def is_result(file: str | PathLike[str]) -> bool:
    """Tell whether ``file`` holds results rather than a packing."""
    return h5_format(file) in (*KINDS, FORMAT_MODEL)


def read_results(file: str | PathLike[str]) -> dict[str, Any]:
    """Return every result of ``file`` by the name of its group: all of one of ``KINDS``.

    Raises
    ------
    InputError
        If the file is missing, damaged, or holds no results.
    """
    with open_h5(file) as h5:
        kind, schema = h5.attrs.get("format"), h5.attrs.get("schema")
        if kind == FORMAT_MODEL and schema == SCHEMA:
            model = _read_model(h5)
            return {model.packing["name"]: ComplexModulus.sampled(model, per_decade(10, *model.span))}
        if kind not in KINDS or schema != SCHEMA:
            raise InputError(f"holds {kind!r} with schema {schema}, not results with schema {SCHEMA}")
        return {name: KINDS[kind](**_values(node, KINDS[kind])) for name, node in h5.items()}


class Item(NamedTuple):
    """What a result was made of and with; ``made_with`` is empty for moduli."""

    name: str
    made_with: str
    checksum: str
    damping: str
    prestress: bool


def inventory(file: str | PathLike[str]) -> list[Item]:
    """Return what each result of ``file`` was made of, without reading it.

    Raises
    ------
    InputError
        If the file is missing, damaged, or holds no results.
    """
    with open_h5(file) as h5:
        if h5.attrs.get("format") not in KINDS or h5.attrs.get("schema") != SCHEMA:
            raise InputError(f"holds {shown(h5.attrs.get('format'))}, not results")
        items = []
        for name, node in h5.items():
            law = _law(node["damping"]) if "damping" in node else node.attrs.get("damping")
            checksum = node["packing"].attrs["checksum"]
            items.append(Item(name, node.attrs["made_with"], checksum, str(law), bool(node.attrs["prestress"])))
        return items


def read_moduli(file: str | PathLike[str]) -> dict[str, ComplexModulus]:
    """Return every result of ``file`` by the name of its group.

    A file of :func:`write_spectrum` gives one, ten frequencies a decade.

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
    file: str | PathLike[str], laws: Iterable[Mapping[str, Any]], omega: Array, kept: Array, rtol: float | None
) -> set[tuple[str, str, bool]]:
    """Return checksum, damping and pre-stress of what ``file`` holds, if it was made with these settings.

    Parameters
    ----------
    laws : iterable of mappings
        Strain, damping and pre-stress that this run would use.
    omega, kept : arrays
        Frequencies, and those at which fields are kept.
    rtol : float or None
        Of the reduced model; None if each frequency is solved for.

    Raises
    ------
    InputError
        If it was made with others.
    """
    laws, there = list(laws), set()
    for name, g in read_moduli(file).items():
        own = {key: getattr(g, key) for key in SETTINGS}
        reason = None
        if own not in laws:
            other = next((key for key in SETTINGS if all(own[key] != law[key] for law in laws)), "damping")
            reason = f"with {other} = {own[other]}, not {laws[0][other]}"
        elif (g.model is None) != (rtol is None):
            reason = "with " + ("one solve a frequency" if g.model is None else "the reduced model")
        elif g.model is not None and rtol is not None and g.model.rtol > rtol:
            reason = f"with rtol = {g.model.rtol:g}, not {rtol:g}"
        elif not np.array_equal(g.omega, omega):
            reason = "at other frequencies (omega)"
        elif not np.array_equal(g.field_omega, kept):
            reason = "with other frequencies kept (fields)"
        if reason:
            raise InputError(f"{file}: {name} was made {reason}; it cannot be resumed")
        there.add((g.packing["checksum"], g.damping, g.prestress))
    return there


def write_spectrum(model: Spectrum, file: str | PathLike[str], *, overwrite: bool = False) -> None:
    """Write a reduced model: a small file, unless it carries its motions.

    Raises
    ------
    InputError
        If the file exists and ``overwrite`` is not set, or cannot be written.
    """
    check_output(file, overwrite=overwrite)
    with atomic_h5(file) as h5:
        h5.attrs.update(format=FORMAT_MODEL, schema=SCHEMA)
        for item in fields(model):
            _write(h5, item.name, getattr(model, item.name))


def read_spectrum(file: str | PathLike[str]) -> Spectrum:
    """Return the reduced model of a file of :func:`write_spectrum`, or the one in a file of moduli.

    Raises
    ------
    InputError
        If the file is missing, damaged, or holds no reduced model, or several.
    """
    with open_h5(file) as h5:
        if (h5.attrs.get("format"), h5.attrs.get("schema")) == (FORMAT_MODEL, SCHEMA):
            return _read_model(h5)
    model = read_modulus(file).model
    if model is None:
        raise InputError(f"{file}: was made with one solve a frequency; it holds no reduced model")
    return model


def _write(node: Any, name: str, value: Any, own: Mapping[str, str] | None = None) -> None:
    unit = {**UNITS, **(own or {})}.get(name)
    if isinstance(value, np.ndarray):
        node[name] = value
        if unit:
            node[name].attrs["unit"] = unit
    elif isinstance(value, dict):
        node.create_group(name).attrs.update(value)
    elif isinstance(value, Packing):
        geometry = node.create_group(name)
        geometry["positions"], geometry["radii"] = value.positions, value.radii
        geometry["cell"] = value.box.cell
        geometry.attrs["potential"] = value.potential_name
    elif isinstance(value, Spectrum):
        model = node.create_group(name)
        for item in fields(value):
            _write(model, item.name, getattr(value, item.name))
    elif isinstance(value, DampingLaw):
        node.create_group(name).attrs.update({"law": value.name, **asdict(value)})
    elif isinstance(value, tuple) and all(isinstance(line, str) for line in value):
        node.attrs[name] = "\n".join(value)
    elif value is not None:
        node.attrs[name] = value
        if unit:
            node.attrs[f"{name} unit"] = unit


def _read_model(node: Any) -> Spectrum:
    values = _values(node, Spectrum)
    if "rounding_only" not in node.attrs and not (values["gains"].any() or values["estimate"]):
        values["definite"] = False  # an older file: where the residual was rounding, it bounds no error
    pairs = {name: tuple(values[name].tolist()) for name in ("span", "forcing", "affine")}
    return Spectrum(**{**values, **pairs})


def _values(node: Any, kind: type) -> dict[str, Any]:
    there = {*node, *node.attrs}
    missing = {item.name for item in fields(kind) if item.name not in there and not _may_be_none(item)}
    if missing - set(ADDED):
        raise InputError(f"{node.name} lacks {', '.join(sorted(missing - set(ADDED)))}")
    values = {item.name: _value(node, item) if item.name in there else ADDED.get(item.name) for item in fields(kind)}
    _check(node.name, kind, values)
    return values


def _check(where: str, kind: type, values: Mapping[str, Any]) -> None:
    """Refuse values of another type or shape than ``kind`` has, or that are not finite."""
    for item in fields(kind):
        value = values[item.name]
        check_type(f"{where}: {item.name}", value, str(item.type))
        if item.name in FINITE and value is not None and not np.isfinite(value).all():
            raise InputError(f"{where}: {item.name} is not finite")
    check_shapes(where, SHAPES[kind], values)
    for name, annotation in PACKING.items():
        if name not in values["packing"]:
            raise InputError(f"{where}: packing lacks {name}")
        check_type(f"{where}: {name} of the packing", values["packing"][name], annotation)
    if "strain" in values:
        strain_mode(values["strain"])


def _may_be_none(item: Field) -> bool:
    return "None" in str(item.type)


def _value(node: Any, item: Field) -> Any:
    if item.name not in node:
        value = _plain(node.attrs[item.name])
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
    if "law" in inside.attrs:
        return _law(inside)
    return {key: _plain(value) for key, value in inside.attrs.items()}


def _law(node: Any) -> DampingLaw:
    settings = {key: _plain(value) for key, value in node.attrs.items()}
    law = LAWS[settings.pop("law")](**settings)
    for item in fields(law):
        check_type(f"{node.name}: {item.name}", getattr(law, item.name), str(item.type))
    return law


def _plain(value: Any) -> Any:
    return value.item() if isinstance(value, np.generic) else value
