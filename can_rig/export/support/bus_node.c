/* The controller node of scenario {scenario} on a CAN bus: bus operations of FMI-LS-BUS 1.0,
 * network abstraction, numbers with the low byte first.
 *
 * Frames that come in an event are answered in the next iteration of that event. A node whose
 * feedback does not come answers at the end of a communication step.
 */
#include <math.h>
#include <string.h>

#include "fmu.h"

enum { FORMAT_ERROR = 0x01, TRANSMIT = 0x10, FD_TRANSMIT = 0x11, CONFIRM = 0x20 };
enum { ARBITRATION_LOST = 0x30, BUS_ERROR = 0x31, CONFIGURATION = 0x40, STATUS = 0x41 };
enum { WAKE_UP = 0x42, BAUD_RATE = 0x01, HEAD = 8, FRAME_HEAD = 16, FD_FRAME_HEAD = 17 };

static const uint32_t extended = 0x80000000u, fd = 0x40000000u, numbers = 0x1FFFFFFFu;
static const uint32_t bit_rate = {bit_rate}u; /* bit/s; 0: the bus simulation's own */

static uint32_t number_at(const uint8_t *bytes, size_t n)
{
    uint32_t number = 0;

    for (size_t i = n; i > 0; i--) {
        number = number << 8 | bytes[i - 1];
    }
    return number;
}

static void put(struct bus_node *node, uint32_t number, size_t n)
{
    for (size_t i = 0; i < n && node->waiting < SENT_ROOM; i++) {
        node->next[node->waiting] = (uint8_t)(number >> (8 * i));
        node->waiting++;
    }
}

static void put_bytes(struct bus_node *node, const uint8_t *bytes, size_t n)
{
    put(node, (uint32_t)n, 2);
    for (size_t i = 0; i < n; i++) {
        put(node, bytes[i], 1);
    }
}

void ecu_send(const struct ecu *ecu, uint32_t id, uint8_t length, const uint8_t *data)
{
    struct bus_node *const node = (struct bus_node *)(uintptr_t)ecu; /* its first member */
    const bool is_fd = (id & fd) != 0u;

    put(node, is_fd ? FD_TRANSMIT : TRANSMIT, 4);
    put(node, (is_fd ? FD_FRAME_HEAD : FRAME_HEAD) + (uint32_t)length, 4);
    put(node, id & numbers, 4);
    put(node, (id & extended) != 0u, 1);
    put(node, 0, is_fd ? 2 : 1); /* the bit rate stays, no error is announced; no remote frame */
    put_bytes(node, data, length);
}

static uint32_t now_us(const struct instance *self)
{
    return (uint32_t)(int64_t)fmod(rint(self->reals[TIME] * 1e6), 4294967296.0);
}

/* Take in one operation; whether it is sound. */
static bool take(struct instance *self, const uint8_t *operation, size_t n)
{
    const uint32_t code = number_at(operation, 4);
    const size_t head = code == FD_TRANSMIT ? FD_FRAME_HEAD : FRAME_HEAD;

    if (code != TRANSMIT && code != FD_TRANSMIT) {
        return code == FORMAT_ERROR || code == CONFIRM || code == ARBITRATION_LOST ||
               code == BUS_ERROR || code == STATUS || code == CONFIGURATION || code == WAKE_UP;
    }
    if (n < head || n - head > UINT8_MAX || number_at(&operation[head - 2], 2) != n - head) {
        return false;
    }
    const bool is_remote = code == TRANSMIT && operation[13] != 0u;
    const uint32_t id = number_at(&operation[8], 4) | (operation[12] != 0u ? extended : 0u) |
                        (code == FD_TRANSMIT ? fd : 0u);

    if (!is_remote && ecu_on_frame(&self->node.ecu, id, (uint8_t)(n - head), &operation[head],
                                   now_us(self))) {
        ecu_on_tick(&self->node.ecu);
    }
    return true;
}

/* Take in the operations of an event; the answer to an unsound one has the rest of them. */
static void receive(struct instance *self)
{
    struct bus_node *const node = &self->node;
    size_t at = 0;

    while (at < node->received) {
        const uint8_t *const operation = &node->rx[at];
        const size_t left = node->received - at;
        const size_t n = left < HEAD ? 0 : number_at(&operation[4], 4);

        if (n < HEAD || n > left || !take(self, operation, n)) {
            put(node, FORMAT_ERROR, 4);
            put(node, (uint32_t)(HEAD + 2 + left), 4);
            put_bytes(node, operation, left);
            break;
        }
        at += n;
    }
    node->received = 0;
}

/* The operations that wait are those of this event. */
static void send(struct bus_node *node)
{
    (void)memcpy(node->tx, node->next, node->waiting);
    node->sent = node->waiting;
    node->waiting = 0;
    node->tx_is_active = node->sent > 0;
}

bool model_works(struct instance *self)
{
    return ecu_init(&self->node.ecu);
}

void model_start(struct instance *self)
{
    (void)ecu_init(&self->node.ecu);
    if (bit_rate > 0u) {
        put(&self->node, CONFIGURATION, 4);
        put(&self->node, HEAD + 5, 4);
        put(&self->node, BAUD_RATE, 1);
        put(&self->node, bit_rate, 4);
    }
}

/* The initialisation ends in an event. */
void model_begin(struct instance *self)
{
    send(&self->node);
}

/* The end of a communication step. */
void model_tick(struct instance *self, bool first)
{
    (void)first;
    while (ecu_is_overdue(&self->node.ecu, now_us(self))) {
        ecu_on_tick(&self->node.ecu);
    }
}

EXPORT int fmi3EnterEventMode(void *instance)
{
    send(&((struct instance *)instance)->node);
    return FMI_OK;
}

ANSWERS(fmi3EnterStepMode, FMI_OK)

EXPORT int fmi3UpdateDiscreteStates(void *instance, bool *again, bool *terminate,
                                    bool *nominals_changed, bool *states_changed, bool *has_next,
                                    double *next_s)
{
    struct instance *const self = instance;

    (void)next_s;
    if (self->node.rx_is_active) {
        receive(self);
    }
    self->node.rx_is_active = false;
    send(&self->node);
    *again = self->node.tx_is_active;
    *terminate = *nominals_changed = *states_changed = *has_next = false;
    return FMI_OK;
}

EXPORT int fmi3SetClock(void *instance, const uint32_t references[], size_t n, const bool values[])
{
    for (size_t i = 0; i < n; i++) {
        if (references[i] != RX_CLOCK) {
            return fmu_refuse(instance, "a clock to set must be rx_clock");
        }
        ((struct instance *)instance)->node.rx_is_active = values[i];
    }
    return FMI_OK;
}

EXPORT int fmi3GetClock(void *instance, const uint32_t references[], size_t n, bool values[])
{
    for (size_t i = 0; i < n; i++) {
        if (references[i] != TX_CLOCK) {
            return fmu_refuse(instance, "a clock to get must be tx_clock");
        }
        values[i] = ((struct instance *)instance)->node.tx_is_active;
    }
    return FMI_OK;
}

EXPORT int fmi3SetBinary(void *instance, const uint32_t references[], size_t n,
                         const size_t sizes[], const uint8_t *const values[], size_t n_values)
{
    struct bus_node *const node = &((struct instance *)instance)->node;

    for (size_t i = 0; i < n; i++) {
        if (references[i] != RX_DATA || n_values != n || sizes[i] > RECEIVED_ROOM) {
            return fmu_refuse(instance, "a binary to set must be rx_data, of at most 4096 bytes");
        }
        (void)memcpy(node->rx, values[i], sizes[i]);
        node->received = sizes[i];
    }
    return FMI_OK;
}

EXPORT int fmi3GetBinary(void *instance, const uint32_t references[], size_t n, size_t sizes[],
                         const uint8_t *values[], size_t n_values)
{
    struct bus_node *const node = &((struct instance *)instance)->node;

    for (size_t i = 0; i < n; i++) {
        if (references[i] != TX_DATA || n_values != n) {
            return fmu_refuse(instance, "a binary to get must be tx_data");
        }
        sizes[i] = node->sent;
        values[i] = node->tx;
    }
    return FMI_OK;
}
