"""FastSLAM: a Rao-Blackwellised particle filter over the vehicle's path, with one gain for all particles.

State
    x in R^n   pose, odometry biases and scales, clock offsets, errors of the array, virtual transmitters (VTs): the
               state of the joint EKF (`slam/joint`), with which this filter shares its models and linearisation
    u_k in R^d what the odometry's white noise sums up to in block k of snapshots, some 0.6 s long: a particle is a
               path, the sequence of its draws of u_1, u_2, ...
    Given the path, x is Gaussian. F, H and R hardly depend on which path it is, so N particles share one covariance
    P (n, n) and one gain; particle i has its own mean, column i of M (n, N), and its own weight w_i.

Recursion, and where it stands                                                    (a part: replaceable, `parts.py`)
    each snapshot                                                                 `_go_on`
      predict    M <- f(M), for each particle;  P <- F P F^T + Q                  `predict` (compiled)
                 u_k is a part of the state
      associate  e = z - h(M w), S = H P H^T + R + spread of h(M): the one-to-one `_associate`; parts `association`
                 pairs with the greatest sum of log p_D N(e; 0, S) /              and `birth`
                 (clutter (1 - p_D)), as far as that is positive
    each block of snapshots                                                       `_end_block`
      innovate   E = z - h(M) (m, N);  S = H P H^T + R = L L^T;                   `innovate` (compiled)
                 W = L^-1 E, G = L^-1 H P
      update     M <- M + K E = M + G^T W;  P <- P - K S K^T = P - G^T G          part `update`; `_move`, `end_block`
      weigh      log w_i <- log w_i - |W_i|^2 / 2                                 part `weight`; `_move`
                 log det S is common to all particles and cancels
      draw       u_i ~ N(M_u, P_uu), for the u of `lag` blocks ago;               part `proposal`; `_drawn`
                 M <- M + G_u (u_i - M_u), P <- P - G_u P_u., G_u = P_.u P_uu^-1
      prune      VTs that are unlikely to exist                                   part `pruning`; `_prune`
      resample   where 1 / sum(w_i^2) < effective_share N: copy columns of M      part `resampling`; `_resample`

    The belief is the mixture of N(m_i, P): mean M w, covariance P + (spread of the columns of M). In the code below M
    is the weighted mean `f.x` and each particle's `f.deviation` from it (n, N); P is `f.p`, w is `f.weight` (N,).

`lag` is what tells the relatives apart. With lag = 0 a block's noise is drawn from its posterior given the
measurements of the block: FastSLAM 2.0. With lag = -1 it is drawn from its prior, before: FastSLAM 1.0. The greater
the lag, the more measurements the noise is drawn by, and the more of what is known stays in P instead of in the
particles; where nothing is ever drawn (lag = NEVER) one column is left, and the filter is the joint EKF.

What no Gaussian holds, several hypotheses of an association or modes of a clock offset, is in groups: each has an M, a
P and a share of the particles, and is weighed by the likelihood of its measurements. While clock offsets are wide, the
groups are the Gaussians of the joint filter's start, which draw nothing.

Sources: Schoen, Gustafsson and Nordlund, "Marginalized particle filters for mixed linear/nonlinear state-space models",
IEEE Trans. Signal Processing 53(7), 2005 (common Riccati recursion); Montemerlo et al., "FastSLAM", AAAI 2002, and
"FastSLAM 2.0", IJCAI 2003; measurement model: Chen, Whiton and Tufvesson, "Extended FastSLAM using cellular multipath
component delays and angular information", sections III and IV.
"""

from __future__ import annotations

import math
from pathlib import Path
from typing import Any, ClassVar, Self

import numpy as np
from scipy.linalg.blas import dgemm

from cellslam.sim.compiling import is_compiled
from cellslam.sim.recording import Floats, Ints
from cellslam.slam import warm_up
from cellslam.slam.api import Setup
from cellslam.slam.fastslam import fastslam_kernel
from cellslam.slam.fastslam.fastslam_kernel import (
    Scores,
    end_block,
    innovate,
    predict,
    score,
    spread_over_particles,
    step_clocks,
    use,
    workspace_for,
)
from cellslam.slam.fastslam.fastslam_options import NEVER, FastSlamOptions
from cellslam.slam.fastslam.parts import (
    BUILT_IN,
    NO_VT,
    CalledPart,
    Candidates,
    Parts,
    Transmitters,
    checked,
    never_called,
    one_to_one,
    part_named,
    returned,
)
from cellslam.slam.fastslam.relocation import PLANE, components_of_pose, log_likelihood
from cellslam.slam.joint.ekf_slam import JointFilter
from cellslam.slam.joint.mixture import Mixture
from cellslam.slam.joint.snapshot.association_kernel import FRESH, NO_BIRTH
from cellslam.slam.joint.snapshot.gauge_kernel import carry_over
from cellslam.slam.joint.snapshot.motion_kernel import NOTHING_DRAWN, Interval
from cellslam.slam.joint.snapshot.snapshot_kernel import Workspace
from cellslam.slam.joint.state.layout import (
    HITS,
    LAST,
    POSE,
    WEIGHT,
    ArrayErrors,
    Block,
    Filter,
    Measured,
    block_of,
    one_of,
)

FEWEST = 10  # particles of a group: three of them do not hold a path
TINY = 1e-12  # of a variance: as good as none
SPARE_ROWS = 16  # beside three for each VT: those of the noise that is drawn, and what the kernels pad with
DROPPED = 0.0  # share of a VT in the map that makes the joint filter drop it


class FastSlam(JointFilter):
    """Particles over the vehicle's path, in groups; see the module for the equations, `parts` for what can be replaced.

    Parts are given by the options, by name, or as objects: FastSlam(options, association=my_function).
    """

    name: ClassVar[str] = "fastslam"
    Options: ClassVar[type[FastSlamOptions]] = FastSlamOptions
    options: FastSlamOptions

    def __init__(self, options: FastSlamOptions | None = None, **parts: Any) -> None:
        """Take options, and parts as objects in the place of those that the options name.

        Raises InputError for a slot or a name that does not exist, and for a part that cannot be called.
        """
        super().__init__(options or FastSlamOptions())
        given = {slot: checked(slot, part) for slot, part in parts.items()}
        named = {slot: part_named(slot, getattr(self.options, slot)) for slot in BUILT_IN if slot not in parts}
        self.parts = Parts(**named, **given)

    @staticmethod
    def compiled() -> bool:
        """Return whether the kernels have been compiled before, and are in Numba's cache."""
        return is_compiled(fastslam_kernel.__name__, Path(fastslam_kernel.__file__))

    def warm_up(self) -> None:
        """Compile every kernel on a made-up drive of four snapshots, each a block of its own."""
        warm_up.drive(self._alike(start_limit_s=0.1, block_s=0.0))

    def start(self, setup: Setup, rng: np.random.Generator) -> None:
        """Take the prior; draws begin with the first block of snapshots."""
        self._rng, self._block = rng, 0
        self._called = Parts(*(CalledPart(slot, part) for slot, part in self.parts._asdict().items()))
        self._workspace: Workspace | None = None
        super().start(setup, rng)
        o, wide = self.options, np.asarray(setup.start_std)[PLANE]
        self._widths = np.array([o.place_component_m, o.place_component_m, math.radians(o.heading_component_deg)])
        self._start_is_wide = setup.map is not None and self._start is None and bool((wide > self._widths).any())

    def remarks(self) -> list[str]:
        """Return what the drive says against the filter's assumptions, and which of its parts were never called."""
        own = self._valid
        assert isinstance(own, FastSlam)
        return [*super().remarks(), *never_called(own._called)]

    def _alike(self, **changes: Any) -> Self:
        other = super()._alike(**changes)
        other.parts = self.parts
        return other

    @property
    def _drawn_blocks(self) -> int:
        return 0 if self.options.lag >= NEVER else max(self.options.lag, 0) + 1

    # ---- a snapshot --------------------------------------------------------------------------------------------------

    def _go_on(self, mixture: Mixture, errors: ArrayErrors, interval: Interval, measured: Measured) -> Ints:
        """Use a snapshot in all groups; return the associations (K, m).

        While the drive so far is gone through again at the end of the start, there are no particles yet.
        """
        if self._start is not None or self._past:
            return mixture.use(errors, interval, measured, self.options.vts)
        if self._start_is_wide and len(measured.z):
            self._begin_groups(mixture, measured)
        self._share_particles(mixture)
        mixture.reserve_for(measured, self.options.vts)
        if self._drawn_blocks:
            interval = interval._replace(drawn=self._core.drawn[self._block % self._drawn_blocks])
        paired = [self._associate(*self._group(mixture, k), errors, interval, measured) for k in range(len(mixture))]
        parents, second = self._second_hypotheses(mixture, paired)
        mixture.split(parents)
        chosen = [one[0] for one in paired] + second
        association = np.full((len(mixture), len(measured.z)), -1)
        full = len(parents) > 0
        for k in range(len(mixture)):
            f, b = self._group(mixture, k)
            full |= use(f, errors, b, measured, chosen[k], association[k], self._workspace_for(f, measured))
        if full:
            for k in range(len(mixture)):
                mixture.influence.rest[k] += self._end_block(*self._group(mixture, k), errors, interval, measured)
            self._block += 1
        mixture.weigh(association, measured)
        return association

    @staticmethod
    def _group(mixture: Mixture, k: int) -> tuple[Filter, Block]:
        return one_of(mixture.arrays, k), block_of(mixture.blocks, k)

    def _associate(
        self, f: Filter, b: Block, errors: ArrayErrors, interval: Interval, measured: Measured
    ) -> list[Ints]:
        """Move a group, and return hypotheses of which VT each measurement is of: its slot (m,), FRESH for a new one,
        NO_BIRTH for none; the likeliest first."""
        m, V, work = len(measured.z), len(f.vts.slots), self._workspace_for(f, measured)
        scores = Scores(np.zeros(1, np.int64), np.empty(V, np.int64), np.empty((V, m)), np.empty((V, m)))
        if interval.dt > 0.0:
            predict(f, b, interval, work)
        score(f, errors, measured, work, scores)
        found = self._hypotheses(f, measured, scores)
        if self._core.step_m.any() and step_clocks(f, errors, b, measured, found[0], work):
            score(f, errors, measured, work, scores)
            found = self._hypotheses(f, measured, scores)
        return found

    def _hypotheses(self, f: Filter, measured: Measured, scores: Scores) -> list[Ints]:
        m, n = len(measured.z), int(scores.count[0])
        slot = scores.slot[:n]
        candidates = Candidates(scores.log_ratio[:n], scores.distance2[:n], f.vts.slots[slot, HITS])
        found = np.atleast_2d(self._called.association(candidates)) if n else np.full((1, m), NO_VT)
        found = one_to_one(returned("association", found, (len(found), m), "i", below=n))
        return [self._slots(candidates, slot, candidate_of) for candidate_of in found]

    def _slots(self, candidates: Candidates, slot: Ints, candidate_of: Ints) -> Ints:
        """Return the slot (m,) of each measurement's VT, FRESH where it begins one, NO_BIRTH where it does not."""
        begins = returned("birth", self._called.birth(candidates, candidate_of), candidate_of.shape, "b")
        without = np.where(begins, FRESH, NO_BIRTH)
        return np.where(candidate_of >= 0, slot[candidate_of], without) if len(slot) else without

    def _second_hypotheses(self, mixture: Mixture, paired: list[list[Ints]]) -> tuple[Ints, list[Ints]]:
        """Return the groups that become two, the likeliest first, as long as there is room, and their second
        hypotheses."""
        found = [(k, one) for k in np.argsort(-mixture.log_weight, kind="stable") for one in paired[k][1:]]
        found = found[: max(self.options.hypotheses - len(mixture), 0)]
        return np.array([k for k, _ in found], np.int64), [one for _, one in found]

    # ---- the end of a block ------------------------------------------------------------------------------------------

    def _end_block(self, f: Filter, b: Block, errors: ArrayErrors, interval: Interval, measured: Measured) -> float:
        """Update, weigh, draw and resample a group; return what adds to its log-weight beside its VTs."""
        work, parts, before = self._workspace_for(f, measured), self._called, f.x[: f.size[0]].copy()
        site_of, indices = measured.site_of, self._core.drawn
        drawn = indices[(self._block + 1) % len(indices)] if self._drawn_blocks else NOTHING_DRAWN
        if self.options.lag < 0:
            self._draw_blindly(f, b, drawn)
            spread_over_particles(f, site_of, work)
        innovate(f, errors, b, measured, work)
        n, w, k = int(f.size[0]), work.pending, int(work.pending.used[0])
        # By these rows, and beside them, the joint filter has moved the mean; here the particles are moved.
        f.x[:n] += w.added[:n] - w.rows[:k, :n].T @ w.whitened_mean[:k]
        G, W = parts.update(w.rows[:k, :n], w.whitened[:k])
        G, W = returned("update", G, (len(W), n)), returned("update", W, (len(G), len(f.particles.weight)))
        log_likelihood = returned("weight", parts.weight(W), f.particles.weight.shape)
        if self.options.lag >= 0:
            G, W, log_ratio = self._drawn(f, drawn, G, W)
            log_likelihood = log_likelihood + log_ratio
        w.used[0] = len(G)
        w.rows[: len(G), :n] = G
        self._move(f, G, W, log_likelihood)
        rules = self._prune(f, measured)
        total = end_block(f, errors, b, before, interval.noise, measured._replace(rules=rules), drawn, work)
        before = f.x[: f.size[0]].copy()
        if self._resample(f):  # the mean has moved, without a measurement
            carry_over(f, before, w.rows)
        spread_over_particles(f, site_of, work)
        return total

    def _drawn(self, f: Filter, drawn: Ints, G: Floats, W: Floats) -> tuple[Floats, Floats, Floats]:
        """Draw noise that was a part of the state until now, given an update with the rows G (k, n), W (k, N).

        Return the update with the rows that condition the state on the draws, and the log of target over proposal (N,).
        With A A^T = P_uu they are G_u = A^-1 P_u. and W_u = A^-1 (u_i - M_u).
        """
        n, u = G.shape[1], drawn[drawn >= 0]
        P_u = f.p[u, :n] - G[:, u].T @ G
        variance, axes = np.linalg.eigh(P_u[:, u])
        there = variance > TINY * f.p[u, u].max(initial=0.0)
        if not there.any():
            return G, W, np.zeros(W.shape[1])
        M_u = f.x[u, None] + f.particles.deviation[u] + G[:, u].T @ W
        draws, log_ratio = self._called.proposal(M_u, P_u[:, u], self._rng)
        draws, log_ratio = returned("proposal", draws, M_u.shape), returned("proposal", log_ratio, M_u.shape[1:])
        root = axes[:, there].T / np.sqrt(variance[there, None])
        return np.concatenate([G, root @ P_u]), np.concatenate([W, root @ (draws - M_u)]), log_ratio

    def _draw_blindly(self, f: Filter, b: Block, drawn: Ints) -> None:
        """Draw a block's noise before its measurements are used, and move the particles along it."""
        n, N, pose = int(f.size[0]), len(f.particles.weight), f.particles.deviation[:POSE].copy()
        G, W, log_ratio = self._drawn(f, drawn, np.empty((0, n)), np.empty((0, N)))
        f.p[:n, :n] -= G.T @ G
        self._move(f, G, W, log_ratio)
        b.track.deviation[:] += f.particles.deviation[:POSE] - pose

    @staticmethod
    def _move(f: Filter, G: Floats, W: Floats, log_likelihood: Floats) -> None:
        """Let M <- M + G^T W and w_i <- w_i exp(log_likelihood_i); x stays the weighted mean of the columns of M."""
        n = G.shape[1]
        with np.errstate(divide="ignore"):
            log_weight = np.log(f.particles.weight) + log_likelihood
        weight = np.exp(log_weight - log_weight.max())
        f.particles.weight[:] = weight / weight.sum()
        if len(G):
            dgemm(1.0, W.T, G, beta=1.0, c=f.particles.deviation[:n].T, overwrite_c=True)
        _recentre(f, n)

    def _resample(self, f: Filter) -> bool:
        """Resample the particles of a group if their weights differ too much; return whether they did."""
        count, n = len(f.particles.weight), int(f.size[0])
        if count == 1 or 1.0 / np.sum(f.particles.weight**2) >= self.options.effective_share * count:
            return False
        ancestors = self._ancestors(f.particles.weight, count)
        f.particles.deviation[:n] = f.particles.deviation[:n, ancestors]
        f.particles.weight[:] = 1.0 / count
        _recentre(f, n)
        return True

    def _prune(self, f: Filter, measured: Measured) -> Any:
        """Mark the VTs that are to be dropped; return the rules for what the joint filter does at a block's end."""
        rules, count = measured.rules, int(f.count[0])
        hits, unseen = f.vts.slots[:count, HITS], measured.now - f.vts.slots[:count, LAST]
        step_s = self._step_s
        lifetime = np.where(hits < 2, rules.lifetime.age_once, rules.lifetime.age_twice)
        vts = Transmitters(
            detections=hits.copy(), unseen_s=np.asarray(unseen * step_s, np.float64), lifetime_s=lifetime * step_s,
            confirmed=hits >= rules.lifetime.confirm,
        )  # fmt: skip
        f.vts.anchor[:count, WEIGHT][returned("pruning", self._called.pruning(vts), (count,), "b")] = DROPPED
        forever = np.iinfo(np.int64).max
        return rules._replace(lifetime=rules.lifetime._replace(age_once=forever, age_twice=forever))

    # ---- groups and memory -------------------------------------------------------------------------------------------

    def _begin_groups(self, mixture: Mixture, measured: Measured) -> None:
        """Begin with a group for each component of a wide start pose that may be, by the map and the first snapshot."""
        self._start_is_wide, remembered = False, mixture.remembered
        assert remembered is not None
        step, std = self.options.component_step, np.asarray(self._setup.start_std)[PLANE]
        offsets, log_prior, widths = components_of_pose(std, self._widths, step)
        poses = np.repeat(mixture.arrays.x[:1, :POSE], len(offsets), axis=0)
        poses[:, PLANE] += offsets
        clock_m = mixture.arrays.x[0, self._core.offsets]
        log_weight = log_prior + log_likelihood(
            poses, widths, clock_m, self._setup.range_scale_std, remembered, measured
        )
        likely = np.argsort(-log_weight)[: self.options.hypotheses]
        likely = likely[log_weight[likely] >= log_weight[likely[0]] + math.log(self.options.prune_ratio)]
        mixture.split(np.zeros(len(likely) - 1, np.int64))
        # What the snapshot says is weighed as it is used; here it has only chosen the groups.
        mixture.influence.rest += log_prior[likely]
        mixture.log_weight += log_prior[likely]
        a = mixture.arrays
        for k, one in enumerate(likely.tolist()):
            a.x[k, :POSE] = poses[one]
            a.p[k, PLANE, PLANE] = widths**2

    def _share_particles(self, mixture: Mixture) -> None:
        """Give each group its share of the particles, if the number of groups has changed."""
        count = 1 if self._drawn_blocks == 0 else max(self.options.particles // len(mixture), FEWEST)
        if mixture.arrays.particles.weight.shape[1] != count:
            mixture.share_particles(count, lambda weight: self._ancestors(weight, count))

    def _ancestors(self, weight: Floats, count: int) -> Ints:
        found = self._called.resampling(weight, count, self._rng)
        return returned("resampling", found, (count,), "i", least=0, below=len(weight))

    def _workspace_for(self, f: Filter, measured: Measured) -> Workspace:
        """Return memory to work in that is large enough for a group and a snapshot."""
        w, most = self._workspace, len(measured.z)
        if (
            w is None or len(w.pending.added) != len(f.x) or w.pairs.score.shape[0] != len(f.vts.slots)
            or w.pairs.score.shape[1] < most or w.pending.whitened.shape[1] != len(f.particles.weight)
        ):  # fmt: skip
            w = self._workspace = workspace_for(f, 2 * most + 8, 3 * len(f.vts.slots) + SPARE_ROWS)
        return w


def _recentre(f: Filter, n: int) -> None:
    """Let x be the weighted mean of the particles again."""
    shift = f.particles.deviation[:n] @ f.particles.weight
    f.x[:n] += shift
    f.particles.deviation[:n] -= shift[:, None]
