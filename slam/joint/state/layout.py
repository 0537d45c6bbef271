"""What travels together through the compiled joint filters, and where things stand in their arrays."""

from __future__ import annotations

import math
from typing import NamedTuple

from cellslam.sim.compiling import part
from cellslam.sim.recording import Floats, Ints
from cellslam.slam.model.field_kernel import MOST_BELLS, Grid

POSE = 6
# Owners of states: weights of fields have their number; core states nobody; a VT's are OF_VT and below.
NOBODY, OF_VT = -1, -2
# States of a VT: range, azimuth, elevation about its anchor, and its diffuse errors in distance, azimuth, elevation.
VT, DIFFUSE, VT_STATES = 0, 3, 6
# Integers of a VT: link, detections, snapshot of the last one, identity, 1 while only a remembered map has it, 1 where
# its wall is known not to reach: nothing is associated with it there; 1 if it was known before the drive: it stays; 1
# if it is a scatterer, 0: a mirror image; and the VT that illuminates the scatterer, or the one that this image would
# be if it was one: -1, none (`birth_kernel`).
LINK, HITS, LAST, IDENT, UNSEEN, BEYOND, SURVEYED, SCATTERER, ILLUMINATOR, SLOT = range(10)
# Behind the three coordinates of an anchor: the probability that the VT exists and is visible (belief propagation); the
# weight of a hypothesis of a VT (1: the only one, 0: given up); the probability that another path has merged with that
# of the VT; the log-ratio of the likelihood of its measurements to that of clutter; and its track score. A VT is
# tentative, then confirmed by enough detections and a positive score, which it has from the beginning where paths
# cannot be scattered (`tentative_kernel`).
EXISTS, WEIGHT, MERGED, LOG_RATIO, SCORE, ANCHOR = range(3, 9)
MOST_SCORE = 6.0  # ever so many measurements that fit do not outweigh those that no longer do
# What the measurements may do to the map.
FREE, KNOWN_ASSOCIATION, KNOWN_MAP, BELIEF = range(4)
# A VT of the map: identity, link, position (3), covariance (9), and 1 if it is a scatterer.
POSITION, SPREAD, KIND, ENTRY = 2, 5, 14, 15
# States that one measurement touches at most: pose, sway, ground, scale of range, clock offset, VT and its diffuse
# errors, its illuminator; weights of five fields.
TOUCHED = POSE + 3 + 1 + 1 + 1 + VT_STATES + 3 + 5 * MOST_BELLS


class Core(NamedTuple):
    """States that are always there: pose (0-5), turns of the array within a snapshot (yaw, pitch, roll), how much
    the ground reflects, the scale of range, odometry biases and scales that the data sheet has, what its white noise
    has summed up to lately, clock offsets (S), rates of those that drift, errors that the VTs of a remembered map have
    in common.

    `bias`, `scale`, `noise` (6,), `rate` (S,): indices of each component's error and of each offset's rate, `sway`
    (3,), `ground`, `range_scale`, -1 where there is none; `drawn` (D, 6): what the odometry's white noise sums
    up to in each of the last D blocks, in a filter that draws it, -1 where a component has none. `wander` (2, S):
    densities of the walks of offsets and rates, m/sqrt(s), (m/s)/sqrt(s); `step_m` (S,): deviation of the size of steps
    of offsets, m, 0 where a clock does not step. From `first_common` to `size`: the map's errors.
    """

    sway: Ints
    ground: int
    range_scale: int
    bias: Ints
    scale: Ints
    noise: Ints
    first_offset: int
    rate: Ints
    wander: Floats
    step_m: Floats
    drawn: Ints
    first_common: int
    size: int

    @property
    def offsets(self) -> slice:
        """The clock offsets."""
        return slice(self.first_offset, self.first_offset + len(self.rate))

    @property
    def common(self) -> slice:
        """The errors that the VTs of a remembered map have in common."""
        return slice(self.first_common, self.size)


class ArrayErrors(NamedTuple):
    """Errors that persist, as states: deviations in m and rad, 0 where there is no such error.

    `calibration` (3,), `roof` (3,): of functions of the direction, weights of bells on their grids; `diffuse` (3,): of
    each VT, over `diffuse_m`; `sway` (3,): turns of the array in yaw, pitch, roll over `sway_s`; `tilt` (2,): of
    pitch and roll over `tilt_s`; `ground`: of how much the ground reflects, without unit.
    """

    calibration: Floats
    calibration_grid: Grid
    roof: Floats
    roof_grid: Grid
    diffuse: Floats
    diffuse_m: float
    sway: Floats
    sway_s: float
    tilt: Floats
    tilt_s: float
    ground: float


class FieldWeights(NamedTuple):
    """The weights (W,) of the fields of direction: index of the `state` of each, -1 where it is none; snapshot in which
    it was `met` last."""

    state: Ints
    met: Ints


class Vts(NamedTuple):
    """V VTs: `state` (V, 6): indices of the states of each, -1 where there is none; `anchor` (V, 9) and integers
    `slots` (V, 10), as above; `spread` (V, 6): covariance over the particles of what they expect to measure of each VT,
    xx, xy, xz, yy, yz, zz in m and rad. A VT that is known exactly has states without variance."""

    state: Ints
    anchor: Floats
    slots: Ints
    spread: Floats


class Lost(NamedTuple):
    """Confirmed VTs that were given up for others in a snapshot: `rows` (E, 15), of which `used` (1,)."""

    rows: Floats
    used: Ints


class Learnt(NamedTuple):
    """What was learnt of assumptions: `sizes` (3, Z), see `sizes_kernel`; `summed` (1,): time (s) of the sums of noise;
    `nis` (2,): sum of the normalised innovations squared of first measurements of VTs of a remembered map, and how many
    components they had."""

    sizes: Floats
    summed: Floats
    nis: Floats


class Particles(NamedTuple):
    """The N particles of a filter that has some (see `slam.fastslam`; N is 0 in others): x is their weighted mean and p
    the covariance that they share; particle i has the mean x + `deviation` (n, N)[:, i] and the `weight` (N,)[i]."""

    deviation: Floats
    weight: Floats


class Filter(NamedTuple):
    """One filter, with room for n states and V VTs; or a mixture of them, all arrays with a leading axis.

    Mean `x` (n,) and covariance `p` (n, n), of which `size` (1,) are in use; `owner` (n,) of each state; `count` (1,):
    VTs; `links` (L,): 1 where it uses a link; `illuminators` (L,): the VT that is taken for the transmitter, -1: none.
    """

    core: Core
    x: Floats
    p: Floats
    size: Ints
    owner: Ints
    count: Ints  # type: ignore[assignment]  # hides tuple.count
    links: Ints
    illuminators: Ints
    fields: FieldWeights
    vts: Vts
    lost: Lost
    learnt: Learnt
    particles: Particles


class Association(NamedTuple):
    """How measurements are associated.

    `mode`: what they may do to the map (FREE and so on); `log_clutter`: log of the clutter density; `gate`: squared
    Mahalanobis distance; `return_log_odds`: least log-odds that a measurement is of a VT which was last seen more than
    `away` snapshots ago, not of another one nearby.
    """

    mode: int
    log_clutter: float
    gate: float
    return_log_odds: float
    away: int


class Lifetime(NamedTuple):
    """When VTs and weights of the roof's field are confirmed and dropped.

    `confirm`: detections that confirm a VT; `age_once`, `age_twice`: snapshots after which one that was seen once, or a
    few times, is dropped; `hold`: snapshots after which a weight that was not met is given up.
    """

    confirm: int
    age_once: int
    age_twice: int
    hold: int


class BlockLimits(NamedTuple):
    """A block ends after so many `snapshots`, so long a `distance` (m), or so large a `turn` (rad)."""

    snapshots: int
    distance: float
    turn: float


class Existence(NamedTuple):
    """Of belief propagation: odds of a `birth` against clutter; probabilities that a visible VT stays so, that a hidden
    one comes `back`, of `detection`, and below which a VT is given up, `drop`. Other filters do not use them."""

    birth: float = 0.0
    stay: float = 1.0
    back: float = 0.0
    detection: float = 1.0
    drop: float = 0.0


class Rules(NamedTuple):
    """Options of the compiled filters, by what they are about.

    `evidence`: share of detections and misses that counts in the log-likelihood; `step`: log-probability that a clock
    which may step does so in a block; `slip`: log-odds that wheels slip in one; `merge_rate`: how often another path
    merges with that of a VT, 1/s; 0: never; `scatterers`: whether a VT may be a scatterer, or nothing that a filter has
    a model of: its track score confirms it.
    """

    association: Association
    lifetime: Lifetime
    blocks: BlockLimits
    evidence: float
    existence: Existence = Existence()
    step: float = -math.inf
    slip: float = -math.inf
    merge_rate: float = 0.0
    scatterers: bool = False


class Noise(NamedTuple):
    """Variances (m, 3) of measurements, in m^2 and rad^2, besides those of the states.

    `single`: of a measurement; `many`: of what it counts for in an update; `merged` (3,): what updates take beside
    `many`; `diffuse` (m,): share of the diffuse errors' deviation that is left in a measurement.
    """

    single: Floats
    many: Floats
    merged: Floats
    diffuse: Floats


class Births(NamedTuple):
    """Measurements as VTs begin with them: `z` (m, 3) in m and rad, NaN where none may begin; variances `q` (m, 3); and
    how many `hypotheses` there are, if all of them begin, of VTs of which a distance or an azimuth is not known."""

    z: Floats
    q: Floats
    hypotheses: int


class Measured(NamedTuple):
    """One snapshot of m measurements as the kernels take it, snapshot number `now`.

    `born`: identity of measurement 0 as a VT; `first` (L + 1,): first measurement of each link; `site_of` (L,); `given`
    (m,): true VT of each measurement in mode KNOWN_ASSOCIATION; `z` (m, 3): in m and rad, NaN where not measured; `gap`
    (m,): what the log-density of clutter is greater by; `tables` (2, 2, H): see `measurement_options.existence`.
    """

    now: int
    born: int
    first: Ints
    site_of: Ints
    given: Ints
    z: Floats
    gap: Floats
    tables: Floats
    noise: Noise
    births: Births
    rules: Rules


class Track(NamedTuple):
    """The snapshots of a block, up to B: `snapshots` (1,) so far; of each its `pose` (B, 6), by how much the poses of C
    particles differ from that, `deviation` (B, 6, N), and distance (m) and time (s) from the begin `at` (B, 2); `total`
    (3,): distance, turn (rad), time."""

    snapshots: Ints
    pose: Floats
    deviation: Floats
    at: Floats
    total: Floats


class Sums(NamedTuple):
    """Of each VT in a block: how many `detections` (V,), in which snapshots `seen` (V, B); sums of innovations,
    variances and how many were measured: `e`, `q`, `measured` (V, 3), of squared shares of diffuse errors `diffuse`
    (V,), and of the log-odds of what was detected and missed `odds` (V,)."""

    detections: Ints
    seen: Ints
    e: Floats
    q: Floats
    measured: Floats
    diffuse: Floats
    odds: Floats


class Block(NamedTuple):
    """What has been measured since the last update: along the `track`, and in `sums` of each VT. Of each site, across
    blocks: the `shift` (S, 2) of its clock that measurements speak for lately, in m, and how strongly."""

    track: Track
    sums: Sums
    shift: Floats


@part
def one_of(mixture: Filter, k: int) -> Filter:
    """Return filter k of a mixture."""
    fields, vts, lost, learnt, particles = mixture.fields, mixture.vts, mixture.lost, mixture.learnt, mixture.particles
    return Filter(
        core=mixture.core, x=mixture.x[k], p=mixture.p[k], size=mixture.size[k], owner=mixture.owner[k],
        count=mixture.count[k], links=mixture.links[k], illuminators=mixture.illuminators[k],
        fields=FieldWeights(state=fields.state[k], met=fields.met[k]),
        vts=Vts(state=vts.state[k], anchor=vts.anchor[k], slots=vts.slots[k], spread=vts.spread[k]),
        lost=Lost(rows=lost.rows[k], used=lost.used[k]),
        learnt=Learnt(sizes=learnt.sizes[k], summed=learnt.summed[k], nis=learnt.nis[k]),
        particles=Particles(deviation=particles.deviation[k], weight=particles.weight[k]),
    )  # fmt: skip


@part
def block_of(blocks: Block, k: int) -> Block:
    """Return the block of filter k of a mixture."""
    track, sums = blocks.track, blocks.sums
    return Block(
        track=Track(
            snapshots=track.snapshots[k], pose=track.pose[k], deviation=track.deviation[k], at=track.at[k],
            total=track.total[k],
        ),
        sums=Sums(
            detections=sums.detections[k], seen=sums.seen[k], e=sums.e[k], q=sums.q[k], measured=sums.measured[k],
            diffuse=sums.diffuse[k], odds=sums.odds[k],
        ),
        shift=blocks.shift[k],
    )  # fmt: skip
