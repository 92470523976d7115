"""Object code of compiled functions that needs neither Python nor numba, by LLVM."""

from __future__ import annotations

from collections.abc import Callable, Mapping
import inspect
from typing import Any

from llvmlite import binding as llvm
from multicontact_control.errors import ConfigError
import numba
from numba.core.compiler import compile_extra, Flags
from numba.core.registry import cpu_target
import numpy as np

OPTIMISATION = 3
LAYOUT = 'mc_library_layout'
PASSES = 2  # what the first finds constant in arguments, the second takes out
# Calls an entry as numba compiles it: results and exceptions go to places, the status is
# returned. No kernel raises: divisions by zero give infinity or NaN.
SHIM = """
declare i32 @"{symbol}"(ptr, ptr, ptr{types})
define i64 @{name}(ptr %memory{arguments}) {{
  %result = alloca i64
  %exception = alloca ptr
  %status = call i32 @"{symbol}"(ptr %result, ptr %exception, ptr %memory{arguments})
  %value = load i64, ptr %result
  ret i64 %value
}}
"""
# Numba allocates where an assignment between slices overlaps itself, which no kernel does, and
# what it raises where shapes do not fit. There is no memory for either here: the program ends.
NO_ALLOCATION = """
declare void @llvm.trap()
define ptr @NRT_Allocate(i64 %size) noreturn {
  call void @llvm.trap()
  unreachable
}
"""


def compile_entries(
    entries: Mapping[str, Callable[..., Any]],
    memory: np.dtype[Any],
    layout: int,
    triple: str = '',
) -> bytes:
    """
    Return an object file with a function of C for each entry.

    Parameters
    ----------
    entries
        Functions of a pointer to the memory, and of whole numbers, which return one, by their
        names in C.
    memory
        What it points to.
    layout
        Number that the object has as `LAYOUT`.
    triple
        Target, as LLVM names it; empty for this machine and all that its processor can do.

    Raises
    ------
    ConfigError
        If LLVM does not know the target.

    """
    machine = _find_machine(triple)
    layout_constant = f'@{LAYOUT} = constant i64 {layout}'
    module = llvm.parse_assembly(layout_constant + NO_ALLOCATION)
    for name, function in entries.items():
        module.link_in(_compile_entry(name, function, memory))
    for symbol in (*module.functions, *module.global_variables):
        if not symbol.is_declaration and symbol.name not in (*entries, LAYOUT):
            symbol.linkage = 'internal'
    module.triple = machine.triple
    module.data_layout = str(machine.target_data)
    options = llvm.create_pipeline_tuning_options(speed_level=OPTIMISATION)
    passes = llvm.create_pass_builder(machine, options)
    for _ in range(PASSES):
        passes.getModulePassManager().run(module, passes)
    code: bytes = machine.emit_object(module)
    return code


def count_numbers(entry: Callable[..., Any]) -> int:
    """Return how many whole numbers an entry takes beside the pointer."""
    return len(inspect.signature(entry).parameters) - 1


def _find_machine(triple: str) -> llvm.TargetMachine:
    """Return LLVM's machine for a target; ConfigError if there is none."""
    llvm.initialize_all_targets()
    llvm.initialize_all_asmprinters()
    processor: dict[str, str] = {}
    if not triple:
        processor['cpu'] = llvm.get_host_cpu_name()
        processor['features'] = llvm.get_host_cpu_features().flatten()
    try:
        target = llvm.Target.from_triple(triple or llvm.get_process_triple())
    except RuntimeError as error:
        raise ConfigError(
            'target', 'a triple that LLVM knows, e.g. aarch64-linux-gnu', str(error)
        ) from None
    return target.create_target_machine(
        opt=OPTIMISATION, reloc='pic', codemodel='default', **processor
    )


def _compile_entry(
    name: str, function: Callable[..., Any], memory: np.dtype[Any]
) -> llvm.ModuleRef:
    """Return LLVM's module of an entry and of the kernels that it calls."""
    typing, target = cpu_target.typing_context, cpu_target.target_context
    typing.refresh()
    target.refresh()
    flags: Any = Flags()
    flags.no_cpython_wrapper = True
    flags.no_cfunc_wrapper = True
    flags.error_model = 'numpy'
    flags.nrt = True
    numbers = count_numbers(function)
    pointer = numba.types.CPointer(numba.from_dtype(memory))
    kinds = (pointer, *[numba.types.int64] * numbers)
    result = compile_extra(
        typing, target, function, kinds, numba.types.int64, flags, {}
    )
    module = llvm.parse_assembly(result.library.get_llvm_str())
    shim = SHIM.format(
        name=name,
        symbol=result.fndesc.llvm_func_name,
        types=', i64' * numbers,
        arguments=''.join(f', i64 %number_{k}' for k in range(numbers)),
    )
    module.link_in(llvm.parse_assembly(shim))
    return module
