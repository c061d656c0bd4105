"""Vectors in compiled kernels: so many points worked on together as one register of this machine holds.

Left to find vectors in a loop, LLVM takes 32 bytes on many machines that have 64, and leaves sums in memory. Here a kernel
says what it means: `load`, `every`, `fused` and the operator * work on LANES numbers at a time, each an instruction or two.
Run as Python they do the same with numpy. Each lane is rounded by itself, so that the width changes no result.
"""

from __future__ import annotations

import operator
from typing import Any

import numba
import numpy as np
from numba import extending
from numba.core import cgutils, codegen, types

from fluxtwin.sim.base.types import FloatArray

_config: Any = numba.config
_codegen: Any = codegen
_cgutils: Any = cgutils
ir: Any = _cgutils.ir  # of the llvmlite that numba brings
_extending: Any = extending
_features = _codegen.get_host_cpu_features() if _config.CPU_FEATURES is None else _config.CPU_FEATURES

LANES = 8 if "+avx512f" in _features.split(",") else 4
"""Where registers hold two numbers, four of them are two registers."""


def load(array: FloatArray, first: int) -> FloatArray:
    """The LANES numbers of a contiguous array from its element `first` on, as it lies in memory."""
    return array.reshape(-1)[first : first + LANES].copy()


def store(array: FloatArray, first: int, value: FloatArray) -> None:
    """Put them there."""
    array.reshape(-1)[first : first + LANES] = value


def every(number: float) -> FloatArray:
    """The number in every lane."""
    return np.full(LANES, number)


def fused(a: FloatArray, b: FloatArray, c: FloatArray) -> FloatArray:
    """a b + c, rounded once where the machine can."""
    return a * b + c


class _Lanes(types.Type):
    """LANES numbers in a register."""

    def __init__(self) -> None:
        super().__init__(name=f"lanes{LANES}")


_LANES = _Lanes()
_VECTOR = ir.VectorType(ir.DoubleType(), LANES)


def _pointer(context: Any, builder: Any, kind: Any, array: Any, at: Any) -> Any:
    return builder.gep(context.make_array(kind)(context, builder, array).data, [at])


def _load(context: Any, builder: Any, signature: Any, given: Any) -> Any:
    place = _pointer(context, builder, signature.args[0], *given)
    return builder.load(builder.bitcast(place, _VECTOR.as_pointer()), align=8)


def _store(context: Any, builder: Any, signature: Any, given: Any) -> Any:
    place = _pointer(context, builder, signature.args[0], *given[:2])
    builder.store(given[2], builder.bitcast(place, _VECTOR.as_pointer()), align=8)
    return context.get_dummy_value()


def _every(context: Any, builder: Any, signature: Any, given: Any) -> Any:
    empty, index = ir.Constant(_VECTOR, ir.Undefined), ir.IntType(32)
    first = builder.insert_element(empty, given[0], ir.Constant(index, 0))
    return builder.shuffle_vector(first, empty, ir.Constant(ir.VectorType(index, LANES), [0] * LANES))


def _fused(context: Any, builder: Any, signature: Any, given: Any) -> Any:
    kind = ir.FunctionType(_VECTOR, [_VECTOR] * 3)
    return builder.call(_cgutils.get_or_insert_function(builder.module, kind, f"llvm.fmuladd.v{LANES}f64"), given)


def _times(context: Any, builder: Any, signature: Any, given: Any) -> Any:
    return builder.fmul(*given)


def _register() -> None:
    """Say to numba what the functions take, give and become."""
    element, lanes, whole = (types.Array, types.Integer), (_Lanes,), _LANES
    for function, becomes, takes, gives in (
        (load, _load, element, whole),
        (store, _store, element + lanes, types.none),
        (every, _every, (types.Float,), whole),
        (fused, _fused, lanes * 3, whole),
        (operator.mul, _times, lanes * 2, whole),
    ):
        _extending.type_callable(function)(_typer(takes, gives))
        _extending.lower_builtin(function, *takes)(becomes)
    _extending.register_model(_Lanes)(lambda manager, kind: _extending.models.PrimitiveModel(manager, kind, _VECTOR))


def _typer(takes: tuple[Any, ...], gives: Any) -> Any:
    def checked(*given: Any) -> Any:
        fits = all(map(isinstance, given, takes)) and (not isinstance(given[0], types.Array) or given[0].layout == "C")
        return gives if fits else None

    by_number = {1: lambda a: checked(a), 2: lambda a, b: checked(a, b), 3: lambda a, b, c: checked(a, b, c)}
    return lambda context: by_number[len(takes)]  # numba asks how many a function takes


_register()
