"""The one error that a user can cause, and the wording that every such error shares."""

from __future__ import annotations

import difflib
from collections.abc import Iterable

MOST_SAID = 2000


class InputError(ValueError):
    """A request, a file or a value that cannot be used as given.

    The text is one line and is shown to the user as it is: what was given, what is allowed, what to do.
    The command line turns it into exit status 2 without a traceback.
    """


def one_line(value: object, most: int = MOST_SAID) -> str:
    """Return what a value (an exception, mostly) says, as one line of printable text of about `most` characters.

    Never raises: the text may hold anything, be of any length, or fail to be made.
    """
    try:
        text = str(value)
    except BaseException as error:
        return f"(no text: its __str__ raised {type(error).__name__})"
    if len(text) > most:
        text = f"{text[:most]} ... (shortened from {len(text)} characters)"
    return "".join(c if c.isprintable() else "\ufffd" for c in " ".join(text.split()))


def nearest_name(given: str, allowed: Iterable[str]) -> str:
    """Return `; did you mean 'x'?` for the name nearest to `given`, or an empty string if none is near."""
    near = difflib.get_close_matches(given, list(allowed), n=1, cutoff=0.5)
    return f"; did you mean '{near[0]}'?" if near else ""


def unknown_name(kind: str, given: str, allowed: Iterable[str]) -> InputError:
    """Return the error for a name that is not among `allowed`: what was given, the nearest, all of them."""
    names = sorted(allowed)
    return InputError(f"unknown {kind} '{given}'{nearest_name(given, names)} (known: {', '.join(names) or 'none'})")
