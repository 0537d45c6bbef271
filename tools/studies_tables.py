"""Studies as tables on the terminal."""

from __future__ import annotations

from typing import Any

import numpy as np


def print_studies(rows: dict[str, list[dict[str, Any]]]) -> None:
    """Print a table a study: a line for each of its rows."""
    from rich.console import Console
    from rich.table import Table

    console = Console(width=130)
    for study, lines in rows.items():
        table = Table(title=study, title_justify="left")
        for column in lines[0]:
            table.add_column(column, justify="right")
        for line in lines:
            table.add_row(*(_cell(line.get(column)) for column in lines[0]))
        console.print(table)


def _cell(value: Any) -> str:
    if isinstance(value, list):
        return " ".join(_cell(v) for v in value)
    if isinstance(value, float | np.floating):
        return f"{value:.3g}"
    return "-" if value is None else str(value)
