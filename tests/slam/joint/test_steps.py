"""Steps of clocks and slip of wheels: found as by the textbook filter for which offset or motion is open."""

import numpy as np
import pytest
from scipy.stats import chi2

from cellslam.sim.compiling import njit
from cellslam.slam.joint.snapshot.observation_kernel import rotations_of
from cellslam.slam.joint.snapshot.steps_kernel import SLIP, expect_steps, shift_clocks, take_slip, take_steps
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
def block(f, errors, offset, z, q, rules, sight, pending, moved):
    """Take a measurement (3,) at each VT in as one block; return their log-density, and what slip and the decision on
    steps add."""
    expect_steps(f, rules, pending.steps)
    total = 0.0
    for j in range(len(z)):
        measurement = BlockMeasurement(
            z[j], q, q, f.x[:6], Vec3(f.x[0], f.x[1], f.x[2]), rotations_of(f), 1.0, 1.0, NOW, f.particles.deviation[:6]
        )
        total += correct(f, errors, j, offset, measurement, 1.0, rules, sight, pending)
    add_up(f, pending)
    return total, take_slip(f, rules, pending.steps, moved) + take_steps(f, rules, pending.steps)


def use(one, z, moved=(0.0, 0.0)):
    """Take measurements z (m, 3) at all VTs in as one block of so long a distance (m) and turn (rad); return what it
    adds to the log-likelihood, and slip and steps alone."""
    density, steps = block(
        one.f, one.errors, one.offset, z, Q, one.rules, one.w.jacobian, one.w.pending, np.array(moved)
    )
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


def moments(one_filter, slip, moved):
    """Return mean, covariance and log-likelihood after a block in which all VTs are off as by a slip."""
    one, root = prepared(one_filter, slip=slip)
    one.spread(root)
    total, _ = use(one, np.array([one.model(j)[0] + [0.4, -0.05, 0.0] for j in range(len(VTS))]), moved)
    return one.f.x[: one.n].copy(), one.f.p[: one.n, : one.n].copy(), total


@pytest.mark.slow
@pytest.mark.parametrize("moved", [(0.6, 0.0), (0.0, -0.3)])
def test_slip_that_is_certain_is_noise_of_the_odometry(one_filter, kalman, moved):
    """Mean, covariance and likelihood are those of a motion whose distance or turn has the deviation of a slip."""
    one, root = prepared(one_filter)
    p, x, total = one.spread(root), one.f.x[: one.n].copy(), 0.0
    by = np.zeros(one.n)
    by[[0, 1, 3]] = moved[0] * np.cos(POSE[3]), moved[0] * np.sin(POSE[3]), moved[1]
    p, start = p + SLIP**2 * np.outer(by, by), x.copy()
    for _, h in [one.model(j) for j in range(len(VTS))]:
        x, p, density = kalman(x, p, h, np.array([0.4, -0.05, 0.0]) - h @ (x - start), Q)
        total += density
    mean, covariance, found = moments(one_filter, 40.0, moved)
    std = np.sqrt(np.diag(p))
    assert np.abs((mean - x) / std).max() < 1e-6
    np.testing.assert_allclose(covariance / np.outer(std, std), p / np.outer(std, std), atol=1e-6)
    assert found == pytest.approx(total, abs=1e-6)


@pytest.mark.slow
@pytest.mark.parametrize("share", [0.1, 0.5, 0.9])
def test_slip_that_may_be_is_a_mixture(one_filter, share):
    """With prior odds for which a slip has this probability after the block, its two moments are the mixture's."""
    moved = (0.6, 0.0)
    (none, p_none, without), (slipped, p_slipped, with_slip) = (moments(one_filter, s, moved) for s in (-np.inf, 40.0))
    log_odds = np.log(share / (1.0 - share)) - (with_slip - without)
    mean, covariance, total = moments(one_filter, log_odds, moved)
    np.testing.assert_allclose(mean, none + share * (slipped - none), atol=1e-9)
    apart = np.outer(slipped - none, slipped - none)
    mixture = (1.0 - share) * p_none + share * p_slipped + share * (1.0 - share) * apart
    np.testing.assert_allclose(covariance, mixture, atol=1e-9)
    prior = 1.0 / (1.0 + np.exp(-log_odds))
    assert total == pytest.approx(np.logaddexp(np.log1p(-prior) + without, np.log(prior) + with_slip), abs=1e-9)


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
