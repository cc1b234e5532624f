"""The documentation site: `make docs` builds it from Markdown and docstrings, without ROS and without a network."""

from __future__ import annotations

import sys
from pathlib import Path

from sphinx.application import Sphinx
from sphinx.errors import ConfigError

HERE = Path(__file__).parent
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
autodoc_mock_imports = ["rclpy", "rkhs_interfaces", "rcl_interfaces", "diagnostic_msgs", "rosgraph_msgs"]
napoleon_use_rtype = False
napoleon_use_ivar = True  # attributes are fields of their class, not entries beside those of a named tuple
default_role = "any"  # `Name` in a docstring is a link, which must lead somewhere

# Every name of ours must have its entry, but for constants; those of other libraries would take a network.
nitpicky = True
nitpick_ignore_regex = [(r"py:.*", r"(?!rkhs_ros|sim_nodes).*"), ("any", r"numpy\..*|[A-Z_]+")]


def check_settings(app: Sphinx) -> None:
    """Raise ConfigError where docs/settings.md is not what the code says of its settings."""
    if not make_settings.is_up_to_date():
        raise ConfigError("docs/settings.md: expected the settings as they are; run python docs/make_settings.py")


def is_skipped(app: Sphinx, what: str, name: str, member: object, skip: bool, options: object) -> bool | None:
    """Skip the fields of named tuples, which the docstring of their class describes."""
    return True if (getattr(member, "__doc__", None) or "").startswith("Alias for field number") else None


def setup(app: Sphinx) -> None:
    """Have the page of the settings checked by every build."""
    app.connect("builder-inited", check_settings)
    app.connect("autodoc-skip-member", is_skipped)
