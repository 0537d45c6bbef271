"""What is in a recording, what is missing, what looks wrong; and a picture of it, a row of two panels a link."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import ArrayLike

from cellslam.benchmarks.scores.metrics import duration_s
from cellslam.benchmarks.scores.reference_fixes import outlying, unled, within
from cellslam.recordings.importing.campaign import DEVIATIONS, QUANTITIES
from cellslam.recordings.inspection.suspicions import suspicions
from cellslam.sim.frames import SPEED_OF_LIGHT_MPS
from cellslam.sim.recording import COMPONENTS, Ints, Recording, Sites

if TYPE_CHECKING:
    from matplotlib.figure import Figure

DOTS, LINKS = 6000, 16  # of the figure: dots a panel, and rows
GAP = 5.0  # an interval longer than so many median ones is a gap
NAMES = {"distance_m": "distance", "azimuth_rad": "azimuth", "elevation_rad": "elevation", "snr_db": "SNR"}


def inspected(recording: Recording) -> dict[str, Any]:
    """Return the summary as plain values, in the order in which it is printed."""
    r = recording
    return {
        "snapshots": _snapshots(r),
        "measurements": _measurements(r),
        "links": _links(r),
        "odometry": _odometry(r),
        "reference": _reference(r),
        "start": {"pose": _short(r.start_pose), "std": _short(r.start_std)},
        "plane": r.plane,
        "range_scale_std": float(r.range_scale_std),
        "missing": _missing(r),
        "suspicions": [{"kind": s.kind, "text": s.text} for s in suspicions(r)],
        "description": str(r.provenance.get("description") or r.provenance.get("campaign") or ""),
    }


def _snapshots(r: Recording) -> dict[str, Any]:
    step = np.diff(r.time_s).round(6)  # times since 1970 are known to 0.2 us
    out: dict[str, Any] = {"count": len(r.time_s), "duration_s": _number(duration_s(r))}
    if len(step):
        median = float(np.median(step))
        gaps = np.flatnonzero(step > GAP * median)
        out |= {"interval_s": _number(median), "shortest_s": _number(step.min()), "longest_s": _number(step.max())}
        out["gaps"] = [{"at_s": round(float(r.time_s[i]), 3), "lasts_s": _number(step[i])} for i in gaps[:20]]
        out["gap_count"] = len(gaps)
    return out | {"without_measurement": int((np.diff(r.rows) == 0).sum())}


def _measurements(r: Recording) -> dict[str, Any]:
    m = r.measurements
    out: dict[str, Any] = {"count": len(m), "per_snapshot": _number(len(m) / len(r.time_s))}
    for name in (*QUANTITIES, *DEVIATIONS):
        column = getattr(m, name)
        known = np.empty(0) if column is None else column[~np.isnan(column)]
        if len(known):
            out[name] = {
                "share": _number(len(known) / len(m)),
                **dict(zip(("least", "median", "most"), _short(np.quantile(known, (0, 0.5, 1))), strict=True)),
            }
    return out


def _links(r: Recording) -> list[dict[str, Any]]:
    m = r.measurements
    count = np.bincount(m.link, minlength=len(r.links))
    new = np.append(True, (np.diff(m.snapshot) != 0) | (np.diff(m.link) != 0))[: len(m)]
    seen = np.bincount(m.link[new], minlength=len(r.links))
    out = []
    for link in range(len(r.links)):
        site = int(r.links.site[link])
        about: dict[str, Any] = {"link": link, "site": r.sites.name[site]}
        for name in ("cell_id", "port"):
            if getattr(r.links, name)[link] >= 0:
                about[name] = int(getattr(r.links, name)[link])
        about |= {
            "clock_offset_std_m": float(r.sites.clock_offset_std_m[site]),
            "measurements": int(count[link]),
            "paths_per_snapshot": _number(count[link] / max(int(seen[link]), 1)),
            "snapshots_share": _number(seen[link] / len(r.time_s)),
        }
        out.append(about)
    return out


def _odometry(r: Recording) -> dict[str, Any]:
    out: dict[str, Any] = {}
    for i, name in enumerate(COMPONENTS):
        column = r.odometry[1:, i]
        known = column[~np.isnan(column)]
        if len(known):
            least, most = _short([known.min(), known.max()])
            out[name] = {"share": _number(len(known) / max(len(column), 1)), "least": least, "most": most}
    return out


def _reference(r: Recording) -> dict[str, Any] | None:
    if r.reference is None:
        return None
    f = r.reference
    step = np.diff(f.time_s).round(6)
    return {
        "count": len(f),
        "within_the_drive": int(within(r, f).sum()),
        "interval_s": _number(np.median(step)) if len(step) else None,
        "longest_gap_s": _number(step.max()) if len(step) else None,
        "yaw": bool(np.isfinite(f.yaw_rad).any()),
        "height": bool(np.isfinite(f.position_m[:, 2]).any()),
        "outlying_at_s": f.time_s[outlying(f) & within(r, f)].round(3).tolist(),
        "without_odometry": int(unled(r, f).sum()),
        "std_m": _number(np.nanmedian(f.position_std_m)) if np.isfinite(f.position_std_m).any() else None,
    }


def _surveyed(sites: Sites) -> str:
    count = int(np.isfinite(sites.surveyed_m).all(axis=1).sum())
    return f", {count} of them surveyed" if count else ""


def _missing(r: Recording) -> list[str]:
    m, out = r.measurements, []
    for name, word in NAMES.items():
        share = float(np.isnan(getattr(m, name)).mean()) if len(m) else 1.0
        if share == 1.0 and not (name == "elevation_rad" and r.plane):
            out.append(f"{word} (never measured)")
        elif 0.0 < share < 1.0:
            out.append(f"{word} in {100 * share:.1f} % of the rows")
    if all(getattr(m, name) is None for name in DEVIATIONS):
        out.append("deviations of the measurements")
    for i, name in enumerate(COMPONENTS):
        share = float(np.isnan(r.odometry[1:, i]).mean()) if len(r.time_s) > 1 else 0.0
        if share == 1.0:
            std = r.odometry_model.noise_density[i]
            how = "taken as zero" if std == 0 else f"taken as zero with noise density {std:.3g}"
            out.append(f"odometry {name} (never measured; {how})")
        elif share > 0.0:
            out.append(f"odometry {name} in {100 * share:.1f} % of the intervals")
    if r.truth is None:
        out.append("truth" if r.reference is None else "truth (there is a reference)")
        out += ["position, heading: no scores without truth or reference"] if r.reference is None else []
    return out


def as_text(path: Path, recording: Recording, found: Mapping[str, Any]) -> str:
    """Return the summary for people, lines of at most about 100 characters."""
    s, m = found["snapshots"], found["measurements"]
    every = f", every {s['interval_s']:g} s ({s['shortest_s']:g} to {s['longest_s']:g} s)" if "interval_s" in s else ""
    empty = f"{s['without_measurement']} without measurement"
    lines = [
        f"{path}: sound recording" + (f", {found['description']}" if found["description"] else ""),
        f"snapshots     {s['count']} in {s['duration_s']:g} s{every}; {empty}",
        *(f"  gap         {gap['lasts_s']:g} s at {gap['at_s']:.14g} s" for gap in s.get("gaps", [])[:5]),
        *([f"  gaps        {s['gap_count']} in all"] if s.get("gap_count", 0) > 5 else []),
        f"measurements  {m['count']}, {m['per_snapshot']:.4g} a snapshot"
        + (", in one plane" if found["plane"] else ""),
    ]
    for name in (*QUANTITIES, *DEVIATIONS):
        if name in m:
            q = m[name]
            share = "" if q["share"] == 1.0 else f" ({100 * q['share']:.1f} % of the rows)"
            lines.append(f"  {name:<18}{q['least']:>10} .. {q['median']:>10} .. {q['most']:>10}{share}")
    lines += [
        f"links         {len(found['links'])} of {len(recording.sites)} sites" + _surveyed(recording.sites),
        *map(_link_line, found["links"][:24]),
    ]
    for name, u in found["odometry"].items():
        lines.append(f"odometry      {name:<8} {u['least']} .. {u['most']}, {100 * u['share']:.1f} % of the intervals")
    lines += _reference_lines(found["reference"]) if found["reference"] is not None else []
    if recording.truth is not None:
        lines.append(f"truth         poses, {len(recording.truth.vts)} VTs, associations (simulated)")
    lines += [f"missing       {what}" for what in found["missing"]]
    lines += [f"SUSPICIOUS    {what['text']}" for what in found["suspicions"]] or ["suspicious    nothing"]
    for name, warnings in found.get("estimators", {}).items():
        lines += [f"SUSPICIOUS    {line}" for line in warnings] or [f"{name:<14}nothing speaks against its estimate"]
    return "\n".join(lines) + "\n"


def _link_line(link: Mapping[str, Any]) -> str:
    cell = "".join(f", {n} {link[n]}" for n in ("cell_id", "port") if n in link)
    std = link["clock_offset_std_m"]
    return (
        f"  link {link['link']:<3} site {link['site']}{cell}: {link['measurements']} measurements, "
        f"{link['paths_per_snapshot']:.3g} paths in {100 * link['snapshots_share']:.1f} % of the snapshots, "
        f"clock {f'+-{std:.4g} m' if std else 'known'}"
    )


def _reference_lines(f: Mapping[str, Any]) -> list[str]:
    std = f"+-{f['std_m']} m" if f["std_m"] is not None else "deviation not stated, taken as exact"
    lines = [
        f"reference     {f['count']} fixes, {f['within_the_drive']} within the drive, every {f['interval_s']} s, "
        f"{'with yaw' if f['yaw'] else 'no yaw'}, {std}"
    ]
    if at := f["outlying_at_s"]:
        times = ", ".join([*(f"{t:.14g}" for t in at[:5]), *(["..."] if len(at) > 5 else [])])
        lines.append(f"  outliers    {len(at)} far off their neighbours, at {times} s: left out of scores and figures")
    if count := f["without_odometry"]:
        lines.append(f"  pauses      {count} fixes where the odometry pauses: left out of scores and figures")
    return lines


def plot(recording: Recording) -> Figure:
    """Return a figure of what was measured: delay and azimuth of all paths over time, a row of panels for each link.

    Of more than 16 links it has the first 16, of more than 6000 dots a link some of them.
    """
    from matplotlib.figure import Figure

    from cellslam.benchmarks.figures.style import BLUE, WIDTH_IN, context

    r = recording
    links = max(min(len(r.links), LINKS), 1)
    with context():
        figure = Figure(figsize=(WIDTH_IN, 0.6 + 1.05 * links), dpi=110)
        panels = figure.subplots(links, 2, squeeze=False, sharex=True)
        for link in range(links):
            rows = _some(np.flatnonzero(r.measurements.link == link))
            left, right = panels[link]
            time = (r.time_s - r.time_s[0])[r.measurements.snapshot[rows]]
            delay = r.measurements.distance_m[rows] / SPEED_OF_LIGHT_MPS * 1e6
            for axes, values in ((left, delay), (right, np.degrees(r.measurements.azimuth_rad[rows]))):
                axes.plot(time, values, ".", color=BLUE, markersize=1.2, rasterized=True)
                if not np.isfinite(values).any():
                    axes.text(0.5, 0.5, "not measured", transform=axes.transAxes, ha="center", va="center")
            right.set_ylim(-185, 185)
            right.set_yticks([-180, -90, 0, 90, 180])
            left.set_ylabel(f"{_name(r, link)}\ndelay (µs)", fontsize=7)
            right.set_ylabel("azimuth (deg)", fontsize=7)
        for axes in panels[-1]:
            axes.set_xlabel("time (s)")
            axes.set_xlim(0, max(float(r.time_s[-1] - r.time_s[0]), 1e-3))
        figure.subplots_adjust(
            left=0.11, right=0.985, top=0.99, bottom=0.42 / (0.6 + 1.05 * links), wspace=0.3, hspace=0.18
        )
    return figure


def _some(rows: Ints) -> Ints:
    return rows if len(rows) <= DOTS else rows[np.linspace(0, len(rows) - 1, DOTS).astype(np.int64)]


def _name(r: Recording, link: int) -> str:
    site = str(r.sites.name[r.links.site[link]])
    cell, port = int(r.links.cell_id[link]), int(r.links.port[link])
    return site + (f" {cell}" if cell >= 0 else "") + (f"/{port}" if port >= 0 else "")


def _short(values: ArrayLike) -> list[float]:
    return [_number(value) for value in np.ravel(np.asarray(values, np.float64))]


def _number(value: Any) -> float:
    return float(f"{float(value):.6g}")
