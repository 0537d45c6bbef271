"""A drive as MCAP, with messages of ROS 2 that Foxglove, Rerun and ROS 2 itself know.

    /tf             tf2_msgs/TFMessage                          where the vehicle is, by the estimate
    /estimate       geometry_msgs/PoseWithCovarianceStamped     each snapshot; `covariances.in_world`
    /truth          geometry_msgs/PoseStamped                   each snapshot, or fix of a reference
    /measurements   sensor_msgs/PointCloud2                     in the vehicle's frame: each path's measured direction
                                                                and distance less the estimated clock offset; SNR, link
    /map            visualization_msgs/MarkerArray              at the end: VTs as ellipsoids of two deviations, walls
    /city           visualization_msgs/MarkerArray              at the start, of a simulated drive: its triangles

Poses take the frame `world`: east, north, up. Message definitions are those of ROS 2's common_interfaces, Apache-2.0.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from cellslam.benchmarks.scores.trial_result import TrialResult
from cellslam.benchmarks.trials.output_files import quaternions
from cellslam.recordings.exporting.covariances import in_world
from cellslam.recordings.exporting.maps import shown
from cellslam.sim.errors import InputError
from cellslam.sim.frames import rotation_angles, unit_vector
from cellslam.sim.recording import Recording

if TYPE_CHECKING:
    from cellslam.sim.city import City

Message = tuple[str, str, float, dict[str, Any]]  # topic, type, time in s, content
SIGMAS = 2.0
SPHERE, LINES, TRIANGLES = 2, 5, 11  # kinds of markers
GREEN, VIOLET, GREY = (0.0, 0.6, 0.45, 0.5), (0.24, 0.1, 0.47, 1.0), (0.8, 0.78, 0.74, 1.0)
FIELDS = ("x", "y", "z", "snr_db", "link")
DEFINITIONS = {
    "std_msgs/Header": "builtin_interfaces/Time stamp\nstring frame_id",
    "std_msgs/ColorRGBA": "float32 r\nfloat32 g\nfloat32 b\nfloat32 a",
    "geometry_msgs/Point": "float64 x\nfloat64 y\nfloat64 z",
    "geometry_msgs/Vector3": "float64 x\nfloat64 y\nfloat64 z",
    "geometry_msgs/Quaternion": "float64 x\nfloat64 y\nfloat64 z\nfloat64 w",
    "geometry_msgs/Pose": "geometry_msgs/Point position\ngeometry_msgs/Quaternion orientation",
    "geometry_msgs/PoseStamped": "std_msgs/Header header\ngeometry_msgs/Pose pose",
    "geometry_msgs/PoseWithCovariance": "geometry_msgs/Pose pose\nfloat64[36] covariance",
    "geometry_msgs/PoseWithCovarianceStamped": "std_msgs/Header header\ngeometry_msgs/PoseWithCovariance pose",
    "geometry_msgs/Transform": "geometry_msgs/Vector3 translation\ngeometry_msgs/Quaternion rotation",
    "geometry_msgs/TransformStamped": "std_msgs/Header header\nstring child_frame_id\n"
    "geometry_msgs/Transform transform",
    "tf2_msgs/TFMessage": "geometry_msgs/TransformStamped[] transforms",
    "sensor_msgs/PointField": "string name\nuint32 offset\nuint8 datatype\nuint32 count",
    "sensor_msgs/PointCloud2": "std_msgs/Header header\nuint32 height\nuint32 width\nsensor_msgs/PointField[] fields\n"
    "bool is_bigendian\nuint32 point_step\nuint32 row_step\nuint8[] data\nbool is_dense",
    "sensor_msgs/CompressedImage": "std_msgs/Header header\nstring format\nuint8[] data",
    "visualization_msgs/UVCoordinate": "float32 u\nfloat32 v",
    "visualization_msgs/MeshFile": "string filename\nuint8[] data",
    "visualization_msgs/Marker": "std_msgs/Header header\nstring ns\nint32 id\nint32 type\nint32 action\n"
    "geometry_msgs/Pose pose\ngeometry_msgs/Vector3 scale\nstd_msgs/ColorRGBA color\n"
    "builtin_interfaces/Duration lifetime\nbool frame_locked\ngeometry_msgs/Point[] points\n"
    "std_msgs/ColorRGBA[] colors\n"
    "string texture_resource\nsensor_msgs/CompressedImage texture\nvisualization_msgs/UVCoordinate[] uv_coordinates\n"
    "string text\nstring mesh_resource\nvisualization_msgs/MeshFile mesh_file\nbool mesh_use_embedded_materials",
    "visualization_msgs/MarkerArray": "visualization_msgs/Marker[] markers",
}


def write_mcap(recording: Recording, result: TrialResult | None, city: City | None, path: Path) -> None:
    """Write a recording, an estimate of it, and the city, where there are any. Raises InputError without mcap."""
    try:
        from mcap_ros2.writer import Writer
    except ImportError:
        raise InputError("MCAP needs its package: pip install 'cellslam[mcap]'") from None
    messages = sorted(_messages(recording, result, city), key=lambda message: message[2])
    with path.open("wb") as file:
        writer = Writer(file)
        known = {}
        for topic, kind, time_s, content in messages:
            if kind not in known:
                known[kind] = writer.register_msgdef(kind.replace("/", "/msg/"), definition(kind))
            writer.write_message(topic, known[kind], content, round(1e9 * time_s), round(1e9 * time_s))
        writer.finish()  # type: ignore[no-untyped-call]


def definition(kind: str) -> str:
    """Return the definition of a message with those of all that it is made of, as ROS 2 concatenates them."""
    needed, rest = [kind], [kind]
    while rest:
        words = {line.split()[0].partition("[")[0] for line in DEFINITIONS[rest.pop()].splitlines()}
        more = [word for word in sorted(words) if word in DEFINITIONS and word not in needed]
        needed += more
        rest += more
    parts = [DEFINITIONS[kind], *(f"MSG: {name}\n{DEFINITIONS[name]}" for name in needed[1:])]
    return f"\n{'=' * 80}\n".join(parts) + "\n"


def _messages(recording: Recording, result: TrialResult | None, city: City | None) -> Iterator[Message]:
    known = shown(recording, None) if recording.truth is not None or recording.reference is not None else None
    for time_s, pose in zip(known.time_s, known.poses, strict=True) if known is not None else ():
        stamped = {"header": _header(time_s), "pose": _pose(pose[:3], quaternions(pose[None])[0])}
        yield "/truth", "geometry_msgs/PoseStamped", time_s, stamped
    if city is not None:
        corners = city.vertices[city.triangles].reshape(-1, 3)
        marker = _marker("city", 0, TRIANGLES, GREY, points=[_xyz(corner) for corner in corners])
        yield "/city", "visualization_msgs/MarkerArray", recording.time_s[0], _array(recording.time_s[0], [marker])
    if result is None:
        return
    turns = quaternions(result.poses)
    for t, covariance in enumerate(in_world(result.poses, result.covariances)):
        time_s, pose = recording.time_s[t], result.poses[t]
        header = _header(time_s)
        believed = {"pose": _pose(pose[:3], turns[t]), "covariance": covariance.ravel().tolist()}
        yield "/estimate", "geometry_msgs/PoseWithCovarianceStamped", time_s, {"header": header, "pose": believed}
        moved = {"translation": _xyz(pose[:3]), "rotation": _xyz(turns[t], "xyzw")}
        one = {"header": header, "child_frame_id": "vehicle", "transform": moved}
        yield "/tf", "tf2_msgs/TFMessage", time_s, {"transforms": [one]}
        yield "/measurements", "sensor_msgs/PointCloud2", time_s, _cloud(recording, result, t)
    end_s = recording.time_s[-1]
    yield "/map", "visualization_msgs/MarkerArray", end_s, _array(end_s, [*_vts(result), *_walls(result)])


def _cloud(recording: Recording, result: TrialResult, t: int) -> dict[str, Any]:
    """Return the measurements of a snapshot that have direction and distance, as points in the vehicle's frame."""
    m, part = recording.measurements, slice(recording.rows[t], recording.rows[t + 1])
    link = m.link[part]
    offset = 0.0 if result.clock_offset_m is None else result.clock_offset_m[t][recording.links.site[link]]
    toward = unit_vector(m.azimuth_rad[part], np.nan_to_num(m.elevation_rad[part]))
    points = np.column_stack([(m.distance_m[part] - offset)[:, None] * toward, m.snr_db[part], link])
    points = points[np.isfinite(points[:, :3]).all(axis=1)].astype("<f4")
    size = 4 * len(FIELDS)
    fields = [{"name": name, "offset": 4 * i, "datatype": 7, "count": 1} for i, name in enumerate(FIELDS)]
    return {
        "header": _header(recording.time_s[t], "vehicle"), "height": 1, "width": len(points), "fields": fields,
        "is_bigendian": False, "point_step": size, "row_step": size * len(points), "data": list(points.tobytes()),
        "is_dense": True,
    }  # fmt: skip


def _vts(result: TrialResult) -> Iterator[dict[str, Any]]:
    """Yield the final VTs as ellipsoids that hold two deviations along each of their axes."""
    vts = result.vts
    for i in range(0 if vts is None else len(vts.id)):
        assert vts is not None
        variance, axes = np.linalg.eigh(vts.covariance[i])
        axes[:, 0] *= np.sign(np.linalg.det(axes)) or 1.0
        turn = quaternions(np.concatenate([np.zeros(3), rotation_angles(axes)])[None])[0]
        size = 2.0 * SIGMAS * np.sqrt(np.maximum(variance, 0.0))
        yield _marker("vts", i, SPHERE, GREEN, _pose(vts.position_m[i], turn), size, text=f"{vts.link[i]}/{vts.id[i]}")


def _walls(result: TrialResult) -> Iterator[dict[str, Any]]:
    """Yield the visible parts of the walls as lines, at the height of the first pose."""
    if result.walls is not None and len(result.walls):
        ends = result.walls.ends_m.reshape(-1, 2)
        points = [_xyz([*end, result.poses[0, 2]]) for end in ends]
        yield _marker("walls", 0, LINES, VIOLET, size=(0.3, 0.0, 0.0), points=points)


def _marker(
    space: str, number: int, kind: int, colour: Sequence[float], pose: dict[str, Any] | None = None,
    size: Any = (1.0, 1.0, 1.0), **more: Any,
) -> dict[str, Any]:  # fmt: skip
    here = pose or _pose(np.zeros(3), np.array([0.0, 0.0, 0.0, 1.0]))
    appearance = {"color": _xyz(colour, "rgba"), "scale": _xyz(size), "pose": here}
    return {"ns": space, "id": number, "type": kind, "action": 0, **appearance, **more}


def _array(time_s: float, markers: Sequence[dict[str, Any]]) -> dict[str, Any]:
    return {"markers": [{"header": _header(time_s), **marker} for marker in markers]}


def _header(time_s: float, frame: str = "world") -> dict[str, Any]:
    second, rest = divmod(round(1e9 * time_s), 10**9)
    return {"stamp": {"sec": second, "nanosec": rest}, "frame_id": frame}


def _pose(position: Any, turn: Any) -> dict[str, Any]:
    return {"position": _xyz(position), "orientation": _xyz(turn, "xyzw")}


def _xyz(values: Any, names: str = "xyz") -> dict[str, float]:
    return {name: float(value) for name, value in zip(names, values, strict=True)}
