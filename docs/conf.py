"""The site: what the pages in docs show on the code host, and besides

- ``<!-- site: NAME -->`` becomes what the function NAME below writes;
- a list under ``<!-- toctree: CAPTION -->`` becomes a part of the contents at the left, too;
- a link to a .py or .toml that is a paragraph becomes the file itself, one to a module within a text its reference.
"""

import inspect
import os
import re
from importlib import import_module
from pathlib import Path

os.environ["NUMBA_ENABLE_CUDASIM"] = "1"  # petscjam.md.cuda is imported without a GPU

import ziamath
from docutils import nodes
from PIL import Image

from petscjam import __version__ as release
from petscjam.cli.parser import Help, build_parser

project = "petscjam"
author = copyright = "The petscjam developers"
extensions = [
    "myst_parser",
    "sphinx.ext.autodoc",
    "sphinx.ext.autosummary",
    "sphinx.ext.napoleon",
    "sphinx.ext.viewcode",
    "sphinx_copybutton",
]
html_theme = "furo"
html_title = f"petscjam {release}"
html_static_path = ["_static"]
html_css_files = ["petscjam.css"]
html_math_renderer = "svg"
templates_path = ["_templates"]
exclude_patterns = ["_build"]
suppress_warnings = ["ref.python"]  # the C of a shape (C,) is no reference

myst_enable_extensions = ["amsmath", "dollarmath", "colon_fence"]
myst_heading_anchors = 3
autosummary_generate = True
autodoc_typehints = "none"  # the docstrings give types, with shapes
autodoc_member_order = "bysource"
napoleon_google_docstring = False
napoleon_use_ivar = True  # attributes are described once, in the docstring of the class
napoleon_use_rtype = False
here = Path(__file__).parent


def gallery():
    """Return a grid of small pictures of the figures of both papers, each a link to its page."""
    thumbs = here / "_generated" / "thumbs"
    thumbs.mkdir(parents=True, exist_ok=True)
    pages = sorted(
        (here / "paper").glob("*.md"),
        key=lambda page: [int(x) if x.isdigit() else x for x in re.split(r"(\d+)", page.stem)],
    )
    lines = [":::{container} gallery"]
    for page in pages:
        picture = here / "figures" / f"{page.stem}.png"
        if picture.exists():
            image = Image.open(picture).convert("RGB")
            image.thumbnail((320, 320))
            image.save(thumbs / picture.name)
            title = re.search(r"^# (.*)", page.read_text(), re.MULTILINE)[1]
            paper = "VOT" if page.stem.startswith("vot") else "BT"
            short = re.sub(r"Fig\. (\d+).*", rf"{paper} \1", title)
            lines += ["", f"[![{title}](_generated/thumbs/{picture.name}) {short}](paper/{page.name})"]
    return "\n".join([*lines, ":::"])


def python():
    """Return an entry for each public name."""
    lines = []
    for module in ("petscjam", "petscjam.md", "petscjam.plots"):
        package = import_module(module)
        lines += [f"## `{module}`", "", "```{eval-rst}", f".. currentmodule:: {module}", ""]
        for name in sorted(package.__all__, key=str.lower):
            thing = getattr(package, name)
            if inspect.isclass(thing):
                kind = "exception" if issubclass(thing, Exception) else "class"
                lines += [f".. auto{kind}:: {name}", *["   :members:"] * (kind == "class"), ""]
            elif callable(thing):
                lines += [f".. autofunction:: {name}", *["   :no-index:"] * (thing.__module__ == module), ""]
        lines += ["```", ""]
    return "\n".join(lines)


def command():
    """Return all verbs with their options, from the parser."""
    lines, form = [], Help("petscjam")
    verbs = build_parser()._subparsers._group_actions[0]
    summaries = {action.dest: action.help for action in verbs._choices_actions}
    for verb, parser in verbs.choices.items():
        parser.complete()
        lines += [f"## {verb}", "", f"{summaries[verb][0].upper()}{summaries[verb][1:]}.", ""]
        for group in parser._action_groups:
            rows = [
                (form._format_action_invocation(action), form._expand_help(action) if action.help else "")
                for action in group._group_actions
                if "--help" not in action.option_strings
            ]
            if rows:
                lines += [f"*{group.title}*", "", "| | |", "|---|---|"]
                lines += [f"| `{option}` | {escaped(text)} |" for option, text in rows] + [""]
    return "\n".join(lines)


def escaped(text):
    return re.sub(r"([|*_<\\])", r"\\\1", " ".join(text.split()))


def read(app, name, source):
    """Make the site's page of that of the code host."""
    page = here / f"{name}.md"
    if not page.exists():
        return
    text = re.sub(r"<!-- site: (\w+) -->", lambda found: globals()[found[1]](), source[0])
    text = re.sub(
        r"^\[[^\]]+\]\(([./\w-]+\.(?:py|toml))\)$",
        lambda found: f"```{{literalinclude}} {found[1]}\n```",
        text,
        flags=re.MULTILINE,
    )
    text = re.sub(
        r"\[([^\]]+)\]\([./]+/src/(petscjam/[\w/]+?)(?:/__init__)?\.py\)",
        lambda found: f"{{py:mod}}`{found[1].strip('`')} <{found[2].replace('/', '.')}>`",
        text,
    )
    source[0] = re.sub(r"<!-- toctree(?:: (.+))? -->\n\n((?:(?:- |  ).+\n)+)", contents, text)


def contents(found):
    pages = re.findall(r"\]\(([^)#]+)\.md\)", found[2])
    return "\n".join(
        [found[2], "```{toctree}", ":hidden:", *[f":caption: {found[1]}"] * bool(found[1]), "", *pages, "```", ""]
    )


def captions(app, doctree):
    """A picture that is a paragraph becomes a figure with its caption, and a link to its full size."""
    for image in list(doctree.findall(nodes.image)):
        if isinstance(image.parent, nodes.paragraph) and len(image.parent) == 1:
            image["width"] = "100%"  # which makes Sphinx link it
            name = nodes.make_id(image["uri"])
            image.parent.replace_self(nodes.figure("", image, nodes.caption("", image["alt"]), ids=[name]))


ziamath.config.svg2 = False
ziamath.config.precision = 2
ziamath.config.math.color = "currentColor"


def formula(writer, node):
    """Draw a formula: it needs neither a script nor a font."""
    inline = isinstance(node, nodes.math)
    tex = " ".join(node.astext().split())
    drawn = ziamath.Latex(tex, size=17, inline=inline)
    svg = drawn.svg().replace(
        "<svg ",
        f'<svg role="img" aria-label="{writer.attval(tex)}" style="vertical-align:{drawn.getyofst():.1f}px" ',
        1,
    )
    writer.body.append(svg if inline else f'<div class="math">{svg}</div>')
    raise nodes.SkipNode


def keep_bars(app, what, name, obj, options, lines):
    """In a docstring |δ| is an absolute value, not reStructuredText's substitution."""
    lines[:] = [line.replace("|", r"\|") for line in lines]


def setup(app):
    app.connect("source-read", read)
    app.connect("doctree-read", captions)
    app.connect("autodoc-process-docstring", keep_bars)
    app.add_html_math_renderer("svg", (formula, None), (formula, None))
