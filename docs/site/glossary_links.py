"""Words of the glossary in the site's pages: the first use on a page is a link to the meaning, and shows it in passing.

A word is first used where it stands neither in code, nor in a heading, nor in a link. Where a page puts the word itself
in italics or bold, it says what it means, and needs no link. Verbs that look like a word of the glossary that is marked
as a noun are recognised by the word before them.
"""

from __future__ import annotations

import re
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any, NamedTuple

from docutils import nodes

PAGE = "reference/glossary"
FILE = Path(__file__).parents[1] / f"{PAGE}.md"
NOT_PROSE = (nodes.reference, nodes.literal, nodes.literal_block, nodes.title, nodes.raw, nodes.math, nodes.comment)
_BEFORE_A_NOUN = re.compile(r"\b(an?|the|one|each|every|of|into|with|new|two|all|which|its|no)\s$", re.IGNORECASE)
_ROW = re.compile(r"^\| \*\*(.+?)\*\*(?:, \*\*(.+?)\*\*)?( \(noun\))? \| (.+?) \|$", re.MULTILINE)


class Term(NamedTuple):
    """A word of the glossary: where its meaning stands, the meaning, and whether only its noun is meant."""

    anchor: str
    meaning: str
    noun: bool


def terms() -> dict[str, Term]:
    """Return the words, in lower case but for abbreviations; a row that says "see X" leads to X."""
    found: dict[str, Term] = {}
    for *words, noun, meaning in _ROW.findall(FILE.read_text("utf-8")):
        for word in filter(None, words):
            found[word] = Term(anchor_of(words[0]), re.sub(r"[*`]", "", meaning), bool(noun))
    return {word: found.get(term.meaning.removeprefix("see "), term) for word, term in found.items()}


def anchor_of(word: str) -> str:
    """Return the place of a word on the glossary's page."""
    return "term-" + re.sub(r"\W+", "-", word.lower())


def uses(text: str, words: dict[str, Term]) -> Iterator[tuple[re.Match[str], Term]]:
    """Yield where words stand in a text, the longest of those that begin at the same place."""
    every = "|".join(
        re.escape(word) if word.isupper() else f"[{word[0].upper()}{word[0]}]{re.escape(word[1:])}"
        for word in sorted(words, key=len, reverse=True)
    )
    for found in re.finditer(rf"\b({every})s?\b", text):
        term = words.get(found[1]) or words[found[1][0].lower() + found[1][1:]]
        if not term.noun or _BEFORE_A_NOUN.search(text[: found.start()]):
            yield found, term


def link_first_uses(doctree: nodes.document, uri: str) -> None:
    """Make the first use of each word in a page a link to `uri`, the glossary's page."""
    words, linked = terms(), set[str]()
    for text in list(doctree.findall(nodes.Text)):
        parent = text.parent
        if any(isinstance(one, NOT_PROSE) for one in around(text)):
            continue
        pieces: list[nodes.Node] = []
        done = 0
        for found, term in uses(str(text), words):
            if term.anchor in linked:
                continue
            linked.add(term.anchor)
            if isinstance(parent, nodes.emphasis | nodes.strong) and found[0] == text:
                continue
            link = nodes.reference("", found[0], refuri=f"{uri}#{term.anchor}", reftitle=term.meaning)
            link["internal"], link["classes"] = True, ["term"]
            pieces += [nodes.Text(text[done : found.start()]), link]
            done = found.end()
        if pieces:
            parent.replace(text, [*pieces, nodes.Text(text[done:])])


def mark_words(doctree: nodes.document) -> None:
    """Give each word on the glossary's page the place that links lead to."""
    for strong in doctree.findall(nodes.strong):
        strong["ids"].append(anchor_of(strong.astext()))


def on_resolved(app: Any, doctree: nodes.document, page: str) -> None:
    """Link the pages that are read from the beginning; in the reference things are looked up."""
    relative: Callable[[str, str], str] = app.builder.get_relative_uri
    if page == PAGE:
        mark_words(doctree)
    elif not page.startswith("reference/"):
        link_first_uses(doctree, relative(page, PAGE))


def around(node: nodes.Node) -> Iterator[nodes.Node]:
    """Yield what a node stands in, from the inside."""
    while node.parent is not None:
        node = node.parent
        yield node
