/* AUTOSAR end-to-end protection, profile 1 (variant 1A), of a frame of any length.
 *
 * Byte 0 is a CRC-8 (SAE J1850, polynomial 0x1D) over the low and the high byte of the data
 * identifier and the bytes from 1 on; the low nibble of byte 1 is a counter 0..14. A frame with the
 * data identifier 0 is not protected: only its length is checked.
 * Source: AUTOSAR SWS E2E Library (Doc. 428), E2E_P01Protect and E2E_P01Check, with both bytes of
 * the data identifier, SyncCounterInit 1 and no monitor of repeated data.
 */
#ifndef E2E_H
#define E2E_H

#include <stdbool.h>
#include <stdint.h>

#ifdef __cplusplus
extern "C" {
#endif

/* Result of the check of one frame; with any but the first three it updates nothing. */
enum e2e_status {
    E2E_OK,             /* the next frame */
    E2E_INITIAL,        /* the first intact frame: there is no counter to compare with */
    E2E_OK_SOME_LOST,   /* intact and newer, with a tolerated number lost before it */
    E2E_REPEATED,       /* the same counter as in the last frame */
    E2E_WRONG_SEQUENCE, /* too many frames lost, or an old frame */
    E2E_SYNC,           /* in sequence again after E2E_WRONG_SEQUENCE, but not yet confirmed */
    E2E_WRONG_CRC,      /* damaged, another sender's, or the counter 15, which no sender uses */
    E2E_WRONG_LENGTH,   /* another length than the frame's */
    E2E_NO_NEW_DATA,    /* no frame at all where one was due */
    E2E_WRONG_TICK,     /* intact, but of another tick; its counter is not checked */
    E2E_STATUSES
};

/* The sending end of one frame. */
struct e2e_protector {
    uint16_t data_id;
    uint8_t begun;   /* the CRC of the data identifier */
    uint8_t counter; /* of the next frame */
};

/* The receiving end of one frame. */
struct e2e_checker {
    uint16_t data_id;
    uint8_t begun;   /* the CRC of the data identifier */
    uint8_t bytes;   /* of a frame */
    bool known;      /* whether there has been a frame */
    uint8_t last;    /* its counter */
    uint8_t window;  /* largest step of the counter that is tolerated now */
    uint8_t sync;    /* frames in sequence still needed before use */
    uint32_t counts[E2E_STATUSES];
};

void e2e_protector_init(struct e2e_protector *protector, uint16_t data_id);
void e2e_checker_init(struct e2e_checker *checker, uint16_t data_id, uint8_t bytes);

/* Write the next counter and the CRC into a frame of 'bytes' bytes. */
void e2e_protect(struct e2e_protector *protector, uint8_t *data, uint8_t bytes);

/* Whether a frame has its length, the right CRC and a counter that a sender uses. */
bool e2e_intact(const struct e2e_checker *checker, const uint8_t *data, uint8_t length);

/* Judge a received frame of the current tick; whether its content may be used. */
bool e2e_check(struct e2e_checker *checker, const uint8_t *data, uint8_t length);

/* Count a frame of another tick than the current one; nothing else changes. */
void e2e_reject(struct e2e_checker *checker, const uint8_t *data, uint8_t length);

/* Note that a frame was due and none arrived. */
void e2e_no_new_data(struct e2e_checker *checker);

#ifdef __cplusplus
}
#endif

#endif
