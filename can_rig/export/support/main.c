/* An example: {input_words} from standard input,
 * a line a tick, commands to standard output. On a target a timer calls firmware_step instead.{input_note}
 */
#include <stdio.h>

#include "firmware.h"

static struct {memory} state;

int main(void)
{
    double reference;
    double measurement;{input_members}
    char line[256];

    firmware_init(&state);
    firmware_reset(&state, {zero});
    while (fgets(line, sizeof line, stdin) != NULL) {
        if (sscanf(line, "%lf %lf{input_format}",
                   &reference, &measurement{input_places}) != {inputs}) {
            (void)fputs("a line must have {inputs} numbers: "
                        "{input_words}\n",
                        stderr);
            return 2;
        }{input_speed}
        const struct firmware_answer answer =
            firmware_step(&state, (real)reference, (real)measurement);

        printf("%.17g %.17g %.17g %d %d %d\n", (double)answer.command_1, (double)answer.command_2,
               (double)answer.fault_estimate, (int)answer.mode, (int)answer.fault_state,
               (int)answer.verdict);
    }
    return 0;
}
