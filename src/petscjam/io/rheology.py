"""G*(ω) and G(t) as text for programs of rheology. A new format is one entry of :data:`FORMATS`.

``tts`` and ``gt`` are RepTate's: a line of ``key=value;`` pairs, lines of comment, the names of the columns,
the columns. RepTate calls the units rad/s, s and Pa; here they are 1/τ1, τ1 and the unit of stress of the potential.
"""

from __future__ import annotations

import re
from collections.abc import Callable, Sequence
from os import PathLike

import numpy as np
from numpy.typing import ArrayLike

from petscjam.analysis.statistics import Average
from petscjam.base.errors import InputError
from petscjam.base.files import check_output, write_atomically
from petscjam.base.types import Array, numbers, per_decade
from petscjam.io.exporters import format_of
from petscjam.response.reduced import PLATEAU
from petscjam.response.result import ComplexModulus
from petscjam.response.spectrum import Spectrum

PER_DECADE = 10


def export_rheology(
    model_or_modulus: Spectrum | ComplexModulus,
    path: str | PathLike[str],
    fmt: str,
    *,
    omegas: ArrayLike | None = None,
    times: ArrayLike | None = None,
    overwrite: bool = False,
) -> None:
    """Write G*(ω) or G(t) to ``path`` as text, with 17 digits.

    Parameters
    ----------
    model_or_modulus : Spectrum or ComplexModulus
        A modulus is written at its own frequencies, unless it has a model and ``omegas`` are given.
    path : path
    fmt : str
        ``tts``: ω, G′, G″ for RepTate. ``gt``: t, G(t) for RepTate. ``csv``: ω, G′, G″ and, if they are known,
        the bounds on |ΔG′|/|G′| and |ΔG″|/|G″|.
    omegas : (W,) array_like
        Angular frequencies, 1/τ1. Default: 10 per decade over the span of the model.
    times : (T,) array_like
        Times ≥ 0, τ1. Default: 10 per decade from the inverse of the highest frequency of the span to that of the
        lowest.
    overwrite : bool

    Raises
    ------
    InputError
        If the format is unknown or not that of the extension of ``path``, frequencies or times are invalid or not
        used by this format, the format needs a reduced model and there is none, or ``path`` exists (unless
        ``overwrite``) or cannot be written.
    """
    if format_of(path, fmt, fmt) not in FORMATS:
        raise InputError(f"export: the formats of moduli are {', '.join(FORMATS)}, not {fmt}")
    for name, given, formats in (("omegas", omegas, ("tts", "csv")), ("times", times, ("gt",))):
        if given is not None and fmt not in formats:
            raise InputError(f"{name}: {fmt} has none")
    check_output(path, overwrite=overwrite)
    write_atomically(path, FORMATS[fmt](model_or_modulus, times if fmt == "gt" else omegas))


def tts(source: Spectrum | ComplexModulus, omegas: ArrayLike | None = None) -> bytes:
    """Return ω, G′, G″ as RepTate's application LVE reads them.

    Parameters
    ----------
    source : Spectrum or ComplexModulus
    omegas : array_like, optional
        1/τ1; default: those of ``source``, or an even grid in its span.
    """
    modulus = _sampled(source, omegas)
    lines = [_parameters(modulus, Mw=0, T=0), _setting(modulus), f"# frequencies in 1/tau1, {_moduli(modulus)}"]
    columns = [modulus.omega, modulus.values.real, modulus.values.imag]
    return _text([*lines, "w\tG'\tG''"], columns, "\t")


def gt(source: Spectrum | ComplexModulus, times: ArrayLike | None = None) -> bytes:
    """Return t, G(t) as RepTate's application Gt reads them. It divides by ``gamma``: here 1.

    Parameters
    ----------
    source : Spectrum or ComplexModulus
    times : array_like, optional
        τ1; default: an even grid in the range of the model.

    Raises
    ------
    InputError
        If a time is outside that, or a modulus has no model.
    """
    model = _model(source, "G(t)")
    first, last = 1 / model.span[1], 1 / model.span[0]
    t = per_decade(PER_DECADE, first, last) if times is None else _times(times)
    plateau = model.own_limits()[1][:, 0] < PLATEAU  # then G(t) is constant from the end of the span on
    outside = (t < (0.0 if plateau[1] else first * (1 - 1e-9))) | (t > (np.inf if plateau[0] else last * (1 + 1e-9)))
    if outside.any():
        raise InputError(f"times: {t[outside][0]:g} is outside the range of the model, {first:g} to {last:g}")
    lines = [_parameters(model, Mw=0, gamma=1), _setting(model), f"# times in tau1, {_moduli(model)}"]
    impulse = f"# in addition there is {model.eta_inf} delta(t) at the step itself"
    return _text([*lines, impulse, "t\tGt"], [t, model.G(t)], "\t")


def csv(source: Spectrum | ComplexModulus, omegas: ArrayLike | None = None) -> bytes:
    """Return ω, G′, G″ and, if they are known, their errors, separated by commas; # starts a comment.

    Parameters
    ----------
    source : Spectrum or ComplexModulus
    omegas : array_like, optional
        As in :func:`tts`.
    """
    modulus = _sampled(source, omegas)
    names = ["omega", "G_storage", "G_loss"]
    columns = [modulus.omega, modulus.values.real, modulus.values.imag]
    units = f"# omega in 1/tau1, {_moduli(modulus)}"
    if modulus.model is not None:
        names += ["error_storage", "error_loss"]
        columns += [*modulus.part_errors]
        proved = modulus.model.definite and not modulus.model.estimate
        units += f", errors relative: {'bounds' if proved else 'estimates'}"
    lines = [f"# {_parameters(modulus)}", _setting(modulus), units, ",".join(names)]
    return _text(lines, columns, ",")


def _model(source: Spectrum | ComplexModulus, what: str) -> Spectrum:
    model = source.model if isinstance(source, ComplexModulus) else source
    if model is None:
        raise InputError(f"{what} needs a reduced model; this modulus was made by direct solves")
    return model


def _sampled(source: Spectrum | ComplexModulus, omegas: ArrayLike | None) -> ComplexModulus:
    if isinstance(source, ComplexModulus) and omegas is None:
        return source
    model = _model(source, "G* at other frequencies")
    modulus = ComplexModulus.sampled(model, per_decade(PER_DECADE, *model.span) if omegas is None else omegas)
    unknown = ~np.isfinite(modulus.errors)
    if unknown.any():
        low, high = model.span
        raise InputError(f"omega: {modulus.omega[unknown][0]:g} is too far outside the model, {low:g} to {high:g}")
    return modulus


def export_average(mean: Average, path: str | PathLike[str], *, overwrite: bool = False) -> None:
    """Write an average as CSV: ω, the means of G′ and G″, their standard deviations and their standard errors.

    Parameters
    ----------
    mean : Average
    path : path
    overwrite : bool

    Raises
    ------
    InputError
        If ``path`` exists and ``overwrite`` is not set, or cannot be written.
    """
    check_output(path, overwrite=overwrite)
    columns = [mean.omega]
    for values in (mean.mean, mean.scatter, mean.error):
        columns += [values.real, values.imag]
    lines = [
        f"# mean of {mean.count} packings; left out as not stable: {', '.join(mean.excluded) or 'none'}",
        *[f"# not in balance: {', '.join(mean.unbalanced)}"] * bool(mean.unbalanced),
        "# omega in 1/tau1, moduli in units of the potential; scatter: standard deviation; error: of mean",
        "omega,G_storage,G_loss,scatter_storage,scatter_loss,error_storage,error_loss",
    ]
    write_atomically(path, _text(lines, columns, ","))


def _times(times: ArrayLike) -> Array:
    t = numbers("times", times)
    if t.size == 0:
        raise InputError("times: the range is empty")
    bad = ~(np.isfinite(t) & (t >= 0))
    if bad.any():
        raise InputError(f"times: must be ≥ 0 and finite, not {t[np.argmax(bad)]:g}")
    return t


def _parameters(source: Spectrum | ComplexModulus, **others: int) -> str:
    """Return ``key=value;`` pairs. RepTate cuts them at every ; and =, and reads the file as Latin-1."""
    origin = source.origin
    pairs = {"name": re.sub(r"[^\w.+-]", "_", origin.name, flags=re.ASCII), **others}
    pairs |= {key: getattr(origin, key) for key in ("particles", "phi", "pressure", "checksum")}
    return "".join(f"{key}={value};" for key, value in pairs.items())


def _setting(source: Spectrum | ComplexModulus) -> str:
    setting = f"# {source.strain}, {source.damping}, {'with' if source.prestress else 'without'} pre-stress"
    setting += f", {source.inertia} k tau1^2" * bool(source.inertia)
    net_force = source.origin.net_force
    known = net_force is not None and source.origin.balanced is False
    return f"{setting}; {source.state}" + (f"; net forces on disks reach {net_force:.2g} p d" if known else "")


def _moduli(source: Spectrum | ComplexModulus) -> str:
    return f"moduli in force per length of the {source.origin.potential} potential"


def _text(lines: Sequence[str], columns: Sequence[Array], separator: str) -> bytes:
    rows = (separator.join(f"{x:.16e}" for x in row) for row in zip(*columns, strict=True))
    return "\n".join([*lines, *rows, ""]).encode()


FORMATS: dict[str, Callable[[Spectrum | ComplexModulus, ArrayLike | None], bytes]] = {"tts": tts, "gt": gt, "csv": csv}
