/* The controller node on a test bench, in place of its CAN driver.
 *
 * Any link that keeps bytes in order will do: a serial port, semihosting. The bench sends orders of
 * {order_bytes} bytes, of which the first says what it is; the node answers each one:
 *
 *     'F', identifier (4 bytes), length, data       number of frames, then {sent_bytes} bytes for each frame
 *                                                   that was sent: identifier (4), length, data
 *     'T', microseconds (4), anything               as for 'F'; frames that follow come at this time,
 *                                                   and a feedback that is overdue is missed
//: if hears
 *     'C', anything                                 how many frames of reference, feedback and speed
//: else
 *     'C', anything                                 how many frames of reference and feedback
//: end
 *                                                   had each e2e_status (10 numbers of 4 bytes each)
 *     'R', anything                                 8 bytes that say which controller this is; it has
 *                                                   started again, as after power-up; zeros: its
 *                                                   self-test failed, and it stays silent
 *
 * Numbers have their low byte first. Bytes before an order that are none of these letters are skipped:
 * {order_bytes} zeros end an order that was cut short.
 */
#ifndef BENCH_H
#define BENCH_H

#include <stdbool.h>
#include <stdint.h>

#ifdef __cplusplus
extern "C" {
#endif

/* Answer orders for as long as there is a link. */
void bench_run(void);

/* To be provided by the board: all the bytes, however long it takes; false: the link has ended. */
bool bench_read(uint8_t *data, uint32_t size);
bool bench_write(const uint8_t *data, uint32_t size);

#ifdef __cplusplus
}
#endif

#endif
