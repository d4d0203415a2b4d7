"""Settings of the site: ``python -m sphinx -W docs docs/_build``."""

import subprocess
import sys
import tomllib
from pathlib import Path

from pygments.lexers.special import TextLexer
from sphinx.application import Sphinx

DOCS = Path(__file__).parent
sys.path[:0] = [str(DOCS / "extensions"), str(DOCS.parent)]

import array_types  # pyright: ignore[reportMissingImports]

array_types.shorten()

PROJECT = tomllib.loads((DOCS.parent / "pyproject.toml").read_text(encoding="utf-8"))

project = "needleforce"
release = PROJECT["project"]["version"]
author = "needleforce"
copyright = "the needleforce authors, Apache-2.0"

extensions = [
    "myst_parser",
    "sphinx.ext.autodoc",
    "sphinx.ext.napoleon",
    "sphinx.ext.viewcode",
    "api_pages",
    "command_pages",
    "docstrings",
    "mathml",
    "sphinx_gallery.gen_gallery",
]
exclude_patterns = ["_build", "extensions", "figures"]

# Pages
myst_enable_extensions = ["dollarmath", "colon_fence", "deflist"]
myst_heading_anchors = 4
smartquotes = False  # "--" before an option stays as it is

# Docstrings
autodoc_member_order = "bysource"
autodoc_typehints = "signature"
autodoc_typehints_format = "short"
python_use_unqualified_type_names = True
maximum_signature_line_length = 70
napoleon_numpy_docstring = False

# The gallery. What its scripts need is compiled in a process of its own: beside the
# many objects of a build the compiler takes five times as long.
subprocess.run([sys.executable, "-m", "needleforce", "doctor", "--compile"], check=True)
sphinx_gallery_conf = {
    "examples_dirs": str(DOCS.parent / "examples"),
    "gallery_dirs": "gallery",
    "filename_pattern": r"\.py$",
    "within_subsection_order": "gallery_run.ORDER",
    "reset_modules": ("gallery_run.prepare",),
    "image_srcset": ["2x"],
    "first_notebook_cell": "%matplotlib inline",
    "download_all_examples": False,
    "show_memory": False,
    "show_signature": False,
    "min_reported_time": 1e9,  # s; pages are the same whatever the machine
    "write_computation_times": False,
}

# Look
html_theme = "furo"
html_title = f"needleforce {release}"
html_static_path = ["style"]
html_css_files = ["site.css"]
html_copy_source = False
html_show_sourcelink = False
html_show_sphinx = False
html_theme_options = {
    "navigation_with_keys": False,
    "light_css_variables": {"color-brand-primary": "#0b5c7a"},
}


def setup(app: Sphinx) -> None:
    """Let tables in the pages be of the language csv, which has no colours."""
    app.add_lexer("csv", TextLexer)
