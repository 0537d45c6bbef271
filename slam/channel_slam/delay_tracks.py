"""Tracks of delays: which measurement continues which path, by its distance alone.

In the place of the path tracker KEST that Channel-SLAM builds on: a constant-rate filter on each path of a link,
nearest neighbour within a gate. Sources: Jost, Wang, Fiebig and Perez-Fontan, "Detection and tracking of mobile
propagation channel paths", IEEE Trans. Antennas and Propagation 60(10), 2012 (KEST); Bar-Shalom, Li and Kirubarajan,
"Estimation with applications to tracking and navigation", 2001, section 6.2 (constant rate).
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from cellslam.sim.recording import Floats, Ints
from cellslam.slam.api import Snapshot

DISTANCE_GAIN, RATE_GAIN = 0.3, 0.01  # of an alpha-beta filter
FASTEST_MPS = 40.0


@dataclass
class Tracks:
    """Tracks (n,): link, distance (m), its rate (m/s), time of the last detection (s), detections, identity."""

    link: Ints
    distance_m: Floats
    rate_mps: Floats
    seen_s: Floats
    hits: Ints
    id: Ints

    @staticmethod
    def none() -> Tracks:
        """Return no tracks."""
        whole = np.zeros(0, np.int64)
        return Tracks(whole, np.zeros(0), np.zeros(0), np.zeros(0), whole, whole)

    def __len__(self) -> int:
        return len(self.link)

    def follow(self, snapshot: Snapshot, time_s: float, dt_s: float, gate_m: float, gap_s: float, born: int) -> Ints:
        """Predict, assign a snapshot's measurements, start and end tracks; return the track's identity (m,), -1 none.

        time_s, dt_s, gap_s in s, gate_m in m; `born`: identity of a track that begins with measurement 0.
        """
        self.distance_m = self.distance_m + self.rate_mps * dt_s
        answer = np.full(len(snapshot), -1, np.int64)
        known = np.flatnonzero(~np.isnan(snapshot.distance_m))
        gaps = np.abs(snapshot.distance_m[known, None] - self.distance_m)
        gaps[snapshot.link[known, None] != self.link] = np.inf
        free_m, free_t = np.ones(len(known), bool), np.ones(len(self), bool)
        for place in np.argsort(gaps, axis=None, kind="stable") if len(self) else ():
            i, j = divmod(int(place), len(self))
            if gaps[i, j] > gate_m:
                break
            if free_m[i] and free_t[j]:
                free_m[i] = free_t[j] = False
                self._detect(j, float(snapshot.distance_m[known[i]]), time_s, max(dt_s, 1e-3))
                answer[known[i]] = self.id[j]
        fresh = known[free_m]
        answer[fresh] = born + fresh
        self._keep(np.flatnonzero(time_s - self.seen_s <= gap_s))
        self._begin(snapshot, fresh, time_s, born)
        return answer

    def _detect(self, j: int, distance_m: float, time_s: float, dt_s: float) -> None:
        error = distance_m - self.distance_m[j]
        self.distance_m[j] += DISTANCE_GAIN * error
        rate = self.rate_mps[j] + RATE_GAIN * error / dt_s
        self.rate_mps[j] = np.clip(rate, -FASTEST_MPS, FASTEST_MPS)
        self.seen_s[j] = time_s
        self.hits[j] += 1

    def _keep(self, kept: Ints) -> None:
        for name in ("link", "distance_m", "rate_mps", "seen_s", "hits", "id"):
            setattr(self, name, getattr(self, name)[kept])

    def _begin(self, snapshot: Snapshot, fresh: Ints, time_s: float, born: int) -> None:
        self.link = np.concatenate([self.link, snapshot.link[fresh]])
        self.distance_m = np.concatenate([self.distance_m, snapshot.distance_m[fresh]])
        self.rate_mps = np.concatenate([self.rate_mps, np.zeros(len(fresh))])
        self.seen_s = np.concatenate([self.seen_s, np.full(len(fresh), time_s)])
        self.hits = np.concatenate([self.hits, np.ones(len(fresh), np.int64)])
        self.id = np.concatenate([self.id, born + fresh])
