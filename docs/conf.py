"""The documentation site: `make docs` builds it from Markdown and docstrings, without ROS and without a network."""

from __future__ import annotations

import re
import sys
from pathlib import Path

from sphinx.application import Sphinx
from sphinx.errors import ConfigError

HERE = Path(__file__).parent
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
nb_execution_mode = "off"  # the outputs are stored in the notebook, which a test executes

autodoc_member_order = "bysource"
autodoc_typehints = "signature"
autodoc_type_aliases = {"Array": "Array", "Variance": "Variance"}
napoleon_use_rtype = False
napoleon_use_ivar = True  # attributes are fields of their class, not entries beside those of a named tuple
default_role = "any"  # `Name` in a docstring is a link, which must lead somewhere

# Every name of ours must have its entry, but for constants and type variables; those of other libraries would take a
# network.
nitpicky = True
nitpick_ignore_regex = [(r"py:.*", r"(?!rkhs_ros|sim_nodes).*|.*\.[A-Z]"), ("any", r"numpy\..*|[A-Z_]+")]


def check_settings(app: Sphinx) -> None:
    """Raise ConfigError where docs/settings.md is not what the code says of its settings."""
    if not make_settings.is_up_to_date():
        raise ConfigError("docs/settings.md: expected the settings as they are; run python docs/make_settings.py")


def is_skipped(app: Sphinx, what: str, name: str, member: object, skip: bool, options: object) -> bool | None:
    """Skip the fields of named tuples, which the docstring of their class describes."""
    return True if (getattr(member, "__doc__", None) or "").startswith("Alias for field number") else None


def add_modules(app: Sphinx, page: str, source: list[str]) -> None:
    """Put an entry for each module of a package in place of the comment that asks for them."""
    source[0] = MODULES.sub(lambda match: "\n".join(map(entry, modules_of(match[1]))), source[0])


def modules_of(package: str) -> list[str]:
    """Return the dotted names of a package's modules."""
    files = sorted((HERE.parent / package.replace(".", "/")).glob("*.py"))
    return [f"{package}.{file.stem}" for file in files if file.stem != "__init__"]


def entry(module: str) -> str:
    """Return the heading and the docstrings of a module, in Markdown."""
    name = module.rpartition(".")[2]
    return f"## {name}\n\n```{{eval-rst}}\n.. automodule:: {module}\n   :members:\n   :show-inheritance:\n```\n"


def setup(app: Sphinx) -> None:
    """Check the page of the settings, and complete those of the API, in every build."""
    app.connect("source-read", add_modules)
    app.connect("builder-inited", check_settings)
    app.connect("autodoc-skip-member", is_skipped)
