"""The parts of the filter that can be replaced: each is a tuple type, and the kernels are compiled for the types given.

What a part does is an implementation of one or more of the functions below for its type, by Numba's `overload`: the
compiler takes it in as if it stood there, so that a choice costs nothing, and what is not chosen is not compiled. A
part of your own is a NamedTuple with such an implementation; `FastSlam(options, association=Mine())` uses it.

    associate, may_be_born                                                          association.py
    score                                                                           criterion.py
    moved, corrected, place, slopes, begin, begin_spread, begin_gain, locate        landmarks.py
    expect, absorb, begin_offset, offset_belief; if it has more to say: clock_moves,
    rate_changes, load_clock, widen, correct_clock                                  clock.py
"""

from __future__ import annotations

from collections.abc import Callable
from typing import Any, NamedTuple

from cellslam.sim.compiling import njit


class Parts(NamedTuple):
    """How measurements are associated, by which criterion, how VTs are kept, and what is done about clock offsets."""

    association: Any
    criterion: Any
    landmarks: Any
    clock: Any


def is_of(part: Any, kind: type) -> bool:
    """Return whether the Numba type `part` is that of tuples of class `kind`."""
    return getattr(part, "instance_class", None) is kind


def are_own(parts: Parts) -> bool:
    """Return whether all parts are this package's."""
    return all(type(part).__module__.startswith(__package__) for part in parts)


def cached_and_not(kernel: Callable[..., Any]) -> Callable[[Parts], Any]:
    """Compile a kernel that begins with `parts`, or has them among its arguments, twice over; return which of the two
    to take for given parts.

    What is compiled for parts of the caller's own is not kept on disk: whoever reads the cache would need them.
    """
    cached: Any = njit(cache=True, error_model="numpy", nogil=True)(kernel)
    plain: Any = njit(error_model="numpy", nogil=True)(kernel)

    def suitable(parts: Parts) -> Any:
        return cached if are_own(parts) else plain

    suitable.cached = cached  # type: ignore[attr-defined]
    return suitable


INLINE: dict[str, Any] = {"jit_options": {"error_model": "numpy"}, "inline": "always"}
COMPILED: dict[str, Any] = {"jit_options": {"error_model": "numpy"}}
