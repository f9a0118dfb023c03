"""The keys of the controller: the rig's own law, or a controller of one's own."""

from dataclasses import field
from typing import Annotated, Any, Final, Literal

from pydantic import AfterValidator, PositiveFloat
from pydantic.dataclasses import dataclass

from can_rig.scenario.own_class import is_class_path
from can_rig.scenario.plant_settings import (
    FMU,
    STRICT,
    Row,
    Table,
    TransferFunction,
    checked_parameters,
    not_of,
    refuse_large,
)
from firmware_model.discretisation.rules import Rule

OURS: Final = "ours"
FILTERS: Final = "filters"
LIBRARY: Final = "c:"
"""Prefix of a kind that names a shared library."""

PEERS: Final = {
    "pi": "can_rig.controllers.peers.pi:Pi",
    "thesis": "can_rig.controllers.peers.thesis:Thesis",
    "kalman": "can_rig.controllers.peers.kalman:Kalman",
    "allocation": "can_rig.controllers.peers.allocation:Allocation",
    "sliding-mode": "can_rig.controllers.peers.sliding_mode:SlidingMode",
}
"""The shipped controllers beside the rig's own, by their names."""

FILTER_NAMES: Final = (
    "c", "u1_r", "u1_y", "f1_u1", "f1_u2", "f2", "f_hat", "u2_r", "u2_y",
)  # fmt: skip
"""Tables of the kind ``filters``."""

SOS: Final = 6
"""Numbers of a second-order section: b0, b1, b2, a0, a1, a2."""


@dataclass(frozen=True, config=STRICT)
class FilterSettings(TransferFunction):
    """A filter in s, discretised by ``rule``, or in z, as its coefficients stand.

    ``sos`` has rows b0, b1, b2, a0, a1, a2 in powers of 1/z, and needs no ``domain``. ``tick_s``
    states the tick of coefficients in z; a run with another tick is refused.
    """

    sos: tuple[Row, ...] | None = None
    domain: Literal["s", "z"] = "s"
    rule: Rule = "tustin"
    tick_s: PositiveFloat | None = None

    def __post_init__(self) -> None:
        super().__post_init__()
        if self.sos is not None and super().__bool__():
            raise ValueError("sos: must not stand beside another form of the same filter")
        for at, row in enumerate(self.sos or ()):
            refuse_large(f"sos[{at}]", row)
            if len(row) != SOS:
                raise ValueError(f"sos[{at}]: has {len(row)} numbers: must have {SOS}")

    def __bool__(self) -> bool:
        """Whether any coefficient is given."""
        return self.sos is not None or super().__bool__()


@dataclass(frozen=True, config=STRICT)
class ControllerSettings:
    """The controller of a run; see ``controllers``.

    ``parameters`` and ``variables`` belong to a controller of one's own, as to a plant of one's
    own. The other tables are the filters of the kind ``filters``: u1 = c (r - y) + u1_r r + u1_y y,
    d̂ = f1_u1 u1 + f1_u2 u2 + f2 y, and u2 = f_hat d̂ + u2_r r + u2_y y.
    """

    kind: str = OURS
    parameters: Annotated[dict[str, Any], AfterValidator(Table)] = field(default_factory=Table)
    variables: Annotated[dict[str, str], AfterValidator(Table)] = field(default_factory=Table)
    c: FilterSettings = FilterSettings()
    u1_r: FilterSettings = FilterSettings()
    u1_y: FilterSettings = FilterSettings()
    f1_u1: FilterSettings = FilterSettings()
    f1_u2: FilterSettings = FilterSettings()
    f2: FilterSettings = FilterSettings()
    f_hat: FilterSettings = FilterSettings()
    u2_r: FilterSettings = FilterSettings()
    u2_y: FilterSettings = FilterSettings()

    def __post_init__(self) -> None:
        if not (self.kind in (OURS, FILTERS, *PEERS) or self.is_file or self.is_class):
            words = ", ".join((OURS, FILTERS, *PEERS))
            raise ValueError(
                f"kind = {self.kind!r}: must be {words}, package.module:Class, "
                f"{LIBRARY}FILE.so or {FMU}FILE.fmu"
            )
        given = [key for key in FILTER_NAMES if getattr(self, key)]
        if given and self.kind != FILTERS:
            raise not_of(self.kind, given[0], f"kind = {FILTERS!r}")
        if self.kind == FILTERS and not given:
            raise ValueError(f"{FILTER_NAMES[0]}: a filter must be set for kind = {FILTERS!r}")
        for key, value in checked_parameters(self.parameters):
            if self.kind in (OURS, FILTERS):
                raise ValueError(
                    f"parameters.{key} = {value!r}: must not be set for kind = {self.kind!r}"
                )
        if self.variables and not self.is_fmu:
            raise not_of(self.kind, "variables", f"only {FMU}FILE.fmu")

    def refuse_other_tick(self, tick_s: float) -> None:
        """Refuse a filter in z of another tick."""
        for name in FILTER_NAMES:
            of = getattr(self, name).tick_s
            if of is not None and abs(of - tick_s) > 1e-9 * tick_s:
                raise ValueError(f"controller.{name}.tick_s = {of:g}: must be tick_s = {tick_s:g}")

    @property
    def is_ours(self) -> bool:
        """Whether the rig's own law runs."""
        return self.kind == OURS

    @property
    def is_own(self) -> bool:
        """Whether ``kind`` names code of the user's, which need not exist."""
        return self.is_file or is_class_path(self.kind)

    @property
    def is_fmu(self) -> bool:
        """Whether ``kind`` reads ``fmu:FILE.fmu``; the file need not exist."""
        return self.kind.startswith(FMU) and len(self.kind) > len(FMU)

    @property
    def is_library(self) -> bool:
        """Whether ``kind`` reads ``c:FILE.so``; the file need not exist."""
        return self.kind.startswith(LIBRARY) and len(self.kind) > len(LIBRARY)

    @property
    def is_file(self) -> bool:
        """Whether ``kind`` names a file."""
        return self.is_fmu or self.is_library

    @property
    def class_path(self) -> str:
        """``FOLDER/package.module:Class`` of a class or of a shipped controller."""
        return PEERS.get(self.kind, self.kind)

    @property
    def is_class(self) -> bool:
        """Whether ``kind`` names a class, which need not exist."""
        return is_class_path(self.class_path) and not self.is_file
