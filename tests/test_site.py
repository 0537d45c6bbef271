"""The pages of docs/: their code runs, their commands parse, and the reference explains what there is."""

from __future__ import annotations

import re
import runpy
import shlex
import sys
from collections.abc import Iterator
from pathlib import Path
from typing import NamedTuple

import pytest

import cellslam
from cellslam.benchmarks.scores.metrics import ROW_KEYS
from cellslam.cli.main import build_parser, main
from cellslam.scenarios.loading import preset_names

ROOT = Path(__file__).parents[1]
DOCS = ROOT / "docs"
sys.path.append(str(DOCS / "site"))
import draw_gallery  # noqa: E402
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
    "how-to/replace-parts-of-the-world.md",
    "how-to/scenario-files.md",
    "reference/environments.md",
    "reference/python/running.md",
    "reference/python/recordings.md",
    "reference/python/estimators.md",
    "reference/python/worlds.md",
)
# Pages with a module: the file that it is saved as, and how many blocks of Python are such modules, one after another.
MODULES = {
    "tutorials/your-estimator.md": ("coasting.py", 99),
    "how-to/replace-parts-of-fastslam.md": ("my_parts.py", 1),
    "how-to/replace-parts-of-the-world.md": ("my_world.py", 1),
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


def test_row_keys_presets_and_public_names_are_explained() -> None:
    explained = re.findall(r"`(\w+)`", (DOCS / "reference" / "row-keys.md").read_text() + reference_pages.metrics())
    assert set(ROW_KEYS) <= set(explained)
    shown, scenarios = [n for names, _ in reference_pages.PYTHON.values() for n in names], reference_pages.scenarios()
    assert sorted(shown) == [name for name in sorted(cellslam.__all__) if not name.startswith("__")]
    assert [name for name in preset_names() if f"\n## {name}\n" not in f"\n{scenarios}"] == []
