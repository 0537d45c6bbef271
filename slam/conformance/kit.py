"""The conformance kit: a pytest class that an estimator's author subclasses, overriding one fixture.

    from cellslam.slam.conformance import EstimatorConformance

    class TestMine(EstimatorConformance):
        @pytest.fixture
        def estimator(self):
            return MyEstimator

Needs pytest. Without it: `cellslam check-estimator MODULE:CLASS`.
"""

from __future__ import annotations

from typing import Any

import pytest

from cellslam.slam.conformance.checks import CHECKS, Check
from cellslam.slam.conformance.subject import Subject, tiny_drive


class EstimatorConformance:
    """One test for each of `checks.CHECKS`."""

    @pytest.fixture
    def estimator(self) -> type[Any]:
        """Return the estimator class to be checked: override this."""
        raise NotImplementedError("override the fixture `estimator`: let it return your class")

    @pytest.fixture
    def options(self, estimator: type[Any]) -> Any:
        """Return the options to check with: the defaults of `estimator.Options`, or None; may be overridden."""
        model = getattr(estimator, "Options", None)
        return None if model is None else model()

    @pytest.fixture
    def subject(self, estimator: type[Any], options: Any) -> Subject:
        """Return class, options and drive, compiled."""
        subject = Subject(estimator, options, tiny_drive())
        subject.warm_up()
        return subject

    @pytest.mark.parametrize("check", CHECKS, ids=lambda check: check.__name__)
    def test_conforms(self, subject: Subject, check: Check) -> None:
        """Run one check."""
        check(subject)
