"""How the pages become a site: ``make docs``. Nothing is fetched, neither while building nor by the pages."""

from __future__ import annotations

import jointplay

project = "jointplay"
author = "The jointplay developers"
version = release = jointplay.__version__

extensions = ["myst_parser", "sphinx.ext.autodoc", "sphinx.ext.napoleon"]
source_suffix = {".md": "markdown"}
exclude_patterns = ["_build"]

myst_enable_extensions = ["deflist"]
myst_heading_anchors = 4
nitpicky = True
nitpick_ignore_regex = [("py:.*", ".*")]  # of the Python names those of reference/python-api alone have a place here

autodoc_typehints = "none"  # the docstrings say types
autodoc_member_order = "bysource"
napoleon_google_docstring = False
napoleon_use_rtype = False

html_theme = "alabaster"
html_theme_options = {
    "description": "Finds worn joints of planar machines from the vibration of their frame",
    "fixed_sidebar": True,
    "page_width": "72rem",
    "show_relbars": True,
}
html_show_sourcelink = False
html_copy_source = False
html_extra_path = ["openapi.json"]
