"""How far one VT may change the weights of a mixture: bounds, bookkeeping, and a path that is the image of no wall."""

from __future__ import annotations

from dataclasses import astuple, replace
from typing import Any

import numpy as np
import pytest

from cellslam.sim.frames import wrap_angle
from cellslam.sim.recording import Measurements, Recording
from cellslam.slam.api import setup_of
from cellslam.slam.conformance.subject import tiny_drive
from cellslam.slam.joint.ekf_slam import EkfSlam
from cellslam.slam.joint.influence import BIRTH, MOST, bounded
from cellslam.slam.joint.mixture import Mixture
from cellslam.slam.joint.new_filters import NO_ERRORS, core_of, new_mixture
from cellslam.slam.joint.state.layout import IDENT, LOG_RATIO
from tests.slam.driving import driven

NONE = np.empty(0, np.int64)
ALONE = 200  # snapshots for which one path is all that is heard of a site


@pytest.fixture
def mixture() -> Mixture:
    """Two filters without VTs, the log-weights being -1 and -2."""
    setup = setup_of(tiny_drive())
    out = new_mixture(setup, core_of(setup, NO_ERRORS), NO_ERRORS, np.zeros((2, 2)), np.ones(2))
    out.influence.rest[:] = -1.0, -2.0
    return out


def put(mixture: Mixture, k: int, log_ratio: dict[int, float]) -> None:
    """Let filter k have these VTs, by identity, and no others; `log_ratio`: beyond what each costs."""
    mixture.arrays.count[k] = len(log_ratio)
    for j, (ident, value) in enumerate(log_ratio.items()):
        mixture.arrays.vts.slots[k, j, IDENT], mixture.arrays.vts.anchor[k, j, LOG_RATIO] = ident, BIRTH + value


def weighed(mixture: Mixture, association: Any = ((), ()), born: int = 1000) -> list[float]:
    """Return the log-weights after a snapshot."""
    mixture.influence.meet(mixture.arrays, np.array(association, np.int64), born, mixture.log_weight)
    mixture.log_weight = mixture.influence.weigh(mixture.arrays)
    return list(mixture.log_weight)


def test_a_path_says_no_less_than_clutter_and_little_against_a_filter() -> None:
    log_ratio = BIRTH + np.array([[2.0, -9.0, 50.0, -3.0], [1.5, 0.0, -20.0, 0.5]])
    np.testing.assert_allclose(bounded(log_ratio, np.arange(4), NONE), [-0.5, -0.5 - MOST])
    assert bounded(np.empty((2, 0)), np.empty(0), NONE).tolist() == [0.0, 0.0]


def test_who_breaks_a_path_into_many_gains_nothing() -> None:
    """The second filter lost the path twice, and began it again: each VT costs, and together they are one path."""
    log_ratio = np.array([[90.0, 0.0, 0.0], [30.0, 30.0, 30.0]])
    np.testing.assert_allclose(bounded(log_ratio, np.array([5, 5, 5]), NONE), [0.0, -min(2.0 * BIRTH, MOST)])


def test_a_filter_without_a_vt_loses_what_it_explains(mixture: Mixture) -> None:
    put(mixture, 0, {7: 2.0})
    assert weighed(mixture) == [-1.0, -4.0]
    put(mixture, 0, {7: 100.0})  # over its whole life: it is not counted twice
    assert weighed(mixture) == [-1.0, -2.0 - MOST]


def test_the_log_ratio_of_a_lost_vt_remains(mixture: Mixture) -> None:
    put(mixture, 0, {7: 2.0, 9: 1.0})
    put(mixture, 1, {9: 1.5, 7: 1.0})
    before = weighed(mixture)
    assert before == [-1.0 - 0.5, -2.0 - 1.0]
    put(mixture, 0, {9: 1.0})  # the one filter has lost it
    assert weighed(mixture) == before
    put(mixture, 1, {9: 1.5})  # and so has the other
    assert weighed(mixture) == before
    assert mixture.influence.ident.tolist() == [9]
    put(mixture, 0, {})
    put(mixture, 1, {})
    assert weighed(mixture) == before
    assert mixture.influence.log_ratio.shape == (2, 0)


def test_a_vt_that_begins_with_a_measurement_of_another_is_of_its_path(mixture: Mixture) -> None:
    """The second filter takes the measurement 51 for a new VT, the first for VT 7; of measurement 50 neither has
    one."""
    put(mixture, 0, {7: 2.0})
    put(mixture, 1, {7: 1.0})
    weighed(mixture)
    put(mixture, 1, {7: 1.0, 51: 0.5, 50: 0.0})
    assert weighed(mixture, [[-1, 7], [-1, -1]], 50) == [-1.0, -2.0 - 0.5]
    assert mixture.influence.path.tolist() == [7, 50, 7]
    put(mixture, 0, {})
    put(mixture, 1, {51: 4.0})  # the path goes on
    assert weighed(mixture) == [-1.0 - 3.0, -2.0]
    assert mixture.influence.ident.tolist() == [7, 51]


def over_an_edge() -> Recording:
    """Return the drive with one path of the second site over an edge, alone for a while: its distances are those to the
    edge and as much as it is from there, its directions those of the edge."""
    drive = tiny_drive()
    truth, m = drive.truth, drive.measurements
    assert truth is not None
    vt, start = 4, truth.poses[0, :3]
    image = truth.vts.position_m[vt]
    edge = start + 0.4 * (image - start)
    rows = np.flatnonzero(truth.measurement_vt == vt)
    there, place = np.linalg.norm(image - edge), truth.poses[m.snapshot[rows], :3]
    before, after = image - place, edge - place
    distance, azimuth = m.distance_m.copy(), m.azimuth_rad.copy()
    distance[rows] += np.linalg.norm(after, axis=1) + there - np.linalg.norm(before, axis=1)
    turned = np.arctan2(after[:, 1], after[:, 0]) - np.arctan2(before[:, 1], before[:, 0])
    azimuth[rows] = wrap_angle(azimuth[rows] + turned)
    heard = (drive.links.site[m.link] == 0) | (m.snapshot >= ALONE) | (truth.measurement_vt == vt)
    columns = astuple(replace(m, distance_m=distance, azimuth_rad=azimuth))
    return replace(drive, measurements=Measurements(*(column[heard] for column in columns)), truth=None)


@pytest.mark.slow
def test_a_path_over_an_edge_does_not_rule_out_the_right_offset() -> None:
    """Without the bound `MOST` the offset is surely wrong by fifty metres, and no likely filter has the right one."""
    drive, truth, estimator = over_an_edge(), tiny_drive().truth, EkfSlam()
    assert truth is not None
    driven(estimator, drive, ALONE)
    offsets = np.array([mean for mean, _ in estimator._start._likely()[1]])
    assert np.any(np.abs(offsets - truth.clock_offsets_m[1]) < 20.0)
