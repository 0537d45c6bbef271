"""Right campaigns of several kinds, and what an import can get wrong with them."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from importlib.resources import files
from typing import Any

import numpy as np
from numpy.typing import NDArray

from cellslam.recordings import Campaign, OdometryTable, ReferenceTable
from cellslam.recordings.adapters.shared import simulated_odometry
from cellslam.sim.frames import SPEED_OF_LIGHT_MPS, wrap_angle
from cellslam.sim.recording import COMPONENTS, Recording

Floats = NDArray[np.float64]
STEP_S = 0.05


def way_through(places: Floats, speed_mps: float, turn_radps: float, duration_s: float) -> Floats:
    """Poses (N, 3) each 50 ms of a vehicle that steers from place to place (K, 2), round and round."""
    poses = np.empty((int(duration_s / STEP_S) + 1, 3))
    step = places[1] - places[0]
    x, y, heading, goal = *places[0], np.arctan2(step[1], step[0]), 1
    for i in range(len(poses)):
        poses[i] = x, y, heading
        away = places[goal] - (x, y)
        if np.hypot(*away) < 2.5 * speed_mps / turn_radps:
            goal = (goal + 1) % len(places)
        wanted = float(wrap_angle(np.arctan2(away[1], away[0]) - heading))
        turn = np.clip(0.8 * wanted, -turn_radps, turn_radps)
        speed = speed_mps * (1.0 - 0.4 * abs(turn) / turn_radps)
        middle = heading + 0.5 * turn * STEP_S
        x, y = x + speed * np.cos(middle) * STEP_S, y + speed * np.sin(middle) * STEP_S
        heading += turn * STEP_S
    return poses


def at_arm(poses: Floats, arm: tuple[float, float]) -> Floats:
    """Poses (N, 3) of a point `arm` ahead and to the left."""
    c, s = np.cos(poses[:, 2]), np.sin(poses[:, 2])
    return np.column_stack([poses[:, 0] + c * arm[0] - s * arm[1], poses[:, 1] + s * arm[0] + c * arm[1], poses[:, 2]])


def odometry(
    poses: Floats, every: int, noise: tuple[float, float, float, float], rng: np.random.Generator
) -> OdometryTable:
    """Mean speed and yaw rate since the row before; `noise`: speed and yaw density, yaw bias, scale of both."""
    p = poses[::every]
    dt = every * STEP_S
    ahead = np.hypot(*np.diff(p[:, :2], axis=0).T) / dt
    turn = np.diff(p[:, 2]) / dt
    draws = rng.standard_normal((2, len(ahead))) / np.sqrt(dt)
    u_x = ahead * (1.0 + noise[3]) + noise[0] * draws[0]
    u_psi = turn * (1.0 - noise[3]) + noise[2] + noise[1] * draws[1]
    times = STEP_S * every * np.arange(1, len(p))
    return OdometryTable(times, {"u_x": u_x, "u_psi": u_psi}, "before")


def paths(
    poses: Floats,
    rows: NDArray[np.int64],
    sources: Floats,
    std: tuple[float, float],
    reach_m: float,
    seen: float,
    clutter: float,
    rng: np.random.Generator,
    ahead_only: bool = False,
) -> tuple[Floats, Floats, Floats]:
    """Times, distances and azimuths of what is detected, clutter among it."""
    out = []
    for row in rows:
        x, y, heading = poses[row]
        d = np.hypot(sources[:, 0] - x, sources[:, 1] - y)
        a = wrap_angle(np.arctan2(sources[:, 1] - y, sources[:, 0] - x) - heading)
        keep = (d < reach_m) & (rng.random(len(d)) < seen) & ((np.abs(a) < 1.5) | (not ahead_only))
        false = rng.poisson(clutter)
        d = np.append(d[keep] + std[0] * rng.standard_normal(keep.sum()), rng.uniform(0.0, reach_m, false))
        a = np.append(a[keep] + std[1] * rng.standard_normal(keep.sum()), rng.uniform(-np.pi, np.pi, false))
        out.append(np.column_stack([np.full(len(d), row * STEP_S), d, wrap_angle(a)]))
    table = np.concatenate(out)
    return table[:, 0], table[:, 1], table[:, 2]


def campaign(
    vehicle: Floats,
    measured: tuple[Floats, Floats, Floats],
    wheels: OdometryTable,
    arm: tuple[float, float],
    fixes: tuple[int, float, bool],
    rng: np.random.Generator,
    **more: Any,
) -> Campaign:
    """A campaign in the plane; `fixes`: steps from fix to fix, their deviation in m, whether they have a yaw."""
    array = at_arm(vehicle, arm)
    every, std, with_yaw = fixes
    seen = array[::every]
    position = seen[:, :2] + std * rng.standard_normal((len(seen), 2))
    reference = ReferenceTable(STEP_S * every * np.arange(len(seen)), position, seen[:, 2] if with_yaw else None)
    time_s, distance, azimuth = measured
    given = {
        "time_s": time_s,
        "columns": {"distance_m": distance, "azimuth_rad": azimuth},
        "odometry": replace(wheels, lever_arm_m=(*arm, 0.0)),
        "reference": reference,
        "plane": True,
        "noise": {"noise_density": (0.1, 0.0, 0.0, 0.02, 0.0, 0.0)},
    }
    return Campaign(**(given | more))


def hall(seed: int, arm: tuple[float, float] = (0.0, 0.0)) -> Campaign:
    """A hall of 60 x 40 m, walked slowly: eight to ten VTs, 0.3 m and 3 degrees."""
    rng = np.random.default_rng(seed)
    places = np.column_stack([rng.uniform(5, 55, 9), rng.uniform(5, 35, 9)])
    vehicle = way_through(places, 0.6, 0.5, 160.0)
    sources = np.column_stack([rng.uniform(-30, 90, 9), rng.uniform(-30, 70, 9)])
    rows = np.arange(0, len(vehicle), 10)
    seen = paths(at_arm(vehicle, arm), rows, sources, (0.3, np.radians(3.0)), 120.0, 0.8, 0.5, rng)
    wheels = odometry(vehicle, 2, (0.05, 0.02, 0.003, 0.02), rng)
    return campaign(vehicle, seen, wheels, arm, (10, 0.02, True), rng)


def places(seed: int) -> Campaign:
    """The same hall as 60 places a second apart; odometry from place to place."""
    rng = np.random.default_rng(seed)
    corners = np.column_stack([rng.uniform(5, 55, 9), rng.uniform(5, 35, 9)])
    vehicle = way_through(corners, 1.5, 0.7, 60.0)
    sources = np.column_stack([rng.uniform(-30, 90, 10), rng.uniform(-30, 70, 10)])
    seen = paths(vehicle, np.arange(0, len(vehicle), 20), sources, (0.3, np.radians(3.0)), 120.0, 0.8, 0.5, rng)
    wheels = odometry(vehicle, 20, (0.05, 0.03, 0.0, 0.0), rng)
    return campaign(vehicle, seen, wheels, (0.0, 0.0), (20, 0.02, True), rng)


def few_places(seed: int) -> Campaign:
    """A corner of a hall as 45 places half a metre apart, there and back, without a turn."""
    rng = np.random.default_rng(seed)
    along = 0.5 * np.arange(15)
    x = np.concatenate([along, along[::-1], along])
    vehicle = np.column_stack([x, np.repeat([0.0, 0.5, 1.0], 15), np.zeros(45)])
    sources = np.column_stack([rng.uniform(-8, 16, 8), rng.uniform(-10, 12, 8)])
    out = []
    for i, (x_m, y_m, _) in enumerate(vehicle):
        away = sources - (x_m, y_m)
        noise = (0.2, 0.03) * rng.standard_normal((8, 2))
        out.append(np.column_stack([np.full(8, float(i)), np.hypot(*away.T) + noise[:, 0],
                                    np.arctan2(away[:, 1], away[:, 0]) + noise[:, 1]]))  # fmt: skip
    times = np.arange(45.0)
    wheels = simulated_odometry(times, vehicle[:, :2], vehicle[:, 2], (0.05, 0.05, 0.0, 0.02, 0.0, 0.0))
    measured = np.concatenate(out).T
    return Campaign(
        measured[0], {"distance_m": measured[1], "azimuth_rad": wrap_angle(measured[2])}, wheels, plane=True,
        reference=ReferenceTable(times, vehicle[:, :2], vehicle[:, 2]),
    )  # fmt: skip


def beacons(seed: int) -> Campaign:
    """Distances alone to four beacons that are polled in turn, odometry at 5 Hz."""
    rng = np.random.default_rng(seed)
    corners = rng.uniform(0.0, 60.0, (10, 2))
    vehicle = way_through(corners, 1.0, 0.4, 500.0)
    sites = np.array([[-5.0, 3.0], [62.0, -4.0], [66.0, 58.0], [2.0, 63.0]]) + rng.uniform(-8, 8, (4, 2))
    rows = np.arange(0, len(vehicle), 6)
    link = np.arange(len(rows)) % 4
    d = np.hypot(*(sites[link] - vehicle[rows, :2]).T) + 0.4 * rng.standard_normal(len(rows))
    wild = rng.random(len(d)) < 0.03
    d[wild] += rng.exponential(8.0, wild.sum())
    wheels = odometry(vehicle, 4, (0.05, 0.01, 0.002, 0.02), rng)
    more = {"columns": {"distance_m": d}, "link": link, "link_sites": ("a", "b", "c", "d")}
    return campaign(vehicle, (STEP_S * rows, d, d), wheels, (0.0, 0.0), (4, 0.05, False), rng, **more)


def commanded(odometry: OdometryTable, lag_s: float, slip: float, rng: np.random.Generator) -> OdometryTable:
    """Odometry that is commanded: the vehicle follows `lag_s` later, and slips by a share that changes every 10 s."""
    times = np.asarray(odometry.time_s)
    share = 1.0 + slip * rng.standard_normal((2, int(times[-1] / 10.0) + 1))[:, (times / 10.0).astype(int)]
    u = {name: np.asarray(u) * share[i] for i, (name, u) in enumerate(odometry.components.items())}
    return replace(odometry, time_s=times - lag_s, components=u)


def rover(seed: int) -> Campaign:
    """A small robot drives by commands for less than a minute, and ranges to four anchors."""
    rng = np.random.default_rng(seed)
    vehicle = way_through(rng.uniform(0.0, 8.0, (6, 2)), 0.4, 0.6, 50.0)
    sites = np.array([[-1.0, -1.0], [9.0, -1.0], [9.0, 9.0], [-1.0, 9.0]])
    rows = np.arange(20, len(vehicle) - 20, 2)
    link = np.arange(len(rows)) % 4
    d = 1.02 * np.hypot(*(sites[link] - vehicle[rows, :2]).T) + 0.1 + 0.1 * rng.standard_normal(len(rows))
    wheels = commanded(odometry(vehicle, 2, (0.03, 0.08, 0.02, 0.03), rng), 0.3, 0.08, rng)
    more = {"columns": {"distance_m": d}, "link": link, "link_sites": ("a", "b", "c", "d")}
    return campaign(vehicle, (STEP_S * rows, d, d), wheels, (0.0, 0.0), (2, 0.005, True), rng, **more)


def tubes(seed: int) -> Campaign:
    """A small robot drives by commands among fifteen tubes, and sees those before it: range and bearing."""
    rng = np.random.default_rng(seed)
    vehicle = way_through(np.column_stack([rng.uniform(1, 14, 12), rng.uniform(1, 7, 12)]), 0.15, 0.4, 300.0)
    sources = np.column_stack([rng.uniform(0, 15, 15), rng.uniform(0, 8, 15)])
    rows = np.arange(20, len(vehicle) - 20, 8)
    t, d, a = paths(vehicle, rows, sources, (0.08, np.radians(1.0)), 5.0, 0.3, 0.02, rng, True)
    wheels = commanded(odometry(vehicle, 2, (0.03, 0.05, 0.005, 0.03), rng), 0.3, 0.1, rng)
    return campaign(vehicle, (t, 1.02 * d, a), wheels, (0.0, 0.0), (2, 0.002, True), rng)


def trees(seed: int, arm: tuple[float, float] = (3.8, 0.5), noise: float = 1.0) -> Campaign:
    """A vehicle with a laser ahead among trees; GPS without yaw, with outages and some fixes far off."""
    rng = np.random.default_rng(seed)
    corners = rng.uniform(0.0, 200.0, (12, 2))
    vehicle = way_through(corners, 3.0, 0.35, 400.0)
    forest = rng.uniform(-20.0, 220.0, (500, 2))
    rows = np.arange(0, len(vehicle), 4)
    seen = paths(at_arm(vehicle, arm), rows, forest, (0.15, np.radians(1.0)), 35.0, 0.6, 1.0, rng, True)
    wheels = odometry(vehicle, 1, (0.05 * noise, 0.01 * noise, 0.003 * noise, 0.03 * noise), rng)
    made = campaign(vehicle, seen, wheels, arm, (20, 0.3, False), rng)
    assert made.reference is not None
    times, fixes = np.asarray(made.reference.time_s), np.array(made.reference.position_m)
    kept = (times < 150.0) | (times > 210.0)
    fixes[97] += 130.0
    return replace(made, reference=replace(made.reference, time_s=times[kept], position_m=fixes[kept]))


def of_recording(recording: Recording, seed: int, with_yaw: bool) -> Campaign:
    """A simulated drive as a campaign, fixes at about 2 Hz."""
    rng = np.random.default_rng(seed)
    r, m = recording, recording.measurements
    assert r.truth is not None
    every = max(round(0.5 / float(np.median(np.diff(r.time_s)))), 1)
    fixes = r.truth.poses[::every]
    names = ("distance_m", "azimuth_rad", "elevation_rad", "snr_db")
    return Campaign(
        r.time_s[m.snapshot],
        {name: getattr(m, name) for name in names},
        OdometryTable(r.time_s, dict(zip(COMPONENTS, r.odometry.T, strict=True)), "before"),
        link=m.link,
        link_sites=[r.sites.name[site] for site in r.links.site],
        site_offsets={n: (0.0, float(s)) for n, s in zip(r.sites.name, r.sites.clock_offset_std_m, strict=True)},
        snapshots_s=r.time_s,
        reference=ReferenceTable(
            r.time_s[::every],
            fixes[:, :3] + 0.05 * rng.standard_normal((len(fixes), 3)),
            fixes[:, 3] if with_yaw else None,
        ),
        range_scale_std=r.range_scale_std,
    )


def cellular(seed: int) -> Campaign:
    """Half a minute through a small city."""
    path = files("cellslam.slam.conformance").joinpath("conformance_drive.h5")
    return of_recording(Recording.load(str(path)), seed, seed % 2 == 0)


# ---- mistakes


def _columns(**changes: Callable[[Floats], Floats]) -> Callable[[Campaign], Campaign]:
    def change(c: Campaign) -> Campaign:
        new = {n: changes[n](np.asarray(v)) if n in changes else v for n, v in c.columns.items()}
        return replace(c, columns=new)

    return change


def _wheels(**factors: float) -> Callable[[Campaign], Campaign]:
    def change(c: Campaign) -> Campaign:
        assert c.odometry is not None
        new = {n: factors.get(n, 1.0) * np.asarray(v) for n, v in c.odometry.components.items()}
        return replace(c, odometry=replace(c.odometry, components=new))

    return change


def _fixes(
    change_of: Callable[[Floats], Floats], yaw: Callable[[Floats], Floats] = lambda y: y
) -> Callable[[Campaign], Campaign]:
    def change(c: Campaign) -> Campaign:
        assert c.reference is not None
        table = c.reference
        turned = None if table.yaw_rad is None else yaw(np.asarray(table.yaw_rad))
        return replace(c, reference=replace(table, position_m=change_of(np.asarray(table.position_m)), yaw_rad=turned))

    return change


def _late(table: str, seconds: float) -> Callable[[Campaign], Campaign]:
    def change(c: Campaign) -> Campaign:
        given = getattr(c, table)
        return replace(c, **{table: replace(given, time_s=np.asarray(given.time_s) + seconds)})

    return change


def _late_measurements(c: Campaign) -> Campaign:
    snapshots = None if c.snapshots_s is None else np.asarray(c.snapshots_s) + 1.0
    return replace(c, time_s=np.asarray(c.time_s) + 1.0, snapshots_s=snapshots)


def _no_arm(c: Campaign) -> Campaign:
    assert c.odometry is not None
    return replace(c, odometry=replace(c.odometry, lever_arm_m=(0.0, 0.0, 0.0)))


def _swap(p: Floats) -> Floats:
    out = p.copy()
    out[:, [0, 1]] = p[:, [1, 0]]
    return out


def _down(p: Floats) -> Floats:
    out = _swap(p)
    out[:, 2:] = -out[:, 2:]
    return out


_right_hand = dict.fromkeys(("u_y", "u_z", "u_psi", "u_theta"), -1.0)
# What is planted, and the kinds of suspicion that name it.
MISTAKES: dict[str, tuple[Callable[[Campaign], Campaign], tuple[str, ...]]] = {
    "azimuth in radians taken for degrees": (_columns(azimuth_rad=lambda a: a * np.pi / 180), ("radians-as-degrees",)),
    "yaw rate in radians taken for degrees": (_wheels(u_psi=np.pi / 180), ("radians-as-degrees",)),
    "nanoseconds for metres": (_columns(distance_m=lambda d: d / (1e-9 * SPEED_OF_LIGHT_MPS)), ("nanoseconds",)),
    "clockwise azimuth": (_columns(azimuth_rad=lambda a: -a), ("clockwise",)),
    "azimuth from the right": (_columns(azimuth_rad=lambda a: wrap_angle(a + np.pi / 2)), ("azimuth-zero",)),
    "yaw rate of the wrong sign": (_wheels(u_psi=-1.0), ("clockwise", "forward-right-down")),
    "yaw rate in degrees": (_wheels(u_psi=180 / np.pi), ("degrees-as-radians",)),
    "speed backwards": (_wheels(u_x=-1.0), ("odometry-sign",)),
    "km/h": (_wheels(u_x=3.6), ("speed-unit",)),
    "reference with x and y swapped": (_fixes(_swap), ("swapped-axes",)),
    "reference north-east-down": (_fixes(_down, lambda y: wrap_angle(np.pi / 2 - y)), ("swapped-axes",)),
    "reference in feet": (_fixes(lambda p: p / 0.3048), ("reference-unit",)),
    "reference 5 s late": (_late("reference", 5.0), ("reference-clock",)),
    "odometry 2 s late": (_late("odometry", 2.0), ("odometry-clock",)),
    "measurements 1 s late": (_late_measurements, ("measurements-clock",)),
    "forward-right-down": (_wheels(**_right_hand), ("forward-right-down", "clockwise")),
    "20 m on every distance": (_columns(distance_m=lambda d: d + 20.0), ("distance-offset",)),
    "two-way ranges": (_columns(distance_m=lambda d: 2.0 * d), ("two-way",)),
    "wrong wheelbase": (_wheels(u_psi=1.35), ("yaw-scale",)),
    "lever arm left out": (_no_arm, ("lever-arm",)),
}  # fmt: skip
WORLDS: dict[str, Callable[[int], Campaign]] = {
    "hall": hall,
    "hall with an arm": lambda seed: hall(seed, (1.5, -0.5)),
    "places": places,
    "beacons": beacons,
    "trees": trees,
    "trees by bad odometry": lambda seed: trees(seed, noise=2.0),
    "cellular": cellular,
    "few places": few_places,
    "rover": rover,
    "tubes": tubes,
}
