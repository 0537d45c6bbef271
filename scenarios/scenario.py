"""A scenario: a world, and the options of the estimators that meet it."""

from __future__ import annotations

from functools import cached_property
from typing import Any, Self

from pydantic import BaseModel, ConfigDict, Field, model_validator

from cellslam.sim.world import WorldConfig
from cellslam.slam.model.vt_map import VtMap


class MapConfig(BaseModel):
    """The map that estimators begin with. Those that cannot use one drive without it."""

    model_config = ConfigDict(frozen=True, extra="forbid")

    file: str | None = Field(None, min_length=1, description="file of the map that earlier drives left, to begin with")
    drives: int = Field(
        1,
        ge=1,
        le=100,
        description="number of this drive in a sequence through one place: it begins with the map that those before "
        "it left, each with the map of those before itself; clocks, odometry and receiver are new in each",
    )
    cars: int = Field(
        1,
        ge=1,
        le=16,
        exclude_if=lambda cars: cars == 1,  # so that a world of one car is called what it was before there were more
        description="cars that drive before this drive at a time, each with an array and clocks of its own; their maps "
        "are joined before the next ones begin",
    )

    @cached_property
    def known(self) -> VtMap | None:
        """The map of the file. Raises InputError where the file is none."""
        return None if self.file is None else VtMap.load(self.file)

    @model_validator(mode="after")
    def _is_a_map(self) -> Self:
        """Refuse a file that holds no map."""
        _ = self.known
        return self


class Scenario(WorldConfig):
    """The tables of a scenario file. The world's tables are those of `sim.WorldConfig`.

    `estimator` holds the options by estimator name as they were written; `scenarios.estimator_options` validates
    them with the estimator's own model when the estimator is asked for. `facts` states what the scenario gives.
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
