"""A plant by numbers: the keys of a transfer function, and the names of signals."""

from __future__ import annotations

import math
from dataclasses import replace
from typing import Any, Final, Self

from pydantic.dataclasses import dataclass

from can_rig.scenario.stage_settings import STRICT
from firmware_model.design.zpk import Roots, ZeroPoleGain

LARGEST = 1e100  # largest given number: products of two given numbers remain finite
PAIR = 2  # parts of a complex root
LONGEST = 40  # letters of a name
FACTORED: Final = ("zeros", "poles", "gain")
POLYNOMIAL: Final = ("num", "den")

Row = tuple[float, ...]


@dataclass(frozen=True, config=STRICT)
class TransferFunction:
    """``num`` and ``den``, highest power first, or ``zeros``, ``poles`` [rad/s] and ``gain``.

    A root is a number, or ``[real, imaginary]`` for a pair of conjugates. The gain is k in k Π(s -
    zero) / Π(s - pole).
    """

    num: Row | None = None
    den: Row | None = None
    zeros: tuple[Any, ...] | None = None
    poles: tuple[Any, ...] | None = None
    gain: float | None = None

    def __post_init__(self) -> None:
        for key in ("num", "den"):
            refuse_large(key, getattr(self, key) or ())
        for key in ("zeros", "poles"):
            for at, root in enumerate(getattr(self, key) or ()):
                _refuse_root(f"{key}[{at}]", root)
        refuse_large("gain", () if self.gain is None else (self.gain,))
        polynomial, factored = self._given(POLYNOMIAL), self._given(FACTORED)
        if polynomial and factored:
            raise ValueError(
                f"{factored[0]}: must not stand beside {polynomial[0]}; a transfer function is "
                "num and den, or zeros, poles and gain"
            )
        for form, given in ((POLYNOMIAL, polynomial), (("poles", "gain"), factored)):
            for key in form if given else ():
                if getattr(self, key) is None:
                    raise ValueError(f"{key}: must be given beside {given[0]}")
        if self.den is not None and not any(self.den):
            raise ValueError(f"den = {list(self.den)}: must have a coefficient other than 0")

    def __bool__(self) -> bool:
        """Whether any key is given."""
        return bool(self._given((*POLYNOMIAL, *FACTORED)))

    def _given(self, keys: tuple[str, ...]) -> list[str]:
        return [key for key in keys if getattr(self, key) is not None]

    @property
    def factored(self) -> ZeroPoleGain:
        """The transfer function with its polynomials' roots.

        Raises:
            DesignError: coefficients with a ratio beyond the floats.
        """
        if self.num is not None and self.den is not None:
            return ZeroPoleGain.from_coefficients(self.num, self.den)
        return ZeroPoleGain(_roots(self.zeros), _roots(self.poles), self.gain or 0.0)

    def scaled(self, gain: float, speed: float) -> Self:
        """``gain`` times as strong, with poles and zeros ``speed`` times as fast: k G(s/v)."""
        if self.num is not None and self.den is not None:
            return replace(
                self, num=_faster(self.num, speed, gain), den=_faster(self.den, speed, 1.0)
            )
        poles, zeros = _roots(self.poles), _roots(self.zeros)
        power = speed ** (len(poles) - len(zeros))
        return replace(
            self,
            zeros=_moved(self.zeros, speed),
            poles=_moved(self.poles, speed),
            gain=(self.gain or 0.0) * gain * power,
        )


@dataclass(frozen=True, config=STRICT)
class SignalSettings:
    """The name of a plant's signal, and its unit; unset: the kind's default."""

    name: str | None = None
    unit: str | None = None

    def __post_init__(self) -> None:
        for key, value in (("name", self.name), ("unit", self.unit)):
            if value is not None and not (value.isprintable() and len(value) <= LONGEST):
                raise ValueError(f"{key} = {value!r}: must be at most {LONGEST} printable letters")
        if self.name is not None and not self.name.strip():
            raise ValueError(f"name = {self.name!r}: must be a word or more")


def refuse_large(key: str, values: Row) -> None:
    """Refuse a number whose product with another given number is infinite."""
    for value in values:
        if abs(value) > LARGEST:
            raise ValueError(f"{key} = {value:g}: must be at most {LARGEST:g} in magnitude")


def _refuse_root(key: str, root: object) -> None:
    parts: list[Any] = list(root) if isinstance(root, list | tuple) else [root]
    for part in parts:
        number = isinstance(part, int | float) and not isinstance(part, bool)
        if not (number and math.isfinite(part) and abs(part) <= LARGEST and len(parts) <= PAIR):
            raise ValueError(
                f"{key} = {root!r}: must be a number, or [real, imaginary] for a pair of conjugates"
            )
    if len(parts) != 1 and not (len(parts) == PAIR and parts[1] > 0.0):
        raise ValueError(
            f"{key} = {root!r}: must have an imaginary part above 0; it stands for both of the pair"
        )


def _roots(given: tuple[Any, ...] | None) -> Roots:
    pairs = [complex(*root) for root in given or () if isinstance(root, list | tuple)]
    real = [complex(root) for root in given or () if not isinstance(root, list | tuple)]
    return (*real, *pairs, *(root.conjugate() for root in pairs))


def _moved(given: tuple[Any, ...] | None, speed: float) -> tuple[Any, ...] | None:
    if given is None:
        return None
    return tuple(
        tuple(part * speed for part in root) if isinstance(root, list | tuple) else root * speed
        for root in given
    )


def _faster(coefficients: Row, speed: float, gain: float) -> Row:
    powers = range(len(coefficients) - 1, -1, -1)
    return tuple(gain * c / speed**i for c, i in zip(coefficients, powers, strict=True))
