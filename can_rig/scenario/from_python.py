"""Objects of Python as values of a scenario's keys: arrays, linear systems, filters, classes."""

import dataclasses
import inspect
from collections.abc import Iterator, Mapping
from types import SimpleNamespace
from typing import Any

import numpy as np

from can_rig.errors import ScenarioError, one_line
from can_rig.scenario.loading import Changes, as_settings, other_values, toml_text
from can_rig.scenario.own_class import path_of
from can_rig.scenario.plant_settings import STATE_SPACE, TRANSFER_FUNCTIONS, flat
from firmware_model.design.zpk import ZeroPoleGain
from firmware_model.discretisation.systems import Polynomials, continuous
from firmware_model.errors import DesignError


def settings_of(changes: Changes | None) -> list[str]:
    """``KEY=VALUE`` for each change, whose value may be an object of Python.

    An array is a list, and for ``reference`` a value for each tick. A system of python-control or
    scipy is a transfer function, or for ``plant`` and ``model`` both transfer functions or the
    state space. A ``firmware_model.Filter`` is a filter, a class or function its import path, and
    a part of a ``Scenario`` the table.

    Raises:
        ScenarioError: not a mapping, or a value that no key has.
    """
    if changes is None or not isinstance(changes, Mapping):
        return as_settings({} if changes is None else changes)
    pairs = (pair for key, value in flat(changes) for pair in _settings(key, value))
    return [f"{key}={toml_text(key, value)}" for key, value in pairs]


def kind_of(key: str, value: object) -> str:
    """``FOLDER/module:Name`` of a class or function; a text as the text stands.

    Raises:
        ScenarioError: neither, or a class or function that no import finds again.
    """
    if isinstance(value, str):
        return value
    name = getattr(value, "__qualname__", None)
    if not (inspect.isclass(value) or inspect.isfunction(value)) or name is None:
        raise ScenarioError(f"{key} = {value!r}: must be a text, a class or a function")
    if not name.isidentifier():
        raise ScenarioError(
            f"{key} = {name}: must be at the top level of a module, so that others find the name"
        )
    return path_of(value.__module__, name)


def _settings(key: str, value: Any) -> Iterator[tuple[str, Any]]:
    """Keys and plain values of one change."""
    if key in ("plant", "model") and (hasattr(value, "A") or hasattr(value, "den")):
        yield from _plant(key, value)
    elif key == "reference" and (isinstance(value, list | tuple) or hasattr(value, "__array__")):
        samples = np.array(value, dtype=object)
        if samples.ndim != 1:
            raise ScenarioError(
                f"reference: an array of shape {samples.shape}: must be (ticks,), a number for "
                "each tick"
            )
        yield key, {"kind": "samples", "samples_mps2": samples.tolist()}
    else:
        yield key, _plain(key, value)


def _plain(key: str, value: Any) -> Any:
    if inspect.isclass(value) or inspect.isfunction(value) or key.endswith(".kind"):
        return kind_of(key, value)
    if hasattr(value, "to_scipy_sos"):
        return {"sos": value.to_scipy_sos().tolist(), "tick_s": value.tick_s}
    is_array = hasattr(value, "__array__")  # of NumPy a matrix has an A too
    if not is_array and any(hasattr(value, name) for name in ("A", "num", "poles")):
        return _transfer_function(key, value)
    if dataclasses.is_dataclass(value) and not isinstance(value, type):
        return other_values(dataclasses.asdict(value), {})
    if is_array:
        value = np.asarray(value)
        is_roots = value.dtype.kind == "c" and value.ndim == 1
        if is_roots and not np.allclose(np.sort_complex(value), np.sort_complex(value.conj())):
            raise ScenarioError(f"{key} = {value}: must have the conjugate of each root")
        value = _roots(value) if is_roots else value.tolist()
    if isinstance(value, Mapping):
        return {name: _plain(f"{key}.{name}", each) for name, each in value.items()}
    return [_plain(key, each) for each in value] if isinstance(value, list | tuple) else value


def _transfer_function(key: str, system: Any) -> dict[str, Any]:
    """A system with one input and output; of a sampled system the domain is z."""
    tick_s, shown = getattr(system, "dt", None), system
    if tick_s:  # ``continuous`` reads attributes
        names = ("A", "B", "C", "D", "num", "den", "zeros", "poles", "gain", "ninputs", "noutputs")
        shown = SimpleNamespace(**{n: getattr(system, n) for n in names if hasattr(system, n)})
    try:
        form = continuous(shown)
        if isinstance(form, Polynomials):
            table = {"num": form.num.tolist(), "den": form.den.tolist()}
        else:
            of = form if isinstance(form, ZeroPoleGain) else form.zero_pole_gain()
            table = {"zeros": _roots(of.zeros), "poles": _roots(of.poles), "gain": of.gain}
    except DesignError as error:
        raise ScenarioError(f"{key}: {one_line(error)}") from None
    if tick_s and key.startswith(("plant", "model")):
        raise ScenarioError(f"{key}: a system sampled already (dt = {tick_s}): must not be")
    if tick_s:
        table["domain"] = "z"
        if tick_s is not True:  # of an unknown tick
            table["tick_s"] = tick_s
    return table


def _roots(roots: Any) -> list[Any]:
    """A number, or a pair of conjugates as its real and positive imaginary part."""
    upper = [complex(root) for root in roots if root.imag >= 0.0]
    return [[root.real, root.imag] if root.imag else root.real for root in upper]


def _plant(key: str, system: Any) -> Iterator[tuple[str, Any]]:
    """Both inputs of a system: the torque's and the force difference's."""
    if getattr(system, "dt", None):
        raise ScenarioError(f"{key}: a system sampled already (dt = {system.dt}): must not be")
    if hasattr(system, "A"):
        a, b, c, d = (np.asarray(getattr(system, name)) for name in "ABCD")
        if b.shape[1:] != (2,) or len(c) != 1 or d.any():
            raise ScenarioError(
                f"{key}: a state space with B {b.shape}, C {c.shape}, D {d.tolist()}: must have "
                "two inputs, one output and D = 0"
            )
        numbers: dict[str, Any] = {"a": a.tolist(), "b": b.tolist(), "c": c[0].tolist()}
        kind = STATE_SPACE
    else:
        size = getattr(system, "noutputs", 1), getattr(system, "ninputs", 1)
        if size != (1, 2):
            raise ScenarioError(
                f"{key}: {size[1]} input(s) and {size[0]} output(s): must be two inputs and one "
                "output, or plant.g1 and plant.g2"
            )
        pairs = zip(system.num[0], system.den[0], strict=True)
        g1, g2 = ({"num": list(num), "den": list(den)} for num, den in pairs)
        numbers, kind = {"g1": g1, "g2": g2}, TRANSFER_FUNCTIONS
    none: dict[str, Any] = {"a": [], "b": [], "c": [], "g1": {}, "g2": {}}
    for name, value in {"kind": kind, **none, **numbers}.items():
        yield f"{key}.{name}", value
