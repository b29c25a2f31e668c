"""Files of other programs in all their legal forms, and cut, contradictory or imprecise ones."""

import bz2
import gzip
import lzma
import re
from dataclasses import replace
from pathlib import Path

import gsd.hoomd
import h5py
import numpy as np
import pytest
from helpers import SIXTEEN
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.io import netcdf_file
from test_io import refuses, same_bits

import petscjam as pj
from petscjam.base.arguments import parsed, parsed_whole
from petscjam.base.errors import InputError
from petscjam.cli import main
from petscjam.geometry.box import Box
from petscjam.geometry.network import ContactNetwork
from petscjam.geometry.packing import Packing
from petscjam.geometry.potential import POTENTIALS
from petscjam.io.exporters import export_packing, extended_xyz
from petscjam.io.importers import imbalance, import_packing

CELL = np.array([[9.0, 0], [1.5, 8.0]])
POSITIONS = np.array([[0.25, 0.5], [3.125, 2.0], [8.0, 7.5]])
RADII = np.array([0.5, 0.5, 0.7])
EDGE_LENGTHS = np.array([9.0, 8.0])
HEADER = 'Lattice="9 0 0 1.5 8 0 0 0 1" Properties=species:S:1:pos:R:3:radius:R:1 pbc="T T F" potential=harmonic'
ROWS = "A 0.25 0.5 0 0.5\nA 3.125 2 0 0.5\nB 8 7.5 0 0.7\n"
XYZ = f"3\n{HEADER}\n{ROWS}"
DATA = """\
three disks

3 atoms
2 atom types

0 9 xlo xhi
0 8 ylo yhi
-0.5 0.5 zlo zhi
1.5 0 0 xy xz yz

Atoms # sphere

1 1 1 1 0.25 0.5 0
2 1 1 1 3.125 2 0
3 2 1.4 1 8 7.5 0
"""
DUMP = """\
ITEM: TIMESTEP
0
ITEM: NUMBER OF ATOMS
3
ITEM: BOX BOUNDS xy xz yz pp pp pp
0 10.5 1.5
0 8 0
-0.5 0.5 0
ITEM: ATOMS id type x y z radius
1 1 0.25 0.5 0 0.5
2 1 3.125 2 0 0.5
3 2 8 7.5 0 0.7
"""
TEXTS = {"xyz": XYZ, "data": DATA, "dump": DUMP}


@pytest.fixture
def write(tmp_path):
    def write(content, name="p.txt"):
        path = tmp_path / name
        path.write_bytes(content if isinstance(content, bytes) else content.encode())
        return path

    return write


@pytest.fixture
def packing():
    return import_packing(SIXTEEN)


def is_it(found, positions=POSITIONS, cell=CELL, radii=RADII):
    assert found.positions.tolist() == np.asarray(positions).tolist()
    assert found.box.cell.tolist() == np.asarray(cell).tolist()
    assert found.radii.tolist() == np.asarray(radii).tolist()
    return True


@pytest.mark.parametrize("text", TEXTS.values(), ids=TEXTS)
def test_three_disks(write, text):
    assert is_it(import_packing(write(text)))


# Numbers


@pytest.mark.parametrize(
    ("text", "value"),
    [("1.5D-03", 1.5e-3), ("1d2", 100.0), ("-.5E+1", -5.0), ("5.", 5.0), ("+7", 7.0), (" 1e-300 ", 1e-300)],
)
def test_numbers_of_C_and_Fortran(text, value):
    assert parsed(text) == value


@pytest.mark.parametrize("text", ["1_5", "nan", "inf", "-Infinity", "1e999", "", "0x10", "1,5", "١", "1e", "1 5"])
def test_no_numbers(text):
    with pytest.raises(ValueError, match="is not a finite number"):
        parsed(text)


@pytest.mark.parametrize("text", ["1_0", "1.0", "١", "", "+-1"])
def test_no_whole_numbers(text):
    with pytest.raises(ValueError, match="is not a whole number"):
        parsed_whole(text)


@pytest.mark.parametrize(("name", "line"), [("xyz", 4), ("data", 14), ("dump", 11)])
def test_underscores_are_refused_with_their_line(write, name, line):
    refuses(write(TEXTS[name].replace("3.125", "3.1_25")), f"line {line}", "3.1_25")


@pytest.mark.parametrize("options", [["--pressure", "1_0"], ["--seed", "1_0"], ["--particles", "1_6"]])
def test_underscores_are_refused_in_options(tmp_path, capfd, options):
    assert main(["prepare", *options, "-o", str(tmp_path / "p.h5")]) == 2
    assert "1_" in capfd.readouterr().err


# Bytes before the text, and around it


@pytest.mark.parametrize("text", [*TEXTS.values(), SIXTEEN.read_text()], ids=[*TEXTS, "jamBashBulk"])
@pytest.mark.parametrize("before", [b"\xef\xbb\xbf", b"\n", b"\r\n \n", b"\xef\xbb\xbf\n"])
def test_byte_order_mark_and_blank_lines(write, text, before):
    if text == DATA and b"\n" in before:
        pytest.skip("the first line of a data file is its title")
    plain = import_packing(write(text))
    assert same_bits(import_packing(write(before + text.encode())), plain)


@pytest.mark.parametrize("text", TEXTS.values(), ids=TEXTS)
@pytest.mark.parametrize("end", ["\r\n", "\r"])
def test_ends_of_lines_of_other_systems(write, text, end):
    assert is_it(import_packing(write(text.replace("\n", end))))


def test_lines_are_counted_from_the_first_one_in_the_file(write):
    refuses(write("\n\n" + XYZ.replace("3.125", "x")), "line 6")


@pytest.mark.parametrize("text", TEXTS.values(), ids=TEXTS)
@pytest.mark.parametrize("encoding", ["utf-16", "utf-16-le", "utf-16-be"])
def test_utf_16_is_named(write, text, encoding):
    refuses(write(text.encode(encoding)), "UTF-16", "iconv")


def test_fortran_exponents(write, packing):
    """17 digits give the same bits, and the checksum of the header fits."""
    text = extended_xyz(packing).decode()
    lines = text.splitlines()
    rows = [line.split() for line in lines[2:]]
    rows = [" ".join([name, *(f"{float(x):.17E}".replace("E", "D") for x in row)]) for name, *row in rows]
    path = write("\n".join([*lines[:2], *rows, ""]))
    assert "D+00" in path.read_text()
    assert same_bits(import_packing(path), packing)


@pytest.mark.parametrize("pack", [gzip.compress, bz2.compress, lzma.compress], ids=["gz", "bz2", "xz"])
@pytest.mark.parametrize("to", ["xyz", "gsd", "h5md"])
def test_packed_files(write, packing, tmp_path, pack, to):
    """By content, whatever the name."""
    export_packing(packing, tmp_path / "plain", to=to)
    path = write(pack((tmp_path / "plain").read_bytes()), "packed.dat")
    found = import_packing(path)
    assert same_bits(found, import_packing(tmp_path / "plain"))
    if to != "h5md":
        assert found.provenance["source"] == "packed.dat"


@pytest.mark.parametrize("pack", [gzip.compress, bz2.compress, lzma.compress], ids=["gz", "bz2", "xz"])
def test_packed_files_that_are_cut_or_bad(write, pack):
    packed = pack(XYZ.encode())
    for size in range(8, len(packed)):
        refuses(write(packed[:size]))
    refuses(write(pack(XYZ.replace("3.125", "x").encode())), "line 4: 'x'")
    refuses(write(pack(b"poem")), "unknown format")


def test_a_name_alone_makes_no_packed_file(write):
    assert is_it(import_packing(write(DUMP, "p.dump.gz")))


# Cut files


@pytest.mark.parametrize("text", TEXTS.values(), ids=TEXTS)
def test_a_file_cut_anywhere_is_refused(write, text):
    """Even within the last number, and where only the end of the last line is missing."""
    for size in range(len(text)):
        refuses(write(text[:size]))


def test_a_cut_frame_leaves_those_before(write):
    path = write(DUMP + DUMP.replace("8 7.5 0 0.7\n", "8 7.5 0 0."))
    assert is_it(import_packing(path))
    refuses(path, "line 24", "digits", read=lambda path: import_packing(path, 1))
    path = write(XYZ + XYZ[:-2])
    assert is_it(import_packing(path))
    refuses(path, "line 10", "digits", read=lambda path: import_packing(path, 1))


def test_the_checksum_in_the_header_of_xyz_is_compared(write, packing):
    text = extended_xyz(packing).decode()
    assert text.endswith(" 1.4\n")
    for cut in (1, 2):
        refuses(write(text[: -1 - cut]), "checksum", packing.checksum)
    refuses(write(text.replace("1.0\n", "1.1\n", 1)), "checksum", packing.checksum, "line 2")


def test_with_the_right_checksum_the_last_line_needs_no_end(write, packing):
    assert same_bits(import_packing(write(extended_xyz(packing).rstrip())), packing)


# Contradictions


def test_a_key_with_two_values(write):
    refuses(write(XYZ.replace("pbc", 'Lattice="20 0 0 0 20 0 0 0 1" pbc')), "line 2", "Lattice", "twice")
    assert is_it(import_packing(write(XYZ.replace("pbc", "potential=harmonic pbc"))))


def test_a_column_twice(write):
    text = XYZ.replace("radius:R:1", "radius:R:1:radius:R:1")
    text = re.sub(r"(0\.[57])\n", r"\1 0.5\n", text)
    refuses(write(text), "line 2", "column radius", "twice")
    text = re.sub("z radius", "z radius radius", DUMP)
    refuses(write(re.sub(r" 0 (0\.[57])\n", r" 0 \1 0.5\n", text)), "line 9", "column radius", "twice")


def test_an_item_or_a_keyword_twice(write):
    refuses(write(DUMP.replace("ITEM: ATOMS", "ITEM: NUMBER OF ATOMS\n3\nITEM: ATOMS")), "line 9", "NUMBER OF ATOMS")
    refuses(write(DATA.replace("0 8 ylo", "0 7 ylo yhi\n0 8 ylo")), "line 8", "ylo yhi", "twice")
    refuses(write(DATA.replace("3 atoms\n", "3 atoms\n4 atoms\n")), "line 4", "atoms", "twice")
    refuses(write(DATA + "\nAtoms # sphere\n\n1 1 1 1 0 0 0\n"), "section Atoms", "twice")


@pytest.mark.parametrize("name", ["data", "dump"])
@pytest.mark.parametrize(
    ("new", "word"), [("2 1", "id 2 is twice"), ("1.5 1", "id 1.5"), ("-1 1", "id -1")], ids=["twice", "half", "-1"]
)
def test_ids_that_cannot_be(write, name, new, word):
    refuses(write(re.sub(r"(?m)^1 1 ", new + " ", TEXTS[name])), word)


@pytest.mark.parametrize(
    ("name", "old", "new", "word"),
    [
        ("data", "0 9 xlo", "9 0 xlo", "xlo = 9"),
        ("data", "0 8 ylo", "8 0 ylo", "ylo = 8"),
        ("dump", "0 10.5 1.5", "10.5 0 1.5", "xlo = 10.5"),
        ("dump", "0 8 0", "8 0 0", "ylo = 8"),
        ("data", "3 atoms", "3.5 atoms", "3.5 atoms"),
        ("dump", "ATOMS\n3", "ATOMS\n3.5", "line 4"),
        ("dump", "ATOMS\n3", "ATOMS\n-3", "-3"),
        ("xyz", "3\nL", "-3\nL", "line 1"),
        ("xyz", "3\nL", "3.0\nL", "line 1"),
        ("data", "0 9 xlo", "0 0 9 xlo", "3 numbers"),
    ],
)
def test_boxes_and_numbers_that_cannot_be(write, name, old, new, word):
    assert old in TEXTS[name]
    refuses(write(TEXTS[name].replace(old, new, 1)), word)


def with_diameter(text, diameters):
    text = text.replace("z radius", "z radius diameter").replace("radius:R:1", "radius:R:1:diameter:R:1")
    rows = iter(diameters)
    return re.sub(r" (0\.[57])\n", lambda found: f" {found[1]} {next(rows)}\n", text)


@pytest.mark.parametrize("name", ["xyz", "dump"])
def test_radius_and_diameter(write, name):
    assert is_it(import_packing(write(with_diameter(TEXTS[name], [1, 1.000001, 1.4]))))
    refuses(write(with_diameter(TEXTS[name], [1, 1, 1.5])), "disk 2", "radius 0.7", "diameter 1.5")


def test_a_column_diameter_alone(write):
    text = XYZ.replace("radius", "diameter").replace("0.7", "1.4").replace(" 0 0.5", " 0 1")
    assert is_it(import_packing(write(text)))


# Data files of LAMMPS


def test_comments_and_blank_lines_inside_a_section(write):
    text = DATA.replace("0.25 0.5 0\n", "0.25 0.5 0  # the first\n\n# second batch\n")
    assert is_it(import_packing(write(text)))
    refuses(write(text.replace("3.125 2", "3.125 two")), "line 16", "two")
    refuses(write(text.replace("3.125 2", "3.125")), "line 16", "7 columns")


def test_a_section_behind_the_atoms(write):
    assert is_it(import_packing(write(f"{DATA}\nVelocities\n\n1 0 0 0 0 0 0\n")))
    refuses(write(DATA.replace("3 atoms", "2 atoms")), "line 11", "3 rows", "2 atoms")


def test_bpm_sphere(write):
    """A column of molecules comes before the types."""
    text = re.sub(r"(?m)^(\d) (\d .* 0)$", r"\1 7 \2", DATA.replace("# sphere", "# bpm/sphere"))
    assert "1 7 1 1 1 0.25" in text
    assert is_it(import_packing(write(text)))


# Extended XYZ


@pytest.mark.parametrize(
    ("old", "new"),
    [
        ('pbc="T T F"', 'pbc="1 1 0"'),
        ('pbc="T T F"', "pbc=[T, T, F]"),
        ('pbc="T T F"', ""),
        ('pbc="T T F"', 'pbc="True True False"'),
        ('pbc="T T F"', "pbc = 'T T F'"),
        ('pbc="T T F"', "pbc={T T T}"),
        ('Lattice="9 0 0 1.5 8 0 0 0 1"', 'Lattice="9 0 1.5 8"'),
        ('Lattice="9 0 0 1.5 8 0 0 0 1"', "Lattice='9.0 0 0 1.5 8.0 0 0 0 1'"),
        ('Lattice="9 0 0 1.5 8 0 0 0 1"', "Lattice = [[9, 0, 0], [1.5, 8, 0], [0, 0, 1]]"),
        ('Lattice="9 0 0 1.5 8 0 0 0 1"', "Lattice=[[9, 0], [1.5, 8]]"),
        ('Lattice="9 0 0 1.5 8 0 0 0 1"', '"Lattice" = {9 0 0 1.5 8 0 0 0 1}'),
        ("Lattice", "by O'Hern Lattice"),
        ("Lattice", "author=O'Hern Lattice"),
        ("Lattice", """note="O'Hern's \\"jammed\\" disks, a=b" Lattice"""),
        ("Lattice", "flag note='a b' Lattice"),
        ("potential=harmonic", 'potential="harmonic"'),
        ("potential=harmonic", "potential = harmonic energy=1e-3"),
    ],
)
def test_legal_forms_of_the_comment_line(write, old, new):
    assert old in XYZ
    assert is_it(import_packing(write(XYZ.replace(old, new, 1))))


def test_what_stands_in_quotes_is_one_value(write):
    said = """note="O'Hern's \\"jammed\\" disks, a=b" author=O'Hern"""
    header = import_packing(write(XYZ.replace("Lattice", f"{said} Lattice"))).provenance["header"]
    assert header == {"note": "O'Hern's \"jammed\" disks, a=b", "author": "O'Hern"}


@pytest.mark.parametrize("pbc", ["1 0 0", "F T F", "T", "[T, F, T]"])
def test_not_periodic(write, pbc):
    refuses(write(XYZ.replace('pbc="T T F"', f'pbc="{pbc}"')), "line 2", "periodic")


@pytest.mark.parametrize("lattice", ["9 8", "9 0 0 8 0 0", "9 0 0 1.5 8 0 0 0"])
def test_lattices_that_cannot_be(write, lattice):
    refuses(write(XYZ.replace("9 0 0 1.5 8 0 0 0 1", lattice)), "line 2", "Lattice")


def test_positions_in_two_columns(write):
    text = XYZ.replace("pos:R:3", "pos:R:2").replace(" 0 0.5\n", " 0.5\n").replace(" 0 0.7\n", " 0.7\n")
    assert is_it(import_packing(write(text)))


def test_frames_of_xyz(write):
    path = write(XYZ + XYZ.replace("8 7.5", "8 7.25").replace("1.5 8 0", "2 8 0") + "\n\n")
    assert is_it(import_packing(path, 0))
    second = import_packing(path, 1)
    assert is_it(second, [*POSITIONS[:2], [8, 7.25]], [[9, 0], [2, 8]])
    assert second.provenance["index"] == 1
    refuses(path, "holds 2", read=lambda path: import_packing(path, 2))
    refuses(write(XYZ + XYZ.replace("3.125", "x")), "line 9", read=lambda path: import_packing(path, 1))


def test_plain_xyz_says_what_is_missing(write):
    refuses(write("3\nthree disks\nA 0 0 0\nA 1 1 0\nB 2 2 0\n"), "line 2", "Lattice is missing")


# z that is zero but for rounding


def lifted(name, tmp_path, z):
    """The third disk lies at z instead of 0."""
    if name in TEXTS:
        text = re.sub(r"(?m)8 7.5 0( |$)", rf"8 7.5 {z}\1", TEXTS[name])
        (tmp_path / "p").write_text(text)
    elif name == "scaled dump":  # the box is 2 high
        text = DUMP.replace("-0.5 0.5 0", "-1 1 0").replace("x y z", "xs ys zs")
        for x, y in POSITIONS.tolist():
            s, t = np.linalg.solve(CELL.T, [x, y]).tolist()
            text = text.replace(f"{x:g} {y:g} 0 ", f"{s!r} {t!r} {z / 2 + 0.5 if x == 8 else 0.5!r} ")
        (tmp_path / "p").write_text(text)
    elif name == "GSD":
        write_gsd(tmp_path / "p", position=np.array([[0, 0, 0], [1, 0.5, z]]), diameter=[1, 1.5])
    else:
        write_h5md(
            tmp_path / "p",
            x=np.pad(POSITIONS, ((0, 0), (0, 1))) + np.outer([0, 0, z], [0, 0, 1]),
            edges=np.diag([9.0, 8.0, 1.0]),
            radius=RADII,
        )
    return tmp_path / "p"


FORMATS_WITH_Z = [*TEXTS, "scaled dump", "GSD", "H5MD"]


@pytest.mark.parametrize("name", FORMATS_WITH_Z)
def test_z_may_be_rounded(tmp_path, name):
    assert len(import_packing(lifted(name, tmp_path, 4e-7))) in (2, 3)


@pytest.mark.parametrize("name", FORMATS_WITH_Z)
def test_z_may_not_be_more(tmp_path, name):
    refuses(lifted(name, tmp_path, 6e-7), "not in the plane")


@pytest.mark.parametrize("unit", [1e-9, 1e9])
def test_how_flat_a_packing_is_does_not_depend_on_the_unit(write, unit):
    def text(z):
        rows = [f"A {x * unit!r} {y * unit!r} {z * unit!r} {0.5 * unit!r}" for x, y in POSITIONS.tolist()]
        rows[0] = rows[0].replace(repr(z * unit), "0")
        cell = " ".join(repr(v * unit) for v in [9.0, 0.0, 0.0, 1.5, 8.0, 0.0, 0.0, 0.0, 1.0])
        return "\n".join(["3", HEADER.replace("9 0 0 1.5 8 0 0 0 1", cell), *rows, ""])

    assert len(import_packing(write(text(4e-7)))) == 3
    refuses(write(text(6e-7)), "not in the plane")


# GSD


def write_gsd(path, **changes):
    frame = gsd.hoomd.Frame()
    frame.configuration.box = [4, 2, 0, 0.5, 0, 0]
    frame.particles.N, frame.particles.types, frame.particles.typeid = 2, ["A", "B"], [0, 1]
    frame.particles.position = [[0, 0, 0], [1, 0.5, 0]]
    for name, value in changes.items():
        setattr(frame.particles, name, value)
    with gsd.hoomd.open(path, "w") as file:
        file.append(frame)
    return path


def sphere(diameter):
    return {"type": "Sphere", "diameter": diameter}


SQUARE = {"type": "Polygon", "vertices": [[-0.5, -0.5], [0.5, -0.5], [0.5, 0.5]], "rounding_radius": 0.0}


def test_diameters_of_shapes(tmp_path):
    path = write_gsd(tmp_path / "p.gsd", type_shapes=[sphere(1.0), sphere(1.4)])
    assert import_packing(path).radii.tolist() == [0.5, 0.7]
    path = write_gsd(tmp_path / "p.gsd", types=["A"], typeid=[0, 0], type_shapes=[sphere(1.4)])
    assert import_packing(path).radii.tolist() == [0.7, 0.7]


def test_diameters_of_disks_and_shapes_agree(tmp_path):
    shapes = [sphere(1.0), sphere(1.4)]
    path = write_gsd(tmp_path / "p.gsd", diameter=[1.0, 1.4], type_shapes=shapes)
    assert import_packing(path).radii.tolist() == [0.5, 0.7]
    path = write_gsd(tmp_path / "p.gsd", diameter=[1.0, 1.2], type_shapes=shapes)
    refuses(path, "disk 1 is 1.2", "1.4", "type B")


@pytest.mark.parametrize(
    "shape", [SQUARE, {"type": "Ellipsoid", "a": 1.0, "b": 0.5, "c": 1.0}, {"type": "Sphere"}, sphere("1")]
)
def test_shapes_that_are_no_disks(tmp_path, shape):
    refuses(write_gsd(tmp_path / "p.gsd", diameter=[1.0, 1.4], type_shapes=[shape, sphere(1.4)]), "type A is no disk")


def test_shapes_that_no_disk_has_do_not_matter(tmp_path):
    path = write_gsd(tmp_path / "p.gsd", typeid=[1, 1], type_shapes=[SQUARE, sphere(1.4)])
    assert import_packing(path).radii.tolist() == [0.7, 0.7]


EDGES = [0.0, 0.25, 0.5, 0.6, 1 - 1e-12, 1 - 1e-9, 1 - 3e-8, 1 - 1e-16, 1e-17, -1e-17, -1e-9]


@settings(max_examples=40)
@given(
    st.lists(st.tuples(*[st.sampled_from(EDGES) | st.floats(0, 1)] * 2), min_size=1, max_size=20),
    st.floats(-3, 3),
    st.floats(0.1, 10),
    st.integers(-8, 8),
)
def test_gsd_lies_in_the_cell_in_single_precision(tmp_path_factory, fractions, tilt, height, power):
    """As a program finds it that computes in single precision, and one that computes in double."""
    cell = 10.0**power * np.array([[1, 0], [tilt, height]])
    path = tmp_path_factory.mktemp("io") / "p.gsd"
    export_packing(Packing(np.array(fractions) @ cell, np.ones(len(fractions)), Box(cell)), path)
    with gsd.hoomd.open(path) as file:
        box, x = file[0].configuration.box, file[0].particles.position
    there = np.array(fractions) @ cell
    for kind in (np.float32, np.float64):
        Lx, Ly, _, xy = np.asarray(box, dtype=np.float32)[:4].astype(kind)
        s = np.stack([(x[:, 0].astype(kind) - xy * x[:, 1].astype(kind)) / Lx, x[:, 1].astype(kind) / Ly])
        assert s.dtype == kind
        assert (s >= -0.5).all()
        assert (s < 0.5).all()
    away = Box(cell).fractional(x[:, :2].astype(float) - there) - 0.5
    assert np.abs(away - np.rint(away)).max() < 1e-6 * (1 + abs(tilt / min(height, 1)))


# Types instead of radii


def without_radii(name, tmp_path):
    path = tmp_path / "p"
    if name == "GSD":
        return write_gsd(path, types=["1", "2"])
    if name == "H5MD":
        return write_h5md(path, species=np.array([1, 2, 1]))
    xyz = XYZ.replace(":radius:R:1", "").replace("A ", "1 ").replace("B ", "2 ")
    texts = {
        "xyz": xyz,
        "xyz of types": xyz.replace("species:S", "type:I"),
        "data": re.sub(r"(?m)^(\d \d) 1(\.4)? 1 ", r"\1 ", DATA.replace("# sphere", "# atomic")),
        "dump": DUMP.replace(" radius", ""),
    }
    path.write_text(re.sub(r"(\d 0) 0\.[57]\n", r"\1\n", texts[name]))
    return path


TYPED = ["xyz", "xyz of types", "data", "dump", "GSD", "H5MD"]


@pytest.mark.parametrize("name", TYPED)
def test_diameters_of_types(tmp_path, name):
    found = import_packing(without_radii(name, tmp_path), diameters={"1": 1.0, "2": 1.5})
    kinds = {"GSD": [0.5, 0.75], "H5MD": [0.5, 0.75, 0.5]}
    assert found.radii.tolist() == kinds.get(name, [0.5, 0.5, 0.75])


@pytest.mark.parametrize("name", TYPED)
def test_diameters_that_do_not_fit_the_types(tmp_path, name):
    path = without_radii(name, tmp_path)
    refuses(path, "--diameters 1:…,2:…")
    for diameters, words in (
        ({"1": 1.0}, ["type 2", "no diameter"]),
        ({"1": 1.0, "2": 1.4, "3": 2.0}, ["type 3", "occurs nowhere"]),
        ({"1": 1.0, "2": 0.0}, ["radius of disk"]),
        ({}, ["type 1", "no diameter"]),
    ):
        refuses(path, *words, read=lambda path, diameters=diameters: import_packing(path, diameters=diameters))


@pytest.mark.parametrize("text", [*TEXTS.values(), SIXTEEN.read_text()], ids=[*TEXTS, "jamBashBulk"])
def test_diameters_beside_radii(write, text):
    refuses(write(text), "has radii", read=lambda path: import_packing(path, diameters={"1": 1.0, "2": 1.4}))


def test_the_command_takes_diameters(tmp_path, capfd):
    path, out = without_radii("dump", tmp_path), tmp_path / "out.h5"
    assert main(["import", str(path), "--diameters", "1:1.0,2:1.4", "-o", str(out)]) == 0
    assert is_it(Packing.read(out))
    assert main(["info", str(path), "--diameters", "1:1,2:1.4"]) == 0
    capfd.readouterr()
    for bad in ("1:1.0,1:1.4", "1.0", "1:big", ":1", "1:1_0"):
        assert main(["import", str(path), "--diameters", bad, "-o", str(out), "--overwrite"]) == 2
        assert bad.split(",")[-1].split(":")[-1] in capfd.readouterr().err


# Databases of jsrc (Eigen stores its matrices by column: each two numbers are a lattice vector)


def write_jsrc(path, classic, packings, box=b"PeriodicBox_2D_0NonPDim:1", potential=None, size=4):
    values = {
        "pos": np.stack([p.box.fractional(p.positions).ravel() for p in packings]),
        "rad": np.stack([p.radii for p in packings]),
        "BoxMatrix": np.stack([np.resize(p.box.cell.ravel(), size) for p in packings]),
    }
    strings = {"BoxString": box, "PotString": potential}
    strings = {k: np.frombuffer(v.ljust(64, b":"), "S1") for k, v in strings.items() if v is not None}
    values |= {name: np.stack([value] * len(packings)) for name, value in strings.items()}
    if not classic:
        with h5py.File(path, "w") as file:
            for name, value in values.items():
                file[name] = value
        return path
    with netcdf_file(path, "w") as file:
        file.createDimension("rec", None)
        for name, value in values.items():
            file.createDimension(f"n{name}", value.shape[1])
            variable = file.createVariable(name, "c" if value.dtype.kind == "S" else "d", ("rec", f"n{name}"))
            variable[:] = value
    return path


@pytest.fixture(params=[True, False], ids=["classic", "HDF5"])
def classic(request):
    return request.param


def test_jsrc(tmp_path, packing, classic):
    other = replace(packing, radii=packing.radii * 0.5)
    path = write_jsrc(tmp_path / "p.nc", classic, [packing, other])
    found = import_packing(path, 1)
    assert np.abs(found.positions - packing.positions).max() < 1e-14
    assert (found.box.cell == packing.box.cell).all()
    assert (found.radii == other.radii).all()
    assert found.potential_name == "harmonic-relative"
    assert import_packing(path, potential_name="hertzian").potential_name == "hertzian"
    refuses(path, "holds 2", read=lambda path: import_packing(path, 2))


def test_jsrc_says_its_potential(tmp_path, packing, classic):
    path = write_jsrc(tmp_path / "p.nc", classic, [packing], potential=b"HertzianPotential:3ff0000000000000")
    assert import_packing(path).potential_name == "hertzian-relative"
    refuses(path, "hertzian-relative", read=lambda path: import_packing(path, potential_name="harmonic"))
    path = write_jsrc(tmp_path / "p.nc", classic, [packing], potential=b"KALJPotential:")
    refuses(path, "KALJPotential", "HarmonicPotential")


def test_jsrc_that_is_no_periodic_plane(tmp_path, packing, classic):
    refuses(write_jsrc(tmp_path / "p.nc", classic, [packing], box=b"PeriodicBox_2D_1NonPDim:1"), "1NonPDim")
    refuses(write_jsrc(tmp_path / "p.nc", classic, [packing], size=9), "not in the plane", "9 numbers")


def test_cut_jsrc(tmp_path, packing):
    path = write_jsrc(tmp_path / "p.nc", True, [packing])
    data = path.read_bytes()
    for size in range(4, len(data) - 64, 7):  # the last 64 bytes are parameters of the box
        path.write_bytes(data[:size])
        refuses(path)


# H5MD of other programs


def write_h5md(path, x=POSITIONS, edges=EDGE_LENGTHS, frames=None, boundary=("periodic",) * 3, **elements):
    """Arrays do not depend on time, tuples are steps and values; ``frames`` are positions at 0, 10, …"""
    with h5py.File(path, "w") as file:
        file.create_group("h5md/creator").attrs.update(name="other", version="1")
        file["h5md"].attrs["version"] = (1, 1)
        node = file.create_group("particles/all")
        if frames is None:
            node["position"] = x
        else:
            node["position/value"], node["position/step"] = frames, 10 * np.arange(len(frames))
        node.create_group("box").attrs.update(
            dimension=x.shape[1], boundary=np.array(boundary[: x.shape[1]], dtype="S")
        )
        for name, value in {"box/edges": edges, **elements}.items():
            if isinstance(value, tuple):
                node[f"{name}/step"], node[f"{name}/value"] = value
            else:
                node[name] = value
    return path


def test_h5md_of_others(tmp_path):
    found = import_packing(write_h5md(tmp_path / "p.h5", radius=RADII))
    assert is_it(found, cell=[[9, 0], [0, 8]])
    assert found.provenance["header"] == {"name": "other", "version": "1"}
    found = import_packing(write_h5md(tmp_path / "p.h5", radius=RADII, edges=CELL), potential_name="hertzian")
    assert is_it(found)
    assert found.potential_name == "hertzian"


def test_h5md_in_time(tmp_path):
    frames, steps = np.stack([POSITIONS, POSITIONS + 0.25]), np.array([0, 10])
    cells = np.stack([CELL, [[9, 0], [2, 8]]])
    radii = steps, np.stack([RADII, RADII])
    path = write_h5md(tmp_path / "p.h5", frames=frames, edges=(steps, cells), radius=radii)
    assert is_it(import_packing(path, 1), POSITIONS + 0.25, cells[1])
    refuses(path, "holds 2", read=lambda path: import_packing(path, 2))
    path = write_h5md(tmp_path / "p.h5", frames=frames, edges=(steps + 1, cells), radius=RADII)
    refuses(path, "box/edges", "other steps")


def test_h5md_without_radii_says_which_call_to_make(tmp_path):
    path = write_h5md(tmp_path / "p.h5")
    refuses(path, "no radius", "--diameters 1:…")
    assert import_packing(path, diameters={1: 1.5}).radii.tolist() == [0.75] * 3


def test_h5md_that_is_no_packing(tmp_path):
    refuses(write_h5md(tmp_path / "p.h5", radius=RADII, boundary=("periodic", "none")), "periodic", "none")
    refuses(write_h5md(tmp_path / "p.h5", radius=RADII, edges=np.ones(3)), "not in the plane", "(3,)")
    with h5py.File(tmp_path / "p.h5", "a") as file:
        del file["particles/all/position"]
    refuses(tmp_path / "p.h5", "0 groups", "Packing(")


def test_a_damaged_file_of_ours_is_not_taken_for_another(tmp_path, packing):
    packing.write(tmp_path / "p.h5")
    with h5py.File(tmp_path / "p.h5", "a") as file:
        del file["parameters/petscjam"]
    refuses(tmp_path / "p.h5", "lacks /parameters/petscjam")


# Forces that do not balance, and why


def dump_of(packing, digits="%.17g", size="%.17g"):
    cell, rows = packing.box.cell, []
    for i, ((x, y), radius) in enumerate(zip(packing.positions.tolist(), packing.radii.tolist(), strict=True), 1):
        rows.append(f"{i} 1 {digits} {digits} 0 {size}" % (x, y, radius))
    a, b, tilt = cell[0, 0], cell[1, 1], cell[1, 0]
    return "\n".join(
        [
            "ITEM: TIMESTEP\n0\nITEM: NUMBER OF ATOMS",
            str(len(packing)),
            "ITEM: BOX BOUNDS xy xz yz pp pp pp",
            f"0 {float(a + tilt)!r} {float(tilt)!r}\n0 {float(b)!r} 0\n{-b / 2:.3g} {b / 2:.3g} 0",
            "ITEM: ATOMS id type x y z radius",
            *rows,
            "",
        ]
    )


def scaled(packing, unit):
    return Packing(packing.positions * unit, packing.radii * unit, Box(packing.box.cell * unit), "harmonic")


@pytest.mark.parametrize("unit", [1.0, 1e-9, 3e8])
def test_balanced_forces_need_no_cause(write, packing, unit):
    p = scaled(packing, unit)
    assert imbalance(p) is None
    assert imbalance(import_packing(write(dump_of(p)))) is None


@pytest.mark.parametrize("unit", [1.0, 1e-9, 3e8])
@pytest.mark.parametrize("digits", [5, 6, 8])
def test_few_digits_are_the_likely_cause(write, packing, unit, digits):
    """The size is in p·d and in mean contact forces, as recomputed here from the contacts."""
    found = import_packing(write(dump_of(scaled(packing, unit), f"%.{digits}g")))
    said = imbalance(found)
    assert f"likely cause: positions of {digits} digits" in said
    assert found.provenance["precision"] == f"{digits} digits"
    network = ContactNetwork.of(found)
    net = np.zeros((len(found), 2))
    for i, j, f, r in zip(network.i, network.j, network.force, network.r, strict=True):
        net[i] -= f * r / np.hypot(*r)
        net[j] += f * r / np.hypot(*r)
    worst = np.hypot(*net.T).max()
    pressure = (network.force * network.distance).sum() / (2 * found.box.area)
    first, second = (float(number) for number in re.findall(r"([\d.e+-]+) (?:p·d|mean)", said)[:2])
    assert first == pytest.approx(worst / (pressure * found.mean_diameter), rel=0.06)
    assert second == pytest.approx(worst / network.force.mean(), rel=0.06)


def test_digits_that_a_file_of_ours_has_kept(write, packing, tmp_path):
    import_packing(write(dump_of(packing, "%.6g"))).write(tmp_path / "p.h5")
    assert "positions of 6 digits" in imbalance(Packing.read(tmp_path / "p.h5"))


def test_single_precision_is_the_likely_cause(write, packing, tmp_path):
    export_packing(packing, tmp_path / "p.gsd")
    assert "likely cause: positions in single precision" in imbalance(import_packing(tmp_path / "p.gsd"))
    single = replace(packing, positions=packing.positions.astype(np.float32))
    assert "likely cause: positions in single precision" in imbalance(import_packing(write(dump_of(single))))


def test_rounded_radii_are_the_likely_cause(write, packing):
    p = scaled(packing, 1 / 2.4)  # radii 0.41667 and 0.58333
    assert "likely cause: radii of 3 digits" in imbalance(import_packing(write(dump_of(p, size="%.3g"))))


def test_another_potential_is_the_likely_cause(packing):
    for name in POTENTIALS:
        said = imbalance(replace(packing, potential_name=name))
        assert said is None if name == "harmonic" else "--potential harmonic" in said


def test_of_shaken_disks_no_precision_is_the_cause(write, packing):
    shift = 1e-3 * np.random.default_rng(0).standard_normal(packing.positions.shape)
    shaken = replace(packing, positions=packing.positions + shift)
    for digits in ("%.17g", "%.9g"):
        assert "not at a minimum" in imbalance(import_packing(write(dump_of(shaken, digits))))


def test_the_command_names_the_cause(write, packing, tmp_path, capfd):
    path, out = write(dump_of(packing, "%.6g")), tmp_path / "out.h5"
    assert main(["import", str(path), "-o", str(out)]) == 0
    err = capfd.readouterr().err
    assert f"warning: {path}: the forces do not balance: up to " in err
    assert "positions of 6 digits" in err
    assert "--relax" in err
    assert main(["import", str(SIXTEEN), "-o", str(out), "--overwrite"]) == 0
    assert capfd.readouterr().err == ""


def test_relaxing_reports_before_and_after(write, packing, tmp_path, capsys):
    path, out = write(dump_of(packing, "%.5g")), tmp_path / "out.h5"
    assert main(["import", str(path), "--relax", "--pressure", "2e-3", "-o", str(out)]) == 0
    said = capsys.readouterr().out
    for name, p in (("before", import_packing(path)), ("after", Packing.read(out))):
        (line,) = (line for line in said.splitlines() if line.startswith(f"{name}:"))
        pressure, phi, Z = (float(number) for number in re.findall(r"= ([\d.e-]+)", line))
        network = ContactNetwork.of(p)
        assert (pressure, phi, Z) == pytest.approx((network.pressure, p.phi, network.Z), rel=1e-4)
    assert pressure == pytest.approx(2e-3, rel=1e-5)


# Hard disks, and whatever else is not jammed


@pytest.fixture
def hard(packing, tmp_path):
    path = tmp_path / "hard.xyz"
    export_packing(replace(packing, radii=0.97 * packing.radii), path)
    assert len(ContactNetwork.of(import_packing(path))) == 0
    return path


def test_hard_disks_are_sent_to_a_pressure(hard, tmp_path, capfd):
    out = tmp_path / "out.h5"
    assert main(["import", str(hard), "-o", str(out)]) == 0
    assert "--relax --pressure" in capfd.readouterr().err
    assert main(["import", str(hard), "--relax", "-o", str(out), "--overwrite"]) == 2
    assert "--relax --pressure" in capfd.readouterr().err
    assert main(["import", str(hard), "--relax", "--pressure", "1e-2", "-o", str(out), "--overwrite"]) == 0
    assert Packing.read(out).certificate.proved


def test_info_of_hard_disks(hard, tmp_path, capsys):
    out = tmp_path / "out.h5"
    main(["import", str(hard), "-o", str(out)])
    for path in (hard, out):
        capsys.readouterr()
        assert main(["info", str(path)]) == 0
        said = capsys.readouterr().out
        assert said.splitlines()[0].split() == ["file", str(path)]
        assert "contacts           0, 0 in the backbone, Z = 0" in said
        assert "not jammed" in said


def test_info_of_disks_on_one_point(write, capsys):
    path = write(XYZ.replace("3.125 2 0", "0.25 0.5 0"))
    assert main(["info", str(path)]) == 0
    assert "disks 0 and 1 lie on the same point" in capsys.readouterr().out


def test_info_of_a_file_that_does_not_say_all(write, capfd):
    path = write(XYZ.replace("potential=harmonic", "") * 2)
    assert main(["info", str(path)]) == 2
    assert main(["info", str(path), "--potential", "hertzian", "--index", "1"]) == 0
    assert "hertzian" in capfd.readouterr().out


def test_info_takes_no_index_of_what_is_no_packing(tmp_path, capfd):
    out = tmp_path / "p.h5"
    pj.prepare_packing(16, 1e-2).write(tmp_path / "q.h5")
    main(["moduli", str(tmp_path / "q.h5"), "--omega", "1", "-o", str(out)])
    capfd.readouterr()
    assert main(["info", str(out), "--index", "1"]) == 2
    assert str(out) in capfd.readouterr().err


# The ending of an output decides


@pytest.mark.parametrize(
    ("name", "start"),
    [
        ("p.gsd", b"\xdf\x65"),
        ("p.xyz", b"16\n"),
        ("p.extxyz", b"16\n"),
        ("p.h5", b"\x89HDF"),
        ("p.h5md", b"\x89HDF"),
        ("p.GSD", b"\xdf\x65"),
        ("p", b"16\n"),
    ],
)
def test_the_ending_decides(packing, tmp_path, name, start):
    export_packing(packing, tmp_path / name)
    assert (tmp_path / name).read_bytes().startswith(start)
    packing.write(tmp_path / "in.h5")
    assert main(["export", str(tmp_path / "in.h5"), "-o", str(tmp_path / name), "--overwrite"]) == 0
    assert (tmp_path / name).read_bytes().startswith(start)


@pytest.mark.parametrize(
    ("name", "to", "words"),
    [
        ("p.gsd", "xyz", "gsd, not of xyz"),
        ("p.h5", "gsd", "h5md, not of gsd"),
        ("p.dump", None, "'.dump'"),
        ("p.csv", None, "'csv' is unknown"),
        ("p.csv", "xyz", "csv, not of xyz"),
    ],
)
def test_an_ending_that_does_not_fit_is_refused(packing, tmp_path, name, to, words):
    with pytest.raises(InputError, match=words):
        export_packing(packing, tmp_path / name, to=to)
    assert list(tmp_path.iterdir()) == []


def test_another_ending_than_any_goes_with_a_format(packing, tmp_path):
    export_packing(packing, tmp_path / "p.dat", to="gsd")
    assert (tmp_path / "p.dat").read_bytes().startswith(b"\xdf\x65")


def test_import_writes_no_packing_into_a_file_of_another_ending(tmp_path, capfd):
    assert main(["import", str(SIXTEEN), "-o", str(tmp_path / "p.xyz")]) == 2
    assert "xyz, not of h5md" in capfd.readouterr().err


def test_moduli_follow_the_ending_too(packing, tmp_path, capfd):
    g = pj.complex_modulus(packing, [1.0])
    for path, fmt in ((tmp_path / "g.gsd", "csv"), (tmp_path / "g.csv", "tts")):
        with pytest.raises(InputError, match="is the ending of"):
            pj.export_rheology(g, path, fmt)
    packing.write(tmp_path / "p.h5")
    main(["moduli", str(tmp_path / "p.h5"), "--omega", "1e-2,1", "-o", str(tmp_path / "g.h5")])
    assert main(["export", str(tmp_path / "g.h5"), "-o", str(tmp_path / "g.tts")]) == 0
    assert "G'" in Path(tmp_path / "g.tts").read_text()
    capfd.readouterr()
    assert main(["export", str(tmp_path / "g.h5"), "-o", str(tmp_path / "g.xyz")]) == 2
    assert "not xyz" in capfd.readouterr().err
