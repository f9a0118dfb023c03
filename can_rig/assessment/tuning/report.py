"""The trade-off of ``can-rig tune`` as table rows, a sentence, JSON and a picture.

``tuning.png`` shows the noise in X_diff against the peak after the loss.
"""

from collections.abc import Iterator
from typing import Any

from matplotlib.figure import Figure

from can_rig.assessment.stability import finite_or_null
from can_rig.assessment.tuning.candidate import MAX_DELAY_TICKS, Tuning, refusals_as_dict
from can_rig.assessment.tuning.search import EQUAL_PEAKS, Tunings
from can_rig.drawing import style
from can_rig.drawing.names import names_of, ticks_text, with_unit


def picture(found: Tunings) -> Figure:
    """Every tuning that is stable with the nominal car, the trade-off over the box, the choice."""
    scenario, chosen = found.scenario, found.chosen
    figure = style.page(5.0, style.COLUMN_WIDTH_IN)
    axis = figure.subplots()
    axis.set_xscale("log")
    axis.set_yscale("log")
    axis.plot(
        [found.noise_n(t) for t in found.nominal],
        [t.peak_mps2 for t in found.nominal],
        ".",
        color=style.PALE_BLUE,
        ms=4,
        label=f"stable with the nominal {scenario.plant.noun}",
    )
    axis.plot(
        [found.noise_n(t) for t in found.front],
        [t.peak_mps2 for t in found.front],
        "o-",
        color=style.BLUE,
        ms=4,
        lw=1.2,
        label=f"best of those stable with all {found.cars} {scenario.plant.noun}s"
        if found.cars > 1
        else "best of those",
    )
    design = chosen.design
    axis.plot(
        found.noise_n(chosen),
        chosen.peak_mps2,
        "*",
        color=style.ORANGE,
        mec=style.INK,
        ms=16,
        label=f"chosen: τ = {1e3 * design.tau_s:g} ms, $τ_q$ = {1e3 * design.tau_q_s:g} ms, "
        f"α = {design.alpha}, $α_q$ = {design.alpha_q}",
    )
    axis.axhline(
        chosen.unavoidable_mps2,
        color=style.INK,
        lw=1.0,
        ls=style.DASHED,
        label="least possible deviation",
    )
    if found.noise_limit_n is not None:
        axis.axvline(
            found.noise_limit_n, color=style.INK, lw=1.0, ls=style.DOTTED, label="noise limit"
        )
    output, _, second = names_of(scenario.plant)
    unit = f" in {second.unit}" if second.unit else ""
    per = "" if scenario.model.sensor.noise_mps2 else f" per {output.unit or 1} of noise in "
    drawn = second.short.replace("X_diff", "$X_{diff}$")
    axis.set_xlabel(f"noise in {drawn}, rms{unit}{per and per + output.name}")
    axis.set_ylabel(with_unit("deviation after the loss, peak in", output.unit or "1"))
    axis.grid(alpha=0.35, lw=0.5)
    axis.legend(frameon=True, framealpha=0.9, edgecolor="none", fontsize=8, loc="upper right")
    axis.set_title(
        f"{style.plain(scenario.name)}: tick {1e3 * scenario.tick_s:g} ms, latency "
        f"{ticks_text(scenario.latency_ticks)}, {ticks_text(found.spare_ticks)} to spare, "
        f"compensation {scenario.design.compensation.replace('-', ' ')}",
        fontsize=9,
    )
    return figure


ROW_RATIO = 1.6  # factor in peak or noise between successive rows
HEADINGS = (("τ", "ms"), ("τ_q", "ms"), ("α", ""), ("α_q", ""), ("margin", "ticks"))


def headings(found: Tunings) -> list[str]:
    """Of the columns of ``rows``, the unit in a second line."""
    output, first, second = names_of(found.scenario.plant)
    units = noise_unit(found, second.unit), noise_unit(found, first.unit)
    columns = (
        *HEADINGS,
        ("peak", output.unit),
        ("of least", "possible"),
        (second.short, f"rms {units[0]}"),
        (first.short, f"rms {units[1]}"),
        (first.short, f"peak {first.unit}"),
    )
    return [f"{name}\n{unit.strip()}" for name, unit in columns]


def options(tuning: Tuning) -> str:
    """The ``--set`` options of ``tuning`` for its scenario."""
    return " ".join(f"--set {key}={value:g}" for key, value in tuning.changes.items())


def why(found: Tunings) -> str:
    """One sentence: why this tuning is chosen."""
    chosen, limit = found.chosen, found.noise_limit_n
    if chosen is found.front[0]:
        reason = "the least peak"
    else:
        reason = f"within {EQUAL_PEAKS - 1.0:.0%} of the least peak, and of those the least noise"
    if limit is not None:
        second = names_of(found.scenario.plant).command_2
        size = with_unit(f"{limit:g}", second.unit)
        reason += f", all within {size} rms of {second.short} noise"
    cars = f"the nominal {found.scenario.plant.noun}"
    cars += f" and {found.cars - 1} around it" if found.cars > 1 else ""
    held = "" if chosen.within_limits else "; its commands reach the limits, as all of these do"
    return (
        f"{reason}, stable with {ticks_text(found.spare_ticks)} to spare, healthy and with "
        f"{names_of(found.scenario.plant).command_1.said} lost, for {cars}{held}"
    )


def as_dict(found: Tunings) -> dict[str, Any]:
    """For JSON: the request, the choice with its use, the whole trade-off."""
    return {
        "scenario": found.scenario.name,
        "compensation": found.scenario.design.compensation,
        "tried": found.tried,
        "stable_at_the_nominal_car": len(found.nominal),
        "refused": refusals_as_dict(found.refusals),
        "cars": found.cars,
        "spare_ticks": found.spare_ticks,
        "noise_limit_n": found.noise_limit_n,
        "dstar_noise_rms_mps2": found.scenario.model.sensor.noise_mps2,
        "chosen": _values(found.chosen),
        "why": why(found),
        "options": options(found.chosen),
        "front": [_values(tuning) for tuning in found.front],
    }


def rows(found: Tunings) -> Iterator[tuple[Tuning, tuple[str, ...]]]:
    """The trade-off in steps of ``ROW_RATIO``, and the chosen tuning in any case."""
    last: Tuning | None = None
    for tuning in found.front:
        near = last is not None and (
            tuning.peak_mps2 < ROW_RATIO * last.peak_mps2
            and last.noise_to_force < ROW_RATIO * tuning.noise_to_force
        )
        if near and tuning is not found.chosen:
            continue
        last, design = tuning, tuning.design
        margin = tuning.delay_margin_ticks
        yield (
            tuning,
            (
                f"{1e3 * design.tau_s:g}",
                f"{1e3 * design.tau_q_s:g}",
                str(design.alpha),
                str(design.alpha_q),
                str(margin) if margin is None or margin < MAX_DELAY_TICKS else f"{margin}+",
                f"{tuning.peak_mps2:.2e}",
                f"x {tuning.peak_ratio:.2f}",
                f"{found.noise_n(tuning):.3g}",
                f"{tuning.noise_to_torque * (found.scenario.model.sensor.noise_mps2 or 1.0):.3g}",
                f"{tuning.torque_peak_nm:.4g}",
            ),
        )


def noise_unit(found: Tunings, command_unit: str) -> str:
    """The unit of the noise in a command; without sensor noise, per unit of the output."""
    output = names_of(found.scenario.plant).output.unit
    if found.scenario.model.sensor.noise_mps2 or not output:
        return command_unit
    per = f"({output})" if "/" in output else output
    return f"{command_unit or 1}/{per}"


def _values(tuning: Tuning) -> dict[str, Any]:
    margin, values = tuning.delay_margin_ticks, vars(tuning).copy()
    del values["design"]
    return {
        **{key.removeprefix("design."): value for key, value in tuning.changes.items()},
        **finite_or_null(values),
        "delay_margin_is_at_least": margin is not None and margin >= MAX_DELAY_TICKS,
        "peak_ratio": tuning.peak_ratio,
    }
