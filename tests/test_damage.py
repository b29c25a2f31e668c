"""Files that were damaged: refused in one line or read right, and never a crash."""

import json
import subprocess
import sys

import h5py
import numpy as np
import pytest
from conftest import START
from helpers import SIXTEEN

import petscjam as pj
from petscjam.base.errors import InputError
from petscjam.base.files import open_h5
from petscjam.cli import main
from petscjam.io.results import append_result, read_results
from petscjam.preparation.library import INDEX, RECIPE

pytestmark = pytest.mark.parallel(nprocs=1)
VERBS = {
    "moduli": ["moduli", "--omega", "1e-3:10:5", "--fields", "1"],
    "nonaffine": ["nonaffine"],
    "viscosity": ["viscosity", "--beta", "1"],
    "modes": ["modes", "--count", "4"],
    "relaxations": ["modes", "--count", "4", "--relaxation", "--beta", "1"],
    "density": ["density", "--moments", "16", "--vectors", "2"],
    "correlations": ["correlations", "--beta", "1", "--omega", "1e-2"],
    "drag": ["nonlinear-drag", "--stress", "1e-4", "--omega", "1e-2"],
    "oscillations": ["oscillate", "--amplitude", "1e-3", "--omega", "1", "--cycles", "3"],
    "steps": ["step-strain", "--step", "1e-3", "--time", "10,20"],
    "aqs": ["aqs", "--strain", "0.05", "--events", "2"],
}
KINDS = ["packing", "spectrum", "rebuilt", "run", *VERBS]

# Reads files (a line each of standard input) and prints what came of each: that it was refused, or all that
# was found. Run in a child, because HDF5 may take the interpreter with it.
READER = """
import pickle, sys
from dataclasses import fields, is_dataclass
from petscjam.base.errors import InputError
from petscjam.io.kinds import recognise
from petscjam.plots.files import CONTENTS

def plain(x):
    if is_dataclass(x):
        return {f.name: plain(getattr(x, f.name)) for f in fields(x)}
    if isinstance(x, dict):
        return {k: plain(v) for k, v in x.items()}
    return (x.dtype.str, x.shape, x.tobytes()) if hasattr(x, "tobytes") else repr(x)

for path in map(str.strip, sys.stdin):
    try:
        print(hash(repr(plain(CONTENTS[recognise(path)].read(path)))), flush=True)
    except InputError as error:
        assert str(error).startswith(path + ": ") and "\\n" not in str(error), error
        print("refused", flush=True)
"""


@pytest.fixture(scope="module")
def files(tmp_path_factory):
    """One small file of each kind, by kind."""
    folder = tmp_path_factory.mktemp("files")
    found = {kind: folder / f"{kind}.h5" for kind in KINDS}
    assert main(["import", str(SIXTEEN), "-o", str(found["packing"])]) == 0
    for kind, (verb, *options) in VERBS.items():
        assert main([verb, str(found["packing"]), *options, "-o", str(found[kind])]) == 0
    packing = pj.Packing.read(found["packing"])
    pj.write_spectrum(pj.spectrum(packing), found["spectrum"])
    append_result(pj.mode_sum(packing, 4), found["rebuilt"], "one")
    run = ["shear", "--particles", "16", "--rate", "1e-2", "--strain", "0.2", "-o", str(found["run"])]
    assert main(run) == 0
    return found


@pytest.fixture(scope="module")
def read_all():
    """Return what a child finds in each file of a list."""
    environment = {**START, "PYTHONHASHSEED": "0"}
    child = subprocess.Popen(
        [sys.executable, "-c", READER],
        stdin=subprocess.PIPE,
        stdout=subprocess.PIPE,
        text=True,
        bufsize=1,
        env=environment,
    )

    def read(paths):
        found = []
        for path in paths:
            child.stdin.write(f"{path}\n")
            found.append(child.stdout.readline().strip())
            assert found[-1], f"{path} ended the interpreter"
        return found

    yield read
    child.stdin.close()
    assert child.wait() == 0


def flipped(data, bit):
    """Return ``data`` with one bit changed."""
    changed = bytearray(data)
    changed[bit // 8] ^= 1 << bit % 8
    return bytes(changed)


@pytest.mark.parametrize("kind", KINDS)
def test_flipped_bits(files, tmp_path, read_all, kind):
    data = files[kind].read_bytes()
    random = np.random.default_rng(1)
    copies = [files[kind]]
    for k, bit in enumerate(random.integers(8 * len(data), size=200)):
        copies.append(tmp_path / f"{k}.h5")
        copies[-1].write_bytes(flipped(data, int(bit)))
    right, *found = read_all(copies)
    assert right != "refused"
    assert set(found) <= {right, "refused"}
    assert found.count("refused") > 180  # but for flips in the mark


@pytest.mark.parametrize("kind", KINDS)
def test_cut_files(files, tmp_path, read_all, kind):
    data = files[kind].read_bytes()
    lengths = [*np.linspace(0, len(data), 20, endpoint=False).astype(int), *range(len(data) - 60, len(data), 3)]
    copies = [files[kind]]
    for length in lengths:
        copies.append(tmp_path / f"{length}.h5")
        copies[-1].write_bytes(data[:length])
    right, *found = read_all(copies)
    assert set(found) <= {right, "refused"}
    assert found[:20] == ["refused"] * 20


def test_what_another_program_changed_is_read(files, tmp_path):
    """It leaves no digest, so what it wrote is judged by itself."""
    data = files["viscosity"].read_bytes()
    copy = tmp_path / "copy.h5"
    copy.write_bytes(data)
    with h5py.File(copy, "r+") as file:
        next(iter(file.values())).attrs["eta0"] = 2.0
    (found,) = read_results(copy).values()
    assert found.eta0 == 2.0


def test_the_digest_stands_behind_what_hdf5_reads(files, tmp_path):
    """Programs that know nothing of it open the file: the bytes in front of it are plain HDF5."""
    data = files["packing"].read_bytes()
    plain = tmp_path / "plain.h5"
    plain.write_bytes(data[:-48])
    assert pj.Packing.read(plain).checksum == pj.Packing.read(files["packing"]).checksum
    with h5py.File(files["packing"], "r") as file, h5py.File(plain, "r") as other:
        name = "particles/trajectory/position/value"
        assert file[name][()].tobytes() == other[name][()].tobytes()
    assert data[-48:-32] == b"petscjam blake2b"


@pytest.mark.parametrize("options", [{}, {"chunks": (1000,)}, {"chunks": (1000,), "compression": "gzip"}])
def test_a_small_file_that_asks_for_gigabytes(files, tmp_path, options):
    """Nothing is stored of a dataset that was never filled, whatever its shape."""
    copy = tmp_path / "copy.h5"
    copy.write_bytes(files["packing"].read_bytes())
    with h5py.File(copy, "r+") as file:
        del file["particles/trajectory/radius"]
        file.create_dataset("particles/trajectory/radius", (2**31,), float, **options)
    with pytest.raises(InputError, match=r"copy.h5: .*particles/trajectory/radius needs 1.7e\+10 bytes"):
        pj.import_packing(copy)


def test_what_is_well_compressed_is_read(tmp_path):
    """Ten million zeros in a few kilobytes."""
    with h5py.File(tmp_path / "zeros.h5", "w") as file:
        file.create_dataset("zeros", data=np.zeros(10**7), compression="gzip")
    with open_h5(tmp_path / "zeros.h5") as file:
        assert not file["zeros"][()].any()


# Wrong types, and what is missing

WRONG = {
    "gone": None,
    "text": "x",
    "nan": np.nan,
    "negative": -1,
    "huge": 2**62,
    "empty": np.empty(0),
    "cube": np.ones((2, 3, 4)),
    "bytes": np.void(b"\0\1"),
    "complex": 1j,
    "yes": True,
}


def places(path):
    """Return every dataset and group (its name, None) and every attribute (of what, its name) of a file."""
    found = []
    with h5py.File(path, "r") as file:
        found += [("/", key) for key in file.attrs]

        def note(name, node):
            found.extend([(name, None), *((name, key) for key in node.attrs)])

        file.visititems(note)
    return [place for place in found if "unit" not in (place[1] or "")]


def spoil(path, place, wrong):
    """Put something wrong in a place of a file."""
    name, key = place
    with h5py.File(path, "r+") as file:
        parent, name = (file[name].attrs, key) if key else (file, name)
        del parent[name]
        if wrong is not None:
            parent[name] = wrong


def outcome(capfd, path, *arguments):
    """Run the command on a file; return its status. It is 0, or 2 with one line that names the file."""
    status = main([str(a) for a in arguments])
    err = capfd.readouterr().err
    assert status in (0, 2), err
    if status:
        assert err.count("\n") == 1, err
        assert str(path) in err
    return status


@pytest.mark.parametrize("kind", KINDS)
@pytest.mark.parametrize("verb", ["info", pytest.param("all", marks=[pytest.mark.slow, pytest.mark.timeout(3600)])])
def test_wrong_content(files, tmp_path, capfd, kind, verb):
    """Every place with something wrong in it; the fast test tries a tenth of them."""
    data, refusals = files[kind].read_bytes(), 0
    everything = [(place, wrong) for place in places(files[kind]) for wrong in WRONG.items()]
    for k, (place, (word, wrong)) in enumerate(everything[:: 1 if verb == "all" else 10]):
        copy = tmp_path / f"{k}.h5"
        copy.write_bytes(data)
        spoil(copy, place, wrong)
        try:
            refusals += outcome(capfd, copy, "info", copy) == 2
            if verb == "all":
                outcome(capfd, copy, "export", copy, "-o", tmp_path / f"{k}")
                outcome(capfd, copy, "plot", copy)
        except AssertionError as error:
            raise AssertionError(f"{place} = {word}") from error
    assert refusals > 0


@pytest.mark.parametrize("word", ["gone", "text", "nan", "empty", "cube", "complex", "yes"])
def test_wrong_checkpoints_are_not_resumed(files, tmp_path, capfd, word):
    data, copy = files["run"].read_bytes(), tmp_path / "run.h5"
    resume = ["shear", "--particles", "16", "--rate", "1e-2", "--strain", "0.2", "--resume", "-o", copy]
    for place in places(files["run"]):
        if place[0].startswith("checkpoint/"):
            copy.write_bytes(data)
            spoil(copy, place, WRONG[word])
            assert outcome(capfd, copy, *resume) == 2, place


# Files of text


@pytest.fixture(scope="module")
def library(tmp_path_factory):
    """A library of one packing."""
    folder = tmp_path_factory.mktemp("library")
    pj.prepare_library(folder, [16], [1e-2], [1])
    return folder


@pytest.fixture
def replaced(library):
    """Put another content into a file of the library, for the time of a test."""
    before = {}

    def replace(name, content):
        before.setdefault(name, (library / name).read_bytes())
        (library / name).write_bytes(content)
        return library / name

    yield replace
    for name, content in before.items():
        (library / name).write_bytes(content)


@pytest.mark.parametrize("place", [(), ("schema",), ("recipe",), ("recipe", "ratio"), ("recipe", "method")])
@pytest.mark.parametrize("wrong", [None, "x", -1.5, [], [1, 2], {}, "gone"])
def test_recipes_of_wrong_content(library, replaced, capfd, place, wrong):
    content = json.loads((library / RECIPE).read_bytes())
    inside = content
    for key in place[:-1]:
        inside = inside[key]
    if not place:
        content = wrong
    elif wrong == "gone":
        del inside[place[-1]]
    else:
        inside[place[-1]] = wrong
    file = replaced(RECIPE, json.dumps(content).encode())
    assert outcome(capfd, file, "info", library) == 2


def test_flipped_bits_of_a_recipe(library, replaced, capfd):
    """Refused, but for those in the words on units, and in spaces."""
    data, refusals = (library / RECIPE).read_bytes(), 0
    for bit in np.random.default_rng(1).integers(8 * len(data), size=200):
        file = replaced(RECIPE, flipped(data, int(bit)))
        refusals += outcome(capfd, file, "info", library) == 2
    assert refusals > 100


def test_flipped_bits_of_an_index(library, replaced, capfd):
    """The packings are the truth."""
    data, right = (library / INDEX).read_bytes(), pj.read_library(library).rows
    for bit in np.random.default_rng(1).integers(8 * len(data), size=200):
        replaced(INDEX, flipped(data, int(bit)))
        (row,) = pj.read_library(library).rows
        assert {**row, "seconds": None} == {**right[0], "seconds": None}


@pytest.mark.parametrize(
    ("text", "words"),
    [
        ("small = 3", "small is not a table"),
        ("x", "not TOML"),
        ("\xff", "not TOML"),
        ("[small]\nparticles = true", "particles must be a number"),
        ("[small]\nparticles = nan", "particles must be a number"),
        ("[small]\nparticles = 64.5", "particles must be whole"),
        ("[small]\npressure = 1979-05-27", "pressure"),
        ("[small]\npressure = [[1]]", "pressure"),
        ("[small]\npressure = {}", "pressure"),
        ("[small]\nseeds = {}", "seeds"),
    ],
)
def test_parameter_files_of_wrong_content(tmp_path, capfd, text, words):
    known = {"particles": 64, "pressure": '"1e-2:1e-2:1"', "seeds": '"1:1"'}
    if text.startswith("[small]"):
        known = {key: value for key, value in known.items() if key not in text}
        text += "".join(f"\n{key} = {value}" for key, value in known.items())
    file = tmp_path / "p.toml"
    file.write_bytes(text.encode("latin-1"))
    folder = tmp_path / "folder"
    assert main(["figure", "bt2", "--parameters", str(file), "-o", str(folder)]) == 2
    err = capfd.readouterr().err
    assert err.count("\n") == 1, err
    assert str(file) in err
    assert words in err
    assert not folder.exists()


def test_a_run_without_its_rate_is_no_picture(files, tmp_path, capfd):
    copy = tmp_path / "run.h5"
    copy.write_bytes(files["run"].read_bytes())
    spoil(copy, ("settings", "rate"), None)
    assert outcome(capfd, copy, "plot", copy) == 2
