"""What both environments share: an episode is a drive in a scenario, chosen by `reset`, and shown as a picture."""

from __future__ import annotations

from abc import abstractmethod
from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

import gymnasium as gym
import numpy as np
from numpy.typing import NDArray

from cellslam.scenarios.loading import load
from cellslam.sim.city.city import City
from cellslam.sim.errors import InputError, unknown_name
from cellslam.sim.recording import Floats

Observation = dict[str, NDArray[Any]]

OPTIONS = ("scenario", "set", "seed", "trial")
SIZE_PX, DPI = 480, 96
NEAR_M = 60.0
SIGMAS = 2.4477  # 95 % of a Gaussian in the plane


class ScenarioEnv(gym.Env[Observation, Floats]):
    """An environment whose episodes are drives in a scenario."""

    def __init__(
        self, scenario: str, drives: int | None, overrides: Mapping[str, Any] | None, render_mode: str | None
    ) -> None:
        if render_mode not in (None, "rgb_array"):
            raise InputError(f"render_mode = {render_mode!r}: must be None or 'rgb_array'")
        self.render_mode, self.drives = render_mode, drives
        self._scenario = load(scenario, overrides)

    def reset(
        self, *, seed: int | None = None, options: dict[str, Any] | None = None
    ) -> tuple[Observation, dict[str, Any]]:
        """Begin a drive; the same seed and options give the same one."""
        super().reset(seed=seed)
        chosen = dict(options or {})
        for name in chosen:
            if name not in OPTIONS:
                raise unknown_name("option of reset", name, OPTIONS)
        if "scenario" in chosen or "set" in chosen:
            self._scenario = load(chosen.get("scenario", self._scenario.name), chosen.get("set"))
        drawn = int(self.np_random.integers(2**31 if self.drives is None else self.drives))
        self._begin(int(chosen.get("seed", drawn)), int(chosen.get("trial", 0)))
        return self._observe(), self._info()

    def render(self) -> Any:
        """Return an image (480, 480, 3) of city, paths, truth, belief and its ellipse."""
        return None if self.render_mode is None else picture(*self._scene())

    @abstractmethod
    def _begin(self, seed: int, trial: int) -> None:
        """Stand at the start of a drive."""

    @abstractmethod
    def _observe(self) -> Observation:
        """Return what the agent sees now."""

    @abstractmethod
    def _info(self) -> dict[str, Any]:
        """Return the truth, and what describes it."""

    @abstractmethod
    def _scene(self) -> tuple[Scene, Floats, Floats | None]:
        """Return what is shown: the truth, the belief (6,), and its covariance (6, 6) if there is one."""


@dataclass(frozen=True)
class Scene:
    """What is true: city; track (n, 6) so far; VTs seen now (v, 3); sites (S, 3); the route (r, 2) or None."""

    city: City
    track: Floats
    vts_m: Floats
    sites_m: Floats
    route_m: Floats | None = None


def picture(scene: Scene, belief: Floats, covariance: Floats | None) -> NDArray[np.uint8]:
    """Return an image (480, 480, 3), 120 m wide: truth black, belief (6,) orange with its 95 % ellipse, paths blue.

    A path is drawn as the line to its VT.
    """
    from matplotlib.backends.backend_agg import FigureCanvasAgg
    from matplotlib.figure import Figure
    from matplotlib.patches import PathPatch

    from cellslam.benchmarks.figures.style import outline

    figure = Figure(figsize=(SIZE_PX / DPI, SIZE_PX / DPI), dpi=DPI)
    canvas: Any = FigureCanvasAgg(figure)
    axes = figure.add_axes((0.0, 0.0, 1.0, 1.0))
    here = scene.track[-1]
    for footprint in scene.city.footprints:
        axes.add_patch(PathPatch(outline(footprint), color="0.8", linewidth=0))
    if scene.route_m is not None:
        axes.plot(*scene.route_m.T, color="tab:green", linewidth=0.8, linestyle="--")
    for x, y, _ in scene.vts_m:
        axes.plot([here[0], x], [here[1], y], color="tab:blue", linewidth=0.6, alpha=0.6)
    axes.plot(*scene.track[:, :2].T, color="black", linewidth=1.2)
    axes.plot(*scene.sites_m[:, :2].T, "^", color="tab:blue")
    nose = belief[:2] + 4.0 * np.array([np.cos(belief[3]), np.sin(belief[3])])
    axes.plot(*belief[:2], "o", color="tab:orange", markersize=5)
    axes.plot([belief[0], nose[0]], [belief[1], nose[1]], color="tab:orange")
    if covariance is not None:
        values, basis = np.linalg.eigh(covariance[:2, :2])
        angle = np.linspace(0, 2 * np.pi, 61)
        ring = SIGMAS * (basis * np.sqrt(np.maximum(values, 0.0))) @ np.stack([np.cos(angle), np.sin(angle)])
        axes.plot(*(belief[:2, None] + ring), color="tab:orange", linewidth=1)
    (x0, y0), (x1, y1) = here[:2] - NEAR_M, here[:2] + NEAR_M
    axes.set(xlim=(x0, x1), ylim=(y0, y1), aspect="equal")
    axes.set_axis_off()
    canvas.draw()
    return np.asarray(canvas.buffer_rgba())[:, :, :3].copy()
