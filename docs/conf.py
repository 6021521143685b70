"""How Sphinx makes the manual: `python -m sphinx -W docs docs/_build/html`. Nothing is fetched."""

from __future__ import annotations

import os
import sys
from pathlib import Path

ROOT = Path(__file__).resolve().parent.parent
sys.path[:0] = [str(ROOT), str(ROOT / "docs")]

# Kernels as the plain functions that they are written as, whose signatures and docstrings can be read.
# Taken back, because notebooks fly with compiled ones.
_before = os.environ.get("NUMBA_DISABLE_JIT")
os.environ["NUMBA_DISABLE_JIT"] = "1"
import formation_env  # noqa: E402

if _before is None:
    del os.environ["NUMBA_DISABLE_JIT"]

project = "Formation"
author = "The Formation authors"
copyright = author
version = release = formation_env.__version__

extensions = [
    "myst_nb",
    "sphinx.ext.autodoc",
    "sphinx.ext.viewcode",
    "_ext.mathml",
    "_ext.pages",
    "_ext.reference",
]
exclude_patterns = ["_build", "_ext"]
nitpicky = True
# Without an inventory of other projects, which would have to be fetched, their names are no links.
nitpick_ignore_regex = [
    ("py:.*", r"(?!(formation_env|baselines|train)\.).*"),
    # Two classes of one name, of which the reference has the other.
    ("py:class", r"baselines\.scoring\.intervals\.Estimate"),
]
highlight_language = "none"
default_role = "literal"

myst_enable_extensions = ["dollarmath", "colon_fence", "deflist"]
myst_heading_anchors = 4

nb_execution_mode = "cache"
nb_execution_timeout = 1800  # s, of a cell: compiling on a busy machine takes its time
nb_execution_raise_on_error = True
nb_merge_streams = True
nb_output_stderr = "remove"  # progress

autodoc_member_order = "bysource"
autodoc_typehints = "signature"
autodoc_preserve_defaults = True
python_maximum_signature_line_length = 88
python_use_unqualified_type_names = True
viewcode_line_numbers = True
modindex_common_prefix = ["formation_env."]

html_theme = "furo"
html_title = "Formation"
html_static_path = ["_static"]
html_css_files = ["manual.css"]
html_show_copyright = False
html_copy_source = False
html_show_search_summary = False  # a browser fetches no page that was opened from the disk
