"""The source distribution, the wheel and the recipes of packages have what the project says."""

import re
import shutil
import subprocess
import sys
import tarfile
import tomllib
import zipfile
from email import message_from_bytes
from pathlib import Path
from tempfile import TemporaryDirectory

import pytest
import yaml

ROOT = Path(__file__).parents[1]
PROJECT = tomllib.loads((ROOT / "pyproject.toml").read_text())["project"]
pytestmark = pytest.mark.parallel(nprocs=1)


def test_the_versions_are_one():
    citation = yaml.safe_load((ROOT / "CITATION.cff").read_text())
    recipe = yaml.safe_load((ROOT / "packaging" / "conda" / "meta.yaml").read_text())
    assert {citation["version"], recipe["package"]["version"]} == {PROJECT["version"]}
    assert recipe["source"]["url"].endswith(f"petscjam-{PROJECT['version']}.tar.gz")


def test_the_conda_recipe_requires_what_the_project_requires():
    recipe = yaml.safe_load((ROOT / "packaging" / "conda" / "meta.yaml").read_text())
    run = {line.split()[0]: line.split()[1] for line in recipe["requirements"]["run"]}
    for line in PROJECT["dependencies"]:
        name, version = re.fullmatch(r"([\w-]+)(>=[\d.]+)", line).groups()
        assert run.pop({"matplotlib": "matplotlib-base"}.get(name, name)) == version
    assert run.pop("python") == PROJECT["requires-python"]
    assert run.keys() == {"petsc4py", "slepc4py"}
    assert recipe["about"]["license"] == PROJECT["license"]
    assert recipe["build"]["entry_points"] == [f"petscjam = {PROJECT['scripts']['petscjam']}"]


def test_the_apptainer_recipe_uses_what_is_there():
    text = (ROOT / "packaging" / "apptainer.def").read_text()
    sections = dict(re.findall(r"^%(\w+)\n((?:(?!^%).*\n)*)", text, re.MULTILINE))
    for name in ("post", "environment", "runscript", "test"):
        subprocess.run(["sh", "-n"], input=sections[name], text=True, check=True)
    for file in re.findall(r"tools/[\w.]+", text):
        assert (ROOT / file).exists()
    extras = re.search(r"tools/setup.sh (.*)", sections["post"])[1].split()
    assert set(extras) <= set(PROJECT["optional-dependencies"])


@pytest.mark.slow
def test_the_distributions_have_everything():
    """Built from what git knows, as a fresh clone."""
    with TemporaryDirectory() as folder:
        distributions(Path(folder))


def distributions(folder):
    known = subprocess.run(["git", "ls-files", "-z"], cwd=ROOT, capture_output=True, text=True, check=True).stdout
    source = folder / "source"
    for name in filter(None, known.split("\0")):
        (source / name).parent.mkdir(parents=True, exist_ok=True)
        shutil.copy(ROOT / name, source / name, follow_symlinks=False)
    build = "from setuptools import build_meta as b; b.build_sdist('dist'); b.build_wheel('dist')"
    subprocess.run([sys.executable, "-c", build], cwd=source, check=True, capture_output=True)
    with tarfile.open(next((source / "dist").glob("*.tar.gz"))) as tar:
        inside = {name.partition("/")[2] for name in tar.getnames()}
    wanted = [name for name in known.split("\0") if name.startswith(("docs/", "examples/", "src/", "tests/", "tools/"))]
    wanted += ["CHANGELOG.md", "CITATION.cff", "LICENSE", "README.md", "Makefile", "pyproject.toml"]
    assert [name for name in wanted if name not in inside] == []
    with zipfile.ZipFile(next((source / "dist").glob("*.whl"))) as wheel:
        names = wheel.namelist()
        metadata = message_from_bytes(wheel.read(next(name for name in names if name.endswith("METADATA"))))
    assert {"petscjam/py.typed", "petscjam/__init__.pyi", "petscjam/md/__init__.pyi"} <= set(names)
    assert {f"petscjam/figures/{name}.toml" for name in ("bt1", "vot_cd")} <= set(names)
    assert metadata["License-Expression"] == "BSD-3-Clause"
    assert "Typing :: Typed" in metadata.get_all("Classifier")
