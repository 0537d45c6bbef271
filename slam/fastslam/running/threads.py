"""Blocks of particles shared out among threads: no block reads another."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from functools import partial
from typing import Any

from cellslam.slam.fastslam.running.turns_kernel import DONE, new_turns
from cellslam.slam.model.threads import hands, threads


def over_blocks(kernel: Callable[..., None], blocks: int, scratch: Sequence[Any], *arguments: Any) -> None:
    """Call kernel(turns, blocks, *arguments, scratch of the thread) in as many threads as may be, until all blocks are
    done."""
    turns = new_turns()
    with hands(min(len(scratch), blocks, threads()) - 1) as others:
        for other, own in zip(others, scratch[1:], strict=False):
            other.begin(partial(kernel, turns, blocks, *arguments, own))
        kernel(turns, blocks, *arguments, scratch[0])
        if turns[DONE] < blocks:
            for other in others:
                other.wait()
