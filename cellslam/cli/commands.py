"""All commands: where they are, what they are for, and examples of them."""

from __future__ import annotations

from typing import NamedTuple


class Command(NamedTuple):
    """A command: its module in this room, which has `add_arguments` and `command`, one line about it, and examples."""

    module: str
    summary: str
    examples: tuple[str, ...]


SECTIONS = {
    "simulate and estimate": {
        "run": Command(
            "run",
            "simulate a scenario, run estimators on it, score them",
            (
                "run tiny",
                "run lund-530 --seed 7 --estimator ekf-slam --estimator fastslam",
                "run munich-530 --set radio.clutter_scale=2 --estimator my_module:MyEstimator",
                "run lund-530 --trials 10 --json",
            ),
        ),
        "init": Command(
            "city.init",
            "write a scenario file of a city, with a route and sites, to begin from",
            (
                "init lund-530 --out mine.toml",
                "init berlin.osm --route drive.gpx --sites sites.geojson --out berlin.toml",
            ),
        ),
        "sweep": Command(
            "sweep",
            "many variants and trials of a scenario, in parallel, resumable",
            (
                "sweep tiny --sweep radio.load=0,0.5,1 --trials 20 --out load",
                "sweep study.toml --out study --dry-run",
            ),
        ),
        "reproduce": Command(
            "reproduce",
            "the published figures of a known world of others, beside one's own",
            ("reproduce paper --seed 1", "reproduce bp-slam-testbed --trials 5"),
        ),
        "check-estimator": Command(
            "check_estimator",
            "check an estimator against the contract; say what to fix",
            ("check-estimator my_module:MyEstimator",),
        ),
    },
    "results of a sweep": {
        "table": Command(
            "results.table",
            "the results of a sweep as a table",
            ("table load", "table load --interval --format latex", "table load --compare fastslam,ekf-slam"),
        ),
        "figures": Command("results.figures", "the figures of a sweep, as PNG and PDF", ("figures load",)),
        "report": Command(
            "results.report", "one HTML page of a sweep: tables, plots, worst trials", ("report load --out load.html",)
        ),
        "consistency": Command(
            "results.consistency",
            "whether estimators know how wrong they are: errors and claims",
            ("consistency load",),
        ),
    },
    "recordings and measured data": {
        "record": Command(
            "recordings.record",
            "simulate a scenario and keep it as a recording",
            ("record tiny --out tiny.h5", "record tiny --trials 20 --out drives"),
        ),
        "replay": Command(
            "recordings.replay",
            "run estimators on a recording and score them",
            ("replay tiny.h5 --estimator fastslam", "replay drive.h5 --fit"),
        ),
        "import": Command(
            "recordings.import_campaign",
            "a recording of tables with a recording.toml, or by an adapter",
            ("import campaign --out drive.h5", "import --adapter victoria-park park --out park.h5"),
        ),
        "inspect": Command(
            "recordings.inspect", "what is in a recording, what is missing, what looks wrong", ("inspect drive.h5",)
        ),
        "export": Command(
            "recordings.export",
            "a recording or an estimate as CSV, .mat, TUM, GeoJSON, PLY or HTML",
            (
                "export tiny.h5 --format csv --out tables",
                "export tiny.h5 --estimator fastslam --format tum --out t.tum",
            ),
        ),
        "fit-noise": Command(
            "recordings.fit_noise",
            "noise, detection and clutter as the recording itself shows them",
            ("fit-noise drive.h5",),
        ),
        "simulate-from": Command(
            "recordings.simulate_from",
            "a recording of paths that another ray tracer found",
            ("simulate-from paths.npz tiny --out drive.h5",),
        ),
    },
    "look up": {
        "list": Command(
            "look_up.list_known", "the scenarios and estimators that are known by name", ("list scenarios",)
        ),
        "show": Command(
            "look_up.show", "every key of a scenario: value, unit, range, meaning", ("show tiny", "show lund-530 radio")
        ),
        "doctor": Command(
            "look_up.doctor", "versions, cores, caches and extras on one screen, for a question", ("doctor",)
        ),
    },
}
GROUPS = {
    "map": (
        "maps that drives leave",
        {
            "join": Command(
                "between_drives.join_maps",
                "the maps that several cars left, as one",
                ("map join first.h5 second.h5 --out both.h5",),
            ),
        },
    ),
    "city": (
        "look at cities, generate them, trace paths in them",
        {
            "inspect": Command(
                "city.inspect", "what a city consists of, and pictures of it", ("city inspect lund-530",)
            ),
            "generate": Command(
                "city.generate",
                "draw a city, and write it with a scenario that drives in it",
                ("city generate --seed 3 --set open_share=0.8 --out mycity",),
            ),
            "trace": Command(
                "city.trace",
                "all paths from transmitters to receivers, as a table",
                ("city trace sionna-rt:munich --bs=42,-50,30 --rx rx.csv --out paths.csv",),
            ),
        },
    ),
    "bench": (
        "measure accuracy on fixed suites, and look at one snapshot",
        {
            "accuracy": Command(
                "bench.accuracy",
                "a fixed suite of scenarios, seeds and trials, for comparison",
                ("bench accuracy --trials 2 --out accuracy",),
            ),
            "leaderboard": Command(
                "bench.leaderboard",
                "one page of all entries to a suite, the best first",
                ("bench leaderboard mine.json theirs.json --write leaderboard.md",),
            ),
            "snapshot": Command(
                "bench.snapshot",
                "picture of one snapshot at signal level: spectrum and paths",
                ("bench snapshot lund-530",),
            ),
        },
    ),
}
