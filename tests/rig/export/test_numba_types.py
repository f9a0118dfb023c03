"""The translator and numba infer the same type for every name of every function of the law."""

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
from firmware_model.law.structs import Precision, record_type


def as_numba(kind: Type, precision: Precision) -> Any:
    """What numba calls the type, for an argument."""
    real = nb.float32 if precision == "float32" else nb.float64
    match kind:
        case Record():
            return numba.from_dtype(record_type(kind.struct.declared, precision))
        case Array():
            return nb.Array(real, len(kind.shape), "C")
        case Scalar():
            return {REAL: real, BOOL: nb.boolean}.get(kind, nb.int64)
    raise NotImplementedError(kind)


def agrees(kind: Type, found: Any, precision: Precision) -> bool:
    """Whether numba's type of a name is ours."""
    real = nb.float32 if precision == "float32" else nb.float64
    if isinstance(found, nb.Literal):
        found = found.literal_type
    match kind:
        case Record():
            return bool(found.dtype == np.dtype(record_type(kind.struct.declared, precision)))
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
@pytest.mark.parametrize("program", [law_program, speed_program])
def test_types_are_those_of_numba(program):
    """In single precision, where a number that numba takes for double shows."""
    functions, wrong = program().functions, {}
    for name, typed in functions.items():
        found, returned = inferred_types(typed, "float32")
        kinds = [(variable.removeprefix("arg.").split(".")[0], each)
                 for variable, each in found.items() if each != nb.undefined]  # fmt: skip
        pairs = [(local, typed.names[local], each) for local, each in kinds if local in typed.names]
        pairs.append(("return", typed.result, returned))
        wrong |= {(name, local): each for local, ours, each in pairs
                  if not agrees(ours, each, "float32")}  # fmt: skip
    assert wrong == {}
    assert len(functions) > 2
