"""How far each path may change the weights of the filters of a mixture.

A path over an edge, or one whose azimuth errs because it merges with another, is the image of no wall. It fits one
wrong clock offset at each of a hundred measurements. As a product their likelihoods would rule out the right offset,
though all of them are wrong together. So its log-likelihood has bounds, over its whole life: its measurements are at
least as likely as clutter, and at least so likely as in the best filter, but for a factor of exp(-MOST).

A transmitter that was surveyed is where it is: in a filter with a wrong clock offset its line of sight begins another
VT, which explains the path as well from then on. What that VT explains does not count, and the line of sight has a
wider bound, exp(-MOST_SURVEYED).

Source: bounded influence (Hampel et al., Robust Statistics, 1986); the likelihood is that of three explanations of a
path, of which the likeliest is taken: the image of a wall, clutter, and something that is neither.
"""

from __future__ import annotations

from dataclasses import dataclass, field

import numpy as np

from cellslam.sim.recording import Floats, Ints
from cellslam.slam.joint.state.layout import IDENT, LOG_RATIO, SURVEYED, Filter

MOST = 6.0  # log-likelihood that a filter may lose by one path, against the best filter of the mixture
MOST_SURVEYED = 20.0  # by the line of sight of a transmitter whose place is known
BIRTH = 3.0  # log-likelihood that each VT costs: it counts for more than clutter beyond that alone


@dataclass
class Influence:
    """The evidence of paths for the K filters of a mixture: `log_ratio` (K, v) of the likelihood of each VT's
    measurements to that of clutter, by its identity (v,) and that of the first VT of its path (v,); and all else that
    is in the log-weights: `rest` (K,)."""

    rest: Floats
    ident: Ints = field(default_factory=lambda: np.empty(0, np.int64))
    path: Ints = field(default_factory=lambda: np.empty(0, np.int64))
    log_ratio: Floats = field(init=False)

    def __post_init__(self) -> None:
        self.log_ratio = np.empty((len(self.rest), 0))

    def meet(self, mixture: Filter, association: Ints, born: int, log_weight: Floats) -> None:
        """Take in the VTs that began in a snapshot.

        association (K, m): identities at its measurements, -1 for none; a VT that began at measurement i has the
        identity `born` + i. Where that measurement is, in other filters, of a VT that they have, both are of one path,
        as the likeliest of these has it. log_weight (K,).
        """
        new = np.unique(self._identities(mixture))
        new = new[new >= born]
        if not len(new):
            return
        surveyed = np.setdiff1d(self._surveyed(mixture), self.ident)
        self._add(surveyed, surveyed)
        path = new.copy()
        for n, measurements in enumerate(association[:, new - born].T):
            have = np.flatnonzero(np.isin(measurements, self.ident))
            if len(have):
                path[n] = self.path[np.searchsorted(self.ident, measurements[have[np.argmax(log_weight[have])]])]
        self._add(new, path)

    def weigh(self, mixture: Filter) -> Floats:
        """Take in the log-ratios of the VTs at the end of a block, and return the log-weights (K,).

        A filter that has lost a VT keeps what it had by it.
        """
        ident = self._identities(mixture)
        there, column = np.unique(ident[ident >= 0], return_inverse=True)
        new = np.setdiff1d(there, self.ident)
        if len(new):  # of a map
            self._add(new, new)
        at, (row, slot) = np.searchsorted(self.ident, there), np.nonzero(ident >= 0)
        self.log_ratio[row, at[column]] = 0.0
        # A VT may have several hypotheses.
        np.add.at(self.log_ratio, (row, at[column]), mixture.vts.anchor[row, slot, LOG_RATIO])
        left = np.isin(self.path, self.path[at])
        surveyed = self._surveyed(mixture)
        beside = np.isin(self.path, surveyed) & ~np.isin(self.ident, surveyed)
        counted = np.where(beside, 0.0, self.log_ratio)
        self.rest = self.rest + bounded(counted[:, ~left], self.path[~left], surveyed)
        self.ident, self.path, self.log_ratio = self.ident[left], self.path[left], self.log_ratio[:, left]
        return np.asarray(self.rest + bounded(counted[:, left], self.path, surveyed))

    def _surveyed(self, mixture: Filter) -> Ints:
        """Return the identities of surveyed transmitters."""
        ident = self._identities(mixture)
        return np.unique(ident[mixture.vts.slots[: len(ident), : ident.shape[1], SURVEYED] * (ident >= 0) == 1])

    def _identities(self, mixture: Filter) -> Ints:
        """Return the identities (K, V) of the VTs of all filters, -1 where there is none."""
        count = mixture.count[: len(self.rest)]
        most = int(count.max())
        return np.where(np.arange(most) < count, mixture.vts.slots[: len(count), :most, IDENT], -1)

    def _add(self, ident: Ints, path: Ints) -> None:
        """Add VTs (n,) on some paths (n,)."""
        order = np.argsort(np.concatenate([self.ident, ident]))
        self.ident = np.concatenate([self.ident, ident])[order]
        self.path = np.concatenate([self.path, path])[order]
        self.log_ratio = np.pad(self.log_ratio, ((0, 0), (0, len(ident))))[:, order]

    def of(self, filters: Ints) -> Influence:
        """Return the evidence for some filters (k,), in their order."""
        some = Influence(self.rest[filters], self.ident, self.path)
        some.log_ratio = self.log_ratio[filters]
        return some


def bounded(log_ratio: Floats, path: Ints, surveyed: Ints) -> Floats:
    """Return the bounded log-likelihoods (K,) of filters, by the log-ratios (K, v) of VTs and their paths (v,).

    `surveyed`: the paths of surveyed transmitters.
    """
    paths, column = np.unique(path, return_inverse=True)
    above = np.zeros((len(paths), len(log_ratio)))
    np.add.at(above, column, np.maximum(log_ratio - BIRTH, 0.0).T)
    most = np.where(np.isin(paths, surveyed), MOST_SURVEYED, MOST)[:, None]
    return np.asarray(np.maximum(above - above.max(axis=1, keepdims=True), -most).sum(axis=0))
