"""How Sphinx makes HTML of these documents: `make docs`, into build/docs."""

import multicontact_control

project = 'multicontact_control'
author = 'multicontact_control maintainers'
copyright = author  # noqa: A001 - that is what Sphinx calls it
release = multicontact_control.__version__

extensions = ['myst_parser', 'sphinx.ext.autodoc', 'sphinx.ext.napoleon']
exclude_patterns = ['make_reference.py']
html_theme = 'furo'
html_title = 'multicontact control'
html_static_path, html_css_files = ['_static'], ['wide.css']

myst_heading_anchors = 4  # as GitHub makes them, so that a link works in both
autodoc_member_order = 'bysource'
autodoc_typehints = 'description'
napoleon_google_docstring = False
