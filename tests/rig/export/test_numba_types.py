"""The translator and numba infer the same type for every name of every function of the law."""

from __future__ import annotations

from typing import Any

import numba
import numpy as np
import pytest
from numba.core import types as nb
from numba.core.compiler import CompilerBase, DefaultPassBuilder, Flags, compile_extra
from numba.core.compiler_machinery import AnalysisPass, PassManager, register_pass
from numba.core.registry import cpu_target
from numba.core.typed_passes import NopythonTypeInference

from can_rig.export.law import law_program, speed_program
from can_rig.export.source import BOOL, REAL, Answers, Array, Record, Scalar, Type
from can_rig.export.subset import Typed
from firmware_model.target.structs import Precision, record_type

FUNCTIONS = {**law_program().functions, **speed_program().functions}


def as_numba(kind: Type, precision: Precision) -> Any:
    """What numba calls the type, for an argument."""
    real = nb.float32 if precision == "float32" else nb.float64
    match kind:
        case Record():
            return numba.from_dtype(record_type(kind.struct.fields, precision))
        case Array():
            return nb.Array(real, len(kind.shape), "C")
        case Scalar():
            return real if kind is REAL else nb.int64
    raise NotImplementedError(kind)


def agrees(kind: Type, found: Any, precision: Precision) -> bool:
    """Whether numba's type of a name is ours."""
    real = nb.float32 if precision == "float32" else nb.float64
    if isinstance(found, nb.Literal):
        found = found.literal_type
    match kind:
        case Record():
            return bool(found.dtype == np.dtype(record_type(kind.struct.fields, precision)))
        case Array():
            return isinstance(found, nb.Array | nb.NestedArray) and found.dtype == real
        case Answers():
            return [item is REAL for _, item in kind.items] == [each == real for each in found]
        case None:
            return isinstance(found, nb.NoneType)
    if kind is REAL:
        return bool(found == real)
    return found == nb.boolean if kind is BOOL else isinstance(found, nb.Integer)


class InferredOnly(CompilerBase):
    """numba's pipeline up to the types: machine code would take five times as long."""

    def define_pipelines(self) -> list[PassManager]:
        passes = PassManager("types")
        passes.passes.extend(DefaultPassBuilder.define_untyped_pipeline(self.state).passes)
        passes.add_pass(NopythonTypeInference, "types")
        passes.add_pass(Kept, "what was found")
        passes.finalize()
        return [passes]


@register_pass(mutates_CFG=False, analysis_only=True)
class Kept(AnalysisPass):
    _name = "kept"

    def __init__(self) -> None:
        super().__init__()

    def run_pass(self, state: Any) -> bool:
        state.cr = state.typemap, state.return_type
        return False


def inferred_types(typed: Typed, precision: Precision) -> tuple[dict[str, Any], Any]:
    """numba's type for each variable, and for what is returned."""
    function = getattr(typed.function.module.namespace, typed.function.name)
    target, flags = cpu_target, Flags()
    flags.error_model = "numpy"
    arguments = tuple(as_numba(each, precision) for each in typed.arguments)
    python = getattr(function, "py_func", function)
    found: tuple[dict[str, Any], Any] = compile_extra(
        target.typing_context, target.target_context, python, arguments, None, flags, {},
        pipeline_class=InferredOnly,
    )  # fmt: skip
    return found


@pytest.mark.long
@pytest.mark.parametrize("precision", ["float64", "float32"])
@pytest.mark.parametrize("name", FUNCTIONS)
def test_types_are_those_of_numba(name: str, precision: Precision) -> None:
    typed = FUNCTIONS[name]
    found, returned = inferred_types(typed, precision)
    for variable, kind in found.items():
        local = variable.removeprefix("arg.").split(".")[0]
        if local in typed.names and kind != nb.undefined:
            assert agrees(typed.names[local], kind, precision), f"{local}: {kind}"
    assert agrees(typed.result, returned, precision), returned
