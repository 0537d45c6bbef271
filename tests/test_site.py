"""The pages of docs/: their form, their code, and that the reference has all that there is."""

from __future__ import annotations

import re
import runpy
import shlex
import sys
from collections.abc import Iterator
from pathlib import Path
from typing import NamedTuple

import pytest
from docutils import nodes
from docutils.core import publish_doctree
from myst_parser.docutils_ import Parser

import cellslam
from cellslam.benchmarks.scores.metrics import ROW_KEYS
from cellslam.cli.main import SECTIONS, build_parser, main
from cellslam.scenarios.keys import known_fields
from cellslam.scenarios.loading import load, preset_names
from cellslam.scenarios.scenario import Scenario
from cellslam.scenarios.suites import suite
from cellslam.slam import registry

ROOT = Path(__file__).parents[1]
DOCS = ROOT / "docs"
sys.path.append(str(DOCS / "site"))
import draw_gallery  # noqa: E402
import glossary_links  # noqa: E402
import reference_pages  # noqa: E402

PAGES = sorted(str(p.relative_to(DOCS)) for p in DOCS.rglob("*.md") if "examples" not in p.parts)
# Pages whose blocks of code are run, one after the other in one folder.
RUN = (
    "tutorials/first-drive.md",
    "tutorials/your-estimator.md",
    "tutorials/your-city.md",
    "tutorials/your-recording.md",
    "tutorials/train-an-agent.md",
    "how-to/command-line.md",
    "how-to/replace-parts-of-fastslam.md",
    "how-to/scenario-files.md",
    "reference/environments.md",
)
# Pages with a module: the file that it is saved as, and how many blocks of Python are such modules, one after another.
MODULES = {
    "tutorials/your-estimator.md": ("coasting.py", 99),
    "how-to/replace-parts-of-fastslam.md": ("my_parts.py", 1),
}
OUTPUT = ("text", "{toctree}")


class Block(NamedTuple):
    """A block of code of a page: language, text, and why it is not run ("": it is)."""

    language: str
    text: str
    why_not: str


def blocks(page: str) -> list[Block]:
    found = re.findall(r"^(?:<!-- not run: (.*?) -->\n)?```(\S*)\n(.*?)^```$", (DOCS / page).read_text(), re.S | re.M)
    return [Block(language, text, why_not) for why_not, language, text in found]


def command_lines(text: str) -> Iterator[list[str]]:
    """Yield the words of each command of cellslam in a block, without redirections and comments."""
    for line in text.replace("\\\n", " ").splitlines():
        words = shlex.split(line, comments=True)
        if words[:1] == ["cellslam"]:
            yield words[1 : words.index(">") if ">" in words else None]


@pytest.mark.parametrize("page", PAGES)
def test_code_is_run_or_says_why_not_and_commands_parse(page: str) -> None:
    for block in blocks(page):
        assert block.language, block.text
        assert page in RUN or block.why_not or block.language.startswith(OUTPUT), block.text
        for words in command_lines(block.text) if block.language == "sh" else ():
            build_parser(words).parse_args(words)


def test_commands_of_the_readme_and_of_the_gallery_parse() -> None:
    readme = re.findall(r"`(cellslam [a-z]+ [^`]+)`", (ROOT / "README.md").read_text())
    gallery = [line for picture in draw_gallery.GALLERY.values() for line in picture.commands]
    assert readme and gallery
    for words in command_lines("\n".join([*readme, *gallery])):
        build_parser(words).parse_args(words)
    assert all((DOCS / "images" / f"{name}.png").is_file() for name in draw_gallery.GALLERY | draw_gallery.OTHERS)


@pytest.mark.slow
@pytest.mark.parametrize("page", RUN)
def test_code_of_a_page_runs(page: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """Commands run in this process, Python in one after the other; a file is what the sentence before it names."""
    monkeypatch.chdir(tmp_path)
    (tmp_path / "docs").symlink_to(DOCS)
    monkeypatch.syspath_prepend(tmp_path)
    named, (module, left) = dict[str, object]({"__name__": "page"}), MODULES.get(page, ("", 0))
    for block in (b for b in blocks(page) if not b.why_not):
        if block.language == "sh":
            for words in command_lines(block.text):
                assert main(words) == 0, words
        elif block.language == "python" and left > 0:
            (tmp_path / module).write_text(block.text)
            left -= 1
        elif block.language == "python":
            exec(compile(block.text, page, "exec"), named)
        elif block.language == "toml":
            (tmp_path / "page.toml").write_text(block.text)
            assert main(["run", "page.toml", "--estimator", "dead-reckoning", "--no-figures", "--quiet"]) == 0


@pytest.mark.slow
@pytest.mark.parametrize("script", sorted(p.name for p in (DOCS / "notebooks").glob("*.py")))
def test_notebooks_run(script: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    pyplot = pytest.importorskip("matplotlib.pyplot")
    pyplot.switch_backend("agg")
    monkeypatch.chdir(tmp_path)
    assert (DOCS / "notebooks" / script).read_text().count("\n# %%\n") <= 10
    with pyplot.rc_context():
        runpy.run_path(str(DOCS / "notebooks" / script), run_name="__main__")
    pyplot.close("all")


def test_reference_has_every_command_preset_estimator_metric_and_public_name() -> None:
    commands, options, scenarios = (
        f"\n{page()}"
        for page in (reference_pages.commands, reference_pages.estimator_options, reference_pages.scenarios)
    )
    assert [
        name for section in SECTIONS.values() for name in section if f"\n### cellslam {name}\n" not in commands
    ] == []
    assert [name for name in preset_names() if f"\n## {name}\n" not in scenarios] == []
    assert [entry.name for entry in registry.BUILT_IN if f"\n## {entry.name}\n" not in options] == []
    explained = re.findall(r"`(\w+)`", (DOCS / "reference" / "row-keys.md").read_text() + reference_pages.metrics())
    assert set(ROW_KEYS) <= set(explained)
    page = reference_pages.python()
    assert [n for n in cellslam.__all__ if not n.startswith("__") and f"### {n}\n" not in page] == []
    suites = reference_pages.suites()
    assert [name for name in suite("standard").scenarios if f"| `{name}` | " not in suites] == []


def test_reference_has_every_key_of_the_presets() -> None:
    page = reference_pages.scenario_keys()
    for name in preset_names():
        for key in known_fields(Scenario, load(name).resolved):
            parts = key.split(".")
            if parts[0] == "sites" and len(parts) > 1:
                parts[1:] = ["NAME", *parts[2:]]
                parts[3:] = ["N", *parts[4:]] if len(parts) > 3 else []
            if parts[0] not in reference_pages.NOT_KEYS and parts[-1] not in ("sites", "cells", "NAME", "N"):
                whole = ".".join(parts)
                assert f"`{whole}`" in page or f"\n## {whole}\n" in page or f"`{whole}." in page, key


def as_built(text: str) -> nodes.document:
    """A page as the site has it: what only Sphinx knows is left out."""
    settings = {"report_level": 5, "halt_level": 5, "myst_enable_extensions": ["attrs_inline", "colon_fence"]}
    page: nodes.document = publish_doctree(text, parser=Parser(), settings_overrides=settings)
    glossary_links.link_first_uses(page, "glossary.html")
    return page


def test_first_uses_are_links_that_show_the_meaning() -> None:
    text = """# VT

*Clutter* is noise, [gate](x.md) and `gate` are none. Who looks at VTs, a fused measurement of two links; the VT's gate,
gates.

Virtual transmitters and clutter again.
"""
    links = [node for node in as_built(text).findall(nodes.reference) if "term" in node["classes"]]
    assert [node.astext() for node in links] == ["VTs", "fused measurement", "links", "gate"]
    assert links[0]["refuri"] == "glossary.html#term-vt" and "mirrored in the plane" in links[0]["reftitle"]
    page: nodes.document = publish_doctree("**clock offset**", parser=Parser())
    glossary_links.mark_words(page)
    assert [node["ids"] for node in page.findall(nodes.strong)] == [["term-clock-offset"]]
