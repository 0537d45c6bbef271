"""A map of VTs that one drive leaves to the next: where they are, how sure that is, where they were seen; its file.

The joint covariance is sparse: what is uncertain of each VT alone, and R errors that they have in common, as of the
clocks, the array and the path of the drive that found them. With v_j the position of VT j and independent u ~ N(0, I):

    v_j = position_j + common_j u + own_j,   own_j ~ N(0, own_m2_j)

so that any part of the map has its exact marginal at once, and a map of thousands of VTs stays small.

Source: Anderson, "An introduction to multivariate statistical analysis", 2003, chapter 14 (factor analysis).
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any

import numpy as np

from cellslam.sim.described import Described
from cellslam.sim.errors import InputError
from cellslam.sim.plausible import RANGES
from cellslam.sim.recording import Floats, Ints
from cellslam.slam.model.hdf5_file import Kind, check_shapes, read, write

_FILE = Kind(
    "map",
    {
        "site": "1", "cell_id": "1", "port": "1", "position_m": "m", "anchor_m": "m", "own_m2": "m^2", "common_m": "m",
        "seen_m": "m", "hits": "1", "missed": "1",
    },
    "cellslam run --save-map FILE",
)  # fmt: skip
MOST_COMMON = 64  # common errors that a map keeps


@dataclass(frozen=True, repr=False)
class VtMap(Described):
    """VTs, V of them, in the world frame, that of the start poses.

    The link that each was seen on: name of its `site` (V,), `cell_id` (V,), `port` (V,). `position_m` (V, 3);
    `anchor_m` (V, 3): where the vehicle was when it was first detected; `own_m2` (V, 3, 3) and `common_m` (V, 3, R):
    the covariance, as above; `seen_m` (V, 2, 2): least and greatest x and y of the vehicle's places that it was seen
    from; `hits` (V,): detections; `missed` (V,): drives past it, since it was last detected, that did not detect it.
    `provenance`: what it is from, as JSON holds it.
    """

    site: Any
    cell_id: Ints
    port: Ints
    position_m: Floats
    anchor_m: Floats
    own_m2: Floats
    common_m: Floats
    seen_m: Floats
    hits: Ints
    missed: Ints
    provenance: Mapping[str, Any] = field(default_factory=dict)

    def __len__(self) -> int:
        return len(self.position_m)

    @property
    def covariance_m2(self) -> Floats:
        """The covariance (V, 3, 3) of each position, m^2."""
        return np.asarray(self.own_m2 + self.common_m @ np.swapaxes(self.common_m, 1, 2))

    @property
    def joint_covariance_m2(self) -> Floats:
        """The covariance (3 V, 3 V) of all positions, m^2."""
        count = len(self)
        common = self.common_m.reshape(3 * count, -1)
        joint = common @ common.T
        for j, own in enumerate(self.own_m2):
            joint[3 * j : 3 * j + 3, 3 * j : 3 * j + 3] += own
        return np.asarray(joint)

    def part(self, which: Any) -> VtMap:
        """Return the map of some VTs alone."""
        return replace(self, **{name: getattr(self, name)[which] for name in _FILE.units})

    def compressed(self, most: int = MOST_COMMON) -> VtMap:
        """Return the map with `most` common errors at most."""
        own, common = factored(self.common_m, self.own_m2, most)
        return replace(self, own_m2=own, common_m=common)

    def widened(self, by: float) -> VtMap:
        """Return the map with all covariances multiplied by a number."""
        return replace(self, own_m2=by * self.own_m2, common_m=np.sqrt(by) * self.common_m)

    def check(self) -> None:
        """Raise InputError unless the parts fit each other and hold finite numbers and a covariance."""
        count = len(self.position_m)
        common = self.common_m.shape[-1] if self.common_m.ndim == 3 else 0
        check_shapes(self, {
            "site": (count,), "cell_id": (count,), "port": (count,), "position_m": (count, 3), "anchor_m": (count, 3),
            "own_m2": (count, 3, 3), "common_m": (count, 3, common), "seen_m": (count, 2, 2), "hits": (count,),
            "missed": (count,),
        })  # fmt: skip
        if (np.linalg.norm(self.position_m - self.anchor_m, axis=1) == 0.0).any():
            raise InputError("a VT's position equals its anchor: the anchor is a position from which the VT was seen")
        for name in ("position_m", "anchor_m"):
            for value in getattr(self, name).ravel():
                RANGES["position"].check(float(value), name)
        if (self.hits < 0).any() or (self.missed < 0).any():
            raise InputError("hits and missed count measurements: write whole numbers from 0 on")
        least = np.linalg.eigvalsh(self.own_m2)[:, 0] if count else np.zeros(0)
        scale = np.abs(self.own_m2).max(axis=(1, 2), initial=0.0)
        skew = np.abs(self.own_m2 - np.swapaxes(self.own_m2, 1, 2)).max(axis=(1, 2), initial=0.0)
        if (skew > 1e-9 * scale).any():
            raise InputError(f"own_m2 is no covariance: that of VT {int(np.argmax(skew))} is not symmetric")
        if (least < -1e-9 * scale).any():
            raise InputError(f"own_m2 is no covariance: that of VT {int(np.argmin(least))} has a negative eigenvalue")

    def save(self, path: str | Path) -> None:
        """Write the HDF5 file. Raises InputError."""
        write(path, _FILE, {name: getattr(self, name) for name in _FILE.units}, self.provenance)

    @staticmethod
    def load(path: str | Path) -> VtMap:
        """Read a file. Raises InputError where it is none, or not whole."""
        of, about = read(path, _FILE)
        whole = {name: of[name].astype(np.int64) for name in ("cell_id", "port", "hits", "missed")}
        columns: dict[str, Any] = {**of, **whole}
        found = VtMap(**columns, provenance=about)
        try:
            found.check()
        except InputError as error:
            raise InputError(f"{path}: not a map: {error}") from error
        return found


def joined(parts: Sequence[VtMap]) -> VtMap:
    """Return one map of the VTs of all parts, whose common errors are the same ones."""
    columns: dict[str, Any] = {name: np.concatenate([getattr(part, name) for part in parts]) for name in _FILE.units}
    return VtMap(**columns)


def factored(joint: Floats, own: Floats, most: int = MOST_COMMON) -> tuple[Floats, Floats]:
    """Return own covariances (V, 3, 3), m^2, and common errors (V, 3, R), m, R <= `most`, of V positions.

    Given: common errors `joint` (V, 3, K), of any number, and own covariances (V, 3, 3). Kept as common is what
    correlates most, each position in its own deviations; the rest keeps its variance as its own. All is exact where
    there is no rest.
    """
    root = np.linalg.cholesky(own + joint @ np.swapaxes(joint, 1, 2))
    in_deviations = np.linalg.solve(root, joint).reshape(3 * len(joint), joint.shape[2])
    left, size, _ = np.linalg.svd(in_deviations, full_matrices=False)
    modes = root @ (left * size).reshape(len(joint), 3, len(size))
    rest = modes[:, :, most:]
    return own + rest @ np.swapaxes(rest, 1, 2), np.ascontiguousarray(modes[:, :, :most])
