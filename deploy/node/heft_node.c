/* Encoder of heft node frames; see heft_node.h. */
#include "heft_node.h"

#include <string.h>

enum { KIND_DATA = 0x10, KIND_DESCRIPTOR = 0x11, NAME_BYTES = 16, UNIT_BYTES = 8, FULL_BLOCK = 0xFF };

static const uint8_t width[] = {1, 1, 2, 2, 4, 4, 8};

/* A frame on its way out: COBS block by block, CRC on the fly. */
struct writer {
    uint8_t *out;
    size_t capacity;
    size_t length;   /* bytes written; beyond capacity: it did not fit */
    size_t block;    /* where the open block's code belongs */
    uint8_t code;    /* of the open block: its bytes and one; 0: none is open */
    uint16_t crc;
};

/* CRC-16/CCITT-FALSE (0x1021, from 0xFFFF), without a table. */
static uint16_t crc16(uint16_t crc, uint8_t byte)
{
    crc = (uint16_t)((crc >> 8) | (crc << 8));
    crc = (uint16_t)(crc ^ byte);
    crc = (uint16_t)(crc ^ ((crc & 0xFFu) >> 4));
    crc = (uint16_t)(crc ^ (crc << 12));
    crc = (uint16_t)(crc ^ ((crc & 0xFFu) << 5));
    return crc;
}

static void emit(struct writer *w, uint8_t byte)
{
    if (w->length < w->capacity) {
        w->out[w->length] = byte;
    }
    w->length++;
}

static void open_block(struct writer *w)
{
    w->block = w->length;
    w->code = 1;
    emit(w, 0);
}

static void close_block(struct writer *w)
{
    if (w->block < w->capacity) {
        w->out[w->block] = w->code;
    }
    w->code = 0;
}

static void stuff(struct writer *w, uint8_t byte)
{
    if (w->code == 0) {
        open_block(w);
    }
    if (byte == 0) {
        close_block(w);
        open_block(w);
        return;
    }
    emit(w, byte);
    w->code++;
    if (w->code == FULL_BLOCK) {
        close_block(w);
    }
}

static void put(struct writer *w, uint64_t value, uint8_t bytes)
{
    while (bytes-- > 0) {
        uint8_t byte = (uint8_t)(value & 0xFFu);
        w->crc = crc16(w->crc, byte);
        stuff(w, byte);
        value >>= 8;
    }
}

static void put_text(struct writer *w, const char *text, size_t bytes)
{
    size_t length = strlen(text);
    for (size_t i = 0; i < bytes; i++) {
        put(w, i < length ? (uint8_t)text[i] : 0, 1);
    }
}

static void put_channels(struct writer *w, const struct heft_node *node)
{
    put(w, node->tick_hz, 4);
    put(w, node->channel_count, 1);
    for (uint8_t i = 0; i < node->channel_count; i++) {
        const struct heft_channel *channel = &node->channels[i];
        put(w, channel->type, 1);
        put(w, channel->flags, 1);
        put(w, (uint32_t)channel->scale_mantissa, 4);
        put(w, (uint8_t)channel->scale_exponent, 1);
        put_text(w, channel->unit, UNIT_BYTES);
        put_text(w, channel->name, NAME_BYTES);
    }
}

static struct writer begin(uint8_t *out, size_t capacity)
{
    struct writer w = {out, capacity, 0, 0, 0, 0xFFFFu};
    return w;
}

static size_t finish(struct writer *w)
{
    uint16_t crc = w->crc;
    stuff(w, (uint8_t)(crc >> 8));
    stuff(w, (uint8_t)(crc & 0xFFu));
    if (w->code != 0) {
        close_block(w);
    }
    emit(w, 0);
    return w->length <= w->capacity ? w->length : 0;
}

void heft_node_init(struct heft_node *node, uint8_t id, const struct heft_channel *channels, uint8_t channel_count,
                    uint32_t tick_hz, uint32_t boot)
{
    struct writer w = begin(NULL, 0);
    memset(node, 0, sizeof *node);
    node->channels = channels;
    node->channel_count = channel_count;
    node->id = id;
    node->tick_hz = tick_hz;
    node->boot = boot;
    put_channels(&w, node);
    node->schema = w.crc;
}

void heft_node_pulse(struct heft_node *node, uint64_t tick)
{
    node->pulse_tick = (uint32_t)tick;
    node->pulse++;
}

size_t heft_node_descriptor(const struct heft_node *node, uint64_t tick, uint8_t *out, size_t capacity)
{
    struct writer w = begin(out, capacity);
    put(&w, KIND_DESCRIPTOR, 1);
    put(&w, node->id, 1);
    put(&w, node->schema, 2);
    put(&w, node->sequence, 4);
    put(&w, tick, 8);
    put(&w, node->boot, 4);
    put_channels(&w, node);
    return finish(&w);
}

size_t heft_node_data(struct heft_node *node, uint64_t tick, uint8_t status, const int64_t *values, uint8_t *out,
                      size_t capacity)
{
    struct writer w = begin(out, capacity);
    size_t length;
    put(&w, KIND_DATA, 1);
    put(&w, node->id, 1);
    put(&w, node->schema, 2);
    put(&w, node->sequence, 4);
    put(&w, (uint32_t)tick, 4);
    put(&w, node->pulse, 4);
    put(&w, node->pulse_tick, 4);
    put(&w, status, 1);
    for (uint8_t i = 0; i < node->channel_count; i++) {
        put(&w, (uint64_t)values[i], width[node->channels[i].type]);
    }
    length = finish(&w);
    if (length > 0) {
        node->sequence++;
    }
    return length;
}
