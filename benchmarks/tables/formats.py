"""How tables look: headings and numbers, and tables as text, Markdown, LaTeX (booktabs), CSV, JSON."""

from __future__ import annotations

import json
import math
import re
from collections.abc import Callable, Collection, Mapping, Sequence
from dataclasses import dataclass, replace
from typing import TYPE_CHECKING, Any

from cellslam.benchmarks.scores.metrics import METRIC, shown_in
from cellslam.benchmarks.scores.statistics import plain
from cellslam.benchmarks.tables.summaries import BOUNDED, CONFIDENCE, RATIOS, estimate

if TYPE_CHECKING:
    import pandas as pd

PIPE_WIDTH = 200
LONG, TOO_WIDE = 1e3, 1e5  # without decimals; as a power of ten: a spoilt covariance claims an NEES of 1e11
_KEY = re.compile(rf"\b({'|'.join(METRIC)})\b")
_CLASS = re.compile(r"[\w.]+:(?=\w)")
_LATEX = {c: f"\\{c}" for c in "&%$#_{}"} | {"\\": "\\textbackslash{}", "~": "\\textasciitilde{}", "^": "\\^{}"}

Columns = Mapping[str, Callable[[Mapping[Any, Any]], str]]  # by heading: the text of a column, of a tidy line


@dataclass(frozen=True)
class Grid:
    """A table for people: headings, lines of text, and notes below; the first `labels` columns are not numbers."""

    headings: tuple[str, ...]
    lines: tuple[tuple[str, ...], ...]
    labels: int
    notes: tuple[str, ...] = ()


@dataclass(frozen=True)
class Column:
    """A column of results: a metric, the statistic that sums up trials, and whether its 95 % interval is given."""

    metric: str
    statistic: str = "median"
    interval: bool = False

    @property
    def name(self) -> str:
        """The metric's heading; that of a quantile is which one."""
        quantile = self.statistic.startswith("q")
        return f"{self.statistic[1:]} %" if quantile else METRIC[self.metric].heading

    @property
    def heading(self) -> str:
        """The name with its unit, and with the confidence of the interval."""
        text = replace(METRIC[self.metric], heading=self.name).titled
        return f"{text} [{100 * CONFIDENCE:g} %]" if self.interval else text


def columns_of(table: str, with_interval: Collection[str]) -> list[Column]:
    """Return the columns of a table of several trials, those of metrics in `with_interval` with their interval.

    They are medians, but for memory, of which the largest counts; the RMSE has its 90 % quantile beside it.
    """
    keys = shown_in(table)
    columns = [Column(key, "max" if key == "peak_memory_mb" else "median", key in with_interval) for key in keys]
    beside = sum(key in (BOUNDED, *RATIOS) for key in keys)
    return [*columns[:beside], Column(BOUNDED, "q90", table == "report"), *columns[beside:]]


def cell(rows: pd.DataFrame, column: Column) -> str:
    """Return what a column says of rows that are ok."""
    value, low, high = estimate(rows, column.metric, column.statistic, CONFIDENCE if column.interval else None)
    return bracketed(value, low, high, column.metric)


def bracketed(value: float | None, low: float | None, high: float | None, metric: str, statistic: str = "") -> str:
    """Return a number, and in brackets its interval where it has one."""
    text = number(value, metric, statistic)
    return text if _missing(low) else f"{text} [{number(low, metric, statistic)}, {number(high, metric, statistic)}]"


def render(tidy: pd.DataFrame, grid: Grid, format_: str) -> str:
    """Return a table as text, md, csv, latex or json; csv and json hold the tidy numbers, md and latex speak words."""
    if format_ == "csv":
        return str(tidy.to_csv(index=False))
    if format_ == "json":
        lines = ({key: plain(value) for key, value in line.items()} for line in tidy.to_dict("records"))
        return "[\n" + ",\n".join(json.dumps(line, allow_nan=False) for line in lines) + "\n]\n"
    if format_ == "text":
        return _text(grid)
    headings, notes = (tuple(map(in_words, texts)) for texts in (grid.headings, grid.notes))
    body = tuple((*map(in_words, line[: grid.labels]), *line[grid.labels :]) for line in grid.lines)
    return (markdown if format_ == "md" else _latex)(Grid(headings, body, grid.labels, notes))


def in_words(text: str) -> str:
    """Return a text with headings in place of metrics, and classes without the modules that they are in."""
    return _CLASS.sub("", _KEY.sub(lambda found: METRIC[found[0]].titled, text))


def number(value: float | None, metric: str = "", statistic: str = "") -> str:
    """Return a number with the digits that suit its metric; one that would fill the line as a power of ten."""
    if value is None or not math.isfinite(value):
        return "-"
    if abs(value) >= TOO_WIDE:
        return f"{value:.0e}"
    digits = 3 if statistic.startswith("share>") else METRIC[metric].digits if metric in METRIC else 2
    return f"{value:.{digits if abs(value) < LONG else 0}f}"


def summary_grid(tidy: pd.DataFrame, keys: Sequence[str], columns: str | None, oracles: frozenset[str]) -> Grid:
    """Return the grid of a summary: a column for each value of key `columns`, metric and statistic."""
    across = [*([columns] if columns else []), "metric", "statistic"]
    values = {key: tidy.loc[tidy[key] != "", key] for key in across}  # a ratio has no statistic
    several = [key for key in across if values[key].nunique(dropna=False) > 1]
    cells: dict[tuple[str, ...], dict[str, str]] = {}
    trials: dict[tuple[str, ...], set[tuple[int, int]]] = {}
    for line in tidy.to_dict("records"):
        row = tuple(_label(key, line[key], oracles) for key in keys)
        named = [key for key in across if line[key] != "" and (key in several or key == columns)]
        heading = ", ".join(_heading(key, line[key], columns, oracles) for key in named)
        heading = heading or " of ".join(filter(None, (line["statistic"], line["metric"])))
        text = bracketed(line["value"], line.get("low"), line.get("high"), line["metric"], line["statistic"])
        cells.setdefault(row, {})[heading] = text
        trials.setdefault(row, set()).add((line["trials"], line["failed"]))
    headings = list(dict.fromkeys(heading for own in cells.values() for heading in own))
    body = tuple((*row, *(own.get(one, "-") for one in headings), _counted(trials[row])) for row, own in cells.items())
    same = [key for key in ("metric", "statistic") if key not in several and len(values[key])]
    notes = [f"{key}: {values[key].iloc[0]}" for key in same if several]
    if any("(oracle)" in text for row in (*cells, headings) for text in row):
        notes.append("oracle: was shown the truth")
    return Grid((*keys, *headings, "trials ok"), body, len(keys), tuple(notes))


def consistency_grid(tidy: pd.DataFrame, keys: Sequence[str], oracles: frozenset[str]) -> Grid:
    """Return the grid of how consistent covariances are with the errors, a line for each moment."""
    columns: Columns = {
        "time (s)": lambda line: f"{line['time_s']:.0f}",
        "NEES": lambda line: number(line["nees"]),
        "95 % if consistent": lambda line: f"{number(line['nees_low'])} to {number(line['nees_high'])}",
        "positions in 95 %": lambda line: _percent(line, "position"),
        "clocks in 2 sigma": lambda line: _percent(line, "clock"),
        "VTs in 95 %": lambda line: _percent(line, "vt"),
        "trials": lambda line: str(line["trials"]),
    }
    note = "NEES: of the horizontal position, mean over trials; shares with 95 % intervals; VTs: those at the end"
    return _grid(tidy, keys, columns, (note,), oracles)


def integrity_grid(tidy: pd.DataFrame, keys: Sequence[str], oracles: frozenset[str], risk: float) -> Grid:
    """Return the grid of protection levels, and of how often they mislead."""
    columns: Columns = {
        "alert limit (m)": lambda line: f"{line['alert_limit_m']:g}",
        "protection (m)": lambda line: number(line["protection_m"]),
        "99 % served (m)": lambda line: number(line["served_m"]),
        "available": lambda line: f"{100 * line['availability']:.1f} %",
        "misleading [below]": lambda line: f"{line['misleading']:.2g} [{line['misleading_high']:.2g}]",
        "hazardous [below]": lambda line: f"{line['hazardous']:.2g} [{line['hazardous_high']:.2g}]",
        "drives": lambda line: str(line["drives"]),
    }
    note = f"risk {risk:g}; in brackets upper {100 * CONFIDENCE:g} % limits over independent drives"
    return _grid(tidy, [*keys, "claims"], columns, (note,), oracles)


def comparison_grid(tidy: pd.DataFrame, keys: Sequence[str], first: str, second: str, percent: float) -> Grid:
    """Return the grid of paired differences."""

    def interval(line: Mapping[Any, Any]) -> str:
        low, high = (number(line[end], line["metric"]) for end in ("low", "high"))
        return "-" if _missing(line["low"]) else f"{low} to {high}"

    columns: Columns = {
        "median difference": lambda line: number(line["median_difference"], line["metric"]),
        f"{percent:g} % interval": interval,
        "p": lambda line: "-" if _missing(line["p_value"]) else f"{line['p_value']:.2g}",
        f"{first} below": lambda line: "-" if _missing(line["share_below"]) else f"{100 * line['share_below']:.0f} %",
        "pairs": lambda line: str(line["pairs"]),
        "left out": lambda line: str(line["left_out"]),
    }
    what = f"{tidy['metric'].iloc[0]}: {first} minus {second}, the same worlds" if len(tidy) else "no common worlds"
    return _grid(tidy, keys, columns, (what, "p: Wilcoxon's signed-rank test of no difference, each line by itself"))


def _grid(
    tidy: pd.DataFrame,
    keys: Sequence[str],
    columns: Columns,
    notes: tuple[str, ...],
    oracles: frozenset[str] = frozenset(),
) -> Grid:
    """Return the grid of tidy lines: the `keys` of each, and what the columns say of it."""
    lines = tuple(
        (*(_label(key, line[key], oracles) for key in keys), *(text(line) for text in columns.values()))
        for line in tidy.to_dict("records")
    )
    return Grid((*keys, *columns), lines, len(keys), notes)


def _percent(line: Mapping[Any, Any], name: str) -> str:
    if not line[f"{name}s"]:
        return "-"
    share, low, high = (100.0 * line[f"{name}_{part}"] for part in ("share", "low", "high"))
    return f"{share:.0f} % [{low:.0f}, {high:.0f}]"


def _counted(counts: set[tuple[int, int]]) -> str:
    """Return how many trials are ok, of how many where some failed; a range where columns differ."""
    good, bad = sorted({ok for ok, _ in counts}), max(failed for _, failed in counts)
    text = str(good[-1]) if len(good) == 1 else f"{good[0]}-{good[-1]}"
    return f"{text}/{good[-1] + bad}" if bad else text


def _heading(key: str, value: Any, columns: str | None, oracles: frozenset[str]) -> str:
    label = _label(key, value, oracles)
    return f"{key}={label}" if key == columns and key not in ("estimator", "scenario") else label


def _label(key: str, value: Any, oracles: frozenset[str]) -> str:
    if _missing(value):
        return "-"
    text = f"{value:g}" if isinstance(value, float) else str(value)
    return marked(text, oracles) if key == "estimator" else text


def marked(estimator: str, oracles: Collection[str]) -> str:
    """Return an estimator's name, which says so where it was shown the truth."""
    return f"{estimator} (oracle)" if estimator in oracles else estimator


def _missing(value: Any) -> bool:
    return value is None or (isinstance(value, float) and math.isnan(value))


def _text(grid: Grid) -> str:
    from io import StringIO

    from rich import box
    from rich.console import Console
    from rich.markup import escape
    from rich.table import Table

    table = Table(box=box.SIMPLE_HEAD, pad_edge=False, caption=escape("\n".join(grid.notes)), caption_justify="left")
    for index, heading in enumerate(grid.headings):
        table.add_column(escape(heading), justify="left" if index < grid.labels else "right", overflow="fold")
    for line in grid.lines:
        table.add_row(*map(escape, line))
    console = Console()
    file = StringIO()
    Console(file=file, width=console.width if console.is_terminal else PIPE_WIDTH).print(table)
    return "\n".join(line.rstrip() for line in file.getvalue().splitlines()) + "\n"


def markdown(grid: Grid) -> str:
    """Return a table as Markdown."""

    def line(cells: Sequence[str]) -> str:
        return "| " + " | ".join(cell.replace("|", "\\|") for cell in cells) + " |"

    rule = ["---" if index < grid.labels else "---:" for index in range(len(grid.headings))]
    notes = [f"\n{note}" for note in grid.notes]
    return "\n".join([line(grid.headings), "|" + "|".join(rule) + "|", *map(line, grid.lines), *notes]) + "\n"


def _latex(grid: Grid) -> str:
    def line(cells: Sequence[str]) -> str:
        return " & ".join("".join(_LATEX.get(c, c) for c in cell) for cell in cells) + r" \\"

    columns = "l" * grid.labels + "r" * (len(grid.headings) - grid.labels)
    notes = [f"% {note}" for note in grid.notes]
    top = [*notes, rf"\begin{{tabular}}{{{columns}}}", r"\toprule", line(grid.headings), r"\midrule"]
    return "\n".join([*top, *map(line, grid.lines), r"\bottomrule", r"\end{tabular}"]) + "\n"
