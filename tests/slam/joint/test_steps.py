"""Steps of clocks: found as by the textbook filter whose offset is open, with no more false alarms than stated."""

import numpy as np
import pytest
from scipy.stats import chi2

from cellslam.sim.compiling import njit
from cellslam.slam.joint.snapshot.observation_kernel import rotations_of
from cellslam.slam.joint.snapshot.steps_kernel import expect_steps, shift_clocks, take_steps
from cellslam.slam.joint.snapshot.update_kernel import BlockMeasurement, add_up, correct
from cellslam.slam.joint.state.layout import LAST
from cellslam.slam.model.matrices_kernel import Vec3

NOW = 3  # number of the fixture's snapshot
POSE = (1.0, 2.0, 0.0, 0.3, 0.0, 0.0)
VTS = ((60.0, 0.4, 0.2), (80.0, 2.0, 0.1), (45.0, -1.5, 0.3), (90.0, -2.6, 0.15))
Q = np.array([0.2, 0.01, 0.01]) ** 2


def prepared(one_filter, **rules):
    """Return a filter that knows pose, offset and VTs well, and its covariance's root."""
    one = one_filter(**rules)
    one.put(POSE, 5.0, *VTS)
    std = np.full(one.n, 0.01)
    std[:3], std[one.offset] = 0.1, 0.3
    root = np.diag(std) @ (np.eye(one.n) + 0.3 * np.random.default_rng(1).standard_normal((one.n, one.n)) / one.n)
    return one, root


@njit
def block(f, errors, offset, z, q, rules, sight, pending):
    """Take a measurement (3,) at each VT in as one block; return their log-density, and what the decision on steps
    adds."""
    expect_steps(f, rules, pending.steps)
    total = 0.0
    for j in range(len(z)):
        measurement = BlockMeasurement(
            z[j], q, q, f.x[:6], Vec3(f.x[0], f.x[1], f.x[2]), rotations_of(f), 1.0, 1.0, NOW, f.particles.deviation[:6]
        )
        total += correct(f, errors, j, offset, measurement, 1.0, rules, sight, pending)
    add_up(f, pending)
    return total, take_steps(f, rules, pending.steps)


def use(one, z):
    """Take measurements z (m, 3) at all VTs in as one block; return what it adds to the log-likelihood, and steps
    alone."""
    density, steps = block(one.f, one.errors, one.offset, z, Q, one.rules, one.w.jacobian, one.w.pending)
    return density + steps, steps


@pytest.mark.slow
def test_a_step_is_found_as_if_the_offset_had_been_open(one_filter, kalman):
    """With a step that is certain a priori, mean, covariance and likelihood are those of an opened variance."""
    one, root = prepared(one_filter, step=0.0, step_m=3.0)
    p = one.spread(root)
    measurements = np.array([one.model(j)[0] + np.array([0.7, 0.003, -0.002]) for j in range(len(VTS))])
    h = [one.model(j)[1] for j in range(len(VTS))]
    x, p[one.offset, one.offset], total = one.f.x[: one.n].copy(), p[one.offset, one.offset] + 9.0, 0.0
    start = x.copy()
    for z, jacobian, (expected, _) in zip(measurements, h, [one.model(j) for j in range(len(VTS))], strict=True):
        x, p, density = kalman(x, p, jacobian, z - expected - jacobian @ (x - start), Q)
        total += density
    found, _ = use(one, measurements)
    assert found == pytest.approx(total, abs=1e-9)
    std = np.sqrt(np.diag(p))
    assert np.abs((one.f.x[: one.n] - x) / std).max() < 1e-9
    np.testing.assert_allclose(one.f.p[: one.n, : one.n] / np.outer(std, std), p / np.outer(std, std), atol=1e-9)


@pytest.mark.slow
def test_false_alarms_are_as_rare_as_stated(one_filter):
    """Blocks drawn from the filter's own model: alarms come as chi-square says, below the stated probability."""
    probability, rng, alarms, blocks = 0.05, np.random.default_rng(5), 0, 4000
    one, root = prepared(one_filter, step=float(np.log(probability)), step_m=1.0)
    h = np.concatenate([one.model(j)[1] for j in range(len(VTS))])
    expected = np.concatenate([one.model(j)[0] for j in range(len(VTS))])
    x = one.f.x[: one.n].copy()
    for _ in range(blocks):
        one.f.x[: one.n] = x
        one.spread(root)
        z = expected + h @ (root @ rng.standard_normal(one.n)) + np.tile(np.sqrt(Q), 4) * rng.standard_normal(12)
        alarms += use(one, z.reshape(-1, 3))[1] > 0.0
    told = one.w.pending.steps.information[0]
    least = (np.log(1.0 + told) - 2.0 * np.log(probability)) * (1.0 + 1.0 / told)
    rate = chi2.sf(least, 1)
    assert rate < probability
    assert abs(alarms - blocks * rate) < 3.0 * np.sqrt(blocks * rate)


@pytest.mark.slow
@pytest.mark.parametrize(("azimuths", "found"), [((0.3, 0.4, 0.2), False), ((0.3, 1.8, -2.8), True)])
def test_what_a_slip_explains_is_no_step(one_filter, azimuths, found):
    """All distances are 0.8 m short: where VTs are ahead alone, the vehicle may as well be farther than it knows."""
    one = one_filter(step=float(np.log(1e-6)), step_m=50.0)
    one.put(POSE, 5.0, *((rho, azimuth, 0.05) for rho, azimuth in zip((60.0, 80.0, 45.0), azimuths, strict=True)))
    one.spread(np.diag(np.where(np.arange(one.n) < 3, 0.05, 0.01)))
    use(one, np.array([one.model(j)[0] - [0.8, 0.0, 0.0] for j in range(3)]))
    assert (one.f.x[one.offset] < 4.5) == found


@pytest.mark.parametrize(
    ("step_m", "measurements", "last", "snapshots"),
    [(40.0, 4, NOW, 1), (40.0, 4, NOW - 100, 1), (40.0, 1, NOW, 4), (40.0, 1, NOW - 100, None), (0.0, 4, NOW, None)],
)
def test_a_large_step_is_found_where_nothing_associates(one_filter, step_m, measurements, last, snapshots):
    """At once where measurements agree; after some snapshots where there is one alone, if its VT was seen lately."""
    one, root = prepared(one_filter, step=float(np.log(1e-6)), step_m=100.0, log_clutter=-9.0, confirm=0)
    one.spread(root)
    z = np.array([one.model(j)[0] + [step_m, 0.0, 0.0] for j in range(measurements)])
    seen, room = one.seen(z, np.tile(Q, (measurements, 1))), one.w
    room.pairs.slot_of[:], one.f.vts.slots[:, LAST] = -1 if step_m else 0, last
    found = [shift_clocks(one.f, one.block, one.errors, seen, room.jacobian, room.pairs) for _ in range(snapshots or 6)]
    assert found == [False] * (len(found) - 1) + [snapshots is not None]
    assert one.f.x[one.offset] == pytest.approx(5.0 + (step_m if snapshots else 0.0), abs=1e-9)
