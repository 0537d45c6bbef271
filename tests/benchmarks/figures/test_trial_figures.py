"""The figures: the geometry behind the map, what each figure shows, and the files."""

from __future__ import annotations

import dataclasses
from types import SimpleNamespace

import numpy as np
import pytest
from matplotlib.figure import Figure
from shapely import box

from cellslam.benchmarks.bound.cramer_rao import BoundResult
from cellslam.benchmarks.figures.trial import trial_figures
from cellslam.benchmarks.figures.trial import trial_map as overview
from cellslam.benchmarks.figures.trial.trial_figures import draw_all
from cellslam.benchmarks.scores.trial_result import TrialResult
from cellslam.benchmarks.tables.consistency import claimed_by
from cellslam.sim.recording import Reference
from cellslam.slam.api import VtEstimate, WallEstimate

WALL_X_M = 60.0


@pytest.fixture
def scene(make_recording):
    """One site behind a wall's mirror: VT 0 is the site, VT 1 its image in the wall x = 60 m, which one
    building carries.
    """
    recording = make_recording(seed=1, sites=1, ports=2, vts_per_site=2, snapshots=240, detection=0.9)
    truth = recording.truth
    site = np.array([-100.0, 20.0, 40.0])
    image = np.array([2 * WALL_X_M + 100.0, 20.0, 40.0])
    vts = dataclasses.replace(truth.vts, position_m=np.stack([site, image]))
    truth = dataclasses.replace(truth, vts=vts, site_positions_m=site[None])
    recording = dataclasses.replace(recording, truth=truth)
    count = len(recording.time_s)
    # The links' estimates of the site differ by a metre; their mean is right.
    found = np.stack([site, image, site, image]) + np.outer([0.5, 0, -0.5, 0], [1, 0, 0])
    known = VtEstimate(np.array([0, 1, 0, 1]), np.array([0, 0, 1, 1]), found, np.tile(np.eye(3), (4, 1, 1)))
    slam = TrialResult(
        "fastslam", truth.poses + 0.1, np.tile(np.eye(6), (count, 1, 1)), truth.measurement_vt,
        np.tile(truth.clock_offsets_m, (count, 1)), np.ones((count, 1)), known,
    )  # fmt: skip
    reckoning = TrialResult("dead-reckoning", truth.poses + 1.0, np.tile(np.eye(6), (count, 1, 1)))
    bound = BoundResult(np.tile(np.eye(6) * 0.04, (count, 1, 1)), np.ones((count, 1)), np.zeros((count, 6)))
    city = SimpleNamespace(footprints=(box(-50, 60, -30, 80), box(WALL_X_M, -60, WALL_X_M + 15, 30)))
    return SimpleNamespace(
        recording=recording, results={"dead-reckoning": reckoning, "fastslam": slam}, bound=bound, city=city
    )


def test_reflectors_lie_on_the_wall_and_leave_the_site_out(scene):
    mapped = overview.reflectors_of(scene.recording, scene.results["fastslam"])
    assert sorted(r.link for r in mapped) == [0, 1] and mapped[0].life_s >= mapped[1].life_s
    assert len(mapped[0].points_m) > 3
    np.testing.assert_allclose(mapped[0].points_m[:, 0], WALL_X_M, atol=1e-9)
    m, truth = scene.recording.measurements, scene.recording.truth
    seen = np.count_nonzero((truth.measurement_vt == 1) & (m.link == mapped[0].link))
    assert mapped[0].life_s == pytest.approx(seen * 0.075)
    assert overview.emphasised_building(scene.city, mapped) == 1


def test_map_shows_buildings_trajectories_sites_and_reflecting_points(scene):
    figure = Figure(layout="constrained")
    assert overview.draw(figure, scene.city, scene.recording, scene.results)
    whole, drive = figure.axes
    for axes in (whole, drive):
        lines = {line.get_label(): line for line in axes.lines}
        assert {"true trajectory", "dead-reckoning", "fastslam", "reflecting points, site A"} <= set(lines)
        np.testing.assert_allclose(lines["fastslam"].get_xdata(), scene.results["fastslam"].poses[:, 0])
        assert len(axes.collections[0].get_paths()) == 2
    (x0, x1), (y0, y1) = whole.get_xlim(), whole.get_ylim()
    assert x0 < -100 and x1 > WALL_X_M and y1 - y0 == pytest.approx(x1 - x0)
    assert drive.get_xlim()[1] - drive.get_xlim()[0] < x1 - x0


def test_map_figure_shows_the_walls_of_the_first_estimator_that_has_some(scene):
    at_m = np.array([60.0, 70.0])
    walls = WallEstimate(np.arange(2), np.zeros(2), at_m, np.zeros((2, 2, 2)), np.tile([-5.0, 8.0], (2, 1)))
    mapper = dataclasses.replace(scene.results["fastslam"], walls=walls)
    figure = Figure()
    assert overview.draw(figure, None, scene.recording, {**scene.results, "mapper": mapper, "other": mapper})
    for axes in figure.axes:
        (lines,) = (drawn for drawn in axes.collections if drawn.get_label().startswith("walls of"))
        assert lines.get_label() == "walls of mapper"
        np.testing.assert_allclose(lines.get_segments(), [[[x, -5], [x, 8]] for x in at_m])


def test_error_figure_shows_errors_and_bound(scene):
    figure = Figure()
    assert trial_figures.draw_error(figure, scene.recording, scene.results, scene.bound)
    whole, magnified = figure.axes
    expected = {"dead-reckoning": 2**0.5, "fastslam": 0.1 * 2**0.5, "Cramér-Rao bound (rms)": 0.08**0.5}
    for axes in (whole, magnified):
        lines = {line.get_label(): line for line in axes.lines}
        for label, error in expected.items():
            np.testing.assert_allclose(lines[label].get_ydata(), error)
    assert magnified.get_ylim() == (0, pytest.approx(1.1 * np.sqrt(0.08)))
    assert not trial_figures.draw_error(Figure(), dataclasses.replace(scene.recording, truth=None), scene.results, None)


def test_what_is_claimed_is_how_far_inside_the_truth_lies(scene):
    claimed = claimed_by(scene.recording, scene.results["fastslam"])  # 0.1 m off in x and y, with deviations of 1 m
    np.testing.assert_allclose(claimed.position, 1.0 - np.exp(-0.01))
    np.testing.assert_allclose(claimed.clock, 0.0)
    assert len(claimed.position) == len(claimed.heading) == len(claimed.clock) == len(scene.recording.time_s)


def test_association_figure_colours_each_vt_and_greys_the_rest(scene):
    figure, m = Figure(layout="constrained"), scene.recording.measurements
    idle = dataclasses.replace(scene.results["dead-reckoning"], association=np.full(len(m), -1))
    assert trial_figures.draw_associations(figure, scene.recording, {"idle": idle, **scene.results})
    grey, first, second = figure.axes[0].lines
    mine = m.link == trial_figures.shown_links(scene.recording)[0]
    truth_vt = scene.recording.truth.measurement_vt[mine]
    np.testing.assert_allclose(grey.get_ydata(), m.distance_m[mine][truth_vt < 0])
    assert {len(first.get_xdata()), len(second.get_xdata())} == {(truth_vt == 0).sum(), (truth_vt == 1).sum()}
    assert len({line.get_color() for line in (grey, first, second)}) == 3


def test_clock_figure_shows_estimate_band_and_truth(scene):
    figure, offset = Figure(), scene.recording.truth.clock_offsets_m[0]
    assert trial_figures.draw_clock_offsets(figure, scene.recording, scene.results)
    for axes in figure.axes:
        for line in axes.lines:
            np.testing.assert_allclose(line.get_ydata(), offset)
        assert len(axes.lines) == 2
        band = axes.collections[0].get_paths()[0].vertices[:, 1]
        assert band.max() - band.min() == pytest.approx(4.0)
    reckoning = {"dead-reckoning": scene.results["dead-reckoning"]}
    assert not trial_figures.draw_clock_offsets(Figure(), scene.recording, reckoning)
    known = dataclasses.replace(scene.recording.sites, clock_offset_std_m=np.zeros(1))
    drive = dataclasses.replace(scene.recording, sites=known)
    assert not trial_figures.draw_clock_offsets(Figure(), drive, scene.results)


def test_a_recording_without_truth_and_measurements_still_has_its_map(make_recording, tmp_path):
    recording = make_recording(snapshots=20, detection=0.0, clutter=0.0)
    poses = recording.truth.poses
    bare = dataclasses.replace(recording, truth=None)
    result = TrialResult("dead-reckoning", poses, np.tile(np.eye(6), (20, 1, 1)))
    written = draw_all(None, bare, {"dead-reckoning": result}, None, tmp_path)
    assert [path.name for path in written] == ["map.png"]


def measured(scene):
    """The scene as a campaign would have left it: a reference with an outage of 8 s in place of the truth."""
    r = scene.recording
    rows = np.flatnonzero((r.elapsed_s < 5.0) | (r.elapsed_s > 13.0))
    unknown = np.full(len(rows), np.nan)
    reference = Reference(r.time_s[rows], r.truth.poses[rows, :3], unknown, unknown)
    return dataclasses.replace(r, truth=None, reference=reference)


def test_nothing_is_drawn_through_an_outage(scene):
    figure = Figure()
    assert trial_figures.draw_error(figure, measured(scene), scene.results, None)
    line = next(line for line in figure.axes[0].lines if line.get_label() == "fastslam")
    times, values = (np.asarray(data, float) for data in line.get_data())
    assert np.isnan(values).sum() == 1 and times[np.isnan(values).argmax() - 1] < 5.0
    assert np.nanmax(np.diff(times)) < 0.1


def test_map_of_a_measured_drive_shows_the_estimated_vts_or_the_drive_alone(scene):
    figure, alone = Figure(), Figure()
    assert overview.draw(figure, None, measured(scene), scene.results)
    vts = next(line for line in figure.axes[0].lines if line.get_label() == "VTs of fastslam")
    np.testing.assert_allclose(np.column_stack(vts.get_data()), scene.results["fastslam"].vts.position_m[:, :2])
    assert overview.draw(alone, None, measured(scene), {"dead-reckoning": scene.results["dead-reckoning"]})
    assert (len(figure.axes), len(alone.axes)) == (2, 1)


def test_scatterers_have_a_marker_of_their_own_and_no_reflecting_points(scene):
    truth, slam = scene.recording.truth, scene.results["fastslam"]
    vts, found = (
        dataclasses.replace(x, scatterer=np.array(kind)) for x, kind in ((truth.vts, [0, 1]), (slam.vts, [0, 1, 0, 1]))
    )
    recording = dataclasses.replace(scene.recording, truth=dataclasses.replace(truth, vts=vts))
    results = {"fastslam": dataclasses.replace(slam, vts=found)}
    figure = Figure()
    assert overview.draw(figure, None, recording, results)
    lines = {line.get_label(): line for line in figure.axes[0].lines}
    true, estimated = lines["true scatterers"], lines["scatterers of fastslam"]
    np.testing.assert_allclose(np.column_stack(true.get_data()), truth.vts.position_m[[1], :2])
    np.testing.assert_allclose(np.column_stack(estimated.get_data()), slam.vts.position_m[[1, 3], :2])
    assert true.get_marker() != estimated.get_marker()
    assert {"true scatterers", "scatterers of fastslam"} <= {t.get_text() for t in figure.legends[0].get_texts()}
    assert overview.reflectors_of(recording, results["fastslam"]) == []
    figure = Figure()
    assert overview.draw(figure, None, scene.recording, scene.results)
    assert not any("scatterers" in t.get_text() for t in figure.legends[0].get_texts())
