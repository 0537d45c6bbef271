"""Settings of the other vehicles (table [traffic] of a scenario)."""

from __future__ import annotations

from pydantic import BaseModel, ConfigDict, Field

KINDS = ("car", "van", "lorry", "bus")


class KindConfig(BaseModel):
    """A kind of vehicle: how many of it there are, and its box."""

    model_config = ConfigDict(frozen=True, extra="forbid")

    share: float = Field(ge=0.0, le=1000.0, description="how many there are, in proportion to the other kinds")
    length_m: float = Field(ge=1.0, le=25.0, description="length")
    width_m: float = Field(ge=0.5, le=2.6, description="width, without mirrors")
    height_m: float = Field(ge=0.5, le=5.0, description="height above ground")


class TrafficConfig(BaseModel):
    """Other vehicles on the lanes along the route. Default: none.

    Sizes: cars of 3GPP TR 37.885, table 6.1.2-1 (5.0 x 2.0 x 1.6 m, as in highway-env); vans, lorries (two axles, box
    body) and city buses as usually built, widths within Directive 96/53/EC. Shares are a plausible choice.
    """

    model_config = ConfigDict(frozen=True, extra="forbid")

    vehicles_per_km: float = Field(0.0, ge=0.0, le=60.0, description="vehicles on a kilometre of lane; 0: no traffic")
    speed_mps: float = Field(8.0, ge=0.5, le=20.0, description="wanted speed of the traffic, mean over vehicles")
    lanes: int = Field(2, ge=1, le=3, description="lanes in our direction: ours and those to its right that fit")
    oncoming_lanes: int = Field(1, ge=0, le=3, description="lanes in the other direction, to our left, that fit")
    lane_width_m: float = Field(3.5, ge=2.75, le=5.0, description="width of a lane")
    reflect: bool = Field(False, description="whether the sides of lorries and buses reflect")
    car: KindConfig = Field(
        KindConfig(share=78.0, length_m=5.0, width_m=2.0, height_m=1.6), description="passenger cars"
    )
    van: KindConfig = Field(
        KindConfig(share=12.0, length_m=5.9, width_m=2.0, height_m=2.6), description="vans with a high roof"
    )
    lorry: KindConfig = Field(
        KindConfig(share=5.0, length_m=9.0, width_m=2.55, height_m=3.6), description="lorries without a trailer"
    )
    bus: KindConfig = Field(KindConfig(share=5.0, length_m=12.0, width_m=2.55, height_m=3.1), description="city buses")

    @property
    def kinds(self) -> tuple[KindConfig, ...]:
        """The kinds in the order of KINDS."""
        return self.car, self.van, self.lorry, self.bus
