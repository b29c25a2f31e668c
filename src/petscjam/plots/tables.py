"""Packings and results as text."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from contextlib import suppress
from typing import Any, TypeVar

import numpy as np

from petscjam.analysis.statistics import alike, nominal, standard_error
from petscjam.base.errors import InputError
from petscjam.geometry.network import ContactNetwork
from petscjam.geometry.packing import Packing
from petscjam.md.banding import Bands, bands
from petscjam.md.model import Model
from petscjam.md.observables import AbsentError
from petscjam.md.oscillations import summary
from petscjam.md.result import MEANS, Run
from petscjam.preparation.library import Library
from petscjam.response.origin import Result
from petscjam.response.result import ComplexModulus

R = TypeVar("R", bound=Result)


def describe_packing(packing: Packing) -> str:
    """Return a few lines on ``packing``, jammed or not: geometry, contacts, certificate; then provenance."""
    c = packing.certificate
    cell = "; ".join(" ".join(f"{x:.8g}" for x in vector) for vector in packing.box.cell)
    lines = {
        "units": "lengths as in the source, k of the potential",
        "disks": f"{len(packing)}",
        "packing fraction": f"{packing.phi:.10f}",
        "cell": f"{cell} (rows are the lattice vectors)",
        "mean diameter": f"{packing.mean_diameter:.8g}",
        "potential": packing.potential_name,
        **_contacts(packing),
        "checksum": packing.checksum,
        "proved minimum": {None: "not judged", True: "yes", False: "no"}[c.proved],
    }
    if c.pressure_error is not None:
        lines["pressure error"] = f"{c.pressure_error:.1e} of the target"
    if c.stress_error is not None:
        lines["shear stress"] = f"{c.stress_error:.1e} p"
    if c.negative_modes is not None:
        lines["negative modes"] = f"{c.negative_modes}"
    if c.zero_modes is not None:
        lines["zero modes"] = f"{c.zero_modes} (translations left out)"
    if c.lowest_eigenvalue is not None:
        lines["lowest eigenvalue"] = f"{c.lowest_eigenvalue:.6g} ± {c.eigenvalue_error or 0:.0e} k"
    if c.shear_modulus is not None:
        flag = ": UNSTABLE against shear" * (c.shear_modulus <= 0)
        lines["shear modulus"] = f"{c.shear_modulus:.6g} k, softest direction{flag}"
    text = [f"{key:18s} {value}" for key, value in lines.items()]
    if packing.provenance:
        text.append("made with")
    for key, value in packing.provenance.items():
        name = "target pressure" if key == "pressure" else key
        if key == "history" and isinstance(value, Mapping):
            value = f"{len(value.get('evaluations', []))} points"
        text.append(f"  {name:16s} {' '.join(str(value).split())}")
    return "\n".join(text)


def _contacts(packing: Packing) -> dict[str, str]:
    try:
        network = ContactNetwork.of(packing)
    except InputError as error:  # two disks on one point
        return {"contacts": f"not known: {error}"}
    inside = int((network.backbone[network.i] & network.backbone[network.j]).sum())
    lines = {
        "rattlers": f"{network.rattlers}",
        "pressure": f"{network.pressure:.10g} k",
        "contacts": f"{len(network)}, {inside} in the backbone, Z = {network.Z:.6g}",
        "largest force": f"{network.net_force:.1e} p·d{': NOT IN BALANCE' * (not network.balanced)}",
    }
    try:
        network.without_rattlers()
    except InputError as error:
        lines["state"] = str(error)
    return lines


def describe_library(library: Library) -> str:
    """Return a table of a folder of packings, a line for each number of disks and target pressure."""
    rows, failed = library.rows, library.failed
    verdicts = [row["proved"] for row in rows]
    seconds = [row["seconds"] for row in [*rows, *failed] if row["seconds"] is not None]
    lines = [
        f"{len(rows)} packings: {verdicts.count(True)} proved minima, {verdicts.count(False)} not proved, "
        f"{verdicts.count(None)} not judged; {len(failed)} failed; {sum(seconds):.0f} s of work",
        ", ".join(f"{key} {value}" for key, value in library.recipe.items()) or "no recipe",
        f"{'N':>7} {'p (k)':>10} {'made':>5} {'proved':>6} {'failed':>6} {'phi':>20} {'Z':>7} "
        f"{'rattlers':>8} {'unstable':>8} {'lowest eigenvalue (k)':>21} {'time (s)':>9}",
    ]
    groups: dict[tuple[int, float], tuple[list[Any], list[Any]]] = {}
    for k, row in enumerate([*rows, *failed]):
        target = row["target"] or nominal(row["pressure"])
        groups.setdefault((row["particles"], target), ([], []))[k >= len(rows)].append(row)
    for (n, target), (some, lost) in sorted(groups.items(), key=lambda item: (item[0][0], -item[0][1])):
        phi, Z, rattlers = ([row[name] for row in some] for name in ("phi", "Z", "rattlers"))
        low = [row["lowest_eigenvalue"] for row in some if row["lowest_eigenvalue"] is not None]
        time = [row["seconds"] for row in [*some, *lost] if row["seconds"] is not None]
        unstable = sum(row["shear_modulus"] is not None and row["shear_modulus"] <= 0 for row in some)
        lines.append(
            f"{n:7d} {target:10.4g} {len(some):5d} {[row['proved'] for row in some].count(True):6d} "
            f"{len(lost):6d} {_mean(phi):>20} {np.mean(Z) if Z else np.nan:7.4f} "
            f"{np.mean(rattlers) if rattlers else np.nan:8.1f} {unstable:8d} "
            f"{f'{min(low):.2e} … {max(low):.2e}' if low else '—':>21} "
            f"{f'{sum(time):.1f}' if time else '—':>9}"
        )
    lines.append("phi ± standard error; Z, rattlers: means; unstable: against shear in some direction")
    return "\n".join(lines)


def describe_run(run: Run) -> str:
    """Return a few lines on a sheared run: settings, means with their errors, contacts, energy budget.

    Lines whose observables the run lacks are left out.
    """
    s = run.settings
    lines = [
        "units: ds, m, tau_e; means ± standard errors leave out the first quarter",
        f"{s.model.name}, {s.model.potential.name}, {s.particles} disks, phi = {s.phi:.6g}, Q = {s.model.Q:g}"
        f"{f', mass {s.model.mass:g}' * (s.model.mass != 1)}{_drag(s.model)}; "
        f"{s.protocol}, dt = {s.dt:.4g}, {s.integrator}; start: {s.start}",
        f"strain {s.strain0:.6g} to {run.strain[-1]:.6g} in {len(run.strain)} rows, "
        f"strain rate {run.rate.min():.4g} to {run.rate.max():.4g}",
    ]
    if run.after().sum() > 1:
        lines += means_of(run, "{:12s} {:.4g} ± {:.1g}")
    for describe in (_lifetimes, _budget, _parts):
        with suppress(AbsentError):
            lines += describe(run)
    with suppress(InputError):
        lines += describe_bands(bands(run))
    return "\n".join([*lines, *(f"WARNING: {text}" for text in run.warnings)])


def _drag(model: Model) -> str:
    """Return the numbers of nonlinear drag as text; empty if it is linear."""
    if model.film is None:
        return ""
    return f", drag ~ v^{model.drag_exponent:g} with w = {model.drag_speed:g}, cutoff {model.drag_cutoff:g}"


def means_of(run: Run, line: str) -> list[str]:
    """Return a line for each of the means of a run, or the reason why there are none; see :func:`summary`.

    Parameters
    ----------
    run : Run
    line : str
        Format of symbol, mean and error.
    """
    try:
        return [line.format(symbol, *m) for symbol, m in summary(run).items() if np.isfinite(m.value)]
    except InputError as error:
        return [str(error)]


def describe_bands(found: Bands) -> list[str]:
    """Return a table of two shear bands, and the width of their interfaces."""
    e = found.errors
    rows = [("rate", found.rate, e.rate), ("φ", found.phi, e.phi)]
    rows += [("share, rate", found.share, e.share), ("share, φ", found.share_phi, e.share_phi)]
    if np.isfinite(found.stresses).all():
        rows += zip(("P_xx", "Σ", "P_yy"), found.stresses.T, e.stresses.T, strict=True)
    lines = [f"{'two bands:':12s}{'Bagnoldian':>19s}{'Newtonian':>19s}"]
    for name, values, errors in rows:
        pair = [f"{value:.4g} ± {error:.1g}" for value, error in zip(values, errors, strict=True)]
        lines.append(f"{name:12s}{pair[0]:>19s}{pair[1]:>19s}")
    return [*lines, f"rate ~ tanh(Δy/w) at the interfaces, w = {found.width:.3g} ± {e.width:.1g}"]


def _lifetimes(run: Run) -> list[str]:
    kept, particles = run.after(), run.settings.particles
    elapsed = np.diff(run.time, prepend=run.settings.time0)[kept].sum()
    broken, made, duration = (run.rows[name][kept].sum() for name in ("broken", "made", "duration"))
    if kept.sum() < 2 or not broken:
        return []
    each, often = duration / broken, made / (elapsed * particles)
    return [
        f"contacts last {each:.4g} tau_e, {often:.4g} per disk are made in a tau_e: 2 × both = {2 * each * often:.4g} "
        "(Z, except for contacts longer than the run)"
    ]


def _budget(run: Run) -> list[str]:
    heat, missed = run.rows["heat"].sum(), run.rows["imbalance"].sum()
    return [f"energy budget: {heat:.4g} dissipated, error {missed:.1e}"]


def _parts(run: Run) -> list[str]:
    s, parts = run.settings, run.rows["parts"].max()
    if parts <= 1:
        return []
    more = run.rows["steps"].sum() / (run.time[-1] - s.time0) * s.dt
    return [f"time steps divided into up to {parts:.0f} parts where contacts require it: {more:.4g} times as many"]


def describe_runs(runs: Mapping[str, Run]) -> str:
    """Return a table of sheared runs, one line for each."""
    width = max(len(name) for name in runs)
    swings = all(run.settings.protocol == "oscillation" for run in runs.values())
    columns = ["G′", "G″", "P", "Z"] if swings else ["P elastic", "Σ elastic", "μ", "Z", "Rv"]
    head = " ".join([f"{'run':{width}}", f"{'strain':>8}", *(f"{name:>20}" for name in columns)])
    lines = ["units: ds, m, tau_e; means ± standard errors leave out the first quarter", head]
    for name, run in runs.items():
        means = {}
        if swings:
            with suppress(InputError):
                means = summary(run)
        elif run.after().sum() > 1:
            means = {name: run.mean(MEANS[name]) for name in columns}
        values = [f"{m.value:.4g} ± {m.error:.1g}" if (m := means.get(name)) else "too short" for name in columns]
        row = [f"{name:{width}}", f"{run.strain[-1]:8.4g}", *(f"{value:>20}" for value in values)]
        lines.append(" ".join(row))
        lines += [f"{'':{width}} WARNING: {text}" for text in run.warnings]
    return "\n".join(lines)


def _mean(values: list[float]) -> str:
    """Write mean ± standard error."""
    if len(values) < 2:
        return f"{values[0]:.6f}" if values else "—"
    return f"{np.mean(values):.6f} ± {standard_error(values):.6f}"


def table(results: Mapping[str, Result]) -> str:
    """Return ``results`` of one kind as a table: a line for each, with its notes below."""
    if not results:
        return "no results yet"
    first = next(iter(results.values()))
    if isinstance(first, ComplexModulus):
        return moduli_table(results)
    header = first.units + f"; {first.origin.strain}" * (first.origin.strain is not None)
    width, differ = max(len(name) for name in results), coefficients(results)
    rows = {
        name: {
            "N": f"{r.origin.particles}",
            "p": f"{r.origin.pressure:.3e}",
            "pre-stress": "with" if r.prestress else "without",
            **{key: f"{r.damping.settings.get(key, np.nan):g}" for key in differ},
            **{key: x if isinstance(x, str) else f"{x:.4g}" for key, x in r.row().items()},
        }
        for name, r in by_coefficients(results, differ).items()
    }
    heads = {key: max(len(key), *(len(row[key]) for row in rows.values())) for key in rows[next(iter(rows))]}
    lines = [header, " ".join([f"{'packing':{width}}", *(f"{key:>{w}}" for key, w in heads.items())])]
    for name, row in rows.items():
        lines.append(" ".join([f"{name:{width}}", *(f"{row[key]:>{w}}" for key, w in heads.items())]))
        lines += [f"{'':{width}} {note}" for note in results[name].notes]
    return "\n".join(lines)


def moduli_table(results: Mapping[str, Any]) -> str:
    """Return a table of ``results`` for each law: limits, largest error, and whether the packing is stable.

    The coefficients in which the laws differ are columns, and the rows are in their order.
    """
    blocks: dict[tuple[Any, ...], dict[str, ComplexModulus]] = {}
    for name, g in results.items():
        flags = tuple(value for value in g.damping.settings.values() if isinstance(value, bool))
        kind = (g.strain, g.damping.name, flags, g.prestress, g.model is None, g.inertia)
        blocks.setdefault(kind, {})[name] = g
    return "\n\n".join(_block(some) for some in blocks.values())


def coefficients(results: Mapping[str, Result]) -> list[str]:
    """Return the names of the numbers in which the damping laws of ``results`` differ."""
    laws = {r.origin.damping for r in results.values() if r.origin.damping}
    names = dict.fromkeys(name for law in laws for name in law.settings)
    values = {name: [law.settings.get(name, np.nan) for law in laws] for name in names}
    return [name for name, some in values.items() if len(set(some)) > 1 and not isinstance(some[0], bool)]


def by_coefficients(results: Mapping[str, R], names: Sequence[str]) -> dict[str, R]:
    """Return ``results`` in ascending order of these coefficients of their laws.

    Parameters
    ----------
    results : mapping of Result
    names : sequence of str
    """
    order = sorted(results, key=lambda name: [results[name].damping.settings.get(key, np.inf) for key in names])
    return {name: results[name] for name in order}


def _block(results: Mapping[str, ComplexModulus]) -> str:
    differ = coefficients(results)
    results = by_coefficients(results, differ)
    first = next(iter(results.values()))
    width = max(len(name) for name in results)
    same = {name: value for name, value in first.damping.settings.items() if name not in differ}
    law = first.damping.name
    law += f" ({', '.join(f'{name}={value}' for name, value in same.items())})" * bool(same)
    what, meaning = "residual", "residual of each solve"
    if first.model:
        proved = all(g.model and g.model.definite for g in results.values())
        bound = "bound" if proved else "bound or estimate"
        what, meaning = "error", f"error: {bound} on |ΔG*|/|G*|"
    lines = [
        f"{first.strain}, {law}, {'with' if first.prestress else 'without'} pre-stress"
        f"{f', {first.inertia} k tau1²' * bool(first.inertia)}; "
        f"{len(first.omega)} frequencies from {first.omega.min():.3g} to {first.omega.max():.3g}",
        f"stress in k, time in tau1; {meaning}",
        f"{'packing':{width}} {''.join(f'{key:>9} ' for key in differ)}{'N':>7} {'phi':>8} {'p':>9} {'Z':>6} "
        f"{'G0':>12} {'eta0':>12} {'G_inf':>12} {'eta_inf':>12} {what:>8}  state",
    ]
    for name, g in results.items():
        p = g.origin
        limits = " ".join(f"{_value(x):>12}" for x in (g.G0, g.eta0, g.G_inf, g.eta_inf))
        worst = (g.errors if g.model else g.residuals).max()
        lines.append(
            f"{name:{width}} {_numbers(g, differ)}{p.particles:7d} {p.phi:8.5f} {p.pressure:9.3e} {p.Z:6.3f} "
            f"{limits} {worst:8.1e}  {g.state}"
        )
        lines += [f"{'':{width}} {note}" for note in g.notes]
    for kind, some in alike({name: g for name, g in results.items() if g.stable}).items():
        if len(some) > 1:
            values = np.array([[g.G0, g.eta0, g.G_inf, g.eta_inf] for g in some.values()])
            rows = {f"mean of {len(some)} stable": values.mean(0), "± its error": standard_error(values)}
            for label, row in rows.items():
                law = _numbers(next(iter(some.values())), differ)
                head = f"{label:{width}} {law}{kind.particles:7d} {'':8} {kind.pressure:9.2e} {'':6}"
                lines.append(" ".join([head, *(f"{_value(x):>12}" for x in row)]))
    return "\n".join(lines)


def _numbers(r: Result, names: Sequence[str]) -> str:
    return "".join(f"{r.damping.settings[name]:9.4g} " for name in names)


def _value(x: float) -> str:
    return "—" if np.isnan(x) else f"{x:.6g}"
