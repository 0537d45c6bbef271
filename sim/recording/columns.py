"""The columns of a recording: each with shape, unit, kind of value and what its values must fulfil.

`contract` checks a recording by this table, `hdf5` writes and reads its file by it.
"""

from __future__ import annotations

import re
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
_PLACE = (*_XYZ, "ground")  # labels of metres that are coordinates
_QUANTITIES = {
    "s": "time", "m": "distance", "rad": "angle", "m/s": "speed", "rad/s": "turn rate", "dB": "SNR", "1": "share",
}  # fmt: skip
_ROOT = re.compile(r"[*/]sqrt\(s\)$")  # of densities, which are compared as what they are of
_BLOCKED = ("vt", "vehicle", "first_snapshot", "last_snapshot")
_MEASURED, _MEASURED_UNIT = ("distance", "azimuth", "elevation"), "m, rad, rad"


@dataclass(frozen=True)
class Column:
    """One dataset: its path in the file (with dots: in Recording), shape in symbols, unit, kind of value.

    Symbols: T snapshots, L links, S sites, M measurements, V virtual transmitters, I visible intervals, R fixes,
    N other vehicles, K times of their poses, B times that they block, C steps of clocks.
    `optional`: may be left out; `absent`: may be left out if its table's attribute `absent` says so.
    `rule`: what each value must fulfil, one of `contract.RULES`; `index`: of what, in symbols, each value is the
    number; `none`: or -1. `of`: what is measured, of `plausible.RANGES`, where unit and labels do not
    tell.
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
    of: str = ""

    @property
    def table(self) -> str:
        """Path of the group that holds the column; empty for the root."""
        return self.path.rpartition("/")[0]

    def parts(self, values: Any) -> Iterator[tuple[Range, Any]]:
        """Yield the range that is plausible for each part of the values (N, ...), and that part.

        A row has as many parts, equally wide, as the unit has.
        """
        units = self.unit.split(", ") if self.kind == "float" else []
        width = values.shape[-1] // len(units) if len(units) > 1 else 0
        for k, unit in enumerate(units):
            part = slice(k * width, (k + 1) * width) if width else slice(None)
            is_place = unit == "m" and bool(set(_PLACE) & set(self.labels[part]))
            quantity = self.of or ("position" if is_place else _QUANTITIES[_ROOT.sub("", unit)])
            yield RANGES[quantity], values[..., part] if width else values

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
    Column("time_s", ("T",), "s", rule="finite"),
    Column("odometry", ("T", 6), _RATE_UNIT, labels=COMPONENTS, rule="measured"),
    Column("odometry_model/noise_density", (6,), "m/s*sqrt(s), rad/s*sqrt(s)", labels=COMPONENTS, rule="deviation"),
    Column("odometry_model/bias", (6,), _RATE_UNIT, labels=COMPONENTS, rule="deviation"),
    Column("odometry_model/bias_walk_density", (6,), "m/s/sqrt(s), rad/s/sqrt(s)", labels=COMPONENTS, rule="deviation"),
    Column("odometry_model/scale", (6,), labels=COMPONENTS, rule="deviation"),
    Column("odometry_model/time_constant_s", (), "s", optional=True, rule="deviation"),
    Column("links/site", ("L",), kind="int", index=("S",)),
    Column("links/cell_id", ("L",), kind="int", absent=True),
    Column("links/port", ("L",), kind="int", absent=True),
    Column("links/azimuth_rad", ("L",), "rad", optional=True, rule="measured"),
    Column("sites/name", ("S",), kind="text"),
    Column("sites/clock_offset_mean_m", ("S",), "m", rule="finite"),
    Column("sites/clock_offset_std_m", ("S",), "m", rule="deviation"),
    Column("sites/clock_drift_std_m_s", ("S",), "m/s", optional=True, rule="deviation", of="clock rate"),
    Column("sites/clock_walk_m_sqrt_s", ("S",), "m/sqrt(s)", optional=True, rule="deviation", of="clock rate"),
    Column(
        "sites/clock_drift_walk_m_s_sqrt_s", ("S",), "m/s/sqrt(s)", optional=True, rule="deviation", of="clock rate"
    ),
    Column("sites/clock_step_std_m", ("S",), "m", optional=True, rule="deviation"),
    Column("sites/position_m", ("S", 3), "m", labels=_XYZ, optional=True, rule="measured"),
    Column("sites/position_std_m", ("S", 3), "m", labels=_XYZ, optional=True, rule="deviation"),
    Column("measurements/snapshot", ("M",), kind="int", index=("T",)),
    Column("measurements/link", ("M",), kind="int", index=("L",)),
    Column("measurements/distance_m", ("M",), "m", absent=True, rule="measured"),
    Column("measurements/azimuth_rad", ("M",), "rad", absent=True, rule="measured"),
    Column("measurements/elevation_rad", ("M",), "rad", absent=True, rule="measured"),
    Column("measurements/snr_db", ("M",), "dB", absent=True, rule="measured"),
    Column("measurements/distance_std_m", ("M",), "m", optional=True, rule="claim"),
    Column("measurements/azimuth_std_rad", ("M",), "rad", optional=True, rule="claim"),
    Column("measurements/elevation_std_rad", ("M",), "rad", optional=True, rule="claim"),
    Column("start_pose", (6,), _POSE_UNIT, labels=_POSE, rule="finite"),
    Column("start_std", (6,), _POSE_UNIT, labels=_POSE, rule="prior"),
    Column("plane", (), kind="int", optional=True),
    Column("range_scale_std", (), optional=True, rule="deviation"),
    Column("scatterers", (), kind="int", optional=True),
    Column("provenance", (), "JSON", kind="text"),
    Column("truth/poses", ("T", 6), _POSE_UNIT, labels=_POSE, rule="finite"),
    Column("truth/measurement_vt", ("M",), kind="int", index=("V",), none=True),
    Column("truth/measurement_std", ("M", 3), _MEASURED_UNIT, labels=_MEASURED, absent=True),
    Column("truth/persisting_std", ("M", 3), _MEASURED_UNIT, labels=_MEASURED, optional=True),
    Column("truth/merging_shift", ("M", 3), _MEASURED_UNIT, labels=_MEASURED, optional=True),
    Column("truth/vts/position_m", ("V", 3), "m", labels=_XYZ, rule="finite"),
    Column("truth/vts/site", ("V",), kind="int"),
    Column("truth/vts/order", ("V",), kind="int"),
    Column("truth/vts/facets", ("V", 2), kind="int", labels=("first", "second")),
    Column("truth/vts/scatterer", ("V",), kind="int", optional=True),
    Column("truth/vts/visible", ("I", 3), kind="int", labels=("vt", "first_snapshot", "last_snapshot")),
    Column("truth/site_positions_m", ("S", 3), "m", labels=_XYZ, rule="finite"),
    Column("truth/clock_offsets_m", ("S",), "m", rule="finite"),
    Column("truth/clock_drift_m_s", ("S",), "m/s", optional=True, rule="finite", of="clock rate"),
    Column("truth/clock_wander_m", ("T", "S"), "m", optional=True, rule="finite"),
    Column("truth/clock_steps/site", ("C",), kind="int", index=("S",)),
    Column("truth/clock_steps/time_s", ("C",), "s", rule="finite"),
    Column("truth/clock_steps/size_m", ("C",), "m", rule="finite"),
    Column("truth/odometry_bias", ("T", 6), _RATE_UNIT, labels=COMPONENTS, rule="finite"),
    Column("truth/odometry_scale", (6,), labels=COMPONENTS, rule="finite"),
    Column("truth/odometry_slip", ("T",), optional=True, rule="finite"),
    Column("truth/age_s", ("T",), "s", optional=True, rule="finite"),
    Column("truth/vehicles/kind", ("N",), kind="text"),
    Column("truth/vehicles/size_m", ("N", 3), "m", labels=("length", "width", "height"), rule="size"),
    Column("truth/vehicles/time_s", ("K",), "s", rule="finite"),
    Column("truth/vehicles/poses", ("K", "N", 4), "m, m, m, rad", labels=("x", "y", "ground", "yaw"), rule="finite"),
    Column("truth/vehicles/blocked", ("B", 4), kind="int", labels=_BLOCKED, index=("V", "N", "T", "T")),
    Column("truth/vehicles/reflected", ("M",), kind="int", index=("N",), none=True),
    Column("reference/time_s", ("R",), "s", rule="finite"),
    Column("reference/position_m", ("R", 3), "m", labels=_XYZ, rule="measured"),
    Column("reference/yaw_rad", ("R",), "rad", rule="measured"),
    Column("reference/position_std_m", ("R",), "m", rule="uncertainty"),
    Column("reference/odometry", ("R", 6), _RATE_UNIT, labels=COMPONENTS, optional=True, rule="measured"),
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
