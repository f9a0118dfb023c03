"""The controller of a scenario once more, by python-control alone, and the loop that it makes.

From A, B, C: the residual is an observer whose poles are the plant's with the unstable ones
mirrored at the unit circle, or 0.1/τq within it, U, R and F̂ are rational functions put together by
hand, and P comes of a Taylor series at 0 and a Vandermonde system.
"""

import control
import numpy as np
from scipy import linalg, signal

from can_rig.scenario.build import continuous_plant
from can_rig.scenario.settings import Scenario
from firmware_model.law.structs import FloatArray

Roots = list[complex]


def mirrored(roots: Roots, least: float = 0.0) -> Roots:
    return [complex(-max(r.real, least), r.imag) if r.real >= 0 else r for r in roots]


def poles_of(plant: control.StateSpace) -> Roots:
    """With those at 0 there, which are double as a rule and so off by the root of rounding."""
    return [0j if abs(p) < 1e-6 else complex(p) for p in control.poles(plant)]


def sections(zeros: Roots, poles: Roots, gain: float, tick_s: float) -> control.StateSpace:
    """gain Π(s - zero)/Π(s - pole) by Tustin, two roots at a time."""
    above, below = by_two(zeros), by_two(poles)
    whole = control.ss([], [], [], gain, tick_s)
    for i, den in enumerate(below):
        num = above[i] if i < len(above) else np.ones(1)
        part = control.tf2ss(control.tf(num, den))
        whole = control.c2d(part, tick_s, "bilinear") * whole
    return whole


def by_two(roots: Roots) -> list[FloatArray]:
    real = sorted((r.real for r in roots if abs(r.imag) <= 1e-9 * abs(r)), key=abs)
    pairs = [r for r in roots if r.imag > 1e-9 * abs(r)]
    groups = [np.poly([r, r.conjugate()]).real for r in pairs]
    return groups + [np.poly(real[i : i + 2]) for i in range(0, len(real), 2)]


def first_of(plant: control.StateSpace, channel: int) -> tuple[Roots, float]:
    """Zeros and gain of a channel: the least power of s at infinity that does not vanish."""
    b, markov, degree = plant.B[:, [channel]], plant.C, 1
    while abs((markov @ b).item()) <= 1e-9 * np.linalg.norm(markov) * np.linalg.norm(b):
        markov, degree = markov @ plant.A, degree + 1
    alone = control.ss(plant.A, b, plant.C, 0.0)
    zeros = sorted(control.zeros(alone), key=abs)[: plant.nstates - degree]
    return [complex(zero) for zero in zeros], float((markov @ b).item())


def filters(scenario: Scenario) -> list[control.StateSpace]:
    """U, 1/(1 - R), F̂ and the observer from (u1, u2, y) to (N1 u1, N2 u2 - M y)."""
    chosen, tick_s = scenario.design, scenario.tick_s
    model = continuous_plant(scenario.model)
    plant = control.ss(model.a, model.b, model.c, 0.0)
    own, least = poles_of(plant), 0.1 / chosen.tau_q_s
    poles = [pole for pole in own if pole.real >= 0]
    zeros, gain = first_of(plant, 0)
    right = [zero for zero in zeros if zero.real > 0]
    order, tau = chosen.alpha_q + len(poles), chosen.tau_q_s

    sign = (-1.0) ** len(right)
    above = np.polymul(
        np.poly([-1 / tau] * order) * tau**order, np.atleast_1d(np.poly(mirrored(right))).real
    )
    below = sign * np.atleast_1d(np.poly(right)).real
    away = np.array([q for q in poles if q != 0])
    flat = order + 1 - chosen.alpha_q - len(away)  # derivatives of T at 0 equal to those of 1
    series = signal.lfilter(above[::-1], below[::-1], np.eye(1, flat)[0])
    rows = np.eye(flat + len(away), dtype=complex)
    rows[flat:] = np.vander(away, len(rows), increasing=True)
    wanted = np.array([*series, *(np.polyval(above, away) / np.polyval(below, away))])
    p = np.linalg.solve(rows, wanted).real[::-1]
    lags = [complex(-1 / tau)] * order
    u = sections(
        [*np.roots(p), *mirrored(own, least)], [*mirrored(zeros), *lags],
        p[0] / (tau**order * gain * sign), tick_s,
    )  # fmt: skip
    stabiliser = control.ss([], [], [], 0.0, tick_s)
    if poles:
        t_den = np.polymul(np.poly(mirrored(right)), np.poly(lags) * tau**order)
        rest, _ = np.polydiv(
            np.polysub(t_den, sign * np.polymul(np.poly(right), p)), np.poly(poles)
        )
        change = np.polysub(np.poly(poles), np.poly(mirrored(poles, least))).real
        change = np.trim_zeros(np.polymul(change, rest).real, "f")
        stabiliser = sections(
            [complex(root) for root in np.roots(change)], [*mirrored(right), *lags],
            change[0] / tau**order, tick_s,
        )  # fmt: skip
    zeros_2, gain_2 = first_of(plant, 1)
    flips = (-1.0) ** sum(zero.real > 0 for zero in zeros_2)
    f = sections(
        mirrored(own, least), [*mirrored(zeros_2), *[complex(-1 / chosen.tau_s)] * chosen.alpha],
        1.0 / (chosen.tau_s**chosen.alpha * gain_2 * flips), tick_s,
    )  # fmt: skip
    if chosen.compensation == "off":
        f = control.ss([], [], [], 0.0, tick_s)
    one = control.ss([], [], [], 1.0, tick_s)
    named = ((u, "w", "v"), (control.feedback(one, stabiliser, sign=1), "v", "u1"), (f, "d", "u2"))
    parts = [control.ss(part, inputs=[i], outputs=[o], name=f"to {o}") for part, i, o in named]
    return [*parts, observer(plant, poles, least, tick_s)]


def observer(
    plant: control.StateSpace, poles: Roots, least: float, tick_s: float
) -> control.StateSpace:
    """Its gain moves the modes of ``poles`` alone, by Ackermann's formula in their subspace."""
    held = control.c2d(plant, tick_s)
    gain, scale = np.zeros((plant.nstates, 1)), 1.0
    if poles:
        form, basis, size = linalg.schur(held.A, sort=lambda re, im: np.hypot(re, im) > 1 - 1e-6)
        assert size == len(poles)
        moved, own = mirrored(poles, least), form[:size, :size]
        inside = control.acker(
            own.T, (held.C @ basis[:, :size]).T, np.exp(np.array(moved) * tick_s)
        )
        gain = basis[:, :size] @ np.asarray(inside).reshape(-1, 1)
        for pole, image in zip(poles, moved, strict=True):
            change = abs(np.expm1(pole * tick_s) / pole) if pole else tick_s
            scale *= abs(np.expm1(image * tick_s) / image) / change
    return control.ss(
        np.kron(np.eye(2), held.A - gain @ held.C),
        np.block([
            [held.B[:, [0]], np.zeros((plant.nstates, 2))],
            [np.zeros((plant.nstates, 1)), held.B[:, [1]], gain],
        ]),
        scale * np.kron(np.eye(2), held.C),
        scale * np.array([[0.0, 0.0, 0.0], [0.0, 0.0, -1.0]]),
        tick_s, inputs=["a1", "a2", "m"], outputs=["n1", "rest"], name="observer",
    )  # fmt: skip


def loop(scenario: Scenario, left: tuple[float, float], gain: float = 1.0) -> control.StateSpace:
    """From r, and e beside the measurement m = gain y + e, to y, u1, u2, d̂ and m."""
    model, tick_s = continuous_plant(scenario.plant), scenario.tick_s
    held = control.c2d(control.ss(model.a, model.b * left, model.c, 0.0), tick_s)
    delay = control.ss([], [], [], 1.0, tick_s)
    for _ in range(scenario.latency_ticks):
        delay = control.ss(0.0, 1.0, 1.0, 0.0, tick_s) * delay
    blocks = [
        control.ss(held, inputs=["a1", "a2"], outputs=["y"], name="plant"),
        control.ss(delay, inputs=["u1"], outputs=["a1"], name="bus 1"),
        control.ss(delay, inputs=["u2"], outputs=["a2"], name="bus 2"),
        *filters(scenario),
        control.ss(
            [], [], [], [[gain, 1.0]], tick_s, inputs=["y", "e"], outputs=["m"], name="sensor"
        ),
        control.summing_junction(["r", "-m", "n1"], "w", name="error"),
        control.summing_junction(["n1", "rest"], "d", name="residual"),
    ]
    return control.interconnect(blocks, inplist=["r", "e"], outlist=["y", "u1", "u2", "d", "m"])


def step_response(scenario: Scenario) -> FloatArray:
    """y, u1, u2, d̂ at each tick, (4, ticks): a step from rest, the fault in its time."""
    fault = scenario.loss
    lost = round(fault.at_s / scenario.tick_s)
    x, answers = None, []
    for left, ticks in (((1.0, 1.0), lost), ((fault.left, 1.0), scenario.ticks - lost)):
        whole = loop(scenario, left)
        a, b, c, d = whole.A, whole.B[:, 0], whole.C[:4], whole.D[:4, 0]
        x = np.zeros(len(a)) if x is None else x
        r = scenario.reference.amplitude_mps2
        for _ in range(ticks):
            answers.append(c @ x + d * r)
            x = a @ x + b * r
    return np.array(answers).T
