"""Several joint filters that differ in their associations: branching on rivals, pruning.

Source: Reid, "An algorithm for tracking multiple targets", IEEE Trans. Automatic Control 24, 1979. In each snapshot a
filter whose best association has a close rival goes on as two; filters that have agreed for a while are one again.
"""

from __future__ import annotations

from dataclasses import dataclass, field

import numpy as np

from cellslam.sim.recording import Floats, Ints
from cellslam.slam.ekf_slam.ekf_slam_options import EkfSlamOptions
from cellslam.slam.ekf_slam.filter_bank import Bank
from cellslam.slam.ekf_slam.state_layout import Measured


@dataclass
class History:
    """When each pair of hypotheses last differed in an association (K, K), s."""

    differed_s: Floats = field(default_factory=lambda: np.zeros((1, 1)))

    def take(self, kept: Ints) -> None:
        """Keep some hypotheses, in that order; one may be named twice."""
        self.differed_s = self.differed_s[np.ix_(kept, kept)]


def branch(bank: Bank, measured: Measured, history: History) -> tuple[Bank, Ints]:
    """Return the filters with a copy for each one that has a rival, and the pair that each copy must do without."""
    rivals = bank.rivals(measured)
    split = np.flatnonzero(rivals[:, 1] >= 0.0)
    forbidden = np.full((len(bank) + len(split), 2), -1, np.int64)
    if len(split):
        forbidden[len(bank) :] = rivals[split, 1:].astype(np.int64)
        order = np.concatenate([np.arange(len(bank)), split])
        bank = bank.take(order)
        history.take(order)
    return bank, forbidden


def prune(bank: Bank, association: Ints, time_s: float, options: EkfSlamOptions, history: History) -> tuple[Bank, Ints]:
    """Return the hypotheses to follow, and their associations (K, M); updates when they last differed."""
    differ = (association[:, None, :] != association[None, :, :]).any(axis=2)
    history.differed_s = np.where(differ, time_s, history.differed_s)
    weight = bank.log_weight - bank.log_weight.max()
    kept: list[int] = []
    for i in np.argsort(-weight, kind="stable").tolist():
        agreed = any(time_s - history.differed_s[i, k] > options.scan_s for k in kept)
        if weight[i] >= np.log(options.hypothesis_ratio) and not agreed and len(kept) < options.hypotheses:
            kept.append(i)
    bank.log_weight -= bank.log_weight.max()
    if kept == list(range(len(bank))):
        return bank, association
    chosen = np.array(kept, np.int64)
    history.take(chosen)
    return bank.take(chosen), association[chosen]
