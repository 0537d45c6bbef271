"""The compiled filter against the reference: the same draws, associations and resampling; poses and maps to rounding.

The compiled filter keeps VTs and what is made of them in single precision, 3e-5 m of 500 m. On these drives that makes
2e-5 (m, rad) in poses, 1e-4 standard deviations in nuisances and places of VTs, 4e-4 in log-weights. The tolerances are
some ten times that. With its arrays in double precision it agrees to 1e-11.
"""

from collections.abc import Iterator, Sequence
from dataclasses import replace

import numpy as np
import pytest

from cellslam.sim.errors import InputError
from cellslam.sim.recording import Floats, Ints
from cellslam.slam.api import Estimate, VtEstimate, setup_of
from cellslam.slam.conformance.subject import Step, Subject, taken, tiny_drive, with_holes
from cellslam.slam.fastslam import reference as reference_module
from cellslam.slam.fastslam.fastslam_options import FastSlamOptions
from cellslam.slam.fastslam.path_particles import PathParticles
from cellslam.slam.fastslam.reference import ReferenceFastSlam
from cellslam.slam.fastslam.state.layout import HITS, LANES, POSE, THETA
from cellslam.slam.fastslam.state.particles import _moves
from cellslam.slam.model.resampling import systematic

POSE_TOLERANCE, DEVIATIONS, RELATIVE, LOG_WEIGHT = 1e-4, 1e-3, 1e-3, 5e-3


class Placed:
    """Systematic resampling whose copies stand where the compiled filter puts them; counts what it has seen."""

    def __init__(self) -> None:
        self.within = self.between = self.regrouped = 0

    def __call__(self, weights: Floats, count: int, rng: np.random.Generator) -> Ints:
        ancestors = systematic(weights, count, rng)
        if count != len(weights):
            self.regrouped += 1
            return ancestors
        within, between = _moves(np.bincount(ancestors, minlength=count).reshape(-1, LANES))
        self.within, self.between = self.within + len(within), self.between + len(between)
        placed = np.arange(count)
        for block, source, target in within:
            placed[block * LANES + target] = block * LANES + source
        for block, source, to, target in between:
            placed[to * LANES + target] = block * LANES + source
        return placed


def drive_both(options: FastSlamOptions, steps: Sequence[Step], tilt_rad: float = 0.0) -> Placed:
    """Drive both filters with the same seed, and compare them after every snapshot; tilt_rad: pitch, and less roll."""
    placed, compiled, reference = Placed(), PathParticles(options), ReferenceFastSlam(options)
    reference.resampling = placed
    setup = setup_of(tiny_drive())
    tilted = setup.start_pose + tilt_rad * np.array([0.0, 0.0, 0.0, 0.0, 1.0, -1.0])
    for one in (compiled, reference):
        one.start(replace(setup, start_pose=tilted), np.random.default_rng(1))
    for step in steps:
        agree(compiled.step(*step), reference.step(*step))
        particles_agree(compiled, reference)
    return placed


def agree(given: Estimate, wanted: Estimate) -> None:
    """Compare two answers."""
    assert np.array_equal(given.association, wanted.association)
    assert np.allclose(given.pose, wanted.pose, rtol=0, atol=POSE_TOLERANCE)
    std = np.sqrt(np.diag(wanted.covariance))
    assert np.allclose(given.covariance, wanted.covariance, rtol=0, atol=RELATIVE * np.outer(std, std) + 1e-18)
    deviations = (given.clock_offset_m - wanted.clock_offset_m) / np.sqrt(wanted.clock_offset_variance_m2)
    assert np.abs(deviations).max() < DEVIATIONS
    assert np.allclose(given.clock_offset_variance_m2, wanted.clock_offset_variance_m2, rtol=RELATIVE)
    one, other = in_order(given.vts), in_order(wanted.vts)
    assert np.array_equal(one.id, other.id)
    assert np.array_equal(one.link, other.link)
    std = np.sqrt(np.einsum("vii->vi", other.covariance))
    assert np.all(np.abs(one.position_m - other.position_m) < DEVIATIONS * std)
    assert np.all(np.abs(one.covariance - other.covariance) < RELATIVE * std[:, :, None] * std[:, None])


def in_order(vts: VtEstimate) -> VtEstimate:
    """Return VTs by their numbers."""
    order = np.argsort(vts.id)
    return VtEstimate(vts.id[order], vts.link[order], vts.position_m[order], vts.covariance[order])


def particles_agree(compiled: PathParticles, reference: ReferenceFastSlam) -> None:
    """Compare pose, nuisances, weight of each particle, and which VTs it believes in, seen how often and when."""
    p, particles = compiled._particles, reference.particles
    assert len(p) == len(particles)
    pose = p.columns(POSE, 6) + np.concatenate([compiled._origin, np.zeros(3)])
    assert np.allclose(pose, [q.pose for q in particles], rtol=0, atol=POSE_TOLERANCE)
    std = np.sqrt([np.diag(q.covariance) for q in particles])
    theta = p.columns(THETA, p.nuisances) - [q.theta for q in particles]
    assert np.all(np.abs(theta) < DEVIATIONS * std)
    assert np.allclose(p.log_weight.ravel(), [q.log_weight for q in particles], rtol=0, atol=LOG_WEIGHT)
    for number, particle in enumerate(particles):
        block, lane = divmod(number, LANES)
        for link, vts in enumerate(particle.maps):
            slots = p.order[block, link, : p.counts[block, link]]
            status, hits = p.status[block, link, slots, lane], p.records[block, link, slots, HITS * LANES + lane]
            columns = (p.ident[block, link, slots], hits, status >> 2)
            given = {tuple(map(int, row)) for row, s in zip(zip(*columns, strict=True), status, strict=True) if s >= 0}
            assert given == {(vt.id, vt.hits, vt.seen) for vt in vts}


def steps_of(count: int) -> list[Step]:
    return Subject(PathParticles, None, tiny_drive()).steps(count)


def test_compiled_filter_is_the_reference_over_80_snapshots() -> None:
    options = FastSlamOptions(
        errors="counted", particles=32, particles_start=64, start_phase_s=3.0, effective_share=0.9
    )
    placed = drive_both(options, steps_of(80))
    assert placed.regrouped == 1
    assert placed.within > 30
    assert placed.between > 0


def doubled(steps: Sequence[Step]) -> Iterator[Step]:
    """Yield steps in which two links measure everything twice, and a third of the elevations are missing."""
    rng = np.random.default_rng(2)
    for dt_s, odometry, snapshot in steps:
        rows = np.sort(np.concatenate([np.arange(len(snapshot)), np.flatnonzero(snapshot.link % 3 == 0)]))
        more = with_holes(taken(snapshot, rows), "elevation_rad", rng)
        yield dt_s, odometry, replace(more, distance_m=more.distance_m + 0.3 * rng.standard_normal(len(rows)))


def test_doubles_are_merged_and_elevations_missed_as_in_the_reference(monkeypatch: pytest.MonkeyPatch) -> None:
    """Doubles are searched for in snapshots 63 and 64. The array is tilted, so that births turn their variances."""
    given_up, merged = [], reference_module.merged

    def counted(p, vts, existing):  # type: ignore[no-untyped-def]
        left = merged(p, vts, existing)
        given_up.append(len(vts) - len(left))
        return left

    monkeypatch.setattr(reference_module, "merged", counted)
    drive_both(FastSlamOptions(errors="counted", particles=32), list(doubled(steps_of(65))), tilt_rad=0.1)
    assert sum(given_up) > 30


@pytest.mark.parametrize(
    ("part", "name"),
    [
        ("motion", "sampled"), ("criterion", "mahalanobis"), ("clock", "known"),
    ],
)  # fmt: skip
def test_other_parts_are_refused(part: str, name: str) -> None:
    with pytest.raises(InputError, match=f"{part} = .*, not {name}"):
        ReferenceFastSlam(FastSlamOptions(errors="counted", **{part: name}))


def test_drifting_clocks_are_refused() -> None:
    setup = setup_of(tiny_drive())
    sites = replace(setup.sites, clock_drift_std_m_s=np.ones(len(setup.sites)))
    with pytest.raises(InputError, match="drift"):
        ReferenceFastSlam().start(replace(setup, sites=sites), np.random.default_rng(0))
