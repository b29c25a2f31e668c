"""Packings and results as text."""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np

from petscjam.network import ContactNetwork
from petscjam.packing.packing import Packing
from petscjam.response.result import ComplexModulus


def describe_packing(packing: Packing) -> str:
    """Return a few lines on ``packing``: geometry, contacts, certificate, provenance."""
    network = ContactNetwork.of(packing)
    certificate = packing.certificate
    cell = "; ".join(" ".join(f"{x:.8g}" for x in vector) for vector in packing.box.cell)
    lines = [
        f"disks             {len(packing)} ({network.rattlers} rattlers)",
        f"packing fraction  {packing.phi:.10f}",
        f"cell              {cell} (rows are the lattice vectors)",
        f"mean diameter     {packing.mean_diameter:.8g}",
        f"potential         {packing.potential_name}",
        f"pressure          {network.pressure:.10g}",
        f"contacts          {len(network)}, Z = {network.Z:.6g} on the backbone",
        f"checksum          {packing.checksum}",
    ]
    if certificate.max_force is not None:
        verdict = {None: "not judged", True: "yes", False: "no"}[certificate.proved]
        lines += [
            f"largest force     {certificate.max_force:.1e} p·d",
            f"negative modes    {'not counted' if (m := certificate.negative_modes) is None else m}",
            f"proved minimum    {verdict}",
        ]
    lines += [f"{key:17s} {value}" for key, value in packing.provenance.items()]
    return "\n".join(lines)


def table(results: Mapping[str, ComplexModulus]) -> str:
    """Return a table of ``results``: limits, worst residual, and whether the packing is stable."""
    if not results:
        return "no results yet"
    first = next(iter(results.values()))
    width = max(len(name) for name in results)
    head = (
        f"{'packing':{width}} {'N':>7} {'phi':>8} {'p':>9} {'Z':>6} "
        f"{'G0':>12} {'eta0':>12} {'G_inf':>12} {'eta_inf':>12} {'residual':>8}  state"
    )
    lines = [
        f"{first.strain}, {first.damping}, {'with' if first.prestress else 'without'} pre-stress; "
        f"{len(first.omega)} frequencies from {first.omega.min():.3g} to {first.omega.max():.3g}; "
        "stress in k, time in tau1",
        head,
    ]
    for name, g in results.items():
        p = g.packing
        limits = " ".join(f"{_value(x):>12}" for x in (g.G0, g.eta0, g.G_inf, g.eta_inf))
        lines.append(
            f"{name:{width}} {p['particles']:7d} {p['phi']:8.5f} {p['pressure']:9.3e} {p['Z']:6.3f} "
            f"{limits} {g.residuals.max():8.1e}  {state(g)}"
        )
        lines += [f"{'':{width}} {note}" for note in g.notes]
    return "\n".join(lines)


def state(g: ComplexModulus) -> str:
    """Return ``stable``, or what makes the packing unstable, or what is not known."""
    if g.stable:
        return "stable"
    faults, unknown = [], []
    if np.isnan(g.G0):
        unknown.append("G0")
    elif g.G0 < 0:
        faults.append("G0 < 0")
    elif not g.rigid:
        faults.append("G0 = 0")
    if g.negative_modes is None:
        unknown.append("negative modes")
    elif g.negative_modes:
        faults.append(f"{g.negative_modes} negative modes")
    return f"UNSTABLE: {', '.join(faults)}" if faults else f"UNKNOWN: {', '.join(unknown)}"


def _value(x: float) -> str:
    return "—" if np.isnan(x) else f"{x:.6g}"
