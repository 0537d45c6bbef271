"""What a scenario may say about its city; the `kind` decides between a generated city and a mesh."""

from __future__ import annotations

from typing import Annotated, Literal, Self

from pydantic import BaseModel, ConfigDict, Field, model_validator


class _Config(BaseModel):
    model_config = ConfigDict(frozen=True, extra="forbid")

    roughness_m: float = Field(
        0.002, ge=0.0, le=0.1, description="standard deviation of the wall surfaces' height; costs reflected power"
    )
    max_order: int = Field(
        1, ge=1, le=2, description="reflections that a path may have; 2 takes seconds to minutes per site"
    )
    diffraction: bool = Field(False, description="whether paths over one edge of a building exist")
    ground_reflection: bool = Field(False, description="whether the ground reflects")


class ProceduralCityConfig(_Config):
    """A generated city: jittered streets, blocks with courtyards, free-standing buildings, squares."""

    kind: Literal["procedural"] = Field("procedural", description="a generated city")
    seed: Annotated[int, Field(ge=0)] | Literal["trial"] = Field(
        1, description="seed of the city, fixed by the scenario; 'trial': another city in each trial"
    )
    extent_m: float = Field(700.0, ge=100.0, le=5000.0, description="side of the square that holds the street network")
    block_size_m: float = Field(100.0, ge=40.0, le=400.0, description="mean distance between parallel streets")
    irregularity: float = Field(
        0.25, ge=0.0, le=0.4, description="displacement of street corners, as a share of the block size"
    )
    merged_share: float = Field(0.15, ge=0.0, le=0.4, description="share of street pieces left out, which joins blocks")
    street_width_m: float = Field(16.0, ge=6.0, le=60.0, description="width from wall to wall of the narrowest streets")
    open_share: float = Field(0.4, ge=0.0, le=1.0, description="share of blocks with free-standing buildings")
    square_share: float = Field(0.05, ge=0.0, le=0.9, description="share of blocks without buildings: squares, parks")
    open_coverage: float = Field(
        0.3, ge=0.02, le=0.6, description="share of the ground of an open block that buildings cover, at most"
    )
    open_align: float = Field(
        0.6, ge=0.0, le=1.0, description="share of free-standing buildings that stand parallel to a street"
    )
    gap_share: float = Field(0.12, ge=0.0, le=0.8, description="share of lots left empty in a closed block")
    height_min_m: float = Field(8.0, ge=3.0, le=200.0, description="height of the lowest buildings")
    height_max_m: float = Field(35.0, ge=3.0, le=300.0, description="height of the highest ordinary buildings")
    tower_share: float = Field(0.02, ge=0.0, le=0.5, description="share of buildings that are towers")
    tower_height_m: float = Field(50.0, ge=3.0, le=400.0, description="mean height of towers, which vary by 15 percent")
    bay_share: float = Field(0.0, ge=0.0, le=1.0, description="share of buildings whose long walls have bays")
    shop_share: float = Field(
        0.0, ge=0.0, le=1.0, description="share of buildings whose ground floor is glass: shop fronts"
    )
    pole_spacing_m: float = Field(
        0.0, ge=0.0, le=200.0, description="distance of the lamp posts along both kerbs; 0: none"
    )
    material_weights: dict[str, float] = Field(
        default={"concrete": 0.45, "brick": 0.35, "glass": 0.15, "metal": 0.05},
        description="materials of the walls by ITU-R P.2040 name, with their relative frequency",
    )

    @model_validator(mode="after")
    def _consistent(self) -> Self:
        if self.height_max_m < self.height_min_m:
            raise ValueError(
                f"height_max_m {self.height_max_m} is below height_min_m {self.height_min_m}: "
                "raise it or lower the other"
            )
        if self.street_width_m > 0.6 * self.block_size_m:
            raise ValueError(
                f"street_width_m {self.street_width_m} leaves no block at block_size_m {self.block_size_m}: "
                "at most 0.6 of it"
            )
        if self.block_size_m > 0.5 * self.extent_m:
            raise ValueError(f"block_size_m {self.block_size_m} is more than half of extent_m {self.extent_m}")
        if not self.material_weights or min(self.material_weights.values()) < 0.0:
            raise ValueError("material_weights needs at least one material, and no negative weight")
        if sum(self.material_weights.values()) <= 0.0:
            raise ValueError("material_weights are all zero: give one of them a weight above 0")
        return self


class MeshCityConfig(_Config):
    """A city read from a file: PLY, OBJ, STL, GLB, CityJSON, OpenStreetMap, or a Mitsuba XML scene (sionna-rt)."""

    kind: Literal["mesh"] = Field("mesh", description="a city of a file")
    path: str = Field(
        description="mesh, CityJSON, OpenStreetMap or Mitsuba file, or 'sionna-rt:NAME': a scene of that package"
    )
    material: str = Field("concrete", description="ITU-R P.2040 material of meshes that name none")
    thickness_m: float | None = Field(
        0.1, gt=0.0, le=5.0, description="wall thickness of meshes that name none; 'none' is a half space"
    )
    up: Literal["auto", "z", "y"] = Field(
        "auto", description="the file's upward axis; auto: y for GLB and glTF, as their standard says, else z"
    )
    plane_tolerance_m: float = Field(
        0.002, gt=0.0, le=0.1, description="touching triangles become one facet if no corner is further from its plane"
    )
    angle_tolerance_deg: float = Field(
        1.0, gt=0.0, le=20.0, description="and if none is turned further from it than this"
    )


CityConfig = Annotated[ProceduralCityConfig | MeshCityConfig, Field(discriminator="kind")]
