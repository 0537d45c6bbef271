"""The columns of a recording: each with shape, unit, kind of value and what its values must fulfil.

`contract` checks a recording by this table, `hdf5` writes and reads its file by it.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np

from cellslam.sim.errors import InputError
from cellslam.sim.plausible import RANGES, Range

FORMAT = "cellslam recording"
SCHEMA_VERSION = 2
COMPONENTS = ("u_x", "u_y", "u_z", "u_psi", "u_theta", "u_phi")
NOUNS = {"float": "numbers", "int": "integers", "text": "text"}
_POSE = ("x", "y", "z", "psi", "theta", "phi")
_POSE_UNIT = "m, m, m, rad, rad, rad"
_RATE_UNIT = "m/s, m/s, m/s, rad/s, rad/s, rad/s"
_XYZ = ("x", "y", "z")
_BLOCKED = ("vt", "vehicle", "first_snapshot", "last_snapshot")
_MEASURED, _MEASURED_UNIT = ("distance", "azimuth", "elevation"), "m, rad, rad"


@dataclass(frozen=True)
class Column:
    """One dataset: its path in the file (with dots: in Recording), shape in symbols, unit, kind of value.

    Symbols: T snapshots, L links, S sites, M measurements, V virtual transmitters, I visible intervals, R fixes,
    N other vehicles, K times of their poses, B times that they block, C steps of clocks.
    `optional`: may be left out; `absent`: may be left out if its table's attribute `absent` says so.
    `rule`: what each value must fulfil, one of `contract.RULES`; `index`: of what, in symbols, each value is the
    number; `none`: or -1. `of`: what is measured, of `plausible.RANGES`: one for all values of a row, or each of
    several for an equal part of it.
    """

    path: str
    shape: tuple[str | int, ...]
    unit: str = "1"
    kind: str = "float"
    labels: tuple[str, ...] = ()
    optional: bool = False
    absent: bool = False
    rule: str = ""
    index: tuple[str, ...] = ()
    none: bool = False
    of: tuple[str, ...] = ()

    @property
    def table(self) -> str:
        """Path of the group that holds the column; empty for the root."""
        return self.path.rpartition("/")[0]

    def parts(self, values: Any) -> Iterator[tuple[Range, Any]]:
        """Yield the range that is plausible for each part of the values (N, ...), and that part."""
        width = values.shape[-1] // len(self.of) if len(self.of) > 1 else 0
        for k, quantity in enumerate(self.of):
            yield RANGES[quantity], values[..., k * width : (k + 1) * width] if width else values

    @property
    def name(self) -> str:
        """Its name in a Recording."""
        return self.path.replace("/", ".")

    @property
    def described(self) -> str:
        """What a file should hold here, for error messages."""
        shape = ", ".join(str(size) for size in self.shape)
        return f"{NOUNS[self.kind]} of shape ({shape}) with unit '{self.unit}'"


COLUMNS = (
    Column("time_s", ("T",), "s", rule="finite", of=("time",)),
    Column("odometry", ("T", 6), _RATE_UNIT, labels=COMPONENTS, rule="measured", of=("speed", "turn rate")),
    Column(
        "odometry_model/noise_density",
        (6,),
        "m/s*sqrt(s), rad/s*sqrt(s)",
        labels=COMPONENTS,
        rule="deviation",
        of=("speed", "turn rate"),
    ),
    Column("odometry_model/bias", (6,), _RATE_UNIT, labels=COMPONENTS, rule="deviation", of=("speed", "turn rate")),
    Column(
        "odometry_model/bias_walk_density",
        (6,),
        "m/s/sqrt(s), rad/s/sqrt(s)",
        labels=COMPONENTS,
        rule="deviation",
        of=("speed", "turn rate"),
    ),
    Column("odometry_model/scale", (6,), labels=COMPONENTS, rule="deviation", of=("share",)),
    Column("links/site", ("L",), kind="int", index=("S",)),
    Column("links/cell_id", ("L",), kind="int", absent=True),
    Column("links/port", ("L",), kind="int", absent=True),
    Column("links/azimuth_rad", ("L",), "rad", optional=True, rule="measured", of=("angle",)),
    Column("sites/name", ("S",), kind="text"),
    Column("sites/clock_offset_mean_m", ("S",), "m", rule="finite", of=("distance",)),
    Column("sites/clock_offset_std_m", ("S",), "m", rule="deviation", of=("distance",)),
    Column("sites/clock_drift_std_m_s", ("S",), "m/s", optional=True, rule="deviation", of=("clock rate",)),
    Column("sites/clock_walk_m_sqrt_s", ("S",), "m/sqrt(s)", optional=True, rule="deviation", of=("clock rate",)),
    Column(
        "sites/clock_drift_walk_m_s_sqrt_s", ("S",), "m/s/sqrt(s)", optional=True, rule="deviation", of=("clock rate",)
    ),
    Column("sites/clock_step_std_m", ("S",), "m", optional=True, rule="deviation", of=("distance",)),
    Column("sites/position_m", ("S", 3), "m", labels=_XYZ, optional=True, rule="measured", of=("position",)),
    Column("sites/position_std_m", ("S", 3), "m", labels=_XYZ, optional=True, rule="deviation", of=("distance",)),
    Column("measurements/snapshot", ("M",), kind="int", index=("T",)),
    Column("measurements/link", ("M",), kind="int", index=("L",)),
    Column("measurements/distance_m", ("M",), "m", absent=True, rule="measured", of=("distance",)),
    Column("measurements/azimuth_rad", ("M",), "rad", absent=True, rule="measured"),
    Column("measurements/elevation_rad", ("M",), "rad", absent=True, rule="measured"),
    Column("measurements/snr_db", ("M",), "dB", absent=True, rule="measured", of=("SNR",)),
    Column("measurements/distance_std_m", ("M",), "m", optional=True, rule="claim", of=("distance",)),
    Column("measurements/azimuth_std_rad", ("M",), "rad", optional=True, rule="claim", of=("angle",)),
    Column("measurements/elevation_std_rad", ("M",), "rad", optional=True, rule="claim", of=("angle",)),
    Column("start_pose", (6,), _POSE_UNIT, labels=_POSE, rule="finite", of=("position", "angle")),
    Column("start_std", (6,), _POSE_UNIT, labels=_POSE, rule="prior", of=("position", "angle")),
    Column("plane", (), kind="int", optional=True),
    Column("provenance", (), "JSON", kind="text"),
    Column("truth/poses", ("T", 6), _POSE_UNIT, labels=_POSE, rule="finite", of=("position", "angle")),
    Column("truth/measurement_vt", ("M",), kind="int", index=("V",), none=True),
    Column("truth/measurement_std", ("M", 3), _MEASURED_UNIT, labels=_MEASURED, of=("distance", "angle", "angle")),
    Column(
        "truth/persisting_std",
        ("M", 3),
        _MEASURED_UNIT,
        labels=_MEASURED,
        optional=True,
        of=("distance", "angle", "angle"),
    ),
    Column(
        "truth/merging_shift",
        ("M", 3),
        _MEASURED_UNIT,
        labels=_MEASURED,
        optional=True,
        of=("distance", "angle", "angle"),
    ),
    Column("truth/vts/position_m", ("V", 3), "m", labels=_XYZ, rule="finite", of=("position",)),
    Column("truth/vts/site", ("V",), kind="int"),
    Column("truth/vts/order", ("V",), kind="int"),
    Column("truth/vts/facets", ("V", 2), kind="int", labels=("first", "second")),
    Column("truth/vts/visible", ("I", 3), kind="int", labels=("vt", "first_snapshot", "last_snapshot")),
    Column("truth/site_positions_m", ("S", 3), "m", labels=_XYZ, rule="finite", of=("position",)),
    Column("truth/clock_offsets_m", ("S",), "m", rule="finite", of=("distance",)),
    Column("truth/clock_drift_m_s", ("S",), "m/s", optional=True, rule="finite", of=("clock rate",)),
    Column("truth/clock_wander_m", ("T", "S"), "m", optional=True, rule="finite", of=("distance",)),
    Column("truth/clock_steps/site", ("C",), kind="int", index=("S",)),
    Column("truth/clock_steps/time_s", ("C",), "s", rule="finite", of=("time",)),
    Column("truth/clock_steps/size_m", ("C",), "m", rule="finite", of=("distance",)),
    Column("truth/odometry_bias", ("T", 6), _RATE_UNIT, labels=COMPONENTS, rule="finite", of=("speed", "turn rate")),
    Column("truth/odometry_scale", (6,), labels=COMPONENTS, rule="finite", of=("share",)),
    Column("truth/odometry_slip", ("T",), optional=True, rule="finite", of=("share",)),
    Column("truth/age_s", ("T",), "s", optional=True, rule="finite", of=("time",)),
    Column("truth/vehicles/kind", ("N",), kind="text"),
    Column("truth/vehicles/size_m", ("N", 3), "m", labels=("length", "width", "height"), rule="size", of=("distance",)),
    Column("truth/vehicles/time_s", ("K",), "s", rule="finite", of=("time",)),
    Column(
        "truth/vehicles/poses",
        ("K", "N", 4),
        "m, m, m, rad",
        labels=("x", "y", "ground", "yaw"),
        rule="finite",
        of=("position", "position", "position", "angle"),
    ),
    Column("truth/vehicles/blocked", ("B", 4), kind="int", labels=_BLOCKED, index=("V", "N", "T", "T")),
    Column("truth/vehicles/reflected", ("M",), kind="int", index=("N",), none=True),
    Column("reference/time_s", ("R",), "s", rule="finite", of=("time",)),
    Column("reference/position_m", ("R", 3), "m", labels=_XYZ, rule="measured", of=("position",)),
    Column("reference/yaw_rad", ("R",), "rad", rule="measured", of=("angle",)),
    Column("reference/position_std_m", ("R",), "m", rule="uncertainty", of=("distance",)),
    Column(
        "reference/odometry",
        ("R", 6),
        _RATE_UNIT,
        labels=COMPONENTS,
        optional=True,
        rule="measured",
        of=("speed", "turn rate"),
    ),
)


def check_shapes(values: Mapping[str, Any]) -> dict[str, int]:
    """Return the size that each symbol of the columns' shapes stands for. Raises InputError where one has two sizes."""
    sizes: dict[str, int] = {}
    sources: dict[str, str] = {}  # of each symbol the column that set it
    for column in COLUMNS:
        if column.path not in values:
            continue
        shape = np.shape(values[column.path])
        if len(shape) != len(column.shape):
            raise InputError(f"column '{column.path}' has shape {shape}; write {column.described}")
        for size, wanted in zip(shape, column.shape, strict=True):
            if isinstance(wanted, str):
                expected = sizes.setdefault(wanted, size)
                why = f" rows like '{sources.setdefault(wanted, column.path)}'"
            else:
                expected, why = wanted, f"; write {column.described}"
            if size != expected:
                raise InputError(f"column '{column.path}' has shape {shape}, expected {expected}{why}")
    return sizes
