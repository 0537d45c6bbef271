"""The diagram of mean ranks with their critical difference, as in Demsar, J. Machine Learning Research 7, 2006."""

from __future__ import annotations

from collections.abc import Mapping

from matplotlib.axes import Axes
from matplotlib.figure import Figure

from cellslam.benchmarks.figures.style import BLACK, GREY, WIDTH_IN, panels
from cellslam.benchmarks.scores.verdicts import Verdict

LINE_IN, LABEL_IN, LETTER_IN = 0.19, 0.16, 0.062  # height of a label, margin beside it, width of a letter
ABOVE, GAP, BAR = 2.4, 0.7, 0.42  # in lines: margin above the scale, below it, and from one bar to the next
BEYOND = 0.012  # of the scale, which a bar reaches beyond the ranks that it joins


def draw_ranks(figure: Figure, judged: Mapping[str, Verdict]) -> bool:
    """Draw a diagram for each verdict, by its title.

    Each estimator hangs on its mean rank, the best on the left; a bar joins those that Nemenyi's test cannot tell
    apart, and at the top is how long a bar may be.
    """
    if not judged:
        return False
    across = min(2, len(judged))
    lines = max(_lines(one) for one in judged.values())
    width = WIDTH_IN if across > 1 else 0.62 * WIDTH_IN
    grid = panels(figure, len(judged), across, (width, LINE_IN * (lines + ABOVE + 2.0)))
    letters = max(len(name) for one in judged.values() for name in one.names)
    for axes, (title, one) in zip(grid, judged.items(), strict=True):
        _draw(axes, one, width / across, letters * LETTER_IN + LABEL_IN)
        axes.set_ylim(-lines - 0.5, ABOVE)
        axes.set_title(f"{title} ({one.trials} trials)" if title else f"{one.trials} trials", fontsize=8.5)
    return True


def _lines(one: Verdict) -> float:
    return GAP + BAR * len(one.groups) + (len(one.names) + 1) // 2


def _draw(axes: Axes, one: Verdict, width_in: float, margin_in: float) -> None:
    count = len(one.names)
    margin = margin_in * (count - 1) / max(width_in - 2.0 * margin_in, 0.5)
    aside = 0.6 * LABEL_IN / margin_in * margin
    left, right = 1.0 - aside, count + aside
    axes.set_axis_off()
    axes.set_xlim(1.0 - margin, count + margin)
    axes.plot((1, count), (0, 0), color=BLACK, linewidth=0.9)
    for rank in range(1, count + 1):
        axes.plot((rank, rank), (0, 0.25), color=BLACK, linewidth=0.9)
        axes.text(rank, 0.35, str(rank), ha="center", va="bottom", fontsize=7)
    end = 1.0 + one.critical_difference
    axes.plot((1.0, 1.0, 1.0, end, end, end), (1.55, 1.95, 1.75, 1.75, 1.55, 1.95), color=GREY, linewidth=1.2)
    axes.text(end, 1.75, f"  critical difference {one.critical_difference:.2f}", va="center", fontsize=7)
    ranks = one.mean_rank.tolist()
    for number, (first, last) in enumerate(one.groups):
        y = -GAP - BAR * number + 0.25
        ends = ranks[first] - BEYOND * (count - 1), ranks[last] + BEYOND * (count - 1)
        axes.plot(ends, (y, y), color=BLACK, linewidth=3, solid_capstyle="butt", zorder=3)
    top = -GAP - BAR * len(one.groups) - 0.3
    better = (count + 1) // 2
    for i, (name, rank) in enumerate(zip(one.names, ranks, strict=True)):
        best = i < better
        y, x = top - (i if best else count - 1 - i), left if best else right
        axes.plot((rank, rank, x), (0, y, y), color=BLACK, linewidth=0.7)
        axes.text(x, y, f" {name} ", ha="right" if best else "left", va="center", fontsize=8)
