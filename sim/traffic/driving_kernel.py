"""Compiled: vehicles on parallel lanes by highway-env's models of following and of changing lanes.

Source: IDM, Treiber, Hennecke, Helbing 2000; MOBIL, Kesting, Treiber, Helbing 2007; both as in highway-env's
`IDMVehicle`, with its constants, and the lengths of vehicles made good. At low speed highway-env drives backwards and
turns to and fro; here no speed is below zero, and a vehicle turns only as it moves, towards a point of its lane.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from highway_env.vehicle.behavior import IDMVehicle
from numpy.typing import NDArray

from cellslam.sim.compiling import njit, part

Floats = NDArray[np.float64]
Ints = NDArray[np.int64]

# highway-env's constants, as positive numbers: of following, then of changing lanes.
HARDEST_MPS2: float = IDMVehicle.ACC_MAX
ACCELERATION_MPS2: float = IDMVehicle.COMFORT_ACC_MAX
BRAKING_MPS2: float = -IDMVehicle.COMFORT_ACC_MIN
JAM_GAP_M: float = IDMVehicle.DISTANCE_WANTED
TIME_GAP_S: float = IDMVehicle.TIME_WANTED
EXPONENT: float = IDMVehicle.DELTA
POLITENESS: float = IDMVehicle.POLITENESS
LEAST_GAIN_MPS2: float = IDMVehicle.LANE_CHANGE_MIN_ACC_GAIN
MOST_IMPOSED_MPS2: float = IDMVehicle.LANE_CHANGE_MAX_BRAKING_IMPOSED
DELAY_S: float = IDMVehicle.LANE_CHANGE_DELAY

LOOKAHEAD_M, LOOKAHEAD_S = 10.0, 2.0  # a vehicle steers for the point of its lane so far ahead
RADIUS_M = 10.0  # the least radius of a turn
LEAST_MOVING_MPS = 1.0  # below it no lane is changed, as in highway-env
BESIDE_M = 1.0  # a vehicle is on a lane if its centre is at most so far outside, as in highway-env


class Road(NamedTuple):
    """Parallel lanes that begin again where they end, all in one direction.

    `length` in m; `lanes` (L,) to the side in m, left positive, from right to left or from left to right; `width` of a
    lane in m; `limit` (n,) speed in m/s on equal cells along the road.
    """

    length: float
    lanes: Floats
    width: float
    limit: Floats


class Cars(NamedTuple):
    """State of all vehicles, all (N,), the last one being ours: along (m, below the road's length) and to the side (m),
    speed (m/s), heading (rad) relative to the lane, the lane wanted, seconds since lanes were looked at; length (m) and
    wanted speed (m/s).
    """

    along: Floats
    side: Floats
    speed: Floats
    heading: Floats
    lane: Ints
    timer: Floats
    size: Floats
    wanted: Floats


@part
def following(speed: float, wanted: float, gap: float, closing: float) -> float:
    """Return the acceleration (m/s^2) of the IDM at a speed, with `gap` m to the vehicle ahead (inf: none), closing in
    on it by `closing` m/s.
    """
    free: float = ACCELERATION_MPS2 * (1.0 - (max(speed, 0.0) / max(wanted, 0.01)) ** EXPONENT)
    if gap == np.inf:
        return free
    desired = wanted_gap(speed, closing)
    share = desired / max(gap, 0.01)
    return free - ACCELERATION_MPS2 * share * share


@part
def wanted_gap(speed: float, closing: float) -> float:
    """Return the gap (m) that the IDM wants."""
    dynamic: float = speed * closing / (2.0 * np.sqrt(ACCELERATION_MPS2 * BRAKING_MPS2))
    return JAM_GAP_M + speed * TIME_GAP_S + dynamic


@part
def ahead_by(cars: Cars, i: int, j: int, road: Road) -> float:
    """Return how far (m) j is ahead of i, round to its back."""
    distance: float = cars.along[j] - cars.along[i]
    return distance if distance >= 0.0 else distance + road.length


@part
def _neighbours(cars: Cars, i: int, side: float, road: Road) -> tuple[int, int]:
    """Return the vehicles ahead of and behind i on the lane at `side`, -1 none."""
    ahead, behind, least, most = -1, -1, np.inf, -np.inf
    for j in range(len(cars.along)):
        if j == i or abs(cars.side[j] - side) > 0.5 * road.width + BESIDE_M:
            continue
        distance = ahead_by(cars, i, j, road)
        if distance < least:
            least, ahead = distance, j
        if distance > most:
            most, behind = distance, j
    return ahead, behind


@part
def _follow(cars: Cars, i: int, j: int, road: Road) -> float:
    """Return the acceleration of i if it followed j; -1: nobody. highway-env's distances are from centre to centre, of
    vehicles of 5 m each: so is the gap here, with the lengths made good."""
    if i < 0:
        return 0.0
    cell = int(cars.along[i] / road.length * len(road.limit))
    wanted = min(cars.wanted[i], road.limit[min(cell, len(road.limit) - 1)])
    if j < 0:
        return following(cars.speed[i], wanted, np.inf, 0.0)
    gap = ahead_by(cars, i, j, road) + 5.0 - 0.5 * (cars.size[i] + cars.size[j])
    return following(cars.speed[i], wanted, gap, cars.speed[i] - cars.speed[j])


@part
def is_better(cars: Cars, i: int, lane: int, road: Road) -> bool:
    """Return whether MOBIL recommends that vehicle i changes to a lane."""
    ahead, behind = _neighbours(cars, i, road.lanes[lane], road)
    behind_then = _follow(cars, behind, i, road)
    if behind_then < -MOST_IMPOSED_MPS2:
        return False
    old_ahead, old_behind = _neighbours(cars, i, road.lanes[nearest_lane(cars.side[i], road)], road)
    gain = _follow(cars, i, ahead, road) - _follow(cars, i, old_ahead, road)
    others = behind_then - _follow(cars, behind, ahead, road)
    others += _follow(cars, old_behind, old_ahead, road) - _follow(cars, old_behind, i, road)
    return gain + POLITENESS * others >= LEAST_GAIN_MPS2


@part
def nearest_lane(side: float, road: Road) -> int:
    """Return the lane that is nearest to `side` m."""
    return int(np.argmin(np.abs(road.lanes - side)))


@part
def _choose_lane(cars: Cars, i: int, road: Road) -> None:
    """Begin to change lanes, or give it up where somebody ahead changes to the same lane."""
    lane, wanted = nearest_lane(cars.side[i], road), cars.lane[i]
    if lane != wanted:
        for j in range(len(cars.along)):
            if j != i and cars.lane[j] == wanted and nearest_lane(cars.side[j], road) != wanted:
                distance = ahead_by(cars, i, j, road)
                if 0.0 < distance < wanted_gap(cars.speed[i], cars.speed[i] - cars.speed[j]):
                    cars.lane[i] = lane
                    return
        return
    if cars.timer[i] <= DELAY_S:
        return
    cars.timer[i] = 0.0
    for other in (lane - 1, lane + 1):
        if 0 <= other < len(road.lanes) and cars.speed[i] >= LEAST_MOVING_MPS and is_better(cars, i, other, road):
            cars.lane[i] = other


@part
def _accelerate(cars: Cars, i: int, road: Road) -> float:
    """Return what vehicle i does on its lane, and on the one that it changes to."""
    lane = nearest_lane(cars.side[i], road)
    least = _follow(cars, i, _neighbours(cars, i, road.lanes[lane], road)[0], road)
    if cars.lane[i] != lane:
        least = min(least, _follow(cars, i, _neighbours(cars, i, road.lanes[cars.lane[i]], road)[0], road))
    return min(max(least, -HARDEST_MPS2), HARDEST_MPS2)


@part
def _move(cars: Cars, i: int, acceleration: float, step_s: float, road: Road) -> None:
    """Advance vehicle i by a step: it stops rather than going backwards, and turns as far as it moves."""
    v = cars.speed[i]
    then = v + acceleration * step_s
    moved = 0.5 * (v + then) * step_s if then > 0.0 else 0.5 * v * v / max(-acceleration, 1e-9)
    cars.speed[i] = max(then, 0.0)
    ahead = max(LOOKAHEAD_M, LOOKAHEAD_S * v)
    turn = np.arctan2(road.lanes[cars.lane[i]] - cars.side[i], ahead) - cars.heading[i]
    cars.heading[i] += min(max(turn, -moved / RADIUS_M), moved / RADIUS_M)
    cars.along[i] = (cars.along[i] + moved * np.cos(cars.heading[i])) % road.length
    cars.side[i] += moved * np.sin(cars.heading[i])
    cars.timer[i] += step_s


@njit(cache=True)
def drive_all(cars: Cars, ours: Floats, road: Road, step_s: float, kept: int) -> Floats:
    """Return along (m), side (m) and heading (rad) (K, N - 1, 3) of all vehicles but the last, ours, which
    is (k, 2): along in m and speed in m/s at every step of `step_s`. Every `kept`-th step is returned.
    """
    others = len(cars.along) - 1
    out = np.empty(((len(ours) - 1) // kept + 1, others, 3))
    wanted = np.empty(others)
    for step in range(len(ours)):
        cars.along[others], cars.speed[others] = ours[step, 0] % road.length, ours[step, 1]
        if step % kept == 0:
            out[step // kept, :, 0] = cars.along[:others]
            out[step // kept, :, 1] = cars.side[:others]
            out[step // kept, :, 2] = cars.heading[:others]
        for i in range(others):
            _choose_lane(cars, i, road)
            wanted[i] = _accelerate(cars, i, road)
        for i in range(others):
            _move(cars, i, wanted[i], step_s, road)
    return out


@njit(cache=True)
def progress(points_m: Floats, arc_m: Floats, places_m: Floats) -> Floats:
    """Return the arc length (T,) in m of a line (n, 2) beside which each of the places (T, 2) of a drive along it is:
    the line may cross itself.
    """
    out = np.empty(len(places_m))
    near = 0
    for t in range(len(places_m)):
        while True:
            step = points_m[near + 1] - points_m[near]
            share = np.sum((places_m[t] - points_m[near]) * step) / np.sum(step * step)
            if share < 1.0 or near + 2 == len(points_m):
                break
            near += 1
        out[t] = arc_m[near] + max(share, 0.0) * (arc_m[near + 1] - arc_m[near])
    return out
