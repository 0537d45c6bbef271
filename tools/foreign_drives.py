"""Drives of worlds that no model of cellslam's front end made: NumPy alone, by the public way of `Campaign`.

A world is drawn from its seed: area and duration; paths by the line of sight, mirrors, and point scatterers p, whose
path from transmitter q to receiver r has length |p - q| + |p - r| and comes from p; transmitters surveyed or not,
observed all at once or polled one at a time, with clocks or without; ranges with a common scale, noise and outliers;
angles of 0.3 to 5 degrees or none; odometry that is measured, slips, lags, or is commanded, by a data sheet that is a
guess.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from cellslam.recordings import Campaign, OdometryTable, ReferenceTable
from cellslam.sim.frames import wrap_angle

Floats = NDArray[np.float64]
Ints = NDArray[np.int64]
STEP_S = 0.02
MOST_SNAPSHOTS = 3000
SEEN_AT_ONCE = 8.0  # reflections that a snapshot has on average, at most
ODOMETRY = ("measured", "slips", "lags", "commanded")
NO_SCATTERER, HEIGHT_M = -1, 1.5


@dataclass(frozen=True)
class Traits:
    """What a world is like; lengths in m, angles in rad, times in s. `azimuth_std`: 0 where angles are not measured;
    `share`: of scatterers among reflections; `clock_std`: 0 where all clocks are known; `anonymous`: nothing tells
    which transmitter a path is from.
    """

    plane: bool
    area: float
    duration: float
    rate_hz: float
    sites: int
    features: int
    share: float
    known: bool
    polled: bool
    anonymous: bool
    clock_std: float
    range_std: float
    range_scale: float
    outliers: float
    azimuth_std: float
    detected: float
    clutter: float
    odometry: str

    def __str__(self) -> str:
        angle = f"{np.degrees(self.azimuth_std):.1f} deg" if self.azimuth_std else "no angle"
        sites = f"{self.sites} {'anonymous' if self.anonymous else 'known' if self.known else 'unknown'}"
        ways = f"{'2D' if self.plane else '3D'} {'polled' if self.polled else 'at once'}"
        clocks = "clocks" if self.clock_std else "no clock"
        return (
            f"{self.duration:.0f} s {self.rate_hz:.1f} Hz {self.area:.0f} m, {ways}, {sites}, {self.features} features "
            f"{100 * self.share:.0f} % scatter, {self.range_std:.2f} m {100 * self.range_scale:+.1f} %, {angle}, "
            f"{clocks}, odometry {self.odometry}"
        )


@dataclass(frozen=True)
class Features:
    """Features (F,): `place` (F, 3) of a virtual transmitter or a scatterer, its `site` (F,), whether it `scatters`
    (F,). The first one of each site is the line of sight.
    """

    place: Floats
    site: Ints
    scatters: NDArray[np.bool_]


@dataclass(frozen=True)
class World:
    """A drive with its truth: poses (T, 3) at the snapshots (T,), the snapshot (M,) and feature (M,) of each row of the
    campaign, -1 for clutter, what was drawn of clocks (S,), and where the features are.
    """

    traits: Traits
    campaign: Campaign
    time_s: Floats
    poses: Floats
    snapshot: Ints
    feature: Ints
    features: Features
    clocks_m: Floats


def world(seed: int) -> World:
    """Return the world of a seed."""
    rng = np.random.default_rng((seed, 1964))
    t = traits(rng)
    route = drive(t, rng)
    features = scene(t, route, rng)
    clocks_m = t.clock_std * rng.standard_normal(t.sites)
    every = round(1.0 / (t.rate_hz * STEP_S))
    rows = np.arange(every, len(route) - every, every)
    snapshot, feature, z = measured(t, route[rows], features, clocks_m, rng)
    columns = {"distance_m": z[:, 0]}
    if t.azimuth_std:
        columns["azimuth_rad"] = z[:, 1]
        if not t.plane:
            columns["elevation_rad"] = z[:, 2]
    site = np.where(feature >= 0, features.site[feature], rng.integers(0, t.sites, len(feature)))
    if t.polled:
        site = snapshot % t.sites
    names = [f"site {i}" for i in range(t.sites)]
    own = {} if t.anonymous else {
        "link": site, "link_sites": names, "site_offsets": dict.fromkeys(names, (0.0, t.clock_std)),
        "site_surveys": dict(zip(names, features.place[: t.sites].tolist(), strict=True)) if t.known else {},
    }  # fmt: skip
    wheels, noise = odometry(t, route, rng)
    fixes = route[::25]
    position = fixes[:, :2] if t.plane else np.column_stack([fixes[:, :2], np.full(len(fixes), HEIGHT_M)])
    time_s = STEP_S * rows
    campaign = Campaign(
        time_s[snapshot], columns, wheels, **own, noise=noise, plane=t.plane, snapshots_s=time_s,
        reference=ReferenceTable(STEP_S * 25 * np.arange(len(fixes)), position, fixes[:, 2]),
        about={"campaign": "foreign world", "description": f"seed {seed}: {t}"},
    )  # fmt: skip
    return World(t, campaign, time_s, route[rows], snapshot, feature, features, clocks_m)


def traits(rng: np.random.Generator) -> Traits:
    """Draw what a world is like."""
    rate_hz = 1.0 / (STEP_S * round(float(10 ** rng.uniform(0.0, np.log10(50.0))) ** -1 / STEP_S))
    features, angles = round(float(10 ** rng.uniform(0.0, np.log10(200.0)))), rng.random() < 0.7
    sites = int(rng.integers(1, 7)) if angles else int(rng.integers(1, 9))
    sites = min(sites, features)
    known = rng.random() < 0.5
    return Traits(
        plane=rng.random() < 0.6,
        area=float(10 ** rng.uniform(1.0, 2.3)),
        duration=float(np.clip(MOST_SNAPSHOTS / rate_hz, 60.0, 300.0)),
        rate_hz=rate_hz,
        sites=sites,
        # Nobody tells many reflections of one transmitter from each other by ranges alone.
        features=features if angles else min(features, 3 * sites),
        share=float(rng.uniform(0.2, 0.8)),
        known=known,
        polled=sites > 1 and rng.random() < 0.5,
        anonymous=not known and angles and rng.random() < 0.3,
        clock_std=0.0 if rng.random() < 0.5 else 30.0,
        range_std=float(10 ** rng.uniform(-1.3, 0.3)),
        range_scale=float(0.03 * rng.standard_normal()) if rng.random() < 0.7 else 0.0,
        outliers=float(rng.uniform(0.0, 0.08)),
        azimuth_std=float(np.radians(10 ** rng.uniform(np.log10(0.3), np.log10(5.0)))) if angles else 0.0,
        detected=float(rng.uniform(0.6, 0.95)),
        clutter=float(rng.uniform(0.0, 1.0)),
        odometry=ODOMETRY[rng.integers(len(ODOMETRY))],
    )


def drive(t: Traits, rng: np.random.Generator) -> Floats:
    """Return poses (N, 3), x, y in m and heading in rad, each 20 ms, of a vehicle that goes round six places."""
    goals = 0.5 * t.area * rng.uniform(-1.0, 1.0, (6, 2))
    speed = float(np.clip(7.0 * t.area / t.duration, 0.3, 12.0))
    count, most = int(t.duration / STEP_S), speed / (0.08 * t.area)  # turns with a radius of 8 % of the area at least
    stop_s, phase = (rng.uniform(20.0, t.duration - 20.0) if rng.random() < 0.4 else -1e3), rng.uniform(0.0, 6.0)
    poses, (x, y), goal, turn = np.empty((count, 3)), goals[0], 1, 0.0
    heading = float(np.arctan2(*(goals[1] - goals[0])[::-1]))
    for i in range(count):
        poses[i] = x, y, heading
        away, now = goals[goal] - (x, y), i * STEP_S
        if np.hypot(*away) < 0.15 * t.area:
            goal = (goal + 1) % len(goals)
        wanted = most * np.clip(2.0 * float(wrap_angle(np.arctan2(away[1], away[0]) - heading)), -1.0, 1.0)
        turn += 0.05 * (wanted - turn)
        v = 0.0 if 0.0 < now - stop_s < 8.0 else speed * (1.0 + 0.3 * np.sin(0.25 * now + phase))
        rate = turn * v / speed
        middle = heading + 0.5 * rate * STEP_S
        x, y, heading = x + v * np.cos(middle) * STEP_S, y + v * np.sin(middle) * STEP_S, heading + rate * STEP_S
    return poses


def scene(t: Traits, route: Floats, rng: np.random.Generator) -> Features:
    """Draw the features: a line of sight for each site, then mirror images and scatterers."""

    def heights(count: int) -> Floats:
        return np.zeros(count) if t.plane else rng.uniform(0.02, 0.2, count) * t.area

    sites = np.column_stack([0.6 * t.area * rng.uniform(-1.0, 1.0, (t.sites, 2)), heights(t.sites)])
    rest = t.features - t.sites
    site, scatters = rng.integers(0, t.sites, rest), np.arange(rest) < round(t.share * rest)
    azimuth, away = rng.uniform(-np.pi, np.pi, rest), t.area * rng.uniform(0.4, 1.0, rest)
    normal = np.column_stack([np.cos(azimuth), np.sin(azimuth), np.zeros(rest)])
    behind = sites[site] + 2.0 * (away - (sites[site] * normal).sum(axis=1))[:, None] * normal
    points = np.column_stack([0.7 * t.area * rng.uniform(-1.0, 1.0, (rest, 2)), heights(rest)])
    for i in range(rest):  # no vehicle drives through a scatterer
        while np.hypot(*(route[::25, :2] - points[i, :2]).T).min() < 0.03 * t.area:
            points[i, :2] = 0.7 * t.area * rng.uniform(-1.0, 1.0, 2)
    place = np.where(scatters[:, None], points, behind)
    return Features(
        np.concatenate([sites, place]),
        np.append(np.arange(t.sites), site),
        np.append(np.zeros(t.sites, bool), scatters),
    )


def expected(poses: Floats, place: Floats, site: Floats, scatters: NDArray[np.bool_], height: float) -> Floats:
    """Return length (m), azimuth and elevation (rad) (n, 3) of the paths to poses (n, 3) by features at `place` (n, 3)
    from transmitters `site` (n, 3); `height` of the vehicle in m.
    """
    away = place - np.column_stack([poses[:, :2], np.full(len(poses), height)])
    flat = np.hypot(away[:, 0], away[:, 1])
    length = np.sqrt((away**2).sum(axis=1)) + np.where(scatters, np.sqrt(((place - site) ** 2).sum(axis=1)), 0.0)
    azimuth = wrap_angle(np.arctan2(away[:, 1], away[:, 0]) - poses[:, 2])
    return np.column_stack([length, azimuth, np.arctan2(away[:, 2], flat)])


def measured(
    t: Traits, poses: Floats, features: Features, clocks_m: Floats, rng: np.random.Generator
) -> tuple[Ints, Ints, Floats]:
    """Return snapshot (M,), feature (M,) and measurements (M, 3) of what the receiver reports, clutter among it."""
    count, number = len(poses), len(features.site)
    seen = visible(t, poses, number, rng) & (rng.random((count, number)) < t.detected)
    if t.polled:
        seen &= features.site == (np.arange(count) % t.sites)[:, None]
    snapshot, feature = np.nonzero(seen)
    height = 0.0 if t.plane else HEIGHT_M
    at = features.place[: t.sites][features.site[feature]]
    z = expected(poses[snapshot], features.place[feature], at, features.scatters[feature], height)
    z[:, 0] = (1.0 + t.range_scale) * z[:, 0] + clocks_m[features.site[feature]]
    z += np.array([t.range_std, t.azimuth_std, t.azimuth_std]) * rng.standard_normal(z.shape)
    wild = rng.random(len(z)) < t.outliers
    z[wild, 0] += rng.exponential(max(10.0 * t.range_std, 1.0), wild.sum())
    false = np.repeat(np.arange(count), rng.poisson(t.clutter * min(1.0, 0.1 * number), count))
    low, high = np.quantile(z[:, 0], (0.02, 0.98))
    anywhere = [rng.uniform(low, high, len(false)), rng.uniform(-np.pi, np.pi, len(false)),
                rng.choice(z[:, 2], len(false))]  # fmt: skip
    snapshot, feature = np.append(snapshot, false), np.append(feature, np.full(len(false), -1))
    z = np.concatenate([z, np.column_stack(anywhere)])
    z[:, 1] = wrap_angle(z[:, 1])
    return snapshot, feature, z


def visible(t: Traits, poses: Floats, number: int, rng: np.random.Generator) -> NDArray[np.bool_]:
    """Return which features (T, F) are seen: smooth functions of the place, alike whenever the vehicle comes by."""
    share = np.full(number, min(0.7, SEEN_AT_ONCE / max(number - t.sites, 1)))
    share[: t.sites] = 0.85
    wave = rng.normal(0.0, 8.0 / t.area, (4, 2, number))
    phase = rng.uniform(0.0, 2.0 * np.pi, (4, 1, number))
    field = np.cos(np.einsum("tc,kcf->ktf", poses[:, :2], wave) + phase).sum(axis=0) / np.sqrt(2.0)
    limit = np.sort(rng.standard_normal(4096))[(4095 * (1.0 - share)).astype(int)]
    return np.asarray(field > limit)


def odometry(t: Traits, route: Floats, rng: np.random.Generator) -> tuple[OdometryTable, dict[str, tuple[float, ...]]]:
    """Return the odometry as it is reported, and the guess of its data sheet."""
    v = np.append(np.hypot(*np.diff(route[:, :2], axis=0).T) / STEP_S, 0.0)
    w = np.append(np.diff(route[:, 2]) / STEP_S, 0.0)
    if t.odometry == "commanded":  # the vehicle follows as a filter of the first order
        after, every = rng.uniform(0.2, 0.5), 10
        v, w = v + after * np.gradient(v, STEP_S), w + after * np.gradient(w, STEP_S)
    else:
        every = int(rng.choice([1, 2, 5]))
    rows = np.arange(0, len(v) - every, every)
    v, w = (np.add.reduceat(u, rows) / np.diff(np.append(rows, len(u))) for u in (v, w))
    speed, turn = float(0.02 + 0.03 * v.mean()), float(10 ** rng.uniform(-2.5, -1.5))
    spread = 1.0 / np.sqrt(every * STEP_S)
    gain = 0.05 if t.odometry == "commanded" else 0.02
    v = v * (1.0 + gain * rng.standard_normal()) + (v > 0.0) * speed * spread * rng.standard_normal(len(v))
    w = w * (1.0 + gain * rng.standard_normal()) + 0.002 * rng.standard_normal()
    w += turn * spread * rng.standard_normal(len(w))
    times = STEP_S * rows
    if t.odometry == "slips":
        for begin in np.cumsum(rng.exponential(20.0, 60)):
            during = (times > begin) & (times < begin + rng.uniform(0.5, 2.0))
            v[during] *= rng.uniform(1.1, 1.6)
            w[during] *= rng.uniform(0.7, 1.3)
    if t.odometry == "lags":
        times = times + rng.uniform(0.05, 0.25)
    guess = 2.0 ** rng.uniform(-1.0, 1.0, 2)
    noise = {
        "noise_density": (guess[0] * speed, 0.0, 0.0, guess[1] * turn, 0.0, 0.0),
        "bias": (0.0, 0.0, 0.0, 0.002, 0.0, 0.0), "scale": (0.03, 0.0, 0.0, 0.02, 0.0, 0.0),
    }  # fmt: skip
    return OdometryTable(times, {"u_x": v, "u_psi": w}, "next", np.inf if t.odometry == "commanded" else None), noise
