"""A report is one page that needs nothing else: parsed here, with everything it shows decoded."""

import shutil
import signal
import subprocess
from base64 import b64decode
from html.parser import HTMLParser
from io import BytesIO
from pathlib import Path

import numpy as np
import pytest
from helpers import refused
from matplotlib.image import imread

import petscjam as pj
from petscjam.analysis.density import DensityOfStates
from petscjam.analysis.mode_sum import ModeSum
from petscjam.cli import main
from petscjam.geometry.packing import Packing
from petscjam.io.kinds import KINDS, class_of, recognise
from petscjam.io.results import read_results
from petscjam.md.result import read_folder
from petscjam.plots.files import CONTENTS

pytestmark = pytest.mark.parallel(nprocs=1)
FORMATS = Path(__file__).parent / "fixtures" / "formats"
SAME_KIND = (
    "hertzian",
    "ramp.quenched",
    "direct",
    "stokes",
    "stokes-direct",
    "drag-uniform",
    "quench",
    "steps",
    "spectrum",
    "oscillation",
)
FILES = [path for path in sorted(FORMATS.glob("*.h5")) if path.stem not in SAME_KIND]
FILES += [FORMATS / "library", FORMATS / "flows"]
VOID = {"meta", "img", "br", "link", "hr"}


class Page(HTMLParser):
    """The tags of a page, its text, pictures and downloads."""

    def __init__(self, text):
        super().__init__()
        self.tags, self.open, self.text, self.pictures, self.downloads, self.links = [], [], [], [], {}, []
        self.attributes, self.ids = [], []
        self.feed(text)
        self.close()

    def handle_starttag(self, tag, attrs):
        given = dict(attrs)
        self.tags.append(tag)
        self.attributes += attrs
        if tag not in VOID:
            self.open.append(tag)
        if "id" in given:
            self.ids.append(given["id"])
        if tag == "img":
            self.pictures.append(given["src"])
        if tag == "a" and "download" in given:
            self.downloads[given["download"]] = given["href"]
        elif tag == "a":
            self.links.append(given["href"])

    def handle_endtag(self, tag):
        assert self.open.pop() == tag

    def handle_data(self, data):
        self.text.append(data)


def reported(path, out):
    assert main(["report", str(path), "-o", str(out)]) == 0
    return Page(out.read_text())


def decoded(uri, kind):
    head, _, data = uri.partition(",")
    assert head == f"data:{kind};base64"
    return BytesIO(b64decode(data, validate=True))


def complete(page):
    """The page is well formed, has no script, and everything it shows is in it."""
    assert page.open == []
    assert not {"script", "link", "iframe", "object", "embed"} & set(page.tags)
    assert not [name for name, _ in page.attributes if name.startswith("on")]
    sources = [value for name, value in page.attributes if name in ("src", "href", "srcset", "action")]
    assert all(source.startswith(("data:", "#")) for source in sources)
    assert [link.removeprefix("#") for link in page.links] == page.ids[: len(page.links)]
    for picture in page.pictures:
        assert np.std(imread(decoded(picture, "image/png"))) > 0.01
    return page


def test_no_kind_is_forgotten():
    kinds = {type(next(iter(read_results(path).values()))) for path in FILES if recognise(path) == "results"}
    assert kinds == {class_of(kind) for kind in KINDS} - {ModeSum, DensityOfStates}  # in figures/


SLOW = ("flows", "nonaffine.h5", "drag.h5", "ramp.h5", "relaxations.h5", "aqs.h5", "library")


@pytest.mark.parametrize(
    "path", [pytest.param(path, marks=pytest.mark.slow if path.name in SLOW else (), id=path.name) for path in FILES]
)
def test_every_kind_has_a_page(path, tmp_path):
    page = complete(reported(path, tmp_path / "r.html"))
    assert len(page.pictures) == (path.name != "unjudged.h5" or 1)
    (csv,) = page.downloads.values()
    assert decoded(csv, "text/csv").read() == pj.read_table(path).to_csv()


def test_the_page_says_what_of_which_packing(tmp_path):
    page = complete(reported(FORMATS / "viscosity.h5", tmp_path / "r.html"))
    (v,) = read_results(FORMATS / "viscosity.h5").values()
    for word in (v.origin.checksum, f"{v.eta0:.5g}", "stable", "viscosity eta0 and modulus G0", str(v.damping)):
        assert word in " ".join(page.text)
    assert any(text.startswith("viscosity(") for text in page.text)  # made with


def test_a_certificate_is_on_the_page(tmp_path):
    page = complete(reported(FORMATS / "packing.h5", tmp_path / "r.html"))
    c = Packing.read(FORMATS / "packing.h5").certificate
    rows = dict(zip(page.text, page.text[1:], strict=False))
    assert rows["proved minimum"] == "yes"
    assert float(rows["lowest eigenvalue"]) == pytest.approx(c.lowest_eigenvalue, rel=1e-4)
    assert rows["negative modes"] == "0"


def test_an_unstable_packing_is_a_warning(tmp_path):
    page = complete(reported(FORMATS / "quench.h5", tmp_path / "r.html"))
    assert ("class", "warning") in page.attributes
    assert any("UNSTABLE: G0 < 0" in text for text in page.text)


def test_a_folder_is_a_page_with_a_section_for_everything(tmp_path):
    folder = tmp_path / "all"
    for name in ("library", "flows"):
        shutil.copytree(FORMATS / name, folder / name)
    for name in ("viscosity.h5", "modes.h5"):
        shutil.copy(FORMATS / name, folder)
    shutil.copy(FORMATS / "packing.h5", folder / "<i>&.h5")
    log = ["--log", str(folder / "a.log")]
    assert main(["info", str(folder / "viscosity.h5"), *log]) == 0
    assert main(["info", str(folder / "none.h5"), *log]) == 2
    (folder / "damaged.h5").write_bytes((FORMATS / "modes.h5").read_bytes()[:3000])
    page = complete(reported(folder, tmp_path / "r.html"))
    assert "i" not in page.tags
    assert len(page.links) == len(page.ids) == 6
    assert {"library", "flows", "viscosity.h5", "modes.h5", "<i>&.h5"} <= set(page.text)
    assert any("damaged.h5: damaged" in text for text in page.text)
    command = f"petscjam info {folder}/{{}}.h5 --log {folder}/a.log"
    assert "\n".join(map(command.format, ["viscosity", "none"])) in page.text


def test_figures_of_papers_are_on_the_page(tmp_path):
    folder = tmp_path / "figures"
    shutil.copytree(FORMATS / "figures", folder)
    assert main(["plot", str(folder / "modes-density.h5"), "-o", str(folder / "modes.png")]) == 0
    (folder / "modes.csv").write_text("quantity,x,value,error,paper\n")
    page = complete(reported(folder, tmp_path / "r.html"))
    assert {"Figure modes", "modes-density.h5", "modes-rebuilt.h5", "packings"} <= set(page.text)
    assert decoded(page.downloads["modes.csv"], "text/csv").read() == (folder / "modes.csv").read_bytes()


@pytest.mark.parametrize(
    ("given", "out", "words"),
    [("packing.h5", "r.pdf", "ends in .html"), ("none.h5", "r.html", "none.h5"), ("", "r.html", "nothing to report")],
)
def test_what_is_no_report_is_refused(tmp_path, capfd, given, out, words):
    (tmp_path / "empty").mkdir()
    path = FORMATS / given if given else tmp_path / "empty"
    assert words in refused(capfd, "report", path, "-o", tmp_path / out)
    assert not (tmp_path / out).exists()


@pytest.mark.slow
@pytest.mark.skipif(shutil.which("chromium") is None, reason="no chromium")
def test_a_browser_shows_the_page(tmp_path):
    reported(FORMATS / "moduli.h5", tmp_path / "r.html")
    options = ["--headless", "--no-sandbox", "--disable-gpu", "--window-size=390,1800"]
    command = ["chromium", *options, f"--screenshot={tmp_path / 'r.png'}", (tmp_path / "r.html").as_uri()]
    subprocess.run(command, check=True, capture_output=True, timeout=120)
    picture = imread(tmp_path / "r.png")
    assert picture.shape[1] == 390
    assert np.std(picture) > 0.05


def test_a_signal_stops_a_report(tmp_path, monkeypatch, capsys):
    def interrupted(folder):
        signal.raise_signal(signal.SIGINT)
        return read_folder(folder)

    monkeypatch.setitem(CONTENTS, "runs", CONTENTS["runs"]._replace(read=interrupted))
    (tmp_path / "r.html").write_text("old")
    assert main(["report", str(FORMATS), "-o", str(tmp_path / "r.html"), "--overwrite"]) == 130
    assert capsys.readouterr().err == "petscjam: stopped by SIGINT; finished results are kept\n"
    assert (tmp_path / "r.html").read_text() == "old"
