"""What is inside Numba, changed so that a function is compiled as a part of its kernels alone (`compiling.part`)."""

from __future__ import annotations

from typing import Any

import numba
import numba.extending
from numba.core.codegen import JITCodeLibrary
from numba.core.compiler import Compiler


class Part(numba.types.Dispatcher):
    """The type of a part, which is compiled once for all numbers of a type; Numba's own is for each constant again."""

    def get_call_type(self, context: Any, args: Any, kws: Any) -> Any:
        """Return the signature for arguments of these types."""
        plain: Any = numba.types.unliteral
        return super().get_call_type(context, tuple(map(plain, args)), {name: plain(one) for name, one in kws.items()})


numba.extending.register_model(Part)(numba.extending.models.OpaqueModel)


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


class PartCompiler(Compiler):
    """Numba's compiler, which leaves what it makes in a `_PartLibrary`."""

    def __init__(self, typing: Any, target: Any, library: Any, *more: Any) -> None:
        own: Any = _PartLibrary
        super().__init__(typing, target, library or own(target.codegen(), "part"), *more)  # type: ignore[no-untyped-call]
