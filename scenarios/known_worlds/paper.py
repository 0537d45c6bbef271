"""The drive of the extended FastSLAM paper: the preset `lund-530`, whose figures are those of its Table I.

Source: J. Chen, R. Whiton and F. Tufvesson, "Extended FastSLAM using cellular multipath component delays and angular
information", section V: largest error and error at the end of one measured drive, with cellular signals and without.
"""

from __future__ import annotations

from typing import Any

from cellslam.scenarios.known_worlds.known_world import Entry, Figure, KnownWorld
from cellslam.scenarios.loading import load
from cellslam.scenarios.scenario import Scenario
from cellslam.scenarios.simulation import simulate as simulated
from cellslam.sim.city import City
from cellslam.sim.recording import Recording
from cellslam.sim.world import prepare

PRESET = "lund-530"


def scenario() -> Scenario:
    """Return the scenario, clock offsets given."""
    return load(PRESET, {"radio.clock_offset_std_m": 0.0})


def simulate(seed: int, trial: int) -> Recording:
    """Return the recording of a run: the same city, sites and route, another driver and other errors."""
    return simulated(scenario(), seed, trial)


def city(seed: int, trial: int) -> City | None:
    """Return the city of a run."""
    return prepare(scenario().world, seed, trial).scene.city


def _rung(name: str, estimator: str = "paper-fastslam", /, **options: Any) -> Entry:
    return Entry(name, estimator, options)


WORLD = KnownWorld(
    name="paper",
    title="the drive of the extended FastSLAM paper: 530 m, two sites, twelve links",
    source="Chen, Whiton and Tufvesson, section V and Fig. 3: one measured drive",
    simulate=simulate,
    figures=(
        Figure("largest error", "position_max_m", "median", "m"),
        Figure("error at the end", "position_end_m", "median", "m"),
        Figure("position RMSE", "position_rmse_m", "median", "m"),
        Figure("drives above 6 m", "position_max_m", "share>6", "share"),
    ),
    entries=(
        Entry("FastSLAM", "paper-fastslam", {}, {"largest error": 6.0, "error at the end": 3.0}),
        Entry("odometry alone", "dead-reckoning", {}, {"largest error": 20.0, "error at the end": 15.0}),
    ),
    trials=40,
    differences=(
        "Published is one measured drive; own are medians of simulated drives through another city, which has the "
        "paper's carrier, bandwidth, cells, ports, snapshots, duration and distance.",
        "The paper takes the clock offsets for unknown constants and does not say how it finds them; here they are "
        "given.",
        "The filter marginalises the bias of the yaw rate and the scale of the odometer, which the paper does not "
        "mention; the simulated odometry has both.",
    ),
    # Each rung changes one thing of the rung before.
    ladder=(
        _rung("the paper's filter, as printed", motion="sampled"),
        _rung("+ odometry's constants marginalised"),
        _rung("+ a site's links fused", sharing="site"),
        _rung("+ variances raised for lasting errors", sharing="site", noise="persisting"),
        _rung("+ one gain for all, lasting errors as states", "fastslam", particles=100, lag=0),
        _rung("+ noise drawn five blocks later", "fastslam", particles=100, lag=5),
        _rung("+ 300 particles in place of 100", "fastslam", particles=300, lag=5),
    ),
    city=city,
)  # fmt: skip
