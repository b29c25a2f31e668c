"""Files of GSD and LAMMPS, the choice of the potential, and real programs that open what we write."""

import json
import subprocess
import sys
from dataclasses import replace
from pathlib import Path

import gsd.hoomd
import numpy as np
import pytest
from helpers import JAXMD, SIXTEEN
from hypothesis import given
from hypothesis import strategies as st
from test_io import packings, refuses, same_bits

from petscjam.base.errors import InputError
from petscjam.geometry.box import Box
from petscjam.geometry.network import ContactNetwork
from petscjam.geometry.packing import Certificate, Packing
from petscjam.io.exporters import export_packing
from petscjam.io.importers import import_packing


def turned(packing):
    """The same disks turned by 2 rad, in a left-handed cell tilted by another lattice vector."""
    R = np.array([[np.cos(2), np.sin(2)], [-np.sin(2), np.cos(2)]])
    a, b = packing.box.cell @ R
    return replace(packing, positions=packing.positions @ R, box=Box(np.array([a, a - b])))


@pytest.fixture
def packing():
    return import_packing(SIXTEEN)


@pytest.fixture(params=["as it is", "turned"])
def either(request, packing):
    return packing if request.param == "as it is" else turned(packing)


# GSD


@pytest.fixture
def frames(tmp_path):
    """Write frames of GSD, each a change of the first: ``frames({}, {"diameter": [1, 2]})``."""

    def write(*changes):
        with gsd.hoomd.open(tmp_path / "p.gsd", "w") as file:
            for change in changes:
                frame = gsd.hoomd.Frame()
                frame.configuration.box = [4, 2, 0, 0.5, 0, 0]
                frame.particles.N, frame.particles.types, frame.particles.typeid = 2, ["A", "B"], [0, 1]
                frame.particles.position, frame.particles.diameter = [[0, 0, 0], [1, 0.5, 0]], [1, 1.5]
                for name, value in change.items():
                    setattr(frame.particles, name, value)
                file.append(frame)
        return tmp_path / "p.gsd"

    return write


def test_gsd_cell_is_that_of_hoomd(frames):
    assert import_packing(frames({})).box.cell.tolist() == [[4, 0], [1, 2]]


def test_gsd_radii_are_half_the_diameters(frames):
    assert import_packing(frames({})).radii.tolist() == [0.5, 0.75]


def test_gsd_index_picks_the_frame(frames):
    path = frames({}, {"position": [[0, 0, 0], [-1, 0.25, 0]]})
    assert import_packing(path, 1).positions.tolist() == [[0, 0], [-1, 0.25]]
    refuses(path, "no packing 2", "holds 2", read=lambda path: import_packing(path, 2))


def test_gsd_provenance_states_the_precision(frames):
    assert import_packing(frames({})).provenance == {
        "source": "p.gsd",
        "format": "GSD",
        "index": 0,
        "precision": "float32",
        "header": {"step": 0},
    }


@given(packings())
def test_gsd_is_the_packing_turned(tmp_path_factory, packing):
    path = tmp_path_factory.mktemp("io") / "p.gsd"
    export_packing(packing, path, to="gsd")
    found = import_packing(path, potential_name=packing.potential_name)
    a = packing.box.cell[0] / np.hypot(*packing.box.cell[0])
    R = np.array([[a[0], -a[1]], [a[1], a[0]]])  # brings the first lattice vector to the x-axis
    lattice = packing.box.cell @ R @ np.linalg.inv(found.box.cell)
    assert np.abs(lattice - np.diag([1, np.sign(np.linalg.det(packing.box.cell))])).max() < 1e-6
    away = found.positions - packing.positions @ R
    shift = found.box.fractional(away - away[0])
    assert np.abs(shift - np.rint(shift)).max() < 1e-6
    assert np.abs(found.radii / packing.radii - 1).max() < 1e-7


def test_gsd_keeps_the_contacts(either, tmp_path):
    export_packing(either, tmp_path / "p.gsd", to="gsd")
    assert contacts(import_packing(tmp_path / "p.gsd")) == contacts(either)


def test_gsd_types_are_the_sizes(packing, tmp_path):
    export_packing(packing, tmp_path / "p.gsd", to="gsd")
    with gsd.hoomd.open(tmp_path / "p.gsd") as file:
        particles = file[0].particles
    assert particles.types == ["H", "He"]
    assert (particles.typeid == (packing.radii > 1.2)).all()


def test_gsd_of_many_sizes_has_one_type(packing, tmp_path):
    export_packing(replace(packing, radii=np.linspace(0.1, 0.2, 16)), tmp_path / "p.gsd", to="gsd")
    with gsd.hoomd.open(tmp_path / "p.gsd") as file:
        assert file[0].particles.types == ["X"]


def test_gsd_out_of_the_plane(frames):
    refuses(frames({"position": [[0, 0, 0], [1, 0, 0.25]]}), "not in the plane", "0.25")


def test_gsd_without_diameters(frames):
    refuses(frames({"diameter": None}), "no diameter", "--diameters A:…,B:…")


def test_gsd_of_equal_disks_may_have_the_default_diameter(frames):
    assert import_packing(frames({"diameter": None, "typeid": [0, 0]})).radii.tolist() == [0.5, 0.5]


def test_gsd_without_disks(frames):
    refuses(frames({"N": 0, "position": None, "diameter": None, "typeid": None}), "(0, 2)")


def test_gsd_of_another_schema(tmp_path):
    with gsd.fl.open(tmp_path / "p.gsd", "w", application="", schema="weather", schema_version=[1, 0]):
        pass
    refuses(tmp_path / "p.gsd", "incorrect schema")


@given(st.floats(0, 1, exclude_max=True))
def test_truncated_gsd(tmp_path_factory, fraction):
    path = tmp_path_factory.mktemp("io") / "p.gsd"
    export_packing(import_packing(SIXTEEN), path, to="gsd")
    data = path.read_bytes()
    path.write_bytes(data[: int(fraction * len(data))])
    refuses(path)


def test_missing_gsd_library(packing, frames, tmp_path, monkeypatch):
    path = frames({})
    monkeypatch.setitem(sys.modules, "gsd.hoomd", None)
    refuses(path, 'pip install "petscjam[formats]"')
    refuses(tmp_path / "new", "petscjam[formats]", read=lambda path: export_packing(packing, path, to="gsd"))


# LAMMPS: three disks in a tilted box, at these fractions of it

FRACTIONS = np.array([[0.5, 0.25], [0.25, 0.5], [0.75, 0.875]])
TILTED = np.array([[10, 0], [-3, 8]])
THERE = [[3.25, 2], [0, 4], [3.875, 7]]  # by hand: x = −1 + 10 s − 3 t, y = 8 t

LAMMPS_DATA = """\
LAMMPS data file via write_data, timestep = 7

3 atoms
2 atom types

-1 9 xlo xhi
0 8 ylo yhi
-0.5 0.5 zlo zhi
-3 0 0 xy xz yz

Masses

1 1
2 2.25

Atoms # sphere

3 2 1.5 1 3.875 7 0 0 -1 0
1 1 1 1 3.25 2 0 0 0 0  # the first
2 1 1 1 0 4 0 1 0 0

Velocities

1 0 0 0 0 0 0
2 0 0 0 0 0 0
3 0 0 0 0 0 0
"""

LAMMPS_DUMP = """\
ITEM: UNITS
lj
ITEM: TIMESTEP
100
ITEM: NUMBER OF ATOMS
3
ITEM: BOX BOUNDS xy xz yz pp pp pp
-4 9 -3
0 8 0
-0.5 0.5 0
ITEM: ATOMS id type x y z radius
3 2 3.875 7 0 0.75
1 1 3.25 2 0 0.5
2 1 0 4 0 0.5
ITEM: TIMESTEP
200
ITEM: NUMBER OF ATOMS
3
ITEM: BOX BOUNDS xy xz yz pp pp ff
-4 10 -3
0 10 1
-0.5 0.5 2
ITEM: ATOMS id diameter xs ys zs
1 1 0.5 0.25 0.5
2 1 0.25 0.5 0.5
3 1.5 0.75 0.875 0.5
ITEM: TIMESTEP
300
ITEM: NUMBER OF ATOMS
2
ITEM: BOX BOUNDS pp pp pp
-1 9
0 8
-0.5 0.5
ITEM: ATOMS id yu xu radius element
1 2 13.25 0.5 H
2 4 0 0.5 H
ITEM: TIMESTEP
400
ITEM: NUMBER OF ATOMS
3
ITEM: BOX BOUNDS abc origin pp pp pp
10 0 0 -1
-3 8 0 0
0 0 1 -0.5
ITEM: ATOMS id radius xsu ysu
1 0.5 0.5 0.25
2 0.5 0.25 0.5
3 0.75 0.75 0.875
"""


@pytest.fixture
def lammps(tmp_path):
    def write(text):
        path = tmp_path / "p.lammps"
        path.write_text(text)
        return path

    return write


LAMMPS_DATA_VECTORS = (
    LAMMPS_DATA.replace("-1 9 xlo xhi", "10 0 0 avec")
    .replace("0 8 ylo yhi", "-3 8 0 bvec")
    .replace("-0.5 0.5 zlo zhi", "0 0 1 cvec")
    .replace("-3 0 0 xy xz yz", "-1 0 0 abc origin")
)


@pytest.mark.parametrize(
    ("text", "index"),
    [(LAMMPS_DATA, 0), (LAMMPS_DATA_VECTORS, 0), (LAMMPS_DUMP, 0), (LAMMPS_DUMP, 1), (LAMMPS_DUMP, 3)],
)
def test_lammps_in_a_tilted_box(lammps, text, index):
    found = import_packing(lammps(text), index)
    assert found.box.cell.tolist() == TILTED.tolist()
    assert found.positions.tolist() == THERE
    assert found.radii.tolist() == [0.5, 0.5, 0.75]


def test_lammps_numbers_written_by_hand():
    assert (FRACTIONS @ TILTED + (-1, 0) == THERE).all()


def test_lammps_in_a_rectangle(lammps):
    found = import_packing(lammps(LAMMPS_DUMP), 2)
    assert found.box.cell.tolist() == [[10, 0], [0, 8]]
    assert found.positions.tolist() == [[13.25, 2], [0, 4]]


def test_lammps_data_in_a_rectangle_without_images(lammps):
    text = LAMMPS_DATA.replace("-3 0 0 xy xz yz\n", "").replace(" 0 0 0 0", " 0").replace(" 0 1 0 0", " 0")
    found = import_packing(lammps(text.replace(" 0 0 -1 0", " 0")))
    assert found.box.cell.tolist() == [[10, 0], [0, 8]]
    assert found.positions.tolist() == THERE


def test_lammps_provenance(lammps):
    assert import_packing(lammps(LAMMPS_DUMP), 1).provenance["header"]["timestep"] == "200"
    assert import_packing(lammps(LAMMPS_DATA)).provenance["header"]["title"].endswith("timestep = 7")


@pytest.mark.parametrize(
    ("old", "new", "words"),
    [
        ("# sphere", "# full", ["line 16", "'Atoms # full'", "diameter"]),
        ("# sphere", "# atomic", ["line 18", "8 columns"]),
        (" # sphere", "", ["line 16", "'Atoms'", "'Atoms # sphere'"]),
        ("Atoms #", "Molecules #", ["section Atoms"]),
        ("3 atoms", "4 atoms", ["line 16", "3 rows", "4 atoms"]),
        ("3.875", "3.87x", ["line 18", "3.87x"]),
        ("3.875", "nan", ["line 18", "nan"]),
        ("3.875 7", "3.875", ["line 18", "10 columns"]),
        ("4 0 1", "4 0.5 1", ["plane", "0.5"]),
        ("0 8 ylo yhi", "0 eight ylo yhi", ["line 7", "eight"]),
        ("0 8 ylo yhi\n", "", ["lacks", "ylo yhi"]),
        ("-1 9 xlo", "9 9 xlo", ["no area"]),
        ("3 2 1.5", "3 2 0", ["radius of disk 2"]),
    ],
)
def test_bad_lammps_data_is_refused_with_its_line(lammps, old, new, words):
    assert old in LAMMPS_DATA
    refuses(lammps(LAMMPS_DATA.replace(old, new, 1)), *words)


@pytest.mark.parametrize(
    ("old", "new", "words"),
    [
        ("type x y z radius", "kind x y z mass", ["line 11", "radius, diameter or type", "x y z mass"]),
        ("z radius", "z mass", ["radius", "--diameters 1:…,2:…"]),
        ("x y z radius", "vx vy z radius", ["line 11", "xs ys", "vx vy"]),
        ("pp pp pp", "pp ff pp", ["line 7", "ff"]),
        ("xy xz yz pp", "abc pp", ["line 7", "'abc pp pp pp'"]),
        ("-4 9 -3", "-4 9", ["line 8", "3 columns"]),
        ("-4 9 -3", "-4 9 three", ["line 8", "three"]),
        ("3.875", "inf", ["line 12", "inf"]),
        ("3.875 7 0", "3.875 7", ["line 12", "6 columns"]),
        ("ATOMS\n3", "ATOMS\n2", ["line 14", "2 rows"]),
        ("ATOMS\n3", "ATOMS\n4", ["line 15", "4 rows"]),
        ("ATOMS\n3", "ATOMS\nthree", ["line 6", "three"]),
        ("ITEM: BOX", "BOX", ["line 3", "BOX BOUNDS"]),
        ("7 0 0.75", "7 0.25 0.75", ["plane", "0.25"]),
        ("xy xz yz pp pp pp", "", ["line 7", "''"]),
    ],
)
def test_bad_lammps_dump_is_refused_with_its_line(lammps, old, new, words):
    assert old in LAMMPS_DUMP
    refuses(lammps(LAMMPS_DUMP.replace(old, new, 1)), *words)


@pytest.mark.parametrize(("text", "old", "index"), [(LAMMPS_DATA_VECTORS, "10 0 0", 0), (LAMMPS_DUMP, "10 0 0", 3)])
def test_lammps_lattice_vector_out_of_the_plane(lammps, text, old, index):
    path = lammps(text.replace(old, "10 0 0.5"))
    refuses(path, "plane", "0.5", read=lambda path: import_packing(path, index))


def test_lammps_dump_index_out_of_range(lammps):
    refuses(lammps(LAMMPS_DUMP), "holds 4", read=lambda path: import_packing(path, 4))


@given(st.floats(0, 1, exclude_max=True))
def test_truncated_lammps(tmp_path_factory, fraction):
    path = tmp_path_factory.mktemp("io") / "p.lammps"
    for text, index in ((LAMMPS_DATA[: LAMMPS_DATA.index("\n\nVelo")], 0), (LAMMPS_DUMP, 3)):
        path.write_text(text.rsplit(" ", 1)[0][: int(fraction * len(text))])
        refuses(path, read=lambda path, index=index: import_packing(path, index))


# The potential: that of the file, else the one chosen, else harmonic


@pytest.mark.parametrize("chosen", ["harmonic", "harmonic-relative"])
@pytest.mark.parametrize("text", [LAMMPS_DATA, LAMMPS_DUMP])
def test_potential_of_lammps_can_be_chosen(lammps, text, chosen):
    path = lammps(text)
    assert import_packing(path).potential_name == "harmonic"
    assert import_packing(path, potential_name=chosen).potential_name == chosen


def test_potential_of_gsd_can_be_chosen(frames):
    path = frames({})
    assert import_packing(path).potential_name == "harmonic"
    assert import_packing(path, potential_name="harmonic-relative").potential_name == "harmonic-relative"


def test_potential_of_xyz_can_be_chosen_where_the_file_says_none(packing, tmp_path):
    path = tmp_path / "p.xyz"
    export_packing(packing, path)
    path.write_text(path.read_text().replace("potential=harmonic ", ""))
    refuses(path, "potential is missing")
    assert import_packing(path, potential_name="harmonic-relative").potential_name == "harmonic-relative"


def test_what_a_foreign_header_says_stays_in_the_header(packing, tmp_path):
    path = tmp_path / "p.xyz"
    export_packing(packing, path)
    said = "pressure=0.001 shear_stabilised=False program=petscjam source=elsewhere"
    path.write_text(path.read_text().replace(" source_checksum=", f" {said} source_checksum="))
    provenance = import_packing(path).provenance
    assert {key: provenance[key] for key in provenance if key != "header"} == {
        "source": "p.xyz",
        "format": "extended XYZ",
    }
    assert provenance["header"] == {
        "pressure": "0.001",
        "shear_stabilised": "False",
        "program": "petscjam",
        "source": "elsewhere",
        "source_checksum": packing.checksum,
    }


@pytest.mark.parametrize("write", [None, Packing.write, export_packing])
def test_another_potential_than_that_of_the_file_is_refused(packing, tmp_path, write):
    path = SIXTEEN
    if write:
        path = tmp_path / "p"
        write(packing, path)
    assert import_packing(path, potential_name="harmonic").potential_name == "harmonic"
    refuses(
        path,
        "'harmonic'",
        "'harmonic-relative'",
        read=lambda path: import_packing(path, potential_name="harmonic-relative"),
    )


def test_another_potential_than_that_of_jaxmd_is_refused():
    refuses(
        JAXMD, "'harmonic'", "'harmonic-relative'", read=lambda path: import_packing(path, potential_name="harmonic")
    )


def test_unknown_potential(lammps):
    refuses(lammps(LAMMPS_DATA), "'morse'", "known are", read=lambda path: import_packing(path, potential_name="morse"))


# H5MD written elsewhere is our own file


def test_exported_h5md_is_the_same_packing(packing, tmp_path):
    packing = replace(packing, certificate=Certificate(Z=4.125))
    export_packing(packing, tmp_path / "p.h5md", to="h5md")
    found = Packing.read(tmp_path / "p.h5md")
    assert same_bits(packing, found)
    assert (found.certificate, found.provenance) == (packing.certificate, packing.provenance)


def test_existing_output_is_refused(packing, tmp_path):
    (tmp_path / "p").write_text("precious")
    for to in ("gsd", "h5md"):
        with pytest.raises(InputError, match="exists"):
            export_packing(packing, tmp_path / "p", to=to)
    assert (tmp_path / "p").read_text() == "precious"


# Real programs, in an environment of their own, see the same disks and the same contacts


@pytest.fixture(scope="module")
def viewers():
    """Return a Python that has MDAnalysis, freud and OVITO; it is made once (a gigabyte)."""
    folder = Path(__file__).parents[1] / ".venv-viewers"
    python, ready = folder / "bin" / "python", folder / ".ready"
    if not ready.exists():
        subprocess.run([sys.executable, "-m", "venv", "--clear", folder], check=True)
        packages = ["MDAnalysis", "h5py", "gsd", "freud-analysis", "ovito"]
        subprocess.run([python, "-m", "pip", "install", "-q", *packages], check=True)
        ready.touch()
    return python


MDANALYSIS = """
import MDAnalysis
from MDAnalysis.lib.distances import self_capped_distance
from MDAnalysis.lib.mdamath import triclinic_vectors
import h5py
universe = MDAnalysis.Universe.empty(16, trajectory=True)
universe.load_new(path, format="H5MD", convert_units=False)
positions, cell = universe.atoms.positions, triclinic_vectors(universe.dimensions)
radii = h5py.File(path)["particles/trajectory/radius"][()]
pairs, distance = self_capped_distance(positions, 2 * radii.max(), box=universe.dimensions)
"""
FREUD = """
import freud, gsd.hoomd
frame = gsd.hoomd.open(path)[0]
system = freud.locality.AABBQuery.from_system(frame)
assert system.box.is2D
positions, cell, radii = system.points, system.box.to_matrix().T, frame.particles.diameter / 2
found = system.query(positions, dict(r_max=2 * radii.max(), exclude_ii=True)).toNeighborList()
pairs, distance = found[:], found.distances
"""
OVITO = """
from ovito.data import CutoffNeighborFinder
from ovito.io import import_file
data = import_file(path).compute()
positions, radii, cell = data.particles.positions[...], data.particles["Radius"][...], data.cell[:, :3].T
assert data.cell.pbc[:2] == (True, True)
finder = CutoffNeighborFinder(2 * radii.max(), data)
found = [(i, other.index, other.distance) for i in range(len(radii)) for other in finder.find(i)]
pairs, distance = np.array([f[:2] for f in found]), np.array([f[2] for f in found])
"""
TELL = """
touching = pairs[distance < radii[pairs].sum(1)]
found = dict(positions=positions, cell=cell, radii=radii, contacts=np.unique(np.sort(touching), axis=0))
print(json.dumps({name: np.asarray(value).tolist() for name, value in found.items()}))
"""


def contacts(packing):
    network = ContactNetwork.of(packing)
    return sorted(map(list, zip(network.i.tolist(), network.j.tolist(), strict=True)))


def sees(python, program, path, packing, tolerance):
    """The program finds in the file at ``path`` what ``packing`` is."""
    code = "\n".join(["import json", "import numpy as np", f"path = {str(path)!r}", program, TELL])
    run = subprocess.run([python, "-c", code], capture_output=True, text=True)
    assert run.returncode == 0, run.stderr
    found = json.loads(run.stdout.splitlines()[-1])
    assert np.abs(np.array(found["positions"])[:, :2] - packing.positions).max() <= tolerance
    assert np.abs(np.array(found["cell"])[:2, :2] - packing.box.cell).max() <= tolerance
    assert np.abs(np.array(found["radii"]) / packing.radii - 1).max() < 1e-7  # OVITO's are of single precision
    assert found["contacts"] == contacts(packing)


@pytest.mark.slow
@pytest.mark.timeout(1800)
def test_mdanalysis_opens_h5md(viewers, packing, tmp_path):
    export_packing(packing, tmp_path / "p.h5md", to="h5md")
    sees(viewers, MDANALYSIS, tmp_path / "p.h5md", packing, 1e-5)  # positions and angles of single precision


@pytest.mark.slow
@pytest.mark.timeout(1800)
@pytest.mark.parametrize("program", [FREUD, OVITO], ids=["freud", "ovito"])
def test_freud_and_ovito_open_gsd(viewers, either, tmp_path, program):
    export_packing(either, tmp_path / "p.gsd", to="gsd")
    sees(viewers, program, tmp_path / "p.gsd", import_packing(tmp_path / "p.gsd"), 1e-6)
    assert contacts(import_packing(tmp_path / "p.gsd")) == contacts(either)


@pytest.mark.slow
@pytest.mark.timeout(1800)
def test_ovito_opens_xyz(viewers, either, tmp_path):
    export_packing(either, tmp_path / "p.xyz")
    sees(viewers, OVITO, tmp_path / "p.xyz", either, 1e-14)


OVITO_WRITES = """
from ovito.io import export_file, import_file
pipeline = import_file(path + "/p.xyz")
export_file(pipeline, path + "/data", "lammps/data", atom_style="sphere", precision=17)
names = ["Particle Identifier", "Position.X", "Position.Y", "Position.Z", "Radius"]
export_file(pipeline, path + "/dump", "lammps/dump", columns=names, precision=17)
"""


@pytest.mark.slow
@pytest.mark.timeout(1800)
def test_lammps_files_of_ovito(viewers, packing, tmp_path):
    export_packing(packing, tmp_path / "p.xyz")
    subprocess.run([viewers, "-c", f"path = {str(tmp_path)!r}{OVITO_WRITES}"], check=True)
    for name in ("data", "dump"):
        found = import_packing(tmp_path / name)
        assert np.abs(found.positions - packing.positions).max() < 1e-14
        assert np.abs(found.box.cell - packing.box.cell).max() < 1e-14
        assert contacts(found) == contacts(packing)
