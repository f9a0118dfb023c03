"""Parts of a node's C code that depend on receiving the car's speed."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Final

DEAF: Final = {
    "receivers": "2",
    "heard": "reference and feedback",
    "speed_members": "",
    "speed_function": "",
    "speed_init": "",
    "speed_first": "",
    "speed_started": "",
    "speed_frame": "",
    "speed_end": "",
    "speed_declared": "",
    "speed_counted": "",
}
"""Words of the support files, by their place, of a node that hears no speed."""

HEARING: Final = {
    "receivers": "3",
    "heard": "reference, feedback and speed",
    "speed_members": """
    struct ecu_receiver speed;
    bool speed_offered;     /* whether a speed came before the first contact: */
    uint8_t first_speed[8]; /* its bytes */
    uint8_t first_speed_length;""",
    "speed_init": """
    receiver_init(&ecu->speed, &frame_speed);""",
    "speed_first": """
    if (id == frame_speed.id) {
        ecu->speed_offered = true;
        ecu->first_speed_length = length;
        (void)memcpy(ecu->first_speed, data, length < 8 ? length : 8);
        return false;
    }""",
    "speed_started": """
    if (ecu->speed_offered) {
        take_speed(ecu, ecu->first_speed_length, ecu->first_speed);
    }""",
    "speed_frame": """ else if (id == frame_speed.id) {
        take_speed(ecu, length, data);
    }""",
    "speed_end": """
    end_tick(&ecu->speed);""",
    "speed_declared": """
extern const struct frame frame_speed;""",
    "speed_counted": ", &ecu->speed",
}
"""Parts for a node with speed; ``speed_function`` uses the received speed."""

ONE_DESIGN: Final = {
    "memory": "layout_state",
    "speed_function": """
/* Judged and counted like any other; the law is for one speed. */
static void take_speed(struct ecu *ecu, uint8_t length, const uint8_t *data)
{
    (void)receive(&ecu->speed, ecu->tick, length, data);
}
""",
    "inputs": "2",
    "input_words": "reference and measurement",
    "input_note": "",
    "input_members": "",
    "input_places": "",
    "input_format": "",
    "input_speed": "",
    "counted_speed": "",
    "trial_includes": "",
    "trial_members": "",
    "trial_orders": "",
    "trial_cases": "",
    "trial_answer": "",
}
"""Parts for a law with a single design."""

BLENDED: Final = {
    "memory": "firmware_memory",
    "speed_function": """
/* Without a frame that may be used, the law goes on with the last speed. */
static void take_speed(struct ecu *ecu, uint8_t length, const uint8_t *data)
{
    if (receive(&ecu->speed, ecu->tick, length, data)) {
        firmware_change_speed(&ecu->state, (real)frame_value(&frame_speed, data));
    }
}
""",
    "inputs": "3",
    "input_words": "reference, measurement and speed of the car",
    "input_note": """
 * A speed that is nan is as it was.""",
    "input_members": """
    double speed;""",
    "input_places": ", &speed",
    "input_format": " %lf",
    "input_speed": """
        firmware_change_speed(&state, (real)speed);""",
    "counted_speed": """
        firmware_change_speed(&state, (real)inputs[i][2]);""",
    "trial_includes": '#include "schedule.h"\n',
    "trial_members": """\
static struct schedule_constants schedule;
static struct schedule_state blending;
""",
    "trial_orders": """\
 *     'B', schedule, blending       there is no answer
 *     'V', speed                    change of the speed; the state
 *
 * Behind each state go the table and the blending.
""",
    "trial_cases": """\
    case 'B':
        return load(&schedule, sizeof schedule) && load(&blending, sizeof blending);
    case 'V':
        if (!load(inputs, sizeof inputs[0])) {
            return false;
        }
        schedule_change_speed(&schedule, &blending, &table, &state, inputs[0]);
        break;
""",
    "trial_answer": """ &&
           bench_write((const uint8_t *)&table, sizeof table) &&
           bench_write((const uint8_t *)&blending, sizeof blending)""",
}
"""Parts for designs blended by speed."""


def words(hears: bool, blends: bool) -> dict[str, str]:
    """Parts for a node with or without speed, and for a law with or without blended designs."""
    chosen = HEARING if hears else DEAF
    of_law = BLENDED if blends else ONE_DESIGN
    return {**of_law, **chosen}


def words_of(files: Mapping[str, str]) -> dict[str, str]:
    """Parts used in the files of an application, or of a law alone."""
    return words("frame_speed" in files.get("frames.h", ""), "schedule.c" in files)
