"""Numba's `njit` with a cache that notices edits, and functions that are compiled as parts of their kernels alone.

Numba looks a cached kernel up by the time and size of its own file alone: after an edit, or an upgrade, of a file that
the kernel calls into, the old binary would run. Here a kernel's cache has a folder of its own for each digest of all
the sources that its module can reach by imports, and of Numba's version.
"""

from __future__ import annotations

import hashlib
import os
import re
import shutil
from collections.abc import Callable, Iterator
from functools import cache, partial
from pathlib import Path
from typing import Any, TypeVar, overload

import numba
import numba.extending
from numba.core.codegen import JITCodeLibrary
from numba.core.compiler import Compiler
from numba.misc.appdirs import AppDirs

PACKAGE = "cellslam"
KEPT = 4  # folders of earlier sources that are kept for a module: of branches, or of a version that is still running
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
    options.setdefault("_nrt", True)
    if not options.get("cache"):
        return numba.njit(function, **options)
    before = numba.config.CACHE_DIR  # type: ignore[attr-defined]
    numba.config.CACHE_DIR = str(cache_folder(function.__module__, Path(function.__code__.co_filename)))  # type: ignore[attr-defined]
    try:
        return numba.njit(function, **options)
    finally:
        numba.config.CACHE_DIR = before  # type: ignore[attr-defined]


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
    # What is not said here is as in the kernel that calls first, and then the same for those that follow.
    own = {"_nrt": True, "fastmath": False, "no_cpython_wrapper": True, "no_cfunc_wrapper": True}
    compiled = numba.njit(function, pipeline_class=_PartCompiler, **{**own, **options})
    # Kernels take a function for what this says; numba holds it by a weak reference.
    function._numba_type_, function._compiled = _Part(compiled), compiled
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
    return partial(lean, **options) if function is None else part(_nrt=False, **options)(function)


class _Part(numba.types.Dispatcher):
    """The type of a part, which is compiled once for all numbers of a type; Numba's own is for each constant anew."""

    def get_call_type(self, context: Any, args: Any, kws: Any) -> Any:
        """Return the signature for arguments of these types."""
        plain: Any = numba.types.unliteral
        return super().get_call_type(context, tuple(map(plain, args)), {name: plain(one) for name, one in kws.items()})


numba.extending.register_model(_Part)(numba.extending.models.OpaqueModel)


class _PartLibrary(JITCodeLibrary):
    """The intermediate code of a part: it is linked with the parts that it calls, and left as it is for the kernel."""

    def finalize(self) -> None:
        """Link. Numba's own also optimises, and makes machine code."""
        for library in dict.fromkeys(self._linking_libraries):
            self._reload_init.update(library._reload_init)
            self._final_module.link_in(library._get_module_for_linking(), preserve=True)
        self._finalized = True

    def get_pointer_to_function(self, name: str) -> int:
        """Return null: there is no machine code."""
        del name
        return 0

    @property
    def codegen(self) -> _PartLibrary:
        """What `set_env` is called of: there is no machine code whose environment could be set."""
        return self

    def set_env(self, name: str, env: Any) -> None:
        """Do nothing."""


class _PartCompiler(Compiler):
    """Numba's compiler, which leaves what it makes in a `_PartLibrary`."""

    def __init__(self, typing: Any, target: Any, library: Any, *more: Any) -> None:
        own: Any = _PartLibrary
        super().__init__(typing, target, library or own(target.codegen(), "part"), *more)  # type: ignore[no-untyped-call]


def is_compiled(module: str, file: Path) -> bool:
    """Return whether a kernel of this module was compiled before from the sources as they are, and is in the cache."""
    return any(cache_folder(module, file).rglob("*.nbi"))


@cache
def cache_folder(module: str, file: Path) -> Path:
    """Return the cache folder of the kernels of a module of this package, made if need be; older ones are removed.

    It is in `__pycache__` beside the module, or in the user's cache folder where that cannot be written. Numba also
    compares time and size of the module's own file, so these are part of the digest: what is there is valid.
    """
    stamp = file.stat()
    digest = hashlib.sha256(f"{numba.__version__} {file} {stamp.st_mtime_ns} {stamp.st_size}".encode())
    for source in sorted(reachable(file, file.parents[module.count(".") - 1])):
        digest.update(_digest(source))
    beside = file.parent / "__pycache__"
    base = beside if os.access(beside if beside.exists() else file.parent, os.W_OK) else Path(_user_folder())
    folder = base / f"{file.stem}-{digest.hexdigest()[:16]}"
    if not folder.exists():
        _remove_old(base, file.stem)
    return folder


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


def _remove_old(base: Path, stem: str) -> None:
    old = sorted(base.glob(f"{stem}-{'[0-9a-f]' * 16}"), key=lambda folder: folder.stat().st_mtime)
    for folder in old[:-KEPT]:
        shutil.rmtree(folder, ignore_errors=True)


def _user_folder() -> str:
    return str(AppDirs(PACKAGE, appauthor=False).user_cache_dir)  # type: ignore[no-untyped-call]
