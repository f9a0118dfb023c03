/* The controller node on a CAN bus of FMI-LS-BUS 1.0; see bus_node.c. */
#ifndef BUS_NODE_H
#define BUS_NODE_H

#include "ecu.h"

enum { RECEIVED_ROOM = 4096, SENT_ROOM = 32768 };

struct bus_node {
    struct ecu ecu;
    bool rx_is_active, tx_is_active; /* the clocks */
    size_t received, sent, waiting;  /* bytes */
    uint8_t rx[RECEIVED_ROOM];
    uint8_t tx[SENT_ROOM];  /* the operations of this event */
    uint8_t next[SENT_ROOM]; /* the operations of the next one */
};

#endif
