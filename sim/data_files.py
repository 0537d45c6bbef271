"""Text, TOML, JSON and NumPy files that may be from a stranger: sizes are compared before they are read.

The errors are those that a reader expects of a file, OSError and ValueError, whatever goes wrong within: who calls adds
what the file should have been. (UnicodeDecodeError, TOMLDecodeError and JSONDecodeError are ValueErrors.)
"""

from __future__ import annotations

import errno
import json
import math
import tomllib
import zipfile
from pathlib import Path
from typing import IO, Any

import numpy as np
from numpy.typing import NDArray

MOST_TEXT_BYTES = 2**28  # 256 MiB: a CityJSON of a whole city has less; a device has no end
MOST_DEFLATED = 1100  # deflate makes 1032 bytes at the most of one: more is damage, not data


def text_of(path: str | Path) -> str:
    """Return a UTF-8 text file."""
    try:
        with Path(path).open("rb") as file:
            content = file.read(MOST_TEXT_BYTES + 1)
    except ValueError as error:  # a NUL
        raise OSError(errno.EINVAL, f"no name of a file: {error}") from error
    if len(content) > MOST_TEXT_BYTES:
        raise OSError(errno.EFBIG, f"has more than {MOST_TEXT_BYTES >> 20} MiB: no text that is read here has so much")
    return content.decode("utf-8")


def toml_of(text: str) -> dict[str, Any]:
    """Return TOML as plain tables. Raises TOMLDecodeError."""
    try:
        return tomllib.loads(text)
    except tomllib.TOMLDecodeError:
        raise
    except RecursionError:
        raise tomllib.TOMLDecodeError("nested too deep") from None
    except ValueError as error:  # an integer of thousands of digits
        raise tomllib.TOMLDecodeError(str(error)) from error


def json_of(text: str) -> Any:
    """Return JSON as plain values. Raises ValueError."""
    try:
        return json.loads(text)
    except RecursionError:
        raise ValueError("nested too deep") from None


def arrays_of(path: str | Path) -> dict[str, NDArray[Any]]:
    """Return the arrays of an .npz file, by name, or that of an .npy file under the name ''. No objects: no pickles."""
    try:
        if not zipfile.is_zipfile(path):
            with Path(path).open("rb") as file:
                _check_header(file, Path(path).stat().st_size)
            return {"": np.load(path, allow_pickle=False)}
        with zipfile.ZipFile(path) as whole:
            for member in whole.infolist():
                if member.file_size > MOST_DEFLATED * max(member.compress_size, 1):
                    raise ValueError(f"'{member.filename}' says that it holds {member.file_size} bytes")
                with whole.open(member) as opened:
                    _check_header(opened, member.file_size)
        with np.load(path, allow_pickle=False) as held:
            return {name: np.asarray(held[name]) for name in held.files}
    except (OSError, ValueError):
        raise
    except Exception as error:  # zip, deflate and NumPy's header have errors of their own
        raise ValueError(f"damaged: {error}") from error


def _check_header(file: IO[bytes], size: int) -> None:
    """Raise ValueError unless the array that an .npy header declares fits into so many bytes."""
    version = np.lib.format.read_magic(file)
    read = np.lib.format.read_array_header_1_0 if version == (1, 0) else np.lib.format.read_array_header_2_0
    shape, _, kind = read(file)
    if math.prod(shape) * kind.itemsize > size:
        raise ValueError(f"an array of shape {shape} does not fit into {size} bytes")
