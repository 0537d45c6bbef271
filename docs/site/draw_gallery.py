"""Draw the pictures of the gallery and the tutorials, each by the commands that stand below it.

python docs/site/draw_gallery.py [NAME ...]      draw all, or those named (about fifteen minutes for all)

Needs the extras `osm`, `report`, `cities`, and for playback and report Chromium with chromedriver.
"""

from __future__ import annotations

import re
import shlex
import shutil
import subprocess
import sys
import tempfile
from pathlib import Path
from typing import NamedTuple

HERE = Path(__file__).resolve().parent
IMAGES = HERE.parent / "images"
SCREENSHOT = "python docs/site/screenshot.py"


class Picture(NamedTuple):
    """A picture: file that the commands leave, title, what it shows, commands."""

    file: str
    title: str
    shows: str
    commands: tuple[str, ...]


_DRIVE = ("cellslam run lund-530 --out drive",)
_SWEEP = (
    "cellslam sweep lund-530 --set vehicle.distance_m=120 --set vehicle.duration_s=120 --set vehicle.stops=1 "
    "--set vehicle.snapshot_interval_s=0.3 --sweep radio.clutter_scale=0.5,2,8 --trials 10 --out clutter "
    "--estimator ekf-slam --estimator paper-fastslam --estimator dead-reckoning",
    "cellslam figures clutter",
)
_CLUTTER = (
    "cellslam sweep lund-530 --set vehicle.distance_m=120 --set vehicle.duration_s=120 --set vehicle.stops=1 "
    "--set vehicle.snapshot_interval_s=0.3 --set estimator.fastslam.particles=300 "
    "--sweep radio.clutter_scale=0.5,1,2,4 --trials 20 --out clutter-20 "
    "--estimator fastslam --estimator ekf-slam --estimator dead-reckoning"
)
_MUNICH = ("cellslam run munich-530 --rays --estimator dead-reckoning --out munich",)
GALLERY = {
    "city": Picture(
        "city/view.png",
        "A city",
        "A generated city. Colours are materials.",
        ("cellslam city generate --seed 3 --set extent_m=400 --out city",),
    ),
    "rays": Picture(
        "rays/rays.png",
        "Rays",
        "Lines of sight and single reflections of a drive, from above.",
        ("cellslam run lund-530 --rays --estimator dead-reckoning --out rays",),
    ),
    "snapshot": Picture(
        "snapshot.png",
        "A snapshot from received signals",
        "Energy over delay and azimuth on four links. Circles are true paths, crosses those found, squares false ones.",
        ("cellslam bench snapshot lund-530 --at 1500 --out snapshot.png",),
    ),
    "map": Picture(
        "drive/map.png",
        "A map",
        "The true drive and the estimates. Dots are estimated virtual transmitters (VTs), put back on their walls.",
        _DRIVE,
    ),
    "error": Picture(
        "drive/error.png",
        "Error against time",
        "Absolute, not aligned; below the same magnified, with the bound.",
        _DRIVE,
    ),
    "clock": Picture(
        "drive/clock_offsets.png",
        "Clock offsets",
        "The sites' clock offsets, unknown within 150 m at the start, with bands of two deviations.",
        _DRIVE,
    ),
    "associations": Picture(
        "drive/associations.png",
        "Associations",
        "What was measured on one port of two cells, coloured by the VT that FastSLAM gave it to; grey is left over.",
        _DRIVE,
    ),
    "sweep": Picture(
        "clutter/figures/sweep.png", "A sweep", "Median error against clutter, with 95 % intervals.", _SWEEP
    ),
    "consistency": Picture(
        "clutter/figures/consistency-radio.clutter_scale-2.png",
        "Consistency",
        "Whether estimators know how wrong they are: those whose claims are right follow the dotted lines.",
        _SWEEP,
    ),
    "playback": Picture(
        "playback.png",
        "Playback",
        "A page that plays a drive back in the browser.",
        (
            "cellslam record lund-530 --out lund.h5",
            "cellslam export lund.h5 --estimator ekf-slam --format html --out playback.html",
            f"{SCREENSHOT} playback.html 'trial=0&t=260' playback.png",
        ),
    ),
    "comparison": Picture(
        "clutter/figures/ranks.png",
        "A comparison",
        "Mean ranks over trials; a bar joins those that do not differ significantly.",
        _SWEEP,
    ),
    "bound": Picture(
        "bound.png",
        "The bound",
        "The least error that any filter can have, against what is known of the clocks.",
        ("python docs/notebooks/paper_figure.py",),
    ),
}
# Of the tutorials: the same, without a place in the gallery.
OTHERS = {
    "stanford": Picture("clutter/figures/stanford.png", "", "", _SWEEP),
    "tiny-map": Picture("tiny/map.png", "", "", ("cellslam run tiny --out tiny",)),
    "coasting-error": Picture(
        "coasting/error.png",
        "",
        "",
        ("cellslam run tiny --estimator coasting:Coasting --estimator ekf-slam --out coasting",),
    ),
    "init": Picture(
        "mine.png",
        "",
        "",
        (
            "cellslam city generate --seed 3 --set extent_m=400 --out city",
            "cellslam init city/city-3.toml --distance 60 --out mine.toml",
        ),
    ),
    "inspect": Picture(
        "drive.png",
        "",
        "",
        (
            "cellslam record tiny --out simulated.h5",
            "cellslam export simulated.h5 --format csv --out campaign",
            "cellslam import campaign --out drive.h5",
            "cellslam inspect drive.h5",
        ),
    ),
    "rmse-clutter": Picture(
        "clutter-20/figures/sweep.png", "", "", (_CLUTTER, "cellslam figures clutter-20 --statistic rmse")
    ),
    "report": Picture(
        "report.png",
        "",
        "",
        (
            _CLUTTER,
            "cellslam report clutter-20 --worst 1",
            f"{SCREENSHOT} clutter-20/report.html 'section=1&trial=0&t=60' report.png",
        ),
    ),
    "munich-rays": Picture("munich/rays-view.png", "", "", _MUNICH),
    "munich-rays-plan": Picture("munich/rays.png", "", "", _MUNICH),
    "agent": Picture("agent.png", "", "", ("python agent.py",)),
}


def page() -> str:
    """Return the gallery as Markdown."""
    lines = []
    for name, picture in GALLERY.items():
        lines += [f"## {picture.title}", "", f"![{picture.shows}](images/{name}.png)", "", picture.shows, ""]
        lines += ["```sh", *picture.commands, "```", ""]
    return "\n".join(lines)


def code(tutorial: str) -> list[str]:
    """Return the Python blocks of a tutorial."""
    text = (HERE.parent / "tutorials" / f"{tutorial}.md").read_text("utf-8")
    return re.findall(r"```python\n(.*?)```", text, re.S)


def main(names: list[str]) -> None:
    """Draw the pictures of these names, or all; a command that several need runs once."""
    pictures = GALLERY | OTHERS
    with tempfile.TemporaryDirectory() as folder:
        (Path(folder) / "coasting.py").write_text(code("your-estimator")[0], "utf-8")
        save = 'from matplotlib.image import imsave\nimsave("agent.png", env.render())\n'
        (Path(folder) / "agent.py").write_text("\n".join([*code("train-an-agent"), save]), "utf-8")
        done: set[str] = set()
        for name in names or pictures:
            for command in (c for c in pictures[name].commands if c not in done):
                sys.stdout.write(f"{command}\n")
                words = shlex.split(command.replace("docs/", f"{HERE.parent}/"))
                words = [sys.executable, "-m", *words] if words[0] == "cellslam" else words
                words = [sys.executable, *words[1:]] if words[0] == "python" else words
                subprocess.run(words, cwd=folder, check=True)
                done.add(command)
            shutil.copy(Path(folder) / pictures[name].file, IMAGES / f"{name}.png")


if __name__ == "__main__":
    main(sys.argv[1:])
