import os
from pathlib import Path

os.environ["NUMBA_ENABLE_CUDASIM"] = "1"  # petscjam.md.cuda is imported without a GPU

project = "petscjam"
author = copyright = "The petscjam developers"
extensions = [
    "myst_parser",
    "sphinx.ext.autodoc",
    "sphinx.ext.autosummary",
    "sphinx.ext.mathjax",
    "sphinx.ext.napoleon",
    "sphinx.ext.viewcode",
]
html_theme = "furo"
html_title = "petscjam"
templates_path = ["_templates"]
exclude_patterns = ["_build", "paper/results"]
suppress_warnings = ["ref.python"]  # the C of a shape (C,) is no reference

myst_enable_extensions = ["amsmath", "dollarmath", "colon_fence"]
myst_heading_anchors = 3
autosummary_generate = True
autodoc_typehints = "none"  # the docstrings give types, with shapes
autodoc_member_order = "bysource"
napoleon_google_docstring = False
napoleon_use_ivar = True  # attributes are described once, in the docstring of the class
napoleon_use_rtype = False

# One page with every example, as long as there are any.
here = Path(__file__).parent
generated = here / "_generated"
generated.mkdir(exist_ok=True)
pages = ["# Examples\n\nEach of these is run by the tests.\n"]
page = "## {0}\n\n```{{literalinclude}} ../../examples/{0}\n:language: python\n```\n"
pages += [page.format(path.name) for path in sorted((here.parent / "examples").glob("*.py"))]
(generated / "examples.md").write_text("\n".join(pages))


def keep_bars(app, what, name, obj, options, lines):
    """In a docstring |δ| is an absolute value, not reStructuredText's substitution."""
    lines[:] = [line.replace("|", r"\|") for line in lines]


def setup(app):
    app.connect("autodoc-process-docstring", keep_bars)
