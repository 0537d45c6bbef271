"""Numba's `njit` with a cache that knows what a kernel is made of, and functions that are parts of kernels alone.

**Cache.** Numba looks a cached kernel up by the time and size of its own file alone: after an edit, or an upgrade, of a
file that the kernel calls into, the old binary would run; and in a copy of the same sources nothing is found. Here a
kernel's place in the cache is a digest of the content of all sources that its module can reach by imports, and of
Numba's version. So copies and environments share it. It is in the user's cache folder, or in NUMBA_CACHE_DIR.

**Parts.** `part` and `lean` make kernels compile several times as fast by means that are inside Numba. With a version
that they were not tested with (`TESTED`), or with CELLSLAM_PLAIN_NJIT=1, they are plain `njit`.
"""

from __future__ import annotations

import hashlib
import os
import re
import shutil
import tempfile
from collections.abc import Callable, Iterator
from contextlib import suppress
from functools import cache, partial
from pathlib import Path
from typing import Any, TypeVar, overload

import numba
from numba.core import caching
from numba.misc.appdirs import AppDirs

PACKAGE = "cellslam"
TESTED = ("0.68",)  # versions of Numba whose inner parts are known
PLAIN = not numba.__version__.startswith(TESTED) or os.environ.get("CELLSLAM_PLAIN_NJIT", "") not in ("", "0")
KEPT = 8  # folders of earlier sources that are kept for a module: of other checkouts, and of versions still running
_IMPORT = re.compile(rf"^ *from {PACKAGE}\.([\w.]+) import (?:\(([^)]*)\)|([^\n(]+))", re.MULTILINE)

Kernel = TypeVar("Kernel", bound=Callable[..., Any])


@overload
def njit(function: Kernel, /) -> Kernel: ...
@overload
def njit(**options: Any) -> Callable[[Kernel], Kernel]: ...


def njit(function: Any = None, /, **options: Any) -> Any:
    """Compile a function as `numba.njit` does; with `cache=True` into the folder that belongs to its sources."""
    if function is None:
        return partial(njit, **options)
    cached = options.pop("cache", False)
    compiled = numba.njit(function, **{"_nrt": True, **options})
    if cached and not numba.config.DISABLE_JIT:  # type: ignore[attr-defined]
        compiled._cache = _Cache(function)  # type: ignore[no-untyped-call]
    return compiled


class _Locator:
    """Tells Numba where a function is cached, and what stands for its sources."""

    def __init__(self, function: Any) -> None:
        self._py_file = function.__code__.co_filename  # for Numba's warnings
        self._folder = cache_folder(function.__module__, Path(self._py_file))
        self._line = function.__code__.co_firstlineno

    @classmethod
    def from_function(cls, function: Any, file: str) -> _Locator:
        """Return the locator of a function of this package."""
        del file
        return cls(function)

    def ensure_cache_path(self) -> None:
        """Make the folder."""
        self._folder.mkdir(parents=True, exist_ok=True)

    def get_cache_path(self) -> str:
        """Return the folder."""
        return str(self._folder)

    def get_source_stamp(self) -> str:
        """Return what changes with the sources."""
        return self._folder.name

    def get_disambiguator(self) -> str:
        """Return what tells functions of one name in one file apart."""
        return str(self._line)


class _CacheImpl(caching.CompileResultCacheImpl):
    _locator_classes = [_Locator]  # type: ignore[list-item]  # noqa: RUF012


class _Cache(caching.FunctionCache):
    _impl_class = _CacheImpl


@overload
def part(function: Kernel, /) -> Kernel: ...
@overload
def part(**options: Any) -> Callable[[Kernel], Kernel]: ...


def part(function: Any = None, /, **options: Any) -> Any:
    """Let kernels call a function, as a part of each kernel; Python, when it calls it, interprets it.

    A function that `njit` compiles is optimised and made machine code, with a way in from Python, and once more in
    every kernel that calls it, and so on upwards: much more work than for the kernels alone. An exception that a part
    raises has constants for arguments.
    """
    if function is None:
        return partial(part, **options)
    if PLAIN:
        return numba.njit(function, **{"fastmath": False, **options})
    from cellslam.sim.compiling_parts import Part, PartCompiler

    # What is not said here is as in the kernel that calls first, and then the same for those that follow.
    own = {"_nrt": True, "fastmath": False, "no_cpython_wrapper": True, "no_cfunc_wrapper": True}
    compiled = numba.njit(function, pipeline_class=PartCompiler, **{**own, **options})
    # Kernels take a function for what this says; numba holds it by a weak reference.
    function._numba_type_, function._compiled = Part(compiled), compiled
    return function


@overload
def lean(function: Kernel, /) -> Kernel: ...
@overload
def lean(**options: Any) -> Callable[[Kernel], Kernel]: ...


def lean(function: Any = None, /, **options: Any) -> Any:
    """Make a function a `part` of kernels that makes no arrays and returns none.

    Numba counts the references to each array that a function is handed, which can cost more than what small functions
    do with them. Here nothing is counted. A function that makes an array all the same is refused by Numba.
    """
    if function is None:
        return partial(lean, **options)
    uncounted: dict[str, Any] = {} if PLAIN else {"_nrt": False}
    return part(**uncounted, **options)(function)


def is_compiled(module: str, file: Path) -> bool:
    """Return whether a kernel of this module was compiled before from the sources as they are, and is in the cache."""
    return any(cache_folder(module, file).glob("*.nbi"))


@cache
def cache_folder(module: str, file: Path) -> Path:
    """Return the cache folder of the kernels of a module of this package; with a new one, the oldest are removed."""
    root = file.parents[module.count(".") - 1]
    digest = hashlib.sha256(f"{numba.__version__} {PLAIN}".encode())
    for source in sorted(reachable(file, root)):
        digest.update(str(source.relative_to(root)).encode() + _digest(source))
    base = _base()
    folder = base / f"{module}-{digest.hexdigest()[:16]}"
    if not folder.exists():
        _remove_old(base, module)
    return folder


@cache
def _base() -> Path:
    """Return the folder of all caches: one that can be written."""
    chosen = os.environ.get("NUMBA_CACHE_DIR")
    base = Path(chosen or AppDirs(PACKAGE, appauthor=False).user_cache_dir) / "kernels"  # type: ignore[no-untyped-call]
    with suppress(OSError):
        base.mkdir(parents=True, exist_ok=True)
    return base if os.access(base, os.W_OK) else Path(tempfile.gettempdir()) / f"{PACKAGE}-kernels-{os.getuid()}"


def reachable(file: Path, root: Path) -> set[Path]:
    """Return the sources of the package that a module reaches by its imports, its own file included.

    `root`: the folder that holds the rooms (`sim`, `slam`, ...).
    """
    found, todo = {file}, [file]
    while todo:
        new = {*_imported(todo.pop(), root)} - found
        found |= new
        todo += new
    return found


@cache
def _imported(file: Path, root: Path) -> tuple[Path, ...]:
    return tuple(_sources(file.read_text("utf-8"), root))


def _sources(source: str, root: Path) -> Iterator[Path]:
    """Yield the files that the import statements of a source name."""
    for base, many, few in _IMPORT.findall(source):
        place = root.joinpath(*base.split("."))
        if place.with_suffix(".py").is_file():
            yield place.with_suffix(".py")
            continue
        modules = [place / f"{name.split()[0]}.py" for name in (many or few).split(",") if name.strip()]
        yield from (path for path in (place / "__init__.py", *modules) if path.is_file())


@cache
def _digest(file: Path) -> bytes:
    return hashlib.sha256(file.read_bytes()).digest()


def _remove_old(base: Path, module: str) -> None:
    old = sorted(base.glob(f"{module}-{'[0-9a-f]' * 16}"), key=lambda folder: folder.stat().st_mtime)
    for folder in old[:-KEPT]:
        shutil.rmtree(folder, ignore_errors=True)
