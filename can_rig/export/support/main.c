//: if blends
/* An example: reference, measurement and speed of the car from standard input,
//: else
/* An example: reference and measurement from standard input,
//: end
 * a line a tick, commands to standard output. On a target a timer calls firmware_step instead.
//: if blends
 * A speed that is nan is as it was.
//: end
 */
#include <stdio.h>

#include "firmware.h"

//: if blends
static struct firmware_memory state;
//: else
static struct layout_state state;
//: end

int main(void)
{
    double reference;
    double measurement;
//: if blends
    double speed;
//: end
    char line[256];

    firmware_init(&state);
    firmware_reset(&state, {zero});
    while (fgets(line, sizeof line, stdin) != NULL) {
//: if blends
        if (sscanf(line, "%lf %lf %lf",
                   &reference, &measurement, &speed) != 3) {
            (void)fputs("a line must have 3 numbers: "
                        "reference, measurement and speed of the car\n",
                        stderr);
            return 2;
        }
        firmware_change_speed(&state, (real)speed);
//: else
        if (sscanf(line, "%lf %lf",
                   &reference, &measurement) != 2) {
            (void)fputs("a line must have 2 numbers: "
                        "reference and measurement\n",
                        stderr);
            return 2;
        }
//: end
        const struct firmware_answer answer =
            firmware_step(&state, (real)reference, (real)measurement);

        printf("%.17g %.17g %.17g %d %d %d\n", (double)answer.command_1, (double)answer.command_2,
               (double)answer.fault_estimate, (int)answer.mode, (int)answer.fault_state,
               (int)answer.verdict);
    }
    return 0;
}
