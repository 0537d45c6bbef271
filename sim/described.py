"""A short `repr` for data classes of arrays: shapes where the values would fill pages."""

from __future__ import annotations

from collections.abc import Mapping, Sized
from dataclasses import fields
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    import pandas as pd

LONGEST = 60
POSITION_COLUMNS = ("x_m", "y_m", "z_m")
POSE_COLUMNS = (*POSITION_COLUMNS, "yaw_rad", "pitch_rad", "roll_rad")


class Described:
    """Base of data classes (declared with `repr=False`) whose `repr` tells the shape of each array."""

    def __repr__(self) -> str:
        values = ((one.name, getattr(self, one.name)) for one in fields(self))  # type: ignore[arg-type]
        parts = [f"{name}={described(value)}" for name, value in values if value is not None]
        return f"{type(self).__name__}({', '.join(parts)})"


def described(value: Any) -> str:
    """Return a value in a few words: an array by its shape, what is long by its kind and length."""
    shape = getattr(value, "shape", None)
    if isinstance(shape, tuple) and shape:
        return f"array{shape}"
    text = repr(value)
    if len(text) <= LONGEST or isinstance(value, Described):
        return text
    many = f" of {len(value)}" if isinstance(value, Sized) else ""
    kind = "mapping" if isinstance(value, Mapping) else type(value).__name__
    return f"<{kind}{many}>"


def dataframe(columns: Mapping[str, Any]) -> pd.DataFrame:
    """Return columns as a pandas table; those that are None are left out."""
    import pandas as pd

    return pd.DataFrame({name: column for name, column in columns.items() if column is not None})
