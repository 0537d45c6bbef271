"""The array's calibration as an estimator found it: a field of direction, with its uncertainty, and its file.

The field is a sum of bells on a grid over the sphere (`field_kernel`), fixed in the array's frame. Weights that a
drive met have a joint mean and covariance; the others are independent, of mean zero and the deviation of the prior.

Source: Higdon, "Space and space-time modeling using process convolutions", 2002.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from functools import cached_property
from pathlib import Path
from typing import Any

import numpy as np

from cellslam.sim.described import Described
from cellslam.sim.errors import InputError
from cellslam.sim.recording import Floats, Ints
from cellslam.slam.model.field_kernel import Grid, grid, loads
from cellslam.slam.model.hdf5_file import Kind, check_shapes, read, write

COMPONENTS = ("distance", "azimuth", "elevation")
_FILE = Kind(
    "calibration",
    {
        "grid": "rad, 1, 1", "size": "m, rad, rad", "component": "1", "cell": "1", "mean": "m or rad",
        "covariance": "m^2, m rad or rad^2",
    },
    "cellslam run --save-calibration FILE",
)  # fmt: skip


@dataclass(frozen=True, repr=False)
class Calibration(Described):
    """The field of calibration errors after a drive, in m for distance, in rad for azimuth and elevation.

    `size` (3,): prior deviation of the field in each component, 0 where it has none. `scale_rad` of the field,
    `spacing` and `reach` in scales: its grid. For each of W weights that were met: `component` (W,), `cell` (W,) of the
    grid, `mean` (W,) and joint `covariance` (W, W). `provenance`: what it is from, as JSON holds it.
    """

    size: Floats
    scale_rad: float
    spacing: float
    reach: float
    component: Ints
    cell: Ints
    mean: Floats
    covariance: Floats
    provenance: Mapping[str, Any] = field(default_factory=dict)

    @cached_property
    def grid(self) -> Grid:
        """The cells of the field."""
        return grid(self.scale_rad, self.spacing, self.reach)

    @property
    def components(self) -> tuple[str, ...]:
        """The components that the field has, by name."""
        return tuple(name for name, size in zip(COMPONENTS, self.size, strict=True) if size > 0.0)

    def at(self, directions: Floats) -> tuple[Floats, Floats]:
        """Return the field's mean and standard deviation (n, 3), m and rad, at directions (n, 2): azimuth and elevation
        in the body frame, rad."""
        of_cells, shape = loads(self.grid, directions), (len(directions), 3)
        mean, variance = np.zeros(shape), np.tile(self.size**2, (len(directions), 1))
        for c in range(3):
            met = self.component == c
            by = of_cells[:, self.cell[met]]
            mean[:, c] = by @ self.mean[met]
            gained = self.covariance[np.ix_(met, met)] - self.size[c] ** 2 * np.eye(int(met.sum()))
            variance[:, c] += np.einsum("nw,wv,nv->n", by, gained, by)
        return mean, np.sqrt(np.maximum(variance, 0.0))

    def met(self, directions: Floats) -> Floats:
        """Return what share (n,) of the prior variance at directions (n, 2), rad, is that of weights that were met."""
        cells = np.unique(self.cell)
        return np.asarray((loads(self.grid, directions)[:, cells] ** 2).sum(axis=1))

    def check(self) -> None:
        """Raise InputError unless the parts fit each other and hold finite numbers and a covariance."""
        count = len(self.mean)
        shapes = {"size": (3,), "component": (count,), "cell": (count,), "mean": (count,), "covariance": (count, count)}
        check_shapes(self, shapes)
        shape3 = np.array([self.scale_rad, self.spacing, self.reach])
        if not ((shape3 > 0.0).all() and 0.01 <= self.scale_rad <= np.pi and self.spacing >= 0.5 and self.reach <= 3.0):
            raise InputError(f"grid {shape3.tolist()}: scale (rad), spacing and reach must be those of a grid")
        if (self.size < 0.0).any() or not np.isin(self.component, np.flatnonzero(self.size > 0.0)).all():
            raise InputError(f"size {self.size.tolist()} and the components of the weights do not fit")
        pairs = self.component * self.grid.cells + self.cell
        if ((self.cell < 0) | (self.cell >= self.grid.cells)).any() or len(np.unique(pairs)) < count:
            raise InputError(f"cells must be among {self.grid.cells}, each once a component")
        if (np.abs(self.covariance - self.covariance.T) > 1e-9 * np.abs(self.covariance).max(initial=0.0)).any():
            raise InputError("covariance is none: it is not symmetric")
        if count and np.linalg.eigvalsh(self.covariance)[0] < -1e-9 * np.abs(self.covariance).max():
            raise InputError("covariance is none: it has a negative eigenvalue")

    def save(self, path: str | Path) -> None:
        """Write the HDF5 file. Raises InputError."""
        arrays = {name: getattr(self, name) for name in ("size", "component", "cell", "mean", "covariance")}
        write(path, _FILE, arrays | {"grid": [self.scale_rad, self.spacing, self.reach]}, self.provenance)

    @staticmethod
    def load(path: str | Path) -> Calibration:
        """Read a file. Raises InputError where it is none, or not whole."""
        of, about = read(path, _FILE)
        try:
            scale, spacing, reach = of["grid"].tolist()
            component, cell = (of[name].astype(np.int64) for name in ("component", "cell"))
            found = Calibration(
                of["size"], scale, spacing, reach, component, cell, of["mean"], of["covariance"], about
            )  # fmt: skip
            found.check()
        except (ValueError, TypeError) as error:
            raise InputError(f"{path}: not a calibration: {error}") from error
        return found
