"""Filters of several mixtures in threads: each takes its turn once, and what one raises is raised."""

from __future__ import annotations

import os
import threading
from functools import partial

import numba
import pytest

from cellslam.slam.joint.mixture import together


@pytest.mark.parametrize("allowed", [1, 2, 3])
@pytest.mark.parametrize("filters", [[5], [1], [1, 1, 1], [1, 3, 2, 1]])
def test_each_filter_is_done_once(allowed: int, filters: list[int], monkeypatch: pytest.MonkeyPatch) -> None:
    """A worker of a sweep has one thread; with as many as there are cores in each worker they would wait for others."""
    monkeypatch.setattr(numba, "get_num_threads", lambda: allowed)
    done = list[tuple[int, int, int]]()  # thread, mixture, filter

    def work(mixture: int, first: int, step: int) -> None:
        done.extend((threading.get_ident(), mixture, k) for k in range(first, filters[mixture], step))

    together([partial(work, mixture) for mixture in range(len(filters))], filters)
    each = [(mixture, k) for mixture, count in enumerate(filters) for k in range(count)]
    assert sorted(one[1:] for one in done) == each
    assert len({thread for thread, *_ in done}) <= min(allowed, len(each))


@pytest.mark.parametrize("bad", [0, 1])
def test_what_a_filter_raises_is_raised(bad: int, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(numba, "get_num_threads", lambda: 2)

    def work(first: int, step: int) -> None:
        if first == bad:
            raise ValueError("no such filter")

    with pytest.raises(ValueError, match="no such filter"):
        together([work], [2])


@pytest.mark.skipif(not hasattr(os, "fork"), reason="processes cannot be forked here")
@pytest.mark.filterwarnings("ignore::DeprecationWarning")
def test_a_process_that_was_forked_has_threads_of_its_own(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(numba, "get_num_threads", lambda: 2)
    done = list[int]()
    together([lambda first, step: done.append(first)], [2])
    if not (child := os.fork()):
        together([lambda first, step: done.append(first)], [2])
        os._exit(len(done))
    assert os.waitstatus_to_exitcode(os.waitpid(child, 0)[1]) == 4
