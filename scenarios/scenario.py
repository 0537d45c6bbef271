"""A scenario: a world, and the options of the estimators that meet it."""

from __future__ import annotations

from typing import Any

from pydantic import ConfigDict, Field

from cellslam.scenarios.map_config import MapConfig
from cellslam.sim.world import WorldConfig


class Scenario(WorldConfig):
    """The tables of a scenario file. The world's tables are those of `sim.WorldConfig`.

    `estimator` holds the options by estimator name as they were written; `scenarios.options` validates them
    with the estimator's own model when the estimator is asked for. `facts` states what the scenario gives.
    """

    model_config = ConfigDict(frozen=True, extra="forbid")

    name: str = Field(pattern=r"^[^/\\\x00-\x1f]+$", max_length=100, description="name in rows and folders")
    title: str = Field("", description="one line about the place")
    description: str = Field("", description="what the scenario is for")
    facts: dict[str, float | str] = Field(default_factory=dict, description="measured facts, for `cellslam list`")
    map: MapConfig = Field(default_factory=MapConfig, description="the map that estimators begin with")
    estimator: dict[str, dict[str, Any]] = Field(
        default_factory=dict, description="options of the estimators, a table each"
    )

    def __repr__(self) -> str:
        options = f", estimator={self.estimator}" if self.estimator else ""
        return f"Scenario({self.name!r}: {self.title or 'no title'}; {len(self.sites)} sites{options})"

    __str__ = __repr__

    @property
    def world(self) -> WorldConfig:
        """The part that decides what is true and what is measured."""
        return WorldConfig.model_construct(**{name: getattr(self, name) for name in WorldConfig.model_fields})

    @property
    def resolved(self) -> dict[str, Any]:
        """Every value, defaults included, as plain data; loading it again gives the same scenario."""
        everything = self.model_dump(mode="json", exclude={"facts"})
        first = ("name", "title", "description")
        return {key: everything[key] for key in (*first, *(k for k in everything if k not in first))}

    def toml(self) -> str:
        """Return the resolved scenario as a scenario file; what has no value is left out."""
        import tomli_w

        return tomli_w.dumps(_without_none(self.resolved))


def _without_none(value: Any) -> Any:
    if isinstance(value, dict):
        return {key: _without_none(inner) for key, inner in value.items() if inner is not None}
    return [_without_none(inner) for inner in value] if isinstance(value, list) else value
