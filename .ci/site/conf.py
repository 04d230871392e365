"""The documentation as a site (Sphinx): see .ci/docs. Every warning, a broken link or anchor too, is an error."""

import re
from pathlib import Path

_VERSION = re.compile(r'^__version__ = "(.*)"$', re.MULTILINE)

project = "panoexec"
author = "The panoexec project"
project_copyright = "Apache-2.0"
release = _VERSION.findall((Path(__file__).parents[2] / "panoexec" / "__init__.py").read_text())[0]
extensions = ["myst_parser"]
source_suffix = {".md": "markdown"}
myst_heading_anchors = 6  # anchors as on GitHub
html_theme = "furo"
html_title = f"panoexec {release}"
html_theme_options = {"source_repository": "https://github.com/panoexec/panoexec/", "source_branch": "main"}
html_copy_source = False
html_show_copyright = False
