"""Reading and writing packings: the same bits come back, and nothing wrong goes by unnoticed."""

import subprocess
import sys
from dataclasses import replace

import h5py
import numpy as np
import pytest
from helpers import JAXMD, SIXTEEN
from hypothesis import given
from hypothesis import strategies as st

from petscjam.base.errors import InputError
from petscjam.base.files import atomic_h5, open_h5, write_atomically
from petscjam.geometry.box import Box
from petscjam.geometry.network import ContactNetwork
from petscjam.geometry.packing import Certificate, Packing
from petscjam.io.exporters import export_packing
from petscjam.io.importers import import_packing


@st.composite
def packings(draw):
    """Any disks in any cell: rotated, sheared by several lattice vectors, left-handed, tiny or huge."""
    random = np.random.default_rng(draw(st.integers(0, 2**32)))
    scale = 10.0 ** draw(st.integers(-8, 8))
    angle, tilt = draw(st.floats(0, 6.3)), draw(st.floats(-3, 3))
    rotation = np.array([[np.cos(angle), np.sin(angle)], [-np.sin(angle), np.cos(angle)]])
    cell = scale * np.array([[1, 0], [tilt, draw(st.sampled_from([-0.7, 1.3]))]]) @ rotation
    n = draw(st.integers(1, 20))
    radii = scale * random.uniform(0.01, 1, n)
    return Packing(random.normal(size=(n, 2)) @ cell, radii, Box(cell), "harmonic-relative")


def same_bits(a, b):
    pairs = ((a.positions, b.positions), (a.radii, b.radii), (a.box.cell, b.box.cell))
    return all(x.tobytes() == y.tobytes() for x, y in pairs) and a.potential_name == b.potential_name


@pytest.fixture
def packing():
    return import_packing(SIXTEEN)


@pytest.fixture
def written(packing, tmp_path):
    packing.write(tmp_path / "p.h5")
    return tmp_path / "p.h5"


def refuses(path, *words, read=import_packing):
    """Reading fails with one line that names the file and contains ``words``."""
    with pytest.raises(InputError) as error:
        read(path)
    message = str(error.value)
    assert message.startswith(f"{path}: ")
    assert message.count(str(path)) == 1
    assert "\n" not in message
    for word in words:
        assert word in message


# Round trips


@given(packings())
def test_h5md_gives_back_the_same_bits(tmp_path_factory, packing):
    path = tmp_path_factory.mktemp("io") / "p.h5"
    packing.write(path)
    assert same_bits(packing, Packing.read(path))


@given(packings())
def test_xyz_gives_back_the_same_bits(tmp_path_factory, packing):
    path = tmp_path_factory.mktemp("io") / "p.xyz"
    export_packing(packing, path)
    assert same_bits(packing, import_packing(path))


def test_import_reads_our_own_files(packing, written):
    assert same_bits(packing, import_packing(written))


def test_certificate_comes_back_with_what_was_not_measured(packing, tmp_path):
    certificate = Certificate(max_force=1e-13, rattlers=0, Z=4.125, pressure=1e-3, proved=False)
    replace(packing, certificate=certificate).write(tmp_path / "p.h5")
    assert Packing.read(tmp_path / "p.h5").certificate == certificate


def test_provenance_comes_back(packing, tmp_path):
    origin = {"seed": np.int64(3), "pressure": 0.1, "by": "Müller", "stable": True, "versions": {"numpy": "2"}}
    replace(packing, provenance=origin).write(tmp_path / "p.h5")
    assert Packing.read(tmp_path / "p.h5").provenance == origin


def test_no_certificate_says_nothing(written):
    assert Packing.read(written).certificate == Certificate()
    assert Packing.read(written).certificate.proved is None


# The layout that other programs rely on: H5MD 1.1, three-dimensional


def test_h5md_boundary_is_periodic_in_the_plane_only(written):
    with open_h5(written) as file:
        box = file["particles/trajectory/box"]
        assert box.attrs["dimension"] == 3
        assert box.attrs["boundary"].tolist() == [b"periodic", b"periodic", b"none"]


def test_h5md_edges_are_the_lattice_vectors_as_rows(packing, written):
    with open_h5(written) as file:
        edges = file["particles/trajectory/box/edges/value"][0]
    assert (edges[:2, :2] == packing.box.cell).all()
    assert (edges[2, :2] == 0).all()
    assert edges[2, 2] == 2.8


def test_h5md_box_and_positions_share_their_time_axis(written):
    with open_h5(written) as file:
        particles = file["particles/trajectory"]
        assert particles["position/step"] == particles["box/edges/step"]
        assert particles["position/time"] == particles["box/edges/time"]


def test_h5md_species_numbers_the_sizes(packing, written):
    with open_h5(written) as file:
        assert (file["particles/trajectory/species"][()] == (packing.radii > 1.2)).all()


# jamBashBulk: numbers of its own log


def test_jambash_keeps_its_length_unit(packing):
    assert len(packing) == 16
    assert packing.mean_diameter == pytest.approx(2.4, abs=1e-15)
    assert packing.potential_name == "harmonic"


def test_jambash_contacts(packing):
    network = ContactNetwork.of(packing)
    assert (len(network), network.rattlers, network.Z) == (33, 0, 4.125)


def test_jambash_packing_fraction(packing):
    assert packing.phi == pytest.approx(0.81494906634508, rel=1e-13)


def test_jambash_energy(packing):
    assert energy(packing) == pytest.approx(1.0928358570711e-04, rel=1e-12)


def test_jambash_pressure(packing):
    assert ContactNetwork.of(packing).pressure == pytest.approx(1e-3, rel=1e-12)


def test_jambash_provenance(packing):
    assert packing.provenance["source"] == SIXTEEN.name
    assert packing.provenance["header"]["seed"] == "0"
    assert packing.provenance["header"]["commit"] == "85670c21403a4f54092b9da783e3a906d5e2f869"


def test_jambash_file_of_several_packings(tmp_path, packing):
    """The program appends a header and a table for every step of a shear."""
    text = SIXTEEN.read_text()
    path = tmp_path / "two.txt"
    path.write_text(text + text[text.index("N = ") :].replace("0.0630575654921525210", "0.5"))
    assert same_bits(packing, import_packing(path, 0))
    assert import_packing(path, 1).box.cell[1, 0] == 0.5


# jax-md: energies and stresses that it computed itself, to rounding


def energy(packing):
    network = ContactNetwork.of(packing)
    sigma = packing.radii[network.i] + packing.radii[network.j]
    return packing.potential.energy(network.distance, sigma).sum()


@pytest.mark.parametrize("index", range(10))
def test_jaxmd_energy(index):
    with open_h5(JAXMD) as file:
        assert energy(import_packing(JAXMD, index)) == pytest.approx(file["Energy"][index], rel=1e-13)


@pytest.mark.parametrize("index", range(10))
def test_jaxmd_stress_is_negative_in_compression(index):
    with open_h5(JAXMD) as file:
        theirs = file["Stress"][index].reshape(2, 2)
    ours = ContactNetwork.of(import_packing(JAXMD, index)).stress
    assert np.abs(ours + theirs).max() < 1e-14


@pytest.mark.parametrize("index", [-1, 10])
def test_jaxmd_index_out_of_range(index):
    refuses(JAXMD, f"no packing {index}", "holds 10", read=lambda path: import_packing(path, index))


# Bad files


def test_missing_file(tmp_path):
    refuses(tmp_path / "none", "No such file")
    refuses(tmp_path / "none", "No such file", read=Packing.read)


def test_not_hdf5():
    refuses(SIXTEEN, "not an HDF5 file", read=Packing.read)


def test_unknown_format(tmp_path):
    path = tmp_path / "poem.txt"
    path.write_text("Wer reitet so spät durch Nacht und Wind?\n")
    refuses(path, "unknown format", "jamBashBulk", "jax-md", "XYZ")


@given(st.floats(0, 1, exclude_max=True))
def test_truncated_h5md(tmp_path_factory, fraction):
    path = tmp_path_factory.mktemp("io") / "p.h5"
    import_packing(SIXTEEN).write(path)
    data = path.read_bytes()[:-48]  # less its digest
    path.write_bytes(data[: int(fraction * len(data))])
    refuses(path, read=Packing.read)


@given(st.floats(0, 1, exclude_max=True))
def test_truncated_text(tmp_path_factory, fraction):
    path = tmp_path_factory.mktemp("io") / "p.txt"
    text = SIXTEEN.read_text().rstrip()
    path.write_text(text[: int(fraction * len(text))])
    refuses(path)


def test_foreign_hdf5_says_what_is_missing():
    refuses(JAXMD, "lacks /parameters/petscjam", read=Packing.read)


def test_lost_dataset_is_named(written):
    with atomic_h5(written, existing=True) as file:
        del file["particles/trajectory/radius"]
    refuses(written, "lacks /particles/trajectory/radius", read=Packing.read)


def test_newer_schema(written):
    with atomic_h5(written, existing=True) as file:
        file["parameters/petscjam"].attrs["schema"] = (2, 0)
    refuses(written, "newer petscjam", "schema 2", read=Packing.read)


def test_checksum_mismatch(written):
    with atomic_h5(written, existing=True) as file:
        radius = file["particles/trajectory/radius"]
        radius[3] = np.nextafter(radius[3], 2)
    refuses(written, "checksum", read=Packing.read)


@pytest.mark.parametrize(("name", "value"), [("position/value", np.nan), ("radius", 0), ("radius", -1.0)])
def test_bad_value_in_h5md(written, name, value):
    with atomic_h5(written, existing=True) as file:
        file[f"particles/trajectory/{name}"][...] = value
    refuses(written, "of disk 0", read=Packing.read)


@pytest.mark.parametrize(
    ("old", "new", "words"),
    [
        ("5.0440810567318968504", "nan", ["line 20", "nan"]),
        ("5.0440810567318968504", "5.04x", ["line 20", "5.04x"]),
        ("7.9547166101854404198 ,", "", ["line 20", "3 columns"]),
        ("N = 16", "N = 17", ["line 24", "'}'"]),
        ("N = 16", "N = 15", ["line 22", "'}'"]),
        ("1.3999999999999999112", "-1.4", ["radius of disk 8"]),
        ("9.5693366275464142399", "0", ["no area"]),
        ("L2=", "M2=", ["line 5", "L2="]),
    ],
)
def test_bad_text_is_refused_with_its_line(tmp_path, old, new, words):
    path = tmp_path / "bad.txt"
    text = SIXTEEN.read_text()
    assert old in text
    path.write_text(text.replace(old, new, 1).rstrip())
    refuses(path, *words)


@pytest.mark.parametrize(
    ("old", "new", "words"),
    [
        ("potential=harmonic", "", ["line 2", "potential"]),
        ("Lattice=", "Cell=", ["line 2", "Lattice"]),
        (":radius:R:1", ":weight:R:1", ["radius", "--diameters H:…,He:…"]),
        (":radius:R:1", ":radius:R:3", ["line 2", "radius:R:1"]),
        ("R:3", "R:three", ["line 2", "three"]),
        ('"T T F"', '"T F F"', ["line 2", "periodic"]),
        (" 0 1.0", " 0.3 1.0", ["plane"]),
        (" 0 1.0", " 0 1_0", ["line 3", "1_0"]),
        (" 0 1.0", " 0 nan", ["line 3", "nan"]),
        ("16\n", "17\n", ["line 18", "17"]),
        ("=harmonic", "=Hertzian", ["Hertzian"]),
    ],
)
def test_bad_xyz_is_refused_with_its_line(packing, tmp_path, old, new, words):
    path = tmp_path / "p.xyz"
    export_packing(packing, path)
    text = path.read_text()
    assert old in text
    path.write_text(text.replace(old, new, 1))
    refuses(path, *words)


# Outputs


@pytest.mark.parametrize("write", [Packing.write, export_packing])
def test_existing_output_is_refused(packing, tmp_path, write):
    path = tmp_path / "p"
    path.write_text("precious")
    with pytest.raises(InputError, match="exists"):
        write(packing, path)
    assert path.read_text() == "precious"


@pytest.mark.parametrize("write", [Packing.write, export_packing])
def test_existing_output_is_replaced_when_asked(packing, tmp_path, write):
    path = tmp_path / "p"
    path.write_text("old")
    write(packing, path, overwrite=True)
    assert same_bits(packing, import_packing(path))


def test_unknown_export_format(packing, tmp_path):
    with pytest.raises(InputError, match=r"'jpeg' is unknown; known are xyz"):
        export_packing(packing, tmp_path / "p.jpeg", to="jpeg")


def test_missing_folder(packing, tmp_path):
    with pytest.raises(InputError, match="there is no folder"):
        packing.write(tmp_path / "none" / "p.h5")


def test_full_disk_leaves_the_old_file(written):
    """A limit on the size of files fails as a full disk does, half-way through a write."""
    before = written.read_bytes()
    code = f"""
import resource, signal
from petscjam.base.errors import InputError
from petscjam.geometry.packing import Packing
packing = Packing.read({str(written)!r})
signal.signal(signal.SIGXFSZ, signal.SIG_IGN)
resource.setrlimit(resource.RLIMIT_FSIZE, (4096, 4096))
try:
    packing.write({str(written)!r}, overwrite=True)
except InputError as error:
    print(error)
"""
    run = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    assert run.stdout == f"{written}: File too large\n"
    assert written.read_bytes() == before
    assert list(written.parent.iterdir()) == [written]


def test_killed_before_the_replacement_leaves_the_old_file(written):
    before = written.read_bytes()
    code = f"""
import os, signal
from petscjam.base.files import write_atomically
os.replace = lambda *_: os.kill(os.getpid(), signal.SIGKILL)
write_atomically({str(written)!r}, b"new")
"""
    assert subprocess.run([sys.executable, "-c", code]).returncode == -9
    assert written.read_bytes() == before


def test_an_error_while_filling_leaves_the_old_file(written):
    before = written.read_bytes()
    with pytest.raises(ZeroDivisionError), atomic_h5(written, existing=True) as file:
        file["half"] = 1
        raise ZeroDivisionError
    assert written.read_bytes() == before


def test_appending_keeps_what_was_there(packing, written):
    with atomic_h5(written, existing=True) as file:
        file["results/answer"] = 42
    assert same_bits(packing, Packing.read(written))
    with open_h5(written) as file:
        assert file["results/answer"][()] == 42


def test_a_link_stays_a_link(tmp_path):
    (tmp_path / "link").symlink_to(tmp_path / "target")
    write_atomically(tmp_path / "link", b"new")
    assert (tmp_path / "link").is_symlink()
    assert (tmp_path / "target").read_bytes() == b"new"


@pytest.mark.parallel(nprocs=2)
def test_one_rank_writes_and_all_read(comm, tmp_path):
    """Under mpirun h5py may be its parallel build; the files are serial all the same."""
    path = comm.bcast(tmp_path / "p.h5")
    if comm.rank == 0:
        import_packing(SIXTEEN).write(path)
    comm.barrier()
    assert same_bits(Packing.read(path), import_packing(SIXTEEN))
    comm.barrier()


def test_files_are_plain_hdf5(packing, written):
    with h5py.File(written) as file:
        assert file["h5md"].attrs["version"].tolist() == [1, 1]
        assert (file["particles/trajectory/position/value"][0, :, 2] == 0).all()
