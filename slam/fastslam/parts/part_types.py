"""The parts of the filter that can be replaced: each is a tuple type, and the kernels are compiled for the types given.

A function that is `replaceable` is what the filter does by default; a part's type may have a `variant` of it. The
compiler takes it in as if it stood there, so that a choice costs nothing, and what is not chosen is not compiled. A
part of your own is a NamedTuple with variants of one or more of these; `FastSlam(options, association=Mine())` uses it:

    associate, may_be_born                                          association.py
    score                                                           criterion.py
    clock_moves, rate_changes, load_clock, begin_clock, refresh, widen, learn, offset_belief
                                                                    clock.py
"""

from __future__ import annotations

from collections.abc import Callable
from typing import Any, NamedTuple, TypeVar

from numba.extending import overload

from cellslam.sim.compiling import njit

Function = TypeVar("Function", bound=Callable[..., Any])


class Parts(NamedTuple):
    """How measurements are associated, by which criterion, and what is done about clock offsets."""

    association: Any
    criterion: Any
    clock: Any


_VARIANTS: dict[Any, dict[Any, Any]] = {}  # of each function that is replaceable: what it is for types of parts


def replaceable(function: Function) -> Function:
    """Let compiled code that calls the function with a part first take the part's `variant`, if there is one."""
    variants = _VARIANTS.setdefault(function, {})

    def chosen(part: Any, *others: Any) -> Any:
        return variants.get(getattr(part, "instance_class", None), function)

    overload(function, jit_options={"error_model": "numpy"}, strict=False)(chosen)
    return function


def variant(function: Callable[..., Any], kind: type) -> Callable[[Function], Function]:
    """Take the decorated function in place of a replaceable one where the part is a `kind`."""

    def register(own: Function) -> Function:
        _VARIANTS[function][kind] = own
        return own

    return register


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
