"""Settings of the other vehicles (table [traffic] of a scenario), and the sizes of their kinds."""

from __future__ import annotations

from typing import NamedTuple

from pydantic import BaseModel, ConfigDict, Field, model_validator


class Kind(NamedTuple):
    """A kind of vehicle as a box on the ground, in metres, without mirrors."""

    name: str
    length_m: float
    width_m: float
    height_m: float
    reflects: bool


# Cars: 3GPP TR 37.885, table 6.1.2-1, as in highway-env. Vans: long, with a high roof, as Ford Transit and Mercedes
# Sprinter are. Lorries (two axles, box body) and city buses: as usually built, within Directive 96/53/EC.
KINDS = (
    Kind("car", 5.0, 2.0, 1.6, False),
    Kind("van", 5.9, 2.0, 2.6, False),
    Kind("lorry", 9.0, 2.55, 3.6, True),
    Kind("bus", 12.0, 2.55, 3.1, True),
)


class TrafficConfig(BaseModel):
    """Other vehicles on the lanes along the route. Default: none. Shares of kinds are a plausible choice."""

    model_config = ConfigDict(frozen=True, extra="forbid")

    vehicles_per_km: float = Field(0.0, ge=0.0, le=60.0, description="vehicles on a kilometre of lane; 0: no traffic")
    speed_mps: float = Field(8.0, ge=0.5, le=20.0, description="wanted speed of the traffic, mean over vehicles")
    lanes: int = Field(2, ge=1, le=3, description="lanes in our direction: ours and those to its right that fit")
    oncoming_lanes: int = Field(1, ge=0, le=3, description="lanes in the other direction, to our left, that fit")
    lane_width_m: float = Field(3.5, ge=2.75, le=5.0, description="width of a lane")
    van_share: float = Field(0.12, ge=0.0, le=1.0, description="probability that a vehicle is a van, 5.9 x 2.0 x 2.6 m")
    lorry_share: float = Field(0.05, ge=0.0, le=1.0, description="that it is a lorry, 9.0 x 2.55 x 3.6 m")
    bus_share: float = Field(
        0.05, ge=0.0, le=1.0, description="that it is a bus, 12.0 x 2.55 x 3.1 m; cars are the rest"
    )
    reflect: bool = Field(False, description="whether the long sides of lorries and buses reflect")

    @model_validator(mode="after")
    def _check_shares(self) -> TrafficConfig:
        others = self.van_share + self.lorry_share + self.bus_share
        if others > 1.0 + 1e-9:
            raise ValueError(f"van_share, lorry_share and bus_share add up to {others:g}: at most 1, cars are the rest")
        return self

    @property
    def shares(self) -> tuple[float, float, float, float]:
        """The probabilities of the KINDS."""
        others = self.van_share + self.lorry_share + self.bus_share
        return max(1.0 - others, 0.0), self.van_share, self.lorry_share, self.bus_share
