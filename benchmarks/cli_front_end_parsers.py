"""The arguments of `cellslam bench front-end` and `bench calibrate`; light, as every start of the command line loads
them.
"""

from __future__ import annotations

from argparse import ArgumentParser
from collections.abc import Callable

Add = Callable[[str, str, str], ArgumentParser]
STUDIES = ("single", "many", "resolution", "collision", "ghosts", "motion", "speed")


def add_front_end(add: Add) -> None:
    """Add `front-end`, `calibrate` and `snapshot`; `add(name, target, summary)` makes a sub-command's parser."""
    front = add("front-end", "cli_bench_front_end:front_end", "what the path estimator finds, how well, and how fast")
    front.add_argument(
        "--study", metavar="NAME", action="append", default=[], choices=STUDIES, dest="studies",
        help=f"one study: {', '.join(STUDIES)}; may be repeated (default: all)",
    )  # fmt: skip
    front.add_argument("--runs", metavar="N", type=int, default=150, help="random scenes of each point (default: 150)")
    front.add_argument("--seed", metavar="S", type=int, default=0, help="seed of the scenes (default: 0)")
    front.add_argument("--json", action="store_true", help="print the rows as JSON on stdout, nothing else")
    calibrate = add(
        "calibrate", "cli_bench_front_end:calibrate", "constants of the statistical front end, or their check"
    )
    calibrate.add_argument("--scenes", metavar="N", type=int, default=400, help="scenes of each kind (default: 400)")
    calibrate.add_argument("--seed", metavar="S", type=int, default=1, help="seed of the scenes (default: 1)")
    calibrate.add_argument("--out", metavar="FILE.json", help="write the constants here (default: print them)")
    calibrate.add_argument(
        "--check", action="store_true", help="compare the front ends, as calibrated, on scenes of their own instead"
    )
    calibrate.add_argument(
        "--ratio", metavar="DB", type=float, action="append", default=[], dest="ratios",
        help="specular-to-diffuse ratio of the check; may be repeated (default: 6 and 15)",
    )  # fmt: skip
    snapshot = add(
        "snapshot", "cli_bench_front_end:snapshot", "picture of one snapshot at signal level: spectrum and paths"
    )
    snapshot.add_argument("scenario", metavar="SCENARIO", help="name of a preset, or path of a .toml file")
    snapshot.add_argument(
        "--set", metavar="KEY=VALUE", action="append", default=[], dest="sets", help="change one key; may be repeated"
    )
    snapshot.add_argument("--seed", metavar="S", type=int, default=0, help="root seed (default: 0)")
    snapshot.add_argument("--at", metavar="N", type=int, default=0, help="number of the snapshot (default: 0)")
    snapshot.add_argument("--link", metavar="N", type=int, help="link to show (default: the four with most paths)")
    snapshot.add_argument(
        "--out", metavar="FILE.png", default="snapshot.png", help="where to write (default: snapshot.png)"
    )
