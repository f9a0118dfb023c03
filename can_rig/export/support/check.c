/* The self-test as a program: exit status 0 where it succeeds. */
#include <stdio.h>

#include "self_test.h"

int main(void)
{
//: if blends
    static struct firmware_memory memory;
//: else
    static struct layout_state memory;
//: end
    const bool succeeds = self_test(&memory);

    (void)puts(succeeds ? "self-test: the controller computes as in Python"
                        : "self-test: FAILED: compiler, its options or a constant differ");
    return succeeds ? 0 : 1;
}
