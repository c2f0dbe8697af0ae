"""Numba with half the work: what a process that only compiles loops leaves out. `shorten_compilation` is called by nobody else.

Numba makes every function that a loop calls ready to run by itself: linked with all that it calls, optimised, and turned into
machine code, all thrown away once the loop holds a copy. Here a part is what its own lines say until a loop is put together from
all its parts, each once; the loop alone is optimised and turned into machine code. Its parts are its own: Numba leaves them visible
to other loops (`linkonce_odr`), and a process would run whichever copy it had loaded first, rounded a little differently. A long
part is not copied into every place that calls it, unless it says so (`forceinline`).

Numba compiles a function again for every set of options that callers have; parts state their own. It compares options by all their
values tens of thousands of times, and works out which variables live where after every pass, to be asked once.

What a loop computes is held against NumPy by its tests, whoever compiled it.
"""

from __future__ import annotations

import gc
from typing import Any

from numba.core import postproc, targetconfig, transforms
from numba.core.codegen import JITCodeLibrary
from numba.core.registry import cpu_target
from numba.core.typing.templates import _OverloadFunctionTemplate

from boresight.kernels.compilation import PART

#: Instructions, before anything is optimised, of a part that is called and not copied.
LONG = 300


def shorten_compilation() -> None:
    """Let this process leave out what only interactive use needs."""
    gc.disable()  # it lives for seconds, and everything is reachable from everything
    codegen = cpu_target.target_context.codegen()
    codegen._library_class = _Library
    set_env = codegen.set_env
    codegen.set_env = lambda name, env: set_env(name, env) if codegen._engine.is_symbol_defined(name) else None
    _OverloadFunctionTemplate._get_impl = _find_implementation
    postproc.PostProcessor.run = _post_process


class _Library(JITCodeLibrary):  # type: ignore[misc]  # Numba ships no types
    """Machine code of a loop with all its parts; of a part what its own lines say."""

    _is_part = False

    def _optimize_functions(self, module: Any) -> None:
        module.data_layout = self._codegen._data_layout

    def finalize(self) -> None:
        """Put a loop together and turn it into machine code; leave a part as it is."""
        module = self._final_module
        self._is_part = is_part(module)
        if self._is_part:
            for function in module.functions:
                if not function.is_declaration and function.linkage.name == "external":
                    function.linkage = "linkonce_odr"
            self._finalize_dynamic_globals()
            self._finalized = True
            return
        for library in self._callers_first():
            self._reload_init.update(library._reload_init)
            whole = library._final_module if library._is_part else library._get_module_for_linking()
            module.link_in(whole, preserve=True)
        for function in module.functions:
            if not function.is_declaration and function.linkage.name == "linkonce_odr":
                function.linkage = "internal"
                if not _is_forced(function) and _is_long(function):
                    function.add_function_attribute("noinline")
        passes, builder = self._codegen._module_pass_manager()
        passes.run(module, builder)
        module.verify()
        self._finalize_final_module()

    def _callers_first(self) -> list[_Library]:
        """All libraries that this one calls, and those that they call: what nobody has called yet is not linked."""
        found: dict[int, _Library] = {}

        def visit(library: _Library) -> None:
            for one in library._linking_libraries:
                if id(one) not in found:
                    found[id(one)] = one  # a circle ends here
                    visit(one)
                    found[id(one)] = found.pop(id(one))

        visit(self)
        return list(found.values())[::-1]


def is_part(module: Any) -> bool:
    """Whether a module holds functions of Numba's none of which Python can call."""
    names = [one.name for one in module.functions if not one.is_declaration]
    return all(name.startswith("_ZN") and not name.startswith("_ZN7cpython") for name in names)


def _is_forced(function: Any) -> bool:
    return any(b"alwaysinline" in attribute for attribute in function.attributes)


def _is_long(function: Any) -> bool:
    return sum(1 for block in function.blocks for _ in block.instructions) > LONG


#: Options by identity, each kept so that no other can take its place, with what tells it apart from others.
_told_apart: dict[int, tuple[Any, str]] = {}


def _find_implementation(self: Any, arguments: Any, named: Any) -> Any:
    """Do as `_OverloadFunctionTemplate._get_impl`, which looks through all values of the caller's options each time."""
    options = None
    if not PART.keys() <= self._jit_options.keys():
        flags = targetconfig.ConfigStack.top_or_none()
        if id(flags) not in _told_apart:
            _told_apart[id(flags)] = flags, "" if flags is None else repr(sorted(flags.values().items()))
        options = _told_apart[id(flags)][1]
    key = self.context, tuple(arguments), tuple(named.items()), options
    found = self._impl_cache.get(key)
    return found or self._build_impl(key, arguments, named)


_post_process_all = postproc.PostProcessor.run


def _post_process(self: Any, emit_dels: bool = False, extend_lifetimes: bool = False) -> None:
    """Do as `PostProcessor.run`, without what only generators and Python's own objects ask of a pass."""
    if emit_dels or self.func_ir.is_generator:
        _post_process_all(self, emit_dels, extend_lifetimes)
        return
    self.func_ir.blocks = transforms.canonicalize_cfg(self.func_ir.blocks)
    self.func_ir.variable_lifetime = postproc.VariableLifetime(self.func_ir.blocks)
    self.func_ir.generator_info = None
