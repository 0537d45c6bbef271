"""`cellslam bench leaderboard`: one page of all entries to a suite, each a file of `bench accuracy --rows`."""

from __future__ import annotations

import shlex
from argparse import ArgumentParser, Namespace
from dataclasses import replace
from pathlib import Path

from cellslam.benchmarks.trials.output_files import check_file, write_text
from cellslam.cli.output import note
from cellslam.sim.errors import InputError

EXAMPLES = ("bench leaderboard mine.json theirs.json --write leaderboard.md",)


def add_arguments(parser: ArgumentParser) -> None:
    parser.add_argument("entries", metavar="FILE.json", nargs="+", help="rows of a suite, from bench accuracy --rows")
    write_help = "the page to write, and beside it the ranks as FILE.png"
    parser.add_argument("--write", metavar="FILE.md", required=True, help=write_help)


def command(arguments: Namespace) -> None:
    page = Path(arguments.write)
    check_file(page, "--write")
    import pandas as pd

    from cellslam.benchmarks.tables.suite_rows import read
    from cellslam.benchmarks.tables.suite_tables import leaderboard_markdown
    from cellslam.cli.commands.bench_accuracy import draw_verdicts

    entries = [read(Path(file)) for file in arguments.entries]
    made_with: dict[str, str] = {}
    for file, entry in zip(arguments.entries, entries, strict=True):
        if entry.suite != entries[0].suite:
            raise InputError(f"{file}: rows of {entry.suite.name}, the first are of {entries[0].suite.name}")
        for name in entry.rows["estimator"].unique():
            if name in made_with:
                raise InputError(f"{file}: '{name}' is in another file too; give each estimator once")
            made_with[name] = entry.versions.get("cellslam", "-")
    rows = pd.concat([entry.rows for entry in entries], ignore_index=True)
    every = replace(entries[0], rows=rows, oracles=frozenset().union(*(entry.oracles for entry in entries)))
    picture = draw_verdicts(every, page.with_suffix(".png"))
    command = shlex.join(["cellslam", *arguments.words])
    write_text(page, leaderboard_markdown(every, made_with, command, picture))
    note(arguments, f"{len(made_with)} estimators are on {page}")
