/* Cyclic redundancy checks by tables. */
#ifndef CRC_H
#define CRC_H

#include <stdint.h>

#ifdef __cplusplus
extern "C" {
#endif

/* CRC-32 (IEEE 802.3) of further bytes; begins with UINT32_MAX, and its complement is the result. */
uint32_t crc_32(uint32_t crc, const uint8_t *bytes, uint32_t size);

/* CRC-8 (SAE J1850) of further bytes. */
uint8_t crc_8(uint8_t crc, const uint8_t *bytes, uint32_t size);

#ifdef __cplusplus
}
#endif

#endif
