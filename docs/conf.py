"""How Sphinx makes HTML of these documents: `make docs`, into build/docs."""

import multicontact_control
from sphinx.util.inspect import TypeAliasForwardRef

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
# Types by these names, not as what numpy makes of them; in a union Sphinx prints their `repr`.
autodoc_type_aliases = {name: name for name in ('ArrayLike', 'Vector', 'Matrix')}
TypeAliasForwardRef.__repr__ = lambda alias: alias.name
napoleon_google_docstring = False
