"""Numba's `njit` with a cache that knows what a kernel is made of, and functions that are parts of kernels alone.

**Cache.** Numba looks a cached kernel up by its own file alone: after an edit, or an upgrade, of a file that the kernel
calls into, the old binary would run; and in a copy of the same sources nothing is found. Here a kernel's place in the
cache is a digest of the content of all sources that its module can reach by imports, and of Numba's version. So copies
and environments share it. It is in the user's cache folder, in NUMBA_CACHE_DIR, or where neither can be written in a
private folder of the system's temporary one.

**Parts.** `part` and `lean` make kernels compile several times as fast by means that are inside Numba
(`compiling_parts`). With a version that they were not tested with (`TESTED`), or with CELLSLAM_PLAIN_NJIT=1, they are
plain `njit`.
"""

from __future__ import annotations

import atexit
import hashlib
import os
import re
import shutil
import tempfile
from collections.abc import Callable
from contextlib import suppress
from functools import cache, partial, wraps
from pathlib import Path
from typing import Any, Protocol, TypeVar, cast, overload

import numba
from numba.core import caching
from numba.misc.appdirs import AppDirs

from cellslam.sim.files import private_folder

PACKAGE = "cellslam"
TESTED = ("0.68",)  # versions of Numba whose inner parts are known
PLAIN = not numba.__version__.startswith(TESTED) or os.environ.get("CELLSLAM_PLAIN_NJIT", "") not in ("", "0")
KEPT = 8  # folders of earlier sources that are kept for a module: of other checkouts, and of versions still running
_IMPORT = re.compile(rf"^ *from {PACKAGE}\.([\w.]+) import (?:\(([^)]*)\)|([^\n(]+))", re.MULTILINE)

Kernel = TypeVar("Kernel", bound=Callable[..., Any])


class _Decorator(Protocol):
    @overload
    def __call__(self, function: Kernel, /) -> Kernel: ...
    @overload
    def __call__(self, **options: Any) -> Callable[[Kernel], Kernel]: ...


def _decorator(compiled: Callable[..., Any]) -> _Decorator:
    """Let `compiled`, which is called with a function and options, be written above a function, with options or not."""

    @wraps(compiled)
    def decorate(function: Any = None, /, **options: Any) -> Any:
        return partial(compiled, **options) if function is None else compiled(function, **options)

    return cast(_Decorator, decorate)


@_decorator
def njit(function: Any, **options: Any) -> Any:
    """Compile a function as `numba.njit` does; with `cache=True` into the folder that belongs to its sources."""
    cached = options.pop("cache", False)
    compiled = numba.njit(function, **{"_nrt": True, **options})
    if cached and not numba.config.DISABLE_JIT:  # type: ignore[attr-defined]
        compiled._cache = _Cache(function)  # type: ignore[no-untyped-call]
    return compiled


@_decorator
def part(function: Any, **options: Any) -> Any:
    """Let kernels call a function, as a part of each kernel; Python, when it calls it, interprets it.

    A function that `njit` compiles is optimised and made machine code, with a way in from Python, and once more in
    every kernel that calls it, and so on upwards: much more work than for the kernels alone. An exception that a part
    raises has constants for arguments.
    """
    if PLAIN:
        return numba.njit(function, **{"fastmath": False, **options})
    from cellslam.sim.compiling_parts import Part, PartCompiler

    # What is not said here is as in the kernel that calls first, and then the same for those that follow.
    own = {"_nrt": True, "fastmath": False, "no_cpython_wrapper": True, "no_cfunc_wrapper": True}
    compiled = numba.njit(function, pipeline_class=PartCompiler, **{**own, **options})
    # Kernels take a function for what this says; numba holds it by a weak reference.
    function._numba_type_, function._compiled = Part(compiled), compiled
    return function


@_decorator
def lean(function: Any, **options: Any) -> Any:
    """Make a function a `part` of kernels that makes no arrays and returns none.

    Numba counts the references to each array that a function is handed, which can cost more than what small functions
    do with them. Here nothing is counted. A function that makes an array all the same is refused by Numba.
    """
    uncounted: dict[str, Any] = {} if PLAIN else {"_nrt": False}
    return part(**uncounted, **options)(function)


class _Locator(caching._CacheLocator):
    """Tells Numba where a function is cached, and what stands for its sources."""

    def __init__(self, function: Any, file: str) -> None:
        self._py_file = file  # for Numba's warnings
        self._folder = cache_folder(function.__module__, Path(file))
        self._line = function.__code__.co_firstlineno

    @classmethod
    def from_function(cls, function: Any, file: str) -> _Locator:
        return cls(function, file)

    def get_cache_path(self) -> str:
        return str(self._folder)

    def get_source_stamp(self) -> str:
        return self._folder.name

    def get_disambiguator(self) -> str:  # of functions of one name in one file
        return str(self._line)


class _CacheImpl(caching.CompileResultCacheImpl):
    _locator_classes = [_Locator]  # noqa: RUF012


class _Cache(caching.FunctionCache):
    _impl_class = _CacheImpl


def is_compiled(module: str, file: Path) -> bool:
    """Return whether a kernel of this module was compiled before from the sources as they are, and is in the cache."""
    return any(cache_folder(module, file).glob("*.nbi"))


@cache
def cache_folder(module: str, file: Path) -> Path:
    """Return the cache folder of the kernels of a module of this package; with a new one, the oldest are removed."""
    root = file.parents[module.count(".") - 1]
    digest = hashlib.sha256(f"{numba.__version__} {PLAIN}".encode())
    for source in sorted(reachable(file, root)):
        digest.update(str(source.relative_to(root)).encode() + _read(source, root)[0])
    base = _base()
    folder = base / f"{module}-{digest.hexdigest()[:16]}"
    if not folder.exists():
        old = sorted(base.glob(f"{module}-{'[0-9a-f]' * 16}"), key=lambda other: other.stat().st_mtime)
        for other in old[:-KEPT]:
            shutil.rmtree(other, ignore_errors=True)
    return folder


@cache
def _base() -> Path:
    """Return the folder of all caches: one that can be written, by nobody else, as compiled code is run from it."""
    chosen = os.environ.get("NUMBA_CACHE_DIR")
    base = Path(chosen or AppDirs(PACKAGE, appauthor=False).user_cache_dir) / "kernels"  # type: ignore[no-untyped-call]
    with suppress(OSError):
        base.mkdir(parents=True, exist_ok=True)
    if os.access(base, os.W_OK):
        return base
    private = private_folder("kernels")
    if private is None:  # a folder of this process alone
        private = Path(tempfile.mkdtemp(prefix=f"{PACKAGE}-"))
        atexit.register(shutil.rmtree, private, ignore_errors=True)
    return private


def reachable(file: Path, root: Path) -> set[Path]:
    """Return the sources of the package that a module reaches by its imports, its own file included.

    `root`: the folder that holds the rooms (`sim`, `slam`, ...).
    """
    found, todo = {file}, [file]
    while todo:
        new = {*_read(todo.pop(), root)[1]} - found
        found |= new
        todo += new
    return found


@cache
def _read(file: Path, root: Path) -> tuple[bytes, tuple[Path, ...]]:
    """Return the digest of a source, and the files that its import statements name."""
    content = file.read_bytes()
    named: list[Path] = []
    for base, many, few in _IMPORT.findall(content.decode("utf-8")):
        place = root.joinpath(*base.split("."))
        modules = [place / f"{name.split()[0]}.py" for name in (many or few).split(",") if name.strip()]
        own = place.with_suffix(".py")
        named += [own] if own.is_file() else [path for path in (place / "__init__.py", *modules) if path.is_file()]
    return hashlib.sha256(content).digest(), tuple(named)
