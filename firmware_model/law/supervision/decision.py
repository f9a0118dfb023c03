"""Is channel 1 lost? The tick-by-tick decision on the fault estimate d̂.

``mismatch`` removes the effect of other cars from d̂, ``loss_model`` removes known losses, and
``likelihood_ratio`` weighs the rest for a loss, or for the return of a lost channel. The evidence g
makes a loss

    SUSPECTED   from ``suspect`` on: the driver may be told
    CONFIRMED   from ``confirm`` on, by chance once in a given number of hours: F̂ compensates;
                a candidate of a takeover from ``suspect`` on

and clears a confirmed loss from ``recover`` on for the return: a false return costs more than a
late return. A suspicion ends with its candidate and moves no actuator: most faults that are no loss
of channel 1 reach ``suspect`` before they contradict the candidate, and a compensation would add to
their harm.

A fault of the sensor or of channel 2 changes d̂ too. If ``hypotheses`` finds such a fault, the
suspicion ends. If channel 1 contributes too little to show its loss within ``horizon``, a small d̂
proves no health, and the state is CANNOT_TELL instead of CLEAR.
"""

from __future__ import annotations

from typing import TYPE_CHECKING, Annotated

from firmware_model.compiled import firmware
from firmware_model.law.precision import real
from firmware_model.law.status import FaultState
from firmware_model.law.structs import Struct
from firmware_model.law.supervision.bumpless_transfer import begin_transfer
from firmware_model.law.supervision.corroboration import follow_residual, torque_waits
from firmware_model.law.supervision.echoes import known_output, says_lost
from firmware_model.law.supervision.likelihood_ratio import (
    forget_candidate,
    lost_share,
    start_candidate,
    update_test,
)
from firmware_model.law.supervision.loss_model import (
    clear_loss_model,
    earlier_missing,
    earlier_shown,
    fading_output,
    follow_share,
    known_share,
    loss_output,
    loss_shown,
    take_over_candidate,
)
from firmware_model.law.supervision.mismatch import innovation, learn_loss, predict_mismatch
from firmware_model.law.supervision.other_cars import show_other_cars
from firmware_model.law.supervision.sensor_error import sensor_error_shown
from firmware_model.law.supervision.signatures import begin_all
from firmware_model.law.supervision.verdict import (
    TORQUE_LOST,
    clear_hypotheses,
    found_elsewhere,
    weigh_hypotheses,
)

if TYPE_CHECKING:
    from firmware_model.law import layout
    from firmware_model.law.layout import Table


CLEAR, SUSPECTED, CONFIRMED, CANNOT_TELL = (
    int(FaultState.CLEAR),
    int(FaultState.SUSPECTED),
    int(FaultState.CONFIRMED),
    int(FaultState.CANNOT_TELL),
)


class Constants(Struct):
    """Constants."""

    confirm: Annotated[float, "1", "evidence that confirms a loss"]
    recover: Annotated[
        float, "1", "evidence that ends a loss: more, because a return is not urgent"
    ]
    suspect: Annotated[float, "1", "evidence of a suspicion; confirms a candidate of a takeover"]
    horizon: Annotated[float, "tick", "time within which a new loss must show"]
    shown: Annotated[float, "1", "energy of a constant of size 1 behind W within ``horizon``"]


@firmware
def decide(
    table: Table, state: layout.State, residual: float, model_1: float, model_2: float
) -> None:
    """The fault state of this tick.

    Args:
        table: the constant table.
        state: changed in place.
        residual: G1 u1 + G2 u2 - y of this tick.
        model_1: G1 u1 in the residual: a working channel 1 adds G1 u1 to y.
        model_2: G2 u2 likewise.
    """
    constants, test = table.decision, state.sequential_test
    show_acting_commands(table, state)
    if table.corroboration.gust > 0.0:
        follow_residual(table.corroboration, state.corroboration, residual)
    before, w = state.fault_state, loss_shown(table, state)
    known = sensor_error_shown(table, state)
    predict_mismatch(table, state, model_1 + model_2, w, earlier_shown(table, state))
    fading = earlier_missing(table, state)
    lost = state.loss_model.share
    new = innovation(table.mismatch, state.mismatch, residual, known, fading, lost)
    follow_share(table.loss_model, state)
    share = table.sequential_test.share
    update_test(table, state, new, -known_share(state) if before == CONFIRMED else share)
    weigh_hypotheses(table, state, new, model_1 + model_2 - fading - lost * w)
    if found_elsewhere(state.hypotheses):
        state.fault_state = CLEAR
        start_candidate(table, state)
        return
    if before == CONFIRMED:
        if test.evidence > constants.recover:
            recover(table, state)
        return
    if is_acquitted(table, state):
        state.fault_state = CANNOT_TELL
    elif test.evidence > needed_evidence(table, state) and not torque_waits(table, state):
        confirm(table, state)
    elif test.evidence > constants.suspect or (before == SUSPECTED and test.evidence > 0.0):
        state.fault_state = SUSPECTED
    else:
        shows = constants.shown * model_1 * model_1
        state.fault_state = CLEAR
        if shows < constants.confirm * state.mismatch.variance:
            state.fault_state = CANNOT_TELL


@firmware
def is_acquitted(table: Table, state: layout.State) -> bool:
    """Whether the echo of actuator 2 explains d̂ at least half as well as a loss of channel 1."""
    own = state.hypotheses
    other = own.signatures.force_echo.candidate.evidence
    half = real(0.5, other)
    acquitted: bool = other > table.decision.suspect and other > half * own.evidence[TORQUE_LOST]
    return acquitted


@firmware
def needed_evidence(table: Table, state: layout.State) -> float:
    """The evidence that confirms a loss of channel 1.

    Less is needed where the echo of actuator 1 says so too.
    """
    constants, test = table.decision, state.sequential_test
    needed: float = constants.confirm
    echo = state.echoes.channel_1
    if echo.believed == 1:  # the missing output is known already
        needed = constants.recover
    elif test.of_takeover == 1 or says_lost(table.echoes.actuator_1, echo):
        needed = constants.suspect
    return needed


@firmware
def show_acting_commands(table: Table, state: layout.State) -> None:
    """Tell the other cars the commands visible in the measurement, without the known loss."""
    one = real(1.0, state.command_1)
    share = one - known_share(state) if state.fault_state == CONFIRMED else one
    command_1 = state.estimator.showing_1 * share
    command_2 = state.estimator.showing_2
    if table.estimator.shown_ticks_2 == 0:  # this tick's command is unknown yet, or held
        command_2 = state.command_2
    show_other_cars(table, state, command_1, command_2)


@firmware
def confirm(table: Table, state: layout.State) -> None:
    """Take channel 1 for lost since the start of the candidate."""
    state.fault_state = CONFIRMED
    share = lost_share(table.sequential_test, state.sequential_test)
    take_candidate(table, state, share, real(1.0, share))


@firmware
def recover(table: Table, state: layout.State) -> None:
    """Channel 1 works again, since the start of the candidate."""
    state.fault_state = CLEAR
    share = known_share(state)
    take_candidate(table, state, share, -real(1.0, share))


@firmware
def withdraw_loss(table: Table, state: layout.State) -> None:
    """Nothing was lost: the compensation fades out."""
    clear_loss_model(state)
    transfer_to_losses(table, state)
    state.fault_state = CLEAR
    none = real(0.0, state.command_1)
    learn_loss(table.mismatch, state.mismatch, none, none)
    set_aside(table, state)


@firmware
def set_aside(table: Table, state: layout.State) -> None:
    """No d̂ up to now is evidence."""
    start_candidate(table, state)
    clear_hypotheses(state)
    if state.fault_state == SUSPECTED:
        state.fault_state = CLEAR


@firmware
def take_candidate(table: Table, state: layout.State, share: float, sign: float) -> None:
    """Accept the candidate: ``share`` is lost (``sign`` 1) or works again (-1).

    From now on the filter learns the errors of share and moment.
    """
    constants, test = table.loss_model, state.sequential_test
    doubt = constants.doubt / max(test.information, table.decision.suspect)
    doubt = max(doubt, constants.least_doubt)
    moment = constants.moment * test.age
    take_over_candidate(table, state, share, sign)
    transfer_to_losses(table, state)
    forget_candidate(table, state, sign * share)
    learn_loss(
        table.mismatch, state.mismatch, min(constants.share_variance, doubt), moment * moment
    )
    start_candidate(table, state)
    begin_all(state.hypotheses.signatures)


@firmware
def transfer_to_losses(table: Table, state: layout.State) -> None:
    """Begin a bumpless transfer of F̂ to the known loss."""
    loss = state.loss_model
    lost = loss.previous_fading + loss.followed * loss.previous_output
    lost += state.echoes.channel_1.previous - state.echoes.handed
    speed = compensated_output(table, state) - lost
    begin_transfer(table.bumpless_transfer, state.bumpless_transfer, lost, speed)


@firmware
def compensated_output(table: Table, state: layout.State) -> float:
    """The input of F̂: the known missing output."""
    loss = state.loss_model
    lost: float = fading_output(table, state) + loss.followed * loss_output(table, state)
    if table.echoes.longest > 0:
        g1, echo = table.estimator.channel_1, state.echoes.channel_1
        lost += known_output(table.echoes.actuator_1, g1, echo) - state.echoes.handed
    return lost
