"""What the documents show is true: their commands and Python are run, page by page, and their links lead somewhere.

CONTRIBUTING.md describes the marks above a block.
"""

import re
import shlex
from itertools import pairwise
from urllib.parse import unquote

import pytest
from documents import ROOT, SHOWN, blocks, run
from markdown_it import MarkdownIt

BUILT = ("_build", "_generated")
PAGES = [ROOT / "README.md", ROOT / "CONTRIBUTING.md"]
PAGES += sorted(page for page in (ROOT / "docs").rglob("*.md") if not {*BUILT} & {*page.parts})
THERE = {  # files that a reader has
    "other.txt": "tests/data/jambashbulk-N16-P1e-3-0001.txt",
    "jaxmd.nc": "tests/data/jaxmd-2d-polyuniform-N64-Lp-1.nc",
    "library.toml": "mpi_runs/library.toml",
}


def by_page(pages):
    return [pytest.param(page, id=str(page.relative_to(ROOT))) for page in pages]


with_blocks = pytest.mark.parametrize("page", by_page(page for page in PAGES if blocks(page)))
that_run = pytest.mark.parametrize("page", by_page(page for page in PAGES if any(block.runs for block in blocks(page))))


@pytest.fixture
def folder(tmp_path, monkeypatch):
    """The folder where a page is read, with the files that its reader has."""
    for name, source in THERE.items():
        (tmp_path / name).symlink_to(ROOT / source)
    monkeypatch.chdir(tmp_path)
    return tmp_path


@with_blocks
def test_blocks_name_their_language_and_are_run_or_say_why_not(page):
    for block in blocks(page):
        where = f"{page}:{block.line}"
        assert block.language in {"bash", "python", *SHOWN}, where
        if block.runs:
            small = block.small()
            if block.language == "python":
                compile(small, where, "exec")
        elif block.language not in SHOWN:
            assert len(block.said.split()) > 1, f"{where}: a reason"


@with_blocks
def test_commands_have_verbs_and_options_of_the_parser(page, folder):
    from petscjam.cli import join_negative
    from petscjam.cli.parser import build_parser

    commands = "".join(block.text for block in blocks(page) if block.language == "bash").replace("\\\n", " ")
    for command in re.findall(r"^(?:mpirun -n \d+ )?petscjam (.*)", commands, re.MULTILINE):
        _, unknown = build_parser().parse_known_args(join_negative(shlex.split(command, comments=True)))
        assert not unknown, f"{page}: {command}"


@pytest.mark.slow
@pytest.mark.timeout(1800)
@that_run
def test_blocks_run_in_the_order_of_the_page(page, folder, environment):
    done = run(blocks(page), folder, True, environment)
    assert done.returncode == 0, done.stdout[-2000:] + done.stderr[-4000:]


def links(page):
    """Return the targets of links and pictures of a page."""
    found = []
    for token in MarkdownIt().enable("table").parse(page.read_text(encoding="utf-8")):
        for child in token.children or ():
            target = child.attrs.get("href") or child.attrs.get("src")
            if target and not re.match(r"[a-z]+:", target):
                found.append(unquote(target))
    return found


def anchors(page):
    """Return the anchors of the headings of a page, as the code host names them."""
    tokens = MarkdownIt().parse(page.read_text(encoding="utf-8"))
    titles = [after.content for token, after in pairwise(tokens) if token.type == "heading_open"]
    return {re.sub(r"[^\w\- ]", "", title.lower()).replace(" ", "-") for title in titles}


@pytest.mark.parametrize("page", by_page(PAGES))
def test_links_lead_to_files_and_headings(page):
    for target in links(page):
        path, _, anchor = target.partition("#")
        there = (page.parent / path).resolve() if path else page
        assert there.exists(), f"{page}: {target}"
        assert not anchor or anchor in anchors(there), f"{page}: {target}"


def test_every_page_is_reached_from_the_readme():
    reached, waiting = set(), [PAGES[0]]
    while waiting:
        page = waiting.pop()
        if page not in reached and page.suffix == ".md":
            reached.add(page)
            waiting += [(page.parent / target.partition("#")[0]).resolve() for target in links(page)]
    assert not {*PAGES} - reached


@pytest.mark.parametrize("page", by_page(PAGES))
def test_no_page_needs_the_builder_of_the_site(page):
    text = page.read_text(encoding="utf-8")
    assert page.name == "modules.md" or not re.search(r"^\s*[`:]{3,}\{|\{[\w:]+\}`", text, re.MULTILINE)


def test_every_example_is_on_its_page():
    assert {*links(ROOT / "docs" / "examples.md")} == {
        f"../examples/{path.name}" for path in (ROOT / "examples").glob("*.py")
    }
