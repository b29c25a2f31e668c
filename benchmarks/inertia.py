"""Oscillations of the disk engine at small amplitude against G*(ω) with inertia, and without.

    python benchmarks/inertia.py [--folder runs/inertia]

Three packings of 256 disks, without their rattlers, × four laws × five frequencies, amplitude 1e-6, Q = 1, mass 1, two
time steps, 0.02 and 0.01 τe, extrapolated to 0. A rattler that touches the backbone is a contact that only pushes: its
motion is not linear at any amplitude. The first 5000 τe are left out, 30 000 with β = 0, whose lowest mode is hardly
damped.
Prints a table of the largest relative differences, of direct solves and of the slow twin with the lever arms of the
engine (VOT eq. 6), and the part that inertia has in G*. Resumable; about forty minutes on one core.
"""

import argparse
import json
from pathlib import Path

import numpy as np

import petscjam as pj
from petscjam.geometry.network import ContactNetwork
from petscjam.md import protocols
from petscjam.reference import linear as reference

N, AMPLITUDE, DT = 256, 1e-6, 0.02
PACKINGS = {
    "p = 1e-2": {"pressure": 1e-2, "seed": 1},
    "p = 3e-3": {"pressure": 3e-3, "seed": 2, "shear_stabilised": True},
    "p = 1e-3": {"pressure": 1e-3, "seed": 3, "shear_stabilised": True},
}
LAWS = {
    "β = 0": pj.ContactDamping(0.0),
    "β = 0.3, at the centres": pj.ContactDamping(0.3, rotations=False),
    "β = 1, rolling": pj.ContactDamping(1.0),
    "Stokes drag": pj.StokesDrag(1.0),
}
OMEGA = [0.03, 0.1, 0.3, 1.0, 2.0]  # 1/τe


def in_small_diameters(packing):
    """Return the packing in the unit of length of a run, without rattlers."""
    ds, kept = 2 * packing.radii.min(), ContactNetwork.of(packing).without_rattlers().backbone
    x, radii = packing.positions[kept], packing.radii[kept]
    return pj.Packing(x / ds, radii / ds, pj.Box(packing.box.cell / ds), packing.potential_name)


def settling(law):
    """Return the time that is left out, τe."""
    return 30_000.0 if law == LAWS["β = 0"] else 5000.0


def matrices(packing, law):
    """Return K, B and M of the slow twin, B with the lever arms of the engine."""
    found = reference.contacts(packing.positions, packing.radii, packing.box.cell, packing.potential, images=1)
    found = found if law.body else reference.without_rattlers(found, len(packing))
    K = reference.hessian(found, packing.radii)
    if law.body:
        B = reference.stokes_drag(len(packing), packing.box.area, law.fluid)
    else:
        B = reference.contact_damping(found, packing.radii, law.beta, law.rotations, midway=True)
    return K, B, reference.inertia(np.ones(len(packing)), packing.radii)


def swing(packing, law, omega, dt):
    """Return G* of the engine, and the number of contacts made and broken.

    The first cycles are one row, because rows take time; the last two are a run from their end.
    """
    period = 2 * np.pi / omega
    dt, cycles = period / round(period / dt), int(np.ceil(settling(law) / period))
    first = pj.md.run(
        protocols.oscillation(AMPLITUDE, omega, cycles), law, start=packing, dt=dt, row_time=cycles * period
    )
    run = pj.md.run(protocols.oscillation(AMPLITUDE, omega, 2), law, start=first, dt=dt)
    changes = sum(int(part.rows[name].sum()) for part in (first, run) for name in ("made", "broken"))
    return pj.md.harmonics(run, skip=0).modulus, changes


def measured(packing, law):
    """Return the numbers of a packing and a law at all frequencies."""
    scaled, found = in_small_diameters(packing), []
    K, B, M = matrices(scaled, law)
    heavy, none = (pj.complex_modulus(scaled, OMEGA, damping=law, mass=mass).values for mass in (1.0, None))
    for omega, with_inertia, without in zip(OMEGA, heavy, none, strict=True):
        (coarse, first), (fine, second) = (swing(scaled, law, omega, dt) for dt in (DT, DT / 2))
        engine = fine + (fine - coarse) / 3
        twin = reference.modulus(K, B, omega, scaled.box.area, M)
        found.append(
            {
                "omega": omega,
                "difference": abs(engine / with_inertia - 1),
                "twin": abs(engine / twin - 1),
                "part": abs(with_inertia / without - 1),
                "missed": abs((engine - without) / (with_inertia - without) - 1),
                "changes": first + second,
            }
        )
        print(f"{omega:g}: {found[-1]}", flush=True)
    return found


def table(folder):
    """Return the largest numbers over the frequencies."""
    head = ["packing", "law", "engine − solver", "engine − twin", "part of inertia in G*", "the same from the engine"]
    head.append("contacts made and broken")
    lines = [f"| {' | '.join(head)} |", "|---" * len(head) + "|"]
    for p in PACKINGS:
        for law in LAWS:
            file = folder / f"{p}, {law}.json"
            if file.exists():
                rows = json.loads(file.read_text())
                worst = {key: max(row[key] for row in rows) for key in rows[0]}
                low, high = (choose(row["part"] for row in rows) for choose in (min, max))
                missed = max(row["missed"] * row["part"] for row in rows) / high
                lines.append(
                    f"| {p} | {law} | {worst['difference']:.0e} | {worst['twin']:.0e} | "
                    f"{low:.1g} … {high:.2g} | within {missed:.0e} | {worst['changes']} |"
                )
    return "\n".join(lines)


def main():
    """Make what is missing, and print the table."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--folder", type=Path, default=Path("runs/inertia"))
    folder = parser.parse_args().folder
    folder.mkdir(parents=True, exist_ok=True)
    for p, how in PACKINGS.items():
        start = folder / f"{p}.h5"
        if not start.exists():
            pj.prepare_packing(N, **how).write(start)
        packing = pj.Packing.read(start)
        print(p, "proved minimum:", packing.certificate.proved, flush=True)
        for name, law in LAWS.items():
            file = folder / f"{p}, {name}.json"
            if not file.exists():
                print(p, name, flush=True)
                rows = measured(packing, law)
                file.write_text(json.dumps(rows))
    print(table(folder))


if __name__ == "__main__":
    main()
