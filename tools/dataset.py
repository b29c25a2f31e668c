"""Write index, tables, licence, manifest and checksums of a dataset: python tools/dataset.py FOLDER.

The folder is that of mpi_runs/dataset.sh. The manifest is a data package of Frictionless (datapackage.json).
"""

import argparse
import json
from hashlib import sha256
from pathlib import Path

import petscjam as pj
from petscjam.base.tables import Table
from petscjam.io.results import read_results

STRAINS = {"simple-shear": "G", "pure-shear": "G_pure", "compression": "K"}
LICENCE = """This dataset is licensed under the Creative Commons Attribution 4.0 International licence (CC BY 4.0):
https://creativecommons.org/licenses/by/4.0/

Please cite petscjam, with which it was made (version {version}), and K. Baumgarten and B. P. Tighe, Soft Matter 13,
8368 (2017), whose methods it follows.
"""
README = """# Jammed packings of soft disks with their linear response

{count} bidisperse packings of harmonic disks, {sizes} disks, at pressures from {low:g} to {high:g} k; {proved} of them
are proved minima of the energy. Units: stiffness k = 1, mean diameter d = 1, time τ1 = 1.

| file | content |
|---|---|
| `index.csv` | a line for each packing: size, pressure, φ, Z, rattlers, certificate, G0, K0, η0, first mode, checksum |
| `packings/` | the packings (H5MD), each with its certificate; `library.json` is the recipe |
| `moduli-*.h5`, `moduli-*.csv` | G*(ω) for simple shear, pure shear and compression, with bounds on the errors |
| `modes.h5`, `modes.csv` | the lowest modes of the stiffness with pre-stress; the vectors are in the HDF5 file |
| `report.html` | all of it as one page |
| `datapackage.json`, `SHA256SUMS` | manifest (Frictionless), checksums: `sha256sum -c SHA256SUMS` |

Read it in Python with `petscjam.Packing.read`, `petscjam.read_moduli` and `petscjam.read_results`, or with any HDF5
library. Made by `bash mpi_runs/dataset.sh`, with {platform}.
"""


def index(folder):
    """Return a line for each packing, with its moduli and its lowest eigenvalue."""
    library = pj.read_library(folder / "packings")
    moduli = {name: by_checksum(folder / f"moduli-{strain}.h5") for strain, name in STRAINS.items()}
    modes = by_checksum(folder / "modes.h5")
    rows = []
    for row in library.rows:
        row = {key: value for key, value in row.items() if key not in ("seconds", "failure")}
        for name, results in moduli.items():
            g = results[row["checksum"]]
            row |= {f"{name}0": g.G0, f"{name}_inf": g.G_inf, f"eta0_{name}": g.eta0, f"error_{name}": g.errors.max()}
        row["state"] = moduli["G"][row["checksum"]].state
        row["first_mode"] = float(modes[row["checksum"]].eigenvalues[0])
        rows.append(row)
    stress = [f"{name}{limit}" for name in STRAINS.values() for limit in ("0", "_inf")]
    units = dict.fromkeys(["target", "pressure", "shear_modulus", "lowest_eigenvalue", "first_mode", *stress], "k")
    units |= {f"eta0_{name}": "k*tau1" for name in STRAINS.values()}
    return Table.of_rows(rows, units)


def by_checksum(file):
    return {r.origin.checksum: r for r in read_results(file).values()}


def main():
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("folder", type=Path)
    folder = parser.parse_args().folder
    table = index(folder)
    (folder / "index.csv").write_bytes(table.to_csv())
    for name in [*(f"moduli-{strain}" for strain in STRAINS), "modes"]:
        (folder / f"{name}.csv").write_bytes(pj.read_table(folder / f"{name}.h5").to_csv())
    first = next(iter(read_results(folder / "modes.h5").values()))
    columns, version = table.columns, pj.__version__
    (folder / "LICENSE").write_text(LICENCE.format(version=version))
    text = README.format(
        count=len(table),
        sizes=", ".join(map(str, sorted(set(columns["particles"])))),
        low=min(columns["target"]),
        high=max(columns["target"]),
        proved=sum(columns["proved"] == True),  # noqa: E712 - an array
        platform=first.origin.versions,
    )
    (folder / "README.md").write_text(text)
    files = sorted(file for file in folder.rglob("*") if file.is_file())
    files = [file for file in files if file.name not in ("datapackage.json", "SHA256SUMS")]
    sums = {file.relative_to(folder).as_posix(): sha256(file.read_bytes()).hexdigest() for file in files}
    resources = [
        {
            "name": name.lower().replace("/", "-"),
            "path": name,
            "format": Path(name).suffix[1:],
            "bytes": (folder / name).stat().st_size,
            "hash": f"sha256:{digest}",
        }
        for name, digest in sums.items()
    ]
    package = {
        "name": "jammed-packings",
        "title": "Jammed packings of soft disks with their linear response",
        "version": version,
        "licenses": [{"name": "CC-BY-4.0", "path": "https://creativecommons.org/licenses/by/4.0/"}],
        "resources": resources,
    }
    (folder / "datapackage.json").write_text(json.dumps(package, indent=1) + "\n")
    (folder / "SHA256SUMS").write_text("".join(f"{digest}  {name}\n" for name, digest in sums.items()))
    print(f"{folder}: {len(table)} packings, {len(sums)} files, {sum(r['bytes'] for r in resources) / 1e6:.1f} MB")


if __name__ == "__main__":
    main()
