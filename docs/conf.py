"""How the site is built: `sphinx-build -W docs build/site`. Nothing is fetched from elsewhere.

Source: https://www.sphinx-doc.org/en/master/usage/configuration.html, https://myst-parser.readthedocs.io
"""

from __future__ import annotations

import re
import sys
from functools import partial
from importlib.metadata import version as installed
from pathlib import Path
from typing import Any

HERE = Path(__file__).resolve().parent
sys.path.append(str(HERE / "site"))
import draw_gallery  # noqa: E402
import glossary_links  # noqa: E402
import reference_pages  # noqa: E402

project = "cellslam"
author = "The cellslam developers"
version = release = installed("cellslam")
extensions = ["myst_parser", "sphinx.ext.autodoc", "sphinx_copybutton"]
exclude_patterns = ["examples", "site"]
html_theme = "furo"
html_title = "cellslam"
html_logo = html_favicon = "site/logo.svg"
html_static_path = ["site/site.css", "site/site.js"]
html_css_files = ["site.css"]
html_js_files = [("site.js", {"defer": "defer"})]
html_copy_source = False
html_show_copyright = False
html_show_sphinx = False
default_role = "code"
myst_enable_extensions = ["attrs_inline", "colon_fence"]
myst_heading_anchors = 3
autodoc_member_order = "bysource"
autodoc_type_aliases = {name: name for name in ("Floats", "Ints", "Estimators", "OnError", "Step")}
autodoc_typehints_format = "short"
autodoc_default_options = {"members": True, "exclude-members": "model_config"}
add_module_names = False
smartquotes = False  # two dashes are an option
toc_object_entries_show_parents = "hide"
python_use_unqualified_type_names = True

GENERATED = {
    "commands": reference_pages.commands,
    "estimator_options": reference_pages.estimator_options,
    "gallery": draw_gallery.page,
    "metrics": reference_pages.metrics,
    "scenario_keys": reference_pages.scenario_keys,
    "scenarios": reference_pages.scenarios,
    "suites": reference_pages.suites,
    **{f"python_{page}": partial(reference_pages.python, page) for page in reference_pages.PYTHON},
}
MADE = re.compile(r"^> Made from the code \((\w+)\): .*?(?=\n\n|\Z)", re.M | re.S)  # what a page says in a checkout


def add_generated(app: Any, page: str, source: list[str]) -> None:
    """Put what the code says where a page is made from it, and names in the place of links to what is not a page."""
    place = HERE / Path(page).parent
    text = MADE.sub(lambda found: GENERATED[found[1]](), source[0])

    def mended(link: re.Match[str]) -> str:
        target = (place / link[2]).resolve()
        return link[0] if target.is_relative_to(HERE) else f"{link[1]} (`{target.relative_to(HERE.parent)}`)"

    source[0] = re.sub(r"(?<!!)\[([^\]]+)\]\((\.\./[^)\s#]+)\)", mended, text)


def quote(app: Any, what: str, name: str, value: Any, options: Any, lines: list[str]) -> None:
    """Keep the signs of a docstring that reStructuredText would take for marks; code is left alone."""
    lines[:] = [
        "".join(p if p.startswith("`") else re.sub(r"([*|\\]|_\b)", r"\\\1", p) for p in re.split(r"(`[^`]*`)", line))
        for line in lines
    ]


def tidy(app: Any, what: str, name: str, value: Any, options: Any, signature: str | None, returns: str | None) -> Any:
    """Leave out of a signature what Sphinx 9 adds to aliases inside of other types."""

    def plain(text: str | None) -> str | None:
        return text and re.sub(r"TypeAliasForwardRef\('(\w+)'\)|~?typing\.(\w+)", r"\1\2", text)

    return plain(signature), plain(returns)


def setup(app: Any) -> None:
    """Register what is above."""
    app.connect("source-read", add_generated)
    app.connect("doctree-resolved", glossary_links.on_resolved)
    app.connect("autodoc-process-docstring", quote)
    app.connect("autodoc-process-signature", tidy)
