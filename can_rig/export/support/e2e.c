#include "e2e.h"

#include "crc.h"

#define COUNTERS 15u    /* 0..14 */
#define MAX_DELTA 1u    /* tolerated step where no frame was missed */
#define WIDEST 15u      /* a window that tolerates every step */

static uint8_t crc_of_identifier(uint16_t data_id)
{
    const uint8_t bytes[2] = {(uint8_t)(data_id & 0xFFu), (uint8_t)(data_id >> 8)};

    return crc_8(0, bytes, 2);
}

void e2e_protector_init(struct e2e_protector *protector, uint16_t data_id)
{
    *protector = (struct e2e_protector){.data_id = data_id, .begun = crc_of_identifier(data_id)};
}

void e2e_checker_init(struct e2e_checker *checker, uint16_t data_id, uint8_t bytes)
{
    *checker = (struct e2e_checker){.data_id = data_id, .begun = crc_of_identifier(data_id),
                                    .bytes = bytes, .window = MAX_DELTA};
}

void e2e_protect(struct e2e_protector *protector, uint8_t *data, uint8_t bytes)
{
    if (protector->data_id != 0u) {
        data[1] = (uint8_t)((data[1] & 0xF0u) | protector->counter);
        data[0] = crc_8(protector->begun, &data[1], bytes - 1u);
        protector->counter = (uint8_t)((protector->counter + 1u) % COUNTERS);
    }
}

bool e2e_intact(const struct e2e_checker *checker, const uint8_t *data, uint8_t length)
{
    return length == checker->bytes &&
           (checker->data_id == 0u || (data[0] == crc_8(checker->begun, &data[1], length - 1u) &&
                                       (data[1] & 0x0Fu) < COUNTERS));
}

/* Adopt the counter of a frame, with the initial tolerance. */
static enum e2e_status accept(struct e2e_checker *checker, uint8_t counter, enum e2e_status status)
{
    checker->known = true;
    checker->last = counter;
    checker->window = MAX_DELTA;
    return status;
}

/* Compare the counter of an intact frame with that of the last one. */
static enum e2e_status judge(struct e2e_checker *checker, uint8_t counter)
{
    if (!checker->known) {
        return accept(checker, counter, E2E_INITIAL);
    }
    const uint32_t delta = (counter + COUNTERS - checker->last) % COUNTERS;

    if (delta == 0u) {
        return E2E_REPEATED;
    }
    if (delta > checker->window) {
        checker->sync = 1;
        return accept(checker, counter, E2E_WRONG_SEQUENCE);
    }
    if (checker->sync > 0u) {
        checker->sync--;
        return accept(checker, counter, E2E_SYNC);
    }
    return accept(checker, counter, delta == 1u ? E2E_OK : E2E_OK_SOME_LOST);
}

static void widen(struct e2e_checker *checker)
{
    if (checker->window < WIDEST) {
        checker->window++;
    }
}

static enum e2e_status damage(const struct e2e_checker *checker, uint8_t length)
{
    return length == checker->bytes ? E2E_WRONG_CRC : E2E_WRONG_LENGTH;
}

bool e2e_check(struct e2e_checker *checker, const uint8_t *data, uint8_t length)
{
    enum e2e_status status = damage(checker, length);
    const bool intact = e2e_intact(checker, data, length);

    widen(checker);
    if (intact) {
        status = checker->data_id == 0u ? E2E_OK : judge(checker, data[1] & 0x0Fu);
    }
    checker->counts[status]++;
    return status <= E2E_OK_SOME_LOST;
}

void e2e_reject(struct e2e_checker *checker, const uint8_t *data, uint8_t length)
{
    checker->counts[e2e_intact(checker, data, length) ? E2E_WRONG_TICK : damage(checker, length)]++;
}

void e2e_no_new_data(struct e2e_checker *checker)
{
    widen(checker);
    checker->counts[E2E_NO_NEW_DATA]++;
}
