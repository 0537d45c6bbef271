"""Damaged city files load or are refused in one line: a hundred here, as many as CELLSLAM_FUZZ says by

CELLSLAM_FUZZ=10000 pytest tests/sim/city/test_fuzz.py --hypothesis-show-statistics
"""

from __future__ import annotations

import os

import numpy as np
import pytest
from hypothesis import HealthCheck, event, given, settings
from hypothesis import strategies as st

from tests.damaged_files import CITIES, Sound, cities, damaged, read, read_city

INPUTS = int(os.environ.get("CELLSLAM_FUZZ", "100"))


@pytest.fixture(scope="module")
def sound(tmp_path_factory):
    """Return the folder with one sound file of each format, and their contents."""
    folder = tmp_path_factory.mktemp("sound")
    return folder, {suffix: path.read_bytes() for suffix, path in cities(folder).items()}


@pytest.mark.parametrize("suffix", CITIES)
def test_sound_files_load(sound, suffix):
    path = sound[0] / f"sample{suffix}"
    assert read(path, Sound(path, read_city), read_city(path)) == "the same"


def check(sound, suffix, content):
    path = sound[0] / f"damaged{suffix}"
    path.write_bytes(content)
    event(f"{suffix} {read(path, Sound(path, read_city), None)}")


@settings(max_examples=INPUTS, deadline=20_000, database=None, suppress_health_check=list(HealthCheck))
@given(suffix=st.sampled_from(CITIES), seed=st.integers(0, 2**63))
def test_damaged_files_load_or_are_refused(sound, suffix, seed):
    check(sound, suffix, damaged(sound[1][suffix], np.random.default_rng(seed)))


@settings(max_examples=INPUTS // 2, deadline=20_000, database=None, suppress_health_check=list(HealthCheck))
@given(suffix=st.sampled_from(CITIES), content=st.binary(max_size=400))
def test_any_bytes_load_or_are_refused(sound, suffix, content):
    check(sound, suffix, content)
