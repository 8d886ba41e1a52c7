"""The configuration of the site: `docs/build` builds it from a checkout."""

import sys
from pathlib import Path

DOCS = Path(__file__).parent
sys.path[:0] = [str(DOCS), str(DOCS.parent)]

from _site import docstrings, gallery, reference, tutorials

import dolfinx_signorini

# Pages that are made from scripts, scene files and definitions, before Sphinx looks for pages.
tutorials.make_notebooks(DOCS)
gallery.make_gallery(DOCS)
reference.make_reference(DOCS)

project = "dolfinx_signorini"
author = "the dolfinx_signorini developers"
version = release = dolfinx_signorini.__version__
copyright = "2026, the dolfinx_signorini developers"

extensions = [
    "myst_nb",
    "sphinx.ext.autodoc",
    "sphinx.ext.napoleon",
    "sphinx_copybutton",
    "sphinx_design",
]
exclude_patterns = ["_site", "README.md"]
nitpicky = False
autodoc_member_order = "bysource"
autodoc_typehints = "none"
autodoc_preserve_defaults = True
napoleon_google_docstring = True
napoleon_use_ivar = True

myst_enable_extensions = ["amsmath", "colon_fence", "deflist", "dollarmath"]
myst_heading_anchors = 3
nb_execution_mode = "force"
nb_execution_in_temp = True
nb_execution_timeout = 150
nb_execution_raise_on_error = True
nb_merge_streams = True

html_theme = "furo"
html_title = "dolfinx_signorini"
html_static_path = ["_static"]
html_css_files = ["site.css"]
html_theme_options = {
    "light_css_variables": {"color-brand-primary": "#0072B2", "color-brand-content": "#0072B2"},
    "dark_css_variables": {"color-brand-primary": "#56B4E9", "color-brand-content": "#56B4E9"},
}
copybutton_prompt_text = r">>> |\$ "
copybutton_prompt_is_regexp = True


def setup(app):
    # Before and after Napoleon, whose priority is 500.
    app.connect("autodoc-process-docstring", docstrings.process, priority=400)
    app.connect("autodoc-process-docstring", docstrings.shown, priority=600)
    app.connect("source-read", tutorials.linked)
