"""How Sphinx builds these pages: `make docs`, into build/docs."""

from ndob_fmu import __version__

project = "ndob-fmu"
author = "the ndob-fmu authors"
version = release = __version__
extensions = ["myst_nb"]
html_theme = "furo"
html_show_copyright = False
html_title = f"ndob-fmu {__version__}"
exclude_patterns = ["Thumbs.db"]
nitpicky = True

myst_heading_anchors = 4
myst_enable_extensions = ["colon_fence"]

# The notebook is executed at each build; a cell that fails, fails the build.
nb_execution_mode = "force"
nb_execution_raise_on_error = True
nb_execution_timeout = 300
nb_execution_in_temp = True
nb_merge_streams = True
