"""Facts of the presets are those that are measured."""

from __future__ import annotations

import pytest

from cellslam.scenarios.loading import load
from cellslam.sim.errors import InputError
from cellslam.sim.world import prepare
from tools.preset_facts import mean_facts


@pytest.mark.slow
@pytest.mark.parametrize("name", ["lund-530", "lund-nr", "tiny"])
def test_presets_state_what_is_measured(name: str) -> None:
    scenario = load(name)
    measured = mean_facts(scenario)
    assert list(scenario.facts) == list(measured) != []
    for fact, value in measured.items():
        assert scenario.facts[fact] == pytest.approx(value, rel=0.02, abs=0.02), fact


def test_lund_is_as_in_the_paper_and_rich_enough() -> None:
    scenario = load("lund-530")
    facts = {name: float(value) for name, value in scenario.facts.items()}
    assert (facts["snapshots"], facts["duration_s"], facts["links"]) == (6850, 513.75, 12)
    assert facts["distance_m"] == pytest.approx(530.0, rel=0.005)
    assert facts["paths_per_site"] >= 1.5
    assert facts["distinct_vts"] >= 15
    assert facts["longest_reflected_s"] > 120.0
    assert facts["line_of_sight_share"] > 0.3
    assert [c.cell_id for s in scenario.sites for c in s.cells] == [375, 376, 377, 177, 178, 179]


@pytest.mark.parametrize(
    ("name", "other"), [("lund-530", "noiseless"), ("lund-530", "lund-nr"), ("munich-530", "munich-nr")]
)
def test_drives_are_the_same_with_another_receiver(name: str, other: str) -> None:
    one, another = load(name), load(other)
    for part in ("city", "sites", "vehicle", "odometry"):
        assert getattr(one, part) == getattr(another, part)
    assert one.radio.clock_offset_std_m == another.radio.clock_offset_std_m == 150.0


def test_a_survey_changes_nothing_of_the_world() -> None:
    one, another = load("lund-530"), load("lund-known")
    for part in ("city", "vehicle", "odometry", "radio", "facts"):
        assert getattr(one, part) == getattr(another, part)
    for site, known in zip(one.sites, another.sites, strict=True):
        assert known == site.model_copy(update={"known": True, "survey_std_m": 1.0})


@pytest.mark.slow
@pytest.mark.parametrize("name", ["lund-nr", "munich-nr"])
def test_near_and_far_cells_of_nr_share_no_elements(name: str) -> None:
    scenario = load(name)
    ports = [(cell.cell_id, port) for site in scenario.sites for cell in site.cells for port in range(site.ports)]
    assert sorted(scenario.radio.waveform().combs(ports)) == list(range(12))
    assert scenario.radio.waveform().bandwidth_hz == 272 * 12 * 30e3
    more = load(name, {"radio.prs_comb": 6, "radio.prs_symbols": 6})
    with pytest.raises(InputError, match="12 ports share a comb of 6"):
        prepare(more.world, 0, 0)
