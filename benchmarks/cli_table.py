"""`cellslam table`: the results of a sweep as a table."""

from __future__ import annotations

import sys
from argparse import Namespace
from dataclasses import replace
from pathlib import Path

from cellslam.benchmarks.cli import DONE
from cellslam.benchmarks.formats import comparison_grid, consistency_grid, render, summary_grid
from cellslam.benchmarks.rows import results
from cellslam.benchmarks.summaries import Layout, comparison, row_keys, summary
from cellslam.sim.errors import InputError
from cellslam.slam.registry import oracles


def table(arguments: Namespace) -> int:
    """Carry out `cellslam table`."""
    folder = Path(arguments.folder)
    confidence = None if arguments.interval is None else arguments.interval / 100
    rows = tuple(arguments.rows) or None
    if arguments.compare is not None:
        sys.stdout.write(_compared(arguments, folder, rows, confidence))
        return DONE
    layout = Layout(
        rows, arguments.columns, tuple(arguments.metrics), tuple(arguments.statistics) or ("median",), confidence
    )
    layout = Layout(tuple(row_keys(folder, layout)), layout.columns, layout.metrics, layout.statistics, confidence)
    tidy = summary(folder, layout)
    if tidy.empty:
        raise InputError(f"{folder}: no rows yet")
    keys = [key for key in layout.rows or () if key != layout.columns]
    named = tidy["estimator"].unique() if "estimator" in tidy else ()
    grid = summary_grid(tidy, keys, layout.columns, oracles(named))
    if pooled := _pooled(folder, layout) if rows else []:
        grid = replace(grid, notes=(*grid.notes, f"pooled over all values of: {', '.join(pooled)}"))
    sys.stdout.write(render(tidy, grid, arguments.format))
    return DONE


def _pooled(folder: Path, layout: Layout) -> list[str]:
    """Return what varies in a sweep and is neither in the rows nor in the columns of a table."""
    shown = {*(layout.rows or ()), layout.columns}
    varied = [key for key in row_keys(folder, Layout(columns=layout.columns)) if key not in shown]
    return [key for key in varied if key != "estimator" or results(folder, ["estimator"])["estimator"].nunique() > 1]


def _compared(arguments: Namespace, folder: Path, rows: tuple[str, ...] | None, confidence: float | None) -> str:
    first, comma, second = arguments.compare.partition(",")
    if not (first and comma and second):
        raise InputError(f"--compare '{arguments.compare}': write two estimators, as in fastslam,dead-reckoning")
    if arguments.columns is not None or len(arguments.metrics) > 1 or arguments.statistics:
        raise InputError("--compare goes with --rows, --interval, --format and one --metric")
    metric = arguments.metrics[0] if arguments.metrics else "position_rmse_m"
    share = 0.95 if confidence is None else confidence
    tidy = comparison(folder, first.strip(), second.strip(), metric, rows, share)
    columns = list(tidy.columns)
    keys = columns[: columns.index("metric")] if columns else []
    return render(tidy, comparison_grid(tidy, keys, first, second, 100 * share), arguments.format)


def consistency(arguments: Namespace) -> int:
    """Carry out `cellslam consistency`."""
    from cellslam.benchmarks.consistency import consistency as measured

    folder = Path(arguments.folder)
    keys = row_keys(folder, Layout(rows=tuple(arguments.rows) or None))
    tidy = measured(folder, arguments.times, keys)
    named = tidy["estimator"].unique() if "estimator" in tidy else ()
    sys.stdout.write(render(tidy, consistency_grid(tidy, keys, oracles(named)), arguments.format))
    return DONE


def figures(arguments: Namespace) -> int:
    """Carry out `cellslam figures`."""
    from cellslam.benchmarks.bars import bars
    from cellslam.benchmarks.figures.sweep_look import Look
    from cellslam.benchmarks.figures.sweeps import draw_sweep
    from cellslam.benchmarks.output import check_folder

    folder = Path(arguments.folder)
    look = Look(arguments.x, arguments.metric, arguments.statistic, arguments.interval / 100)
    out = Path(arguments.out) if arguments.out else folder / "figures"
    check_folder(out)
    with bars(arguments.quiet) as progress:
        written = draw_sweep(folder, out, look, progress=progress)
    if not arguments.quiet:
        sys.stderr.write(f"{len(written)} files are in {out}: {', '.join(sorted({p.stem for p in written}))}\n")
    return DONE


def report(arguments: Namespace) -> int:
    """Carry out `cellslam report`."""
    from cellslam.benchmarks.bars import bars
    from cellslam.benchmarks.report import Choice, write_report

    choice = Choice(arguments.worst, arguments.metric, tuple(arguments.estimators))
    out = Path(arguments.out) if arguments.out else None
    with bars(arguments.quiet) as progress:
        path = write_report(Path(arguments.folder), out, choice, progress)
    if not arguments.quiet:
        sys.stderr.write(f"the report is in {path} ({path.stat().st_size / 1e6:.1f} MB)\n")
    return DONE
