/* CRC-32 (IEEE 802.3, as zlib's), bit by bit: it guards parameters on their way into a device, speed is no matter. */
#ifndef PF_CRC_H
#define PF_CRC_H
#include <stddef.h>
#include <stdint.h>
#include <string.h>

static inline uint32_t pf_crc32(const void *data, size_t bytes) {
  const unsigned char *byte = (const unsigned char *)data;
  uint32_t crc = 0xFFFFFFFFu;
  for (size_t i = 0; i < bytes; i++) {
    crc ^= byte[i];
    for (int bit = 0; bit < 8; bit++) crc = (crc >> 1) ^ (0xEDB88320u & (0u - (crc & 1u)));
  }
  return ~crc;
}

/* Number by number with the low byte first: the same on every target, whatever its byte order and padding. Chained,
 * crc = pf_crc32_double(crc, values, count), from 0 on; the bytes of all in a row give the same as pf_crc32. */
static inline uint32_t pf_crc32_bits(uint32_t crc, uint64_t value, int bytes) {
  crc = ~crc;
  for (int i = 0; i < bytes; i++, value >>= 8) {
    crc ^= (uint32_t)(value & 0xFFu);
    for (int bit = 0; bit < 8; bit++) crc = (crc >> 1) ^ (0xEDB88320u & (0u - (crc & 1u)));
  }
  return ~crc;
}

static inline uint32_t pf_crc32_uint(uint32_t crc, const uint32_t *values, int count) {
  for (int i = 0; i < count; i++) crc = pf_crc32_bits(crc, values[i], 4);
  return crc;
}

static inline uint32_t pf_crc32_float(uint32_t crc, const float *values, int count) {
  for (int i = 0; i < count; i++) {
    uint32_t bits;
    memcpy(&bits, &values[i], sizeof bits);
    crc = pf_crc32_bits(crc, bits, 4);
  }
  return crc;
}

static inline uint32_t pf_crc32_double(uint32_t crc, const double *values, int count) {
  for (int i = 0; i < count; i++) {
    uint64_t bits;
    memcpy(&bits, &values[i], sizeof bits);
    crc = pf_crc32_bits(crc, bits, 8);
  }
  return crc;
}

#endif
