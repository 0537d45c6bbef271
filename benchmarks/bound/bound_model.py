"""What the bound's recursion works on: plain tuples of arrays, read by its compiled kernels."""

from __future__ import annotations

from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from cellslam.sim.recording import Floats, Ints

Flags = NDArray[np.bool_]


@dataclass(frozen=True)
class Core:
    """Where the states that all links share stand: pose (0-5), odometry biases and scales, rates that clocks
    have walked to, clock offsets.

    `bias` and `scale` (6,): state index of each odometry component, `rate` (S,) of each site, -1 where there is none.
    `mean`: no state; here the covariance has the error of the filter's mean (`recursion_kernel`).
    """

    bias: Ints
    scale: Ints
    rate: Ints
    mean: int
    offsets: Ints
    size: int


class Motion(NamedTuple):
    """Prior variances `start` (core,); `step` (T, 6, core), `noise` (T, 6, 6), `walk` (T, core): the pose's transition,
    covariance of its noise, variances that the core gains. `jump` (T, core): what the error of the filter's mean gains
    (`drawn_errors.jumps`), which has column `mean`. `rate` (S,): state of the rate that a site's clock has walked to
    (-1: none), by which its offset grows over `dt_s` (T,). Row t leads from snapshot t - 1 to t; row 0 is not used.
    """

    start: Floats
    step: Floats
    noise: Floats
    walk: Floats
    jump: Floats
    mean: int
    rate: Ints
    dt_s: Floats


class Views(NamedTuple):
    """What all links share that see a VT in a snapshot, n views; snapshot t has rows[t]:rows[t + 1].

    `by_pose` (n, 3, 6), `by_vt` (n, 3, 3); `offset` (n,): core index of the site's offset; `state` (n, 3, W), `load`
    (n, 3, W): persisting errors in distance, azimuth, elevation as loads on states, -1: none.
    """

    rows: Ints
    by_pose: Floats
    by_vt: Floats
    offset: Ints
    state: Ints
    load: Floats


class Sightings(NamedTuple):
    """The measurements, m of them: `rows` (T + 1,), `view_of` (m,), `key` (m,): row of the VT, whether it is its
    `first` and its `last` one, `variance` (m, 3) of the white errors (infinite: not measured), `residual` (m, 3): what
    it is off in all; `state` (m, 3): the persisting error of its own (-1: none) with loads `load` (3,).
    """

    rows: Ints
    view_of: Ints
    key: Ints
    first: Flags
    last: Flags
    variance: Floats
    residual: Floats
    state: Ints
    load: Floats


class Errors(NamedTuple):
    """Persisting errors, E states of unit variance: `last` (E,) snapshot with a use; `kind` (E,): column of `decay`
    (T, 4), the factor of first-order Gauss-Markov states from a snapshot to the next (column 0: constants).
    """

    last: Ints
    kind: Ints
    decay: Floats


class Work(NamedTuple):
    """Room for the recursion: covariance `p` (N + 1, N + 1), N the most states at once; a snapshot's whitened `gains`
    (K, N + 1), gains `shared` (3 L, N + 1) of its views, products `dots` (K, 3 L); `moved` (6, N + 1); where each error
    and VT coordinate stands, `slot_of` (-1: nowhere), and which one stands there, `id_of`.
    """

    p: Floats
    gains: Floats
    shared: Floats
    dots: Floats
    moved: Floats
    slot_of: Ints
    id_of: Ints


class Found(NamedTuple):
    """What the recursion fills: covariance of the pose `pose` (T, 6, 6), variance of the clock `offset` (T, S), and
    `error` (T, 6), the pose's error of the filter.
    """

    pose: Floats
    offset: Floats
    error: Floats


def room(core: int, states: int, views: Views, sightings: Sightings, errors: Errors) -> Work:
    """Return the work space for `core` and at most `states` other states at once."""
    size = core + states + 1
    most_rows, most_views = int(np.diff(sightings.rows).max()), max(int(np.diff(views.rows).max()), 1)
    vts = 3 * (int(sightings.key.max(initial=-1)) + 1)
    return Work(
        p=np.zeros((size, size)), gains=np.zeros((3 * most_rows + 4, size)), shared=np.zeros((3 * most_views, size)),
        dots=np.zeros((3 * most_rows + 4, 3 * most_views)), moved=np.zeros((6, size)),
        slot_of=np.full(len(errors.last) + vts, -1, np.int64), id_of=np.full(size, -1, np.int64),
    )  # fmt: skip
