/* An example: reference and measurement from standard input, a line a tick, commands to standard
 * output. On a target a timer calls firmware_step instead.
 */
#include <stdio.h>

#include "firmware.h"

static struct {memory} state;

int main(void)
{
    double reference;
    double measurement;

    firmware_init(&state);
    firmware_reset(&state, {zero});
    while (scanf("%lf %lf", &reference, &measurement) == 2) {
        const struct firmware_answer answer =
            firmware_step(&state, (real)reference, (real)measurement);
        printf("%.17g %.17g %.17g %d %d %d\n", (double)answer.command_1, (double)answer.command_2,
               (double)answer.fault_estimate, (int)answer.mode, (int)answer.fault_state,
               (int)answer.verdict);
    }
    return 0;
}
