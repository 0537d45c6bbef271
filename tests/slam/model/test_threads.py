"""Shares of work in threads: each is done once, in as many threads as are allowed, and what one raises is raised."""

from __future__ import annotations

import threading
import time
from collections import Counter
from collections.abc import Iterator
from functools import partial

import numba
import pytest

from cellslam.slam.joint.mixture import together
from cellslam.slam.model.threads import in_threads


@pytest.fixture
def threads_as_before() -> Iterator[None]:
    before = numba.get_num_threads()
    yield
    numba.set_num_threads(before)


def test_each_share_has_a_thread_of_its_own() -> None:
    meeting, met = threading.Barrier(3, timeout=10.0), dict[int, int]()

    def share(i: int) -> None:
        meeting.wait()  # nobody passes before all three are there
        met[i] = threading.get_ident()

    for _ in range(2):
        in_threads(share, 3)
    assert sorted(met) == [0, 1, 2] and len(set(met.values())) == 3


@pytest.mark.parametrize("bad", [0, 1, 2])
def test_what_a_share_raises_is_raised_when_all_are_done(bad: int) -> None:
    done, raised = list[int](), threading.Event()

    def share(i: int) -> None:
        if i == bad:
            raised.set()
            raise ValueError("no such filter")
        raised.wait(10.0)
        time.sleep(0.05 * i)
        done.append(i)

    with pytest.raises(ValueError, match="no such filter"):
        in_threads(share, 3)
    assert sorted([*done, bad]) == [0, 1, 2]
    in_threads(done.append, 3)  # the threads are still there
    assert len(done) == 5


@pytest.mark.parametrize(
    ("allowed", "filters", "loads"),
    [(1, [5], [5]), (2, [5], [2, 3]), (2, [1], [1]), (2, [1, 1, 1], [1, 2]), (2, [1, 3, 2, 1], [3, 4])],
)
@pytest.mark.usefixtures("threads_as_before")
def test_filters_are_shared_out_to_the_threads_that_are_allowed(
    allowed: int, filters: list[int], loads: list[int]
) -> None:
    """A worker of a sweep has one thread; with as many as there are cores in each worker they would wait for others."""
    assert allowed <= numba.config.NUMBA_NUM_THREADS, "one core: this cannot be tested"
    numba.set_num_threads(allowed)
    done = list[tuple[int, int, int]]()  # thread, mixture, filter

    def work(mixture: int, first: int, step: int) -> None:
        done.extend((threading.get_ident(), mixture, k) for k in range(first, filters[mixture], step))

    together([partial(work, mixture) for mixture in range(len(filters))], filters)
    assert sorted(one[1:] for one in done) == [
        (mixture, k) for mixture, count in enumerate(filters) for k in range(count)
    ]
    assert sorted(Counter(thread for thread, *_ in done).values()) == loads
