"""The site that Sphinx makes of this folder and the docstrings: by ``make docs``, and by rosdoc2 on docs.ros.org."""

from importlib.util import find_spec
from pathlib import Path

project = "tam_calibration"
copyright = "The tam_calibration maintainers. Apache-2.0"
html_title = project

extensions = [
    "sphinx.ext.autodoc",
    "myst_parser",
    "numpydoc" if find_spec("numpydoc") else "sphinx.ext.napoleon",  # rosdoc2 does not bring numpydoc
]
html_theme = "sphinx_rtd_theme"  # that of docs.ros.org
html_theme_options = {"titles_only": True}
# Read here by Sphinx, and by rosdoc2 one folder above its copy of docs/
html_static_path = [name for name in ("_static", "docs/_static") if (Path(__file__).parent / name).is_dir()]
html_css_files = ["tables.css"]
myst_heading_anchors = 3  # the anchors that a page has on GitHub

autodoc_member_order = "groupwise"
autodoc_typehints = "none"  # the sections say it, with shapes and units
numpydoc_show_class_members = False  # autodoc shows them where they stand
python_maximum_signature_line_length = 88

rosdoc2_settings = {"allow_other_extensions": True}
