/* Keeps which combinations of its conditions each decision has had, and writes them at the end. */
#include <stdint.h>
#include <stdio.h>

#include "recorder.h"

static const uint32_t begins[] = {{begins}};
static uint32_t now[sizeof begins / sizeof begins[0]];
static uint8_t seen[{size}];

void recorder_begin(int decision)
{
    now[decision] = 0;
}

int recorder_condition(int decision, int number, int holds)
{
    now[decision] |= (holds ? 2u : 1u) << (2 * number);
    return holds;
}

int recorder_end(int decision, int holds)
{
    seen[begins[decision] + now[decision]] = 1;
    return holds;
}

/* Adds to what earlier runs of the program have kept. */
__attribute__((constructor)) static void load(void)
{
    FILE *const file = fopen("seen", "rb");

    if (file != NULL) {
        (void)!fread(seen, sizeof seen, 1, file);
        (void)fclose(file);
    }
}

__attribute__((destructor)) static void keep(void)
{
    FILE *const file = fopen("seen", "wb");

    (void)fwrite(seen, sizeof seen, 1, file);
    (void)fclose(file);
}
