"""The start: clock offsets are too wide for one linearisation, so each site has a bank of narrow components.

A Gaussian sum over the offset of one site at a time, not over all at once: the sites share nothing but the pose, which
odometry knows well at the start, so S banks of K filters do in place of K^S filters.

Source: Sorenson and Alspach, "Recursive Bayesian estimation using Gaussian sums", Automatica 7, 1971.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from cellslam.sim.recording import Floats, Ints
from cellslam.slam.api import Setup
from cellslam.slam.ekf_slam.ekf_slam_options import EkfSlamOptions
from cellslam.slam.ekf_slam.filter_bank import Bank, new_bank
from cellslam.slam.ekf_slam.start.fusion import Gaussian, join
from cellslam.slam.ekf_slam.start.fusion_kernel import fuse, likely
from cellslam.slam.ekf_slam.state_layout import KNOWN_MAP, SLOT, Core, Measured

REACH = 3.0  # the components cover this many deviations of the prior


def components(std_m: float, component_std_m: float, step: float) -> tuple[Floats, Floats, float]:
    """Return means (K,), log-weights (K,) and deviation of the components of a prior N(0, std_m^2)."""
    if std_m <= component_std_m:
        return np.zeros(1), np.zeros(1), std_m
    spread = float(np.sqrt(std_m**2 - component_std_m**2))
    half = int(np.ceil(REACH * spread / (step * component_std_m)))
    means = step * component_std_m * np.arange(-half, half + 1)
    logs = -0.5 * (means / spread) ** 2
    return np.asarray(means), np.asarray(logs - np.log(np.exp(logs).sum())), component_std_m


@dataclass
class Start:
    """One bank a site, and the odometry's own belief (a filter without links).

    Until a site's first distance its bank is one filter with the whole prior of its offset: directions do not tell.
    """

    odometry: Bank
    banks: list[Bank]
    ranged: list[bool]

    def move(self, setup: Setup, dt_s: float, velocity: Floats) -> None:
        """Advance everything by an interval: dt_s in s, mean body velocities (6,) in m/s and rad/s."""
        for bank in (self.odometry, *self.banks):
            bank.move(setup, dt_s, velocity)

    def use(self, setup: Setup, measured: Measured, options: EkfSlamOptions) -> Ints:
        """Use a snapshot in every bank, drop what has become unlikely, and return the best components' association
        (m,)."""
        answer = np.full(len(measured.z), -1, np.int64)
        for s in range(len(self.banks)):
            mine = setup.links.site[_link_of(measured)] == s
            if not self.ranged[s] and np.isfinite(measured.z[mine, 0]).any():
                self.banks[s], self.ranged[s] = split(self.banks[s], setup, s, options), True
            bank = self.banks[s]
            association = bank.use(measured)
            best = association[int(np.argmax(bank.log_weight))]
            answer[mine] = best[mine]
            least = float(np.log(options.prune_ratio))
            kept = likely(bank.log_weight, bank.x, bank.p, bank.core.first_offset + s, least)
            if len(kept) < len(bank):
                self.banks[s] = bank.take(kept)
        return answer

    def offsets(self) -> tuple[Floats, Floats]:
        """Return mean (S,) in m and variance (S,) in m^2 of the clock offsets."""
        found = [bank.moments(bank.core.first_offset + s, 1) for s, bank in enumerate(self.banks)]
        return np.array([mean[0] for mean, _ in found]), np.array([cov[0, 0] for _, cov in found])

    def shared(self) -> Gaussian:
        """Return the fused belief on pose and odometry errors."""
        return self._fused([bank.moments(0, self.odometry.core.first_offset) for bank in self.banks])

    def _fused(self, sites: list[Gaussian]) -> Gaussian:
        n, means, covs = self.odometry.core.first_offset, *zip(*sites, strict=True)
        fused: Gaussian = fuse(self.odometry.x[0, :n], self.odometry.p[0, :n, :n], np.array(means), np.array(covs))
        return fused

    def joint(self, setup: Setup, mode: int, vts: int) -> Bank:
        """Return the one joint filter, of `vts` places, that goes on from the best component of each site."""
        core, n = self.odometry.core, self.odometry.core.first_offset
        best = [int(np.argmax(bank.log_weight)) for bank in self.banks]
        states = [_states(bank, s, i) for s, (bank, i) in enumerate(zip(self.banks, best, strict=True))]
        own = [(bank.x[i, :n], bank.p[i, :n, :n]) for bank, i in zip(self.banks, best, strict=True)]
        gaussians = [
            (bank.x[i, rows], bank.p[i][np.ix_(rows, rows)])
            for bank, i, rows in zip(self.banks, best, states, strict=True)
        ]
        mean, cov = join(self._fused(own), gaussians)
        counts = [_vts(bank, i) for bank, i in zip(self.banks, best, strict=True)]
        places = max(vts, sum(counts))
        zero = np.zeros((1, len(self.banks)))
        out = new_bank(setup, core, mode, places, zero, zero[0])
        rows = _order(n, counts, core)
        out.x[0, rows] = mean
        out.p[0][np.ix_(rows, rows)] = cov
        out.count[0] = sum(counts)
        out.anchor[0, : sum(counts)] = np.concatenate(
            [bank.anchor[i, :c] for bank, i, c in zip(self.banks, best, counts, strict=True)]
        )
        out.slots[0, : sum(counts)] = np.concatenate(
            [bank.slots[i, :c] for bank, i, c in zip(self.banks, best, counts, strict=True)]
        ).reshape(-1, SLOT)
        return out

    def likeliest(self) -> list[tuple[Bank, int]]:
        """Return each site's bank and its most likely component."""
        return [(bank, int(np.argmax(bank.log_weight))) for bank in self.banks]


def begin(setup: Setup, options: EkfSlamOptions, mode: int, vts: int) -> Start:
    """Return the banks at the start, with places for `vts` VTs."""
    core, sites = Core.of(setup), setup.sites
    banks = []
    mean = sites.clock_offset_mean_m[None, :]
    for s in range(len(sites)):
        bank = new_bank(setup, core, mode, vts, mean, np.where(np.arange(len(sites)) == s, sites.clock_offset_std_m, 0))
        bank.links[:] = setup.links.site == s
        banks.append(bank)
    nothing = new_bank(setup, core, mode, 1, mean, np.zeros(len(sites)))
    return Start(nothing, banks, [False] * len(sites))


def split(bank: Bank, setup: Setup, site: int, options: EkfSlamOptions) -> Bank:
    """Return a bank of one filter as one of narrow components of the site's offset, which nothing is correlated with
    yet."""
    std, state = float(setup.sites.clock_offset_std_m[site]), bank.core.first_offset + site
    means, logs, narrow = components(std, options.component_std_m, options.component_step)
    out = bank.take(np.zeros(len(means), np.int64))
    out.x[:, state] += means
    out.p[:, state, state] = narrow**2
    out.log_weight += logs
    return out


def _states(bank: Bank, site: int, index: int) -> Ints:
    """Return the states that a site's filter contributes: shared ones, its offset, its VTs."""
    core = bank.core
    vts = np.arange(core.size, core.size + 3 * _vts(bank, index))
    return np.concatenate([np.arange(core.first_offset), _clock(core, site), vts]).astype(np.int64)


def _clock(core: Core, site: int) -> Ints:
    """Return the states of a site's clock: its offset, and its rate where it drifts."""
    own = [core.first_offset + site, core.rate[site]]
    return np.array(own if core.rate[site] >= 0 else own[:1], np.int64)


def _vts(bank: Bank, index: int) -> int:
    """Return how many VTs a filter has in its state: none of a known map."""
    return 0 if bank.mode == KNOWN_MAP else int(bank.count[index])


def _order(shared: int, counts: list[int], core: Core) -> Ints:
    """Return where [c, clock_1, VTs_1, clock_2, VTs_2, ...] go in the joint state."""
    rows, vt = [np.arange(shared)], core.size
    for s, count in enumerate(counts):
        rows += [_clock(core, s), np.arange(vt, vt + 3 * count)]
        vt += 3 * count
    return np.concatenate(rows).astype(np.int64)


def _link_of(measured: Measured) -> Ints:
    return np.repeat(np.arange(len(measured.first) - 1), np.diff(measured.first))
