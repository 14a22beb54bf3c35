"""Configuration of Sphinx for the site that ``make docs`` builds from the pages that `stage` has laid out."""

from importlib.metadata import version as installed

project = "goldfield"
author = "the authors of goldfield"
release = version = installed("goldfield")
extensions = ["myst_parser", "sphinx.ext.autodoc", "sphinx.ext.napoleon"]
root_doc = "index"
highlight_language = "none"

myst_enable_extensions = ["deflist"]
myst_heading_anchors = 6
"""Headings of all levels are targets of links, named as on GitHub."""

default_role = "code"
"""Docstrings put names between single back-ticks."""
autodoc_member_order = "bysource"
autodoc_typehints = "signature"
autodoc_class_signature = "separated"
python_use_unqualified_type_names = True
napoleon_google_docstring = False
napoleon_use_rtype = False
napoleon_use_ivar = True

html_theme = "furo"
html_title = "goldfield"
html_static_path = ["static"]
html_css_files = ["site.css"]
html_copy_source = False
html_show_copyright = False

linkcheck_timeout = 20
linkcheck_retries = 2
linkcheck_anchors = False
"""Anchors of pages that scripts build are not in what a server sends."""
