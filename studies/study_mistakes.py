"""What `inspect` says of every kind of campaign with every mistake, and of sound ones: a table, and what went wrong.

`python studies/study_mistakes.py [SEEDS]`; takes about a second a case.
"""

from __future__ import annotations

import sys
from collections import Counter
from pathlib import Path

from cellslam.recordings import build
from cellslam.recordings.inspection.suspicions import suspicions

sys.path.append(str(Path(__file__).parents[1] / "tests" / "recordings"))  # the worlds of the tests
from mistaken_worlds import MISTAKES, WORLDS

RANGES_ONLY, UNKNOWN_CLOCKS, WITHOUT_TURN = ("beacons", "rover"), ("cellular",), ("few places",)
WITHOUT_ARM = ("hall", "places", "few places", "beacons", "rover", "tubes", "cellular")
TURNS = ("yaw rate in radians", "yaw rate of the wrong", "yaw rate in degrees", "wrong wheelbase")


def shows(mistake: str, world: str) -> bool:
    """Return whether a mistake changes anything there."""
    return not (
        ("azimuth" in mistake and world in RANGES_ONLY)
        or (mistake.startswith("20 m") and world in UNKNOWN_CLOCKS)
        or (mistake.startswith("lever arm") and world in WITHOUT_ARM)
        or (mistake.startswith(TURNS) and world in WITHOUT_TURN)
    )


def main(seeds: int) -> None:
    """Print a line a mistake: in how many campaigns it was named, and what was said elsewhere."""
    sound = [suspicions(build(make(seed))) for make in WORLDS.values() for seed in range(1000, 1000 + seeds)]
    print(f"sound: {sum(not found for found in sound)} of {len(sound)} without a suspicion")
    for mistake, (plant, kinds) in MISTAKES.items():
        named, other = [], Counter[str]()
        for world, make in WORLDS.items():
            for seed in range(1000, 1000 + seeds if shows(mistake, world) else 1000):
                found = [s.kind for s in suspicions(build(plant(make(seed))))]
                named.append(any(kind in kinds for kind in found))
                other[f"{world}: {found[0] if found else 'nothing'}"] += not named[-1]
        rest = ", ".join(f"{what} ({count})" for what, count in other.items() if count)
        print(f"{mistake:40} {sum(named)} of {len(named)}  {rest}", flush=True)


if __name__ == "__main__":
    main(int(sys.argv[1]) if len(sys.argv) > 1 else 3)
