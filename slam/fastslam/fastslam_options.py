"""Options of FastSLAM, with the defaults for the statistical LTE front end."""

from __future__ import annotations

from pydantic import Field, field_validator
from pydantic_core.core_schema import ValidationInfo

from cellslam.slam.fastslam.parts import BUILT_IN, part_named
from cellslam.slam.joint.ekf_slam_options import EkfSlamOptions

NEVER = 10_000  # blocks of lag, from which on nothing is drawn


def _slot(name: str, what: str) -> str:
    """Return the field of a slot: its default part, and what there is to choose from."""
    parts = BUILT_IN[name]
    own: str = Field(next(iter(parts)), description=f"{what}: {', '.join(parts)}, or your own as module:name")
    return own


class FastSlamOptions(EkfSlamOptions):
    """What a scenario may set under `estimator.fastslam`, beside the options of the joint filter."""

    particles: int = Field(300, ge=1, le=1_000_000, description="number of particles, shared by all groups")
    lag: int = Field(
        20,
        ge=-1,
        le=NEVER,
        description="blocks of snapshots after which the odometry's noise is drawn; -1: before its own block is used "
        f"(FastSLAM 1.0), 0: after it (FastSLAM 2.0), {NEVER}: never, the joint EKF",
    )
    hypotheses: int = Field(
        8,
        ge=1,
        le=1000,
        description="groups of particles with different associations, at most (association=hypotheses)",
    )
    place_component_m: float = Field(
        3.0,
        gt=0,
        le=100,
        description="a start whose place is less certain begins, in a remembered map, as groups so certain, m",
    )
    heading_component_deg: float = Field(5.0, gt=0, le=180, description="the same for its heading, deg")
    effective_share: float = Field(
        0.5, ge=0, le=1, description="resample when the effective sample size falls below this share of the particles"
    )
    association: str = _slot("association", "which measurement is of which VT")
    birth: str = _slot("birth", "which measurement without a VT begins one")
    proposal: str = _slot("proposal", "draws of the odometry's noise")
    update: str = _slot("update", "how innovations change means and covariance")
    weight: str = _slot("weight", "log-likelihood of a particle")
    pruning: str = _slot("pruning", "which VTs are dropped")
    resampling: str = _slot("resampling", "which particles are copied")

    @field_validator(*BUILT_IN)
    @classmethod
    def _known(cls, name: str, info: ValidationInfo) -> str:
        """Refuse a part that is not built in, and cannot be imported as module:name either."""
        part_named(str(info.field_name), name)
        return name
