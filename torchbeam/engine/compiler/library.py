"""Native code: LLVM's text compiled for this processor, loaded, and kept by its object.

llvmlite, the compiler library, is imported here when code is first asked for.
"""

from __future__ import annotations

from collections.abc import Callable
from functools import cache
from typing import Any, ClassVar

from .object_cache import ObjectCache, key_of


class Library:
    """Functions of one module in memory; they stay as long as this object does. cache:
    None = nothing is kept on disk; name: what determines the text, which is then asked for only
    where there is no object by that name, None = the text itself. count: of all made so far.
    """

    count: ClassVar[int] = 0

    def __init__(
        self,
        text: str | Callable[[], str],
        cache: ObjectCache | None = None,
        name: str | None = None,
    ) -> None:
        binding = _binding()
        machine = _machine()
        if callable(text) and name is None:
            text = text()
        key = key_of(text if name is None else name, *_host())
        data = None if cache is None else cache.get(key)
        self.compiled = data is None  # whether it was not found in the cache
        if data is None:
            data = _object(text() if callable(text) else text, machine)
            if cache is not None:
                cache.put(key, data)
        self.size = len(data)
        self._engine = binding.create_mcjit_compiler(binding.parse_assembly(""), machine)
        self._engine.add_object_file(binding.ObjectFileRef.from_data(data))
        self._engine.finalize_object()
        Library.count += 1

    def address(self, name: str) -> int:
        """Of a function. Raises ValueError where there is none of that name."""
        address = self._engine.get_function_address(name)
        if not address:
            raise ValueError(
                f"no function {name!r} in this library; a name that it defines is wanted"
            )
        return address


def _object(text: str, machine: Any) -> bytes:
    """Of functions whose numbers are computed once, in the order in which they are to be: of LLVM's
    usual passes only few are worth their time.
    """
    binding = _binding()
    module = binding.parse_assembly(text)
    module.triple, module.data_layout = machine.triple, str(machine.target_data)
    module.verify()
    passes = binding.create_new_module_pass_manager()
    passes.add_always_inliner_pass()
    passes.add_sroa_pass()
    passes.add_instruction_combine_pass()
    passes.add_reassociate_pass()  # of commuted operands: flags forbid that sums are reordered
    passes.add_simplify_cfg_pass()
    passes.run(
        module, binding.create_pass_builder(machine, binding.create_pipeline_tuning_options())
    )
    return machine.emit_object(module)


@cache
def _binding() -> Any:
    """llvmlite.binding, started. Raises ImportError, with what to install, where it is absent."""
    try:
        import llvmlite.binding as binding
    except ImportError as error:
        raise ImportError(
            "native code was asked for without llvmlite; `pip install llvmlite` is wanted"
        ) from error
    binding.initialize_native_target()
    binding.initialize_native_asmprinter()
    return binding


@cache
def _host() -> tuple[str, str, str]:
    """What an object depends on beside its text: the compiler, the processor, its features."""
    import llvmlite

    binding = _binding()
    return (
        llvmlite.__version__,
        binding.get_host_cpu_name(),
        binding.get_host_cpu_features().flatten(),
    )


def _machine() -> Any:
    binding = _binding()
    _, processor, features = _host()
    return binding.Target.from_default_triple().create_target_machine(
        cpu=processor, features=features, opt=2, codemodel="jitdefault", jit=True
    )
