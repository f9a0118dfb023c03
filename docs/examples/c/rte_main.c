/* In the place of OS and COM: recorded signals for each call of the runnable, its answers sent. */
#include <math.h>

#include "Rte_Steering.h"
#include "host.h"

struct rte_steering rte_steering;

static struct rte_signal signal_of(double value)
{
    return (struct rte_signal){(real)value, isnan(value) ? RTE_E_MAX_AGE_EXCEEDED : E_OK};
}

int main(void)
{
    const int received = host_open_to_read("received");
    const int sent = host_open_to_write("sent");
    double recorded[2]; /* reference and measurement of a tick; not a number: none came */

    Steering_Init();
    while (host_read(received, recorded, sizeof recorded)) {
        rte_steering.reference = signal_of(recorded[0]);
        rte_steering.measurement = signal_of(recorded[1]);
        Steering_Step();
        (void)host_write(sent, &rte_steering.answer, sizeof rte_steering.answer);
    }
    host_exit();
    return 0;
}
