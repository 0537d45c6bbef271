"""What is known of a scenario's map before the drive: from a file, or from earlier drives of a sequence."""

from __future__ import annotations

from functools import cached_property
from typing import Self

from pydantic import BaseModel, ConfigDict, Field, model_validator

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
