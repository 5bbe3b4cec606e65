/* heft node frames: what a microcontroller sends to the flight computer over a UART. Format: docs/node_frame.md.
 *
 * C99, no allocation, no library but stdint.h, stddef.h and string.h, no floating point, no static state. One context
 * calls heft_node_descriptor and heft_node_data and sends what they give in that order; heft_node_pulse may be called
 * from the interrupt of the sync line if it cannot interrupt heft_node_data half way (mask it there on an 8-bit core).
 */
#ifndef HEFT_NODE_H
#define HEFT_NODE_H

#include <stddef.h>
#include <stdint.h>

enum heft_type { HEFT_U8, HEFT_I8, HEFT_U16, HEFT_I16, HEFT_U32, HEFT_I32, HEFT_I64 };

enum { HEFT_WRAPS = 1 };                              /* channel flag: a counter that wraps at the width of its type */
enum { HEFT_NOT_VALID = 1, HEFT_SATURATED = 2 };      /* status byte; the other bits are the node's own */

/* Bytes to reserve, delimiter included, for a frame of `channels` channels of any type. */
#define HEFT_COBS_BYTES(payload) ((payload) + (payload) / 254 + 2)
#define HEFT_DATA_BYTES(channels) HEFT_COBS_BYTES(23 + 8 * (channels))
#define HEFT_DESCRIPTOR_BYTES(channels) HEFT_COBS_BYTES(27 + 31 * (channels))

struct heft_channel {
    const char *name;        /* up to 16 ASCII characters */
    const char *unit;        /* up to 8: "rad", "rad/s", "N", "N m", "A", "1" */
    uint8_t type;            /* enum heft_type */
    uint8_t flags;
    int32_t scale_mantissa;  /* one count is scale_mantissa * 10^scale_exponent units */
    int8_t scale_exponent;
};

struct heft_node {
    const struct heft_channel *channels;
    uint8_t channel_count;
    uint8_t id;
    uint32_t tick_hz;        /* nominal rate of the clock that `tick` counts */
    uint32_t boot;           /* differs from one start to the next (a counter in flash, a random number); 0 if it cannot */
    uint32_t sequence;       /* of the next data frame */
    uint32_t pulse;          /* edges of the sync line so far */
    uint32_t pulse_tick;     /* tick of the last of them */
    uint16_t schema;         /* CRC-16 of the channel list */
};

/* Fill in a node. Call heft_node_descriptor next, and then once a second. */
void heft_node_init(struct heft_node *node, uint8_t id, const struct heft_channel *channels, uint8_t channel_count,
                    uint32_t tick_hz, uint32_t boot);

/* The sync line rose at `tick`. */
void heft_node_pulse(struct heft_node *node, uint64_t tick);

/* Both write a whole frame, delimiter included, to `out` and return its length; 0 when `capacity` is too small, and
 * then nothing has happened. `values` holds one number for each channel, of which its type's low bytes are sent. */
size_t heft_node_descriptor(const struct heft_node *node, uint64_t tick, uint8_t *out, size_t capacity);
size_t heft_node_data(struct heft_node *node, uint64_t tick, uint8_t status, const int64_t *values, uint8_t *out,
                      size_t capacity);

#endif
