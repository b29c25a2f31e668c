"""The dataset, made small by its one command: index, checksums, manifest, licence; a second start makes nothing."""

import json
import os
import subprocess
import sys
from hashlib import sha256
from pathlib import Path

import pandas as pd
import pytest

import petscjam as pj

ROOT = Path(__file__).parents[1]
pytestmark = pytest.mark.parallel(nprocs=1)


@pytest.mark.slow
def test_the_dataset(tmp_path, environment):
    settings = {
        "FOLDER": str(tmp_path / "data"),
        "OMEGA": "1e-2:1:3",
        "MODES": "3",
        "LAUNCH": "",
        "PYTHON": sys.executable,
    }
    command = ["bash", "mpi_runs/dataset.sh", "--particles", "16", "--pressure", "1e-2,1e-3", "--seeds", "1:2"]
    made = subprocess.run(command, cwd=ROOT, env={**environment, **settings}, capture_output=True, text=True)
    assert made.returncode == 0, made.stderr
    folder = tmp_path / "data"
    subprocess.run(["sha256sum", "--check", "--quiet", "SHA256SUMS"], cwd=folder, check=True)
    index = pd.read_csv(folder / "index.csv", comment="#", float_precision="round_trip")
    assert len(index) == 4
    moduli = {g.origin.checksum: g for g in pj.read_moduli(folder / "moduli-simple-shear.h5").values()}
    for line in index.itertuples():
        packing = pj.Packing.read(folder / "packings" / line.file)
        assert (line.checksum, line.proved) == (packing.checksum, packing.certificate.proved)
        assert line.G0 == moduli[packing.checksum].G0
        assert line.first_mode == pytest.approx(packing.certificate.lowest_eigenvalue, rel=1e-6)
    package = json.loads((folder / "datapackage.json").read_text())
    for resource in package["resources"]:
        content = (folder / resource["path"]).read_bytes()
        assert (resource["bytes"], resource["hash"]) == (len(content), f"sha256:{sha256(content).hexdigest()}")
    named = {resource["path"] for resource in package["resources"]} | {"datapackage.json", "SHA256SUMS"}
    there = {os.path.relpath(file, folder) for file in folder.rglob("*") if file.is_file()}
    assert named == there
    assert "CC BY 4.0" in (folder / "LICENSE").read_text()
    before = (folder / "moduli-simple-shear.h5").stat().st_mtime_ns
    again = subprocess.run(command, cwd=ROOT, env={**environment, **settings}, capture_output=True, text=True)
    assert again.returncode == 0, again.stderr
    assert (folder / "moduli-simple-shear.h5").stat().st_mtime_ns == before
