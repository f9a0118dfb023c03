"""Names of the exported lines that C has already: with an underscore there, or refused."""

from __future__ import annotations

import pytest

from can_rig.errors import ExportError
from tests.rig.export.lines import HEADER, Translate, compile_in


@pytest.mark.parametrize(
    "name",
    ["sqrt", "fabs", "rint", "real", "real_min", "int_max", "float_", "NAN", "INFINITY", "memset",
     "int32_t", "bool", "DBL_MAX", "INT32_MAX", "_Bool", "asm", "i", "pair_2"],
)  # fmt: skip
def test_names_that_c_has_are_others_there(translate: Translate, name: str) -> None:
    text = f"""
        @firmware
        def double({name}: float) -> tuple[float, float]:
            float = {name}
            return float, {name}

        @firmware
        def f(state: Record, x: float) -> None:
            float, {name} = double(x)
            state.a = min(np.sqrt(np.ceil({name})), abs(np.rint({name})))
            state.n = max(state.n, 3) % 2
            {name}, _ = pair({name} if math.isfinite({name}) else x)
            state.list[:] = np.copysign({name}, float)
            for _ in range(MANY):
                state.list[:] = {name}
        """
    compile_in(translate(text))


@pytest.mark.parametrize("name", ["MANY", "lines_g", "LINES_H", "SHADE_DARK"])
@pytest.mark.parametrize("where", ["parameter", "local"])
def test_names_of_the_exported_c_are_refused(translate: Translate, name: str, where: str) -> None:
    parameter, local = (name, "y") if where == "parameter" else ("y", name)
    text = f"""
        from enum import IntEnum

        class Shade(IntEnum):
            DARK = 1

        @firmware
        def g({parameter}: float) -> float:
            {local} = -{parameter}
            return {local}

        @firmware
        def f(state: Record, x: float) -> None:
            state.a = g(x) * real(MANY, x)
        """
    line = 8 if where == "parameter" else 9
    what = f":{HEADER.count(chr(10)) + line}: {name}: is a number or a function of the exported C"
    with pytest.raises(ExportError, match=what):
        translate(text)


def test_members_that_a_number_would_replace_are_refused(translate: Translate) -> None:
    text = """
        a = 2

        @firmware
        def f(state: Record, x: float) -> None:
            state.list[a] = x
        """
    with pytest.raises(ExportError, match=r"lines\.py:10: a: is a number or a function"):
        translate(text)


def test_a_name_for_several_answers_must_not_hide_a_function(translate: Translate) -> None:
    text = """
        @firmware
        def g(x: float) -> float:
            return x

        @firmware
        def lines_g(x: float) -> tuple[float, float]:
            y = g(x)
            return x, y

        @firmware
        def f(state: Record, x: float) -> None:
            y, z = lines_g(x)
        """
    with pytest.raises(ExportError, match="lines_g: is a number or a function of the exported C"):
        translate(text)


def test_a_number_may_have_a_name_of_the_library(translate: Translate) -> None:
    text = """
        DBL_MAX = 2.0

        @firmware
        def f(state: Record, x: float) -> None:
            state.a = real(DBL_MAX, x)
        """
    assert "#define DBL_MAX_ 2.0\n" in (translate(text) / "lines.c").read_text(encoding="utf-8")
    compile_in(translate(text))
