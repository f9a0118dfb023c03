"""What stands in the C of a node for a car whose speed changes, and nowhere else."""

from __future__ import annotations

from typing import Final

ONE_SPEED: Final = {
    "memory": "layout_state",
    "speed_members": "",
    "speed_function": "",
    "speed_init": "",
    "speed_first": "",
    "speed_started": "",
    "speed_frame": "",
    "speed_end": "",
    "speed_declared": "",
}
"""Words of the support files, by their place, of a node for one speed."""

CHANGING_SPEED: Final = {
    "memory": "firmware_memory",
    "speed_members": """
    struct ecu_receiver speed;
    bool speed_offered;     /* whether a speed came before the first contact: */
    uint8_t first_speed[8]; /* its bytes */
    uint8_t first_speed_length;""",
    "speed_function": """
/* Without a frame that may be used, the law goes on with the last speed. */
static void take_speed(struct ecu *ecu, uint8_t length, const uint8_t *data)
{
    if (receive(&ecu->speed, ecu->tick, length, data)) {
        firmware_change_speed(&ecu->state, (real)frame_value(&frame_speed, data));
    }
}
""",
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
}
"""The same of a node that hears the speed."""


def words(changing: bool) -> dict[str, str]:
    """For a controller with a schedule, or one without."""
    return CHANGING_SPEED if changing else ONE_SPEED
