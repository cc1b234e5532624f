"""Configure the documentation site, which `make docs` builds from Markdown and docstrings, offline and without ROS."""

import re
import sys
from pathlib import Path

from sphinx.application import Sphinx
from sphinx.errors import ConfigError

HERE = Path(__file__).parent
PICTURE = re.compile(r' download=""( href="[^"]+\.png")')
MODULES = re.compile(r"<!-- modules of (\S+) -->")
sys.path[:0] = [str(HERE.parent), str(HERE)]

import make_settings  # noqa: E402  # beside this file

from rkhs_ros import __version__  # noqa: E402

project = "rkhs_ros"
author = "The rkhs_ros authors"
version = release = __version__
exclude_patterns = ["_build", "results"]

extensions = [
    "myst_nb",  # pages in Markdown, and the notebook
    "sphinx.ext.autodoc",
    "sphinx.ext.napoleon",
    "sphinx.ext.mathjax",
    "sphinx-mathjax-offline",
]

html_theme = "furo"
html_title = f"rkhs_ros {version}"
html_theme_options = {"navigation_with_keys": True}
html_static_path = ["_static"]
html_css_files = ["site.css"]
html_show_copyright = False

myst_enable_extensions = ["dollarmath"]
myst_heading_anchors = 4
nb_execution_mode = "off"  # the notebook stores its outputs; a test executes it

autodoc_member_order = "bysource"
autodoc_typehints = "signature"
autodoc_type_aliases = {"Array": "Array", "Variance": "Variance"}
napoleon_use_rtype = False
napoleon_use_ivar = True  # document attributes as fields of their class
default_role = "any"  # `Name` in a docstring is a link that must have a target

# Each of our names must have an entry, except constants and type variables. Names of other libraries would need a
# network.
nitpicky = True
nitpick_ignore_regex = [(r"py:.*", r"(?!rkhs_ros|sim_nodes).*|.*\.[A-Z]"), ("any", r"numpy\..*|[A-Z_]+")]


def check_settings(app: Sphinx) -> None:
    """Raise ConfigError if docs/settings.md is out of date."""
    if not make_settings.is_up_to_date():
        raise ConfigError(
            "docs/settings.md: expected the current settings, got an outdated page. Run `python docs/make_settings.py`"
        )


def is_skipped(app: Sphinx, what: str, name: str, member: object, skip: bool, options: object) -> bool | None:
    """Skip the fields of named tuples, which the docstring of their class describes."""
    return True if (getattr(member, "__doc__", None) or "").startswith("Alias for field number") else None


def add_modules(app: Sphinx, page: str, source: list[str]) -> None:
    """Replace the comment `<!-- modules of PACKAGE -->` by an entry for each module."""
    source[0] = MODULES.sub(lambda match: "\n".join(map(entry, modules_of(match[1]))), source[0])


def modules_of(package: str) -> list[str]:
    """Return the dotted names of the modules of a package."""
    files = sorted((HERE.parent / package.replace(".", "/")).glob("*.py"))
    return [f"{package}.{file.stem}" for file in files if file.stem != "__init__"]


def entry(module: str) -> str:
    """Return the heading and the docstrings of a module as Markdown."""
    name = module.rpartition(".")[2]
    return f"## {name}\n\n```{{eval-rst}}\n.. automodule:: {module}\n   :members:\n   :show-inheritance:\n```\n"


def show_pictures(app: Sphinx, page: str, template: str, context: dict[str, object], tree: object) -> None:
    """Let links to pictures show them instead of saving them."""
    context["body"] = PICTURE.sub(r"\1", str(context.get("body", "")))


def setup(app: Sphinx) -> None:
    """Connect the hooks that check the page of settings and complete the pages of the API."""
    app.connect("source-read", add_modules)
    app.connect("builder-inited", check_settings)
    app.connect("html-page-context", show_pictures)
    app.connect("autodoc-skip-member", is_skipped)
