import pytest
from cellslam.slam.conformance import EstimatorConformance
from my_estimator import ZeroVelocity


class TestZeroVelocity(EstimatorConformance):
    @pytest.fixture
    def estimator(self):
        return ZeroVelocity
