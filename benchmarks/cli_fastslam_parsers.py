"""The arguments of `cellslam bench fastslam`; light, as every start of the command line loads them."""

from __future__ import annotations

from argparse import ArgumentParser
from collections.abc import Callable

Add = Callable[[str, str, str], ArgumentParser]
STUDIES = ("drive", "link", "cost", "roofline", "memory")


def add_fastslam(add: Add) -> None:
    """Add `fastslam`; `add(name, target, summary)` makes a sub-command's parser."""
    parser = add("fastslam", "cli_bench_fastslam:fastslam", "what a drive, an update and a particle of FastSLAM cost")
    parser.add_argument(
        "--study", metavar="NAME", action="append", default=[], choices=STUDIES, dest="studies",
        help=f"one study: {', '.join(STUDIES)}; may be repeated (default: all)",
    )  # fmt: skip
    parser.add_argument("--scenario", metavar="NAME", default="lund-530", help="preset of the drive (lund-530)")
    parser.add_argument("--particles", metavar="N", type=int, default=1000, help="particles of the drive (1000)")
    parser.add_argument("--seed", metavar="S", type=int, default=0, help="root seed of the drive (default: 0)")
    parser.add_argument("--repeat", metavar="N", type=int, default=5, help="runs of each; the best counts (5)")
    parser.add_argument("--json", action="store_true", help="print the rows as JSON on stdout, nothing else")
