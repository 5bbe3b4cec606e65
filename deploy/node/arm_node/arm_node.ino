/* A node on an arm: IMU (MPU-6050), load cell (NAU7802), encoder (two lines in quadrature) and the sync line, to node
 * frames. docs/node_frame.md has wiring, upload and the lines of vehicle.toml.
 *
 * Written to Arduino's API alone, for 32-bit boards: Teensy 4, RP2040, ESP32. heft_node.c and heft_node.h of the folder
 * above go beside this file. A conversion of the load cell (320 a second) is a frame: its end, by the interrupt of the
 * cell's DRDY, is the frame's tick; the encoder is latched by the same interrupt, the IMU's newest sample read after it.
 */
#include <Arduino.h>
#include <Wire.h>

extern "C" {
#include "heft_node.h"
}

/* Yours: pins, the UART to the flight computer (Serial: USB), its speed, the node's number. */
static const uint8_t PIN_SYNC = 2, PIN_READY = 3, PIN_A = 4, PIN_B = 5;
#define LINK Serial1
static const uint32_t LINK_BAUD = 460800;
static const uint8_t NODE = 7;

/* Yours: what a count is, mantissa and exponent: 2 pi / counts of a turn; rated load / (rated output x 2 x 128 x 2^23). */
static const struct heft_channel CHANNELS[] = {
    {"accel_x", "g", HEFT_I16, 0, 1220703125, -13}, /* 4 g over 32768 */
    {"accel_y", "g", HEFT_I16, 0, 1220703125, -13},
    {"accel_z", "g", HEFT_I16, 0, 1220703125, -13},
    {"gyro_x", "deg/s", HEFT_I16, 0, 1526717557, -11}, /* 1 / 65.5 */
    {"gyro_y", "deg/s", HEFT_I16, 0, 1526717557, -11},
    {"gyro_z", "deg/s", HEFT_I16, 0, 1526717557, -11},
    {"angle", "rad", HEFT_I32, 0, 1533980788, -12}, /* 4096 counts a turn, quadrature included */
    {"force", "N", HEFT_I32, 0, 1164153218, -14},   /* 50 N at 2 mV/V */
};
enum { COUNT = sizeof CHANNELS / sizeof CHANNELS[0], ANGLE = 6, FORCE = 7 };

enum { IMU = 0x68, CELL = 0x2A }; /* I2C addresses */
static const uint32_t SECOND_MS = 1000, SILENCE_MS = 100;

#ifndef IRAM_ATTR /* of ESP32: code that runs while its flash is written */
#define IRAM_ATTR
#endif

/* What interrupts write. */
static volatile uint32_t sync_us, sync_count, ready_us, ready_count;
static volatile int32_t angle_now, angle_at_ready;
static volatile uint8_t lines;

static void IRAM_ATTR on_sync() {
    sync_us = micros(); /* the first line: nothing delays it */
    sync_count = sync_count + 1;
}

static void IRAM_ATTR on_ready() {
    ready_us = micros();
    ready_count = ready_count + 1;
    angle_at_ready = angle_now;
}

static void IRAM_ATTR on_encoder() {
    static const int8_t step[16] = {0, -1, 1, 0, 1, 0, 0, -1, -1, 0, 0, 1, 0, 1, -1, 0};
    lines = (uint8_t)((lines << 2 | (digitalRead(PIN_A) ? 2 : 0) | (digitalRead(PIN_B) ? 1 : 0)) & 15);
    angle_now = angle_now + step[lines];
}

/* I2C */

static bool put(uint8_t address, uint8_t reg, uint8_t value) {
    Wire.beginTransmission(address);
    Wire.write(reg);
    Wire.write(value);
    return Wire.endTransmission() == 0;
}

static bool get(uint8_t address, uint8_t reg, uint8_t *out, uint8_t count) {
    Wire.beginTransmission(address);
    Wire.write(reg);
    if (Wire.endTransmission(false) != 0 || Wire.requestFrom(address, count) != count) {
        return false;
    }
    for (uint8_t i = 0; i < count; i++) {
        out[i] = (uint8_t)Wire.read();
    }
    return true;
}

/* Waits until the bits of a register are so; false after `ms`. */
static bool await(uint8_t address, uint8_t reg, uint8_t bits, uint8_t wanted, uint32_t ms) {
    uint8_t value = 0;
    for (uint32_t began = millis(); millis() - began < ms; delay(1)) {
        if (get(address, reg, &value, 1) && (value & bits) == wanted) {
            return true;
        }
    }
    return false;
}

static bool set_up_imu() { /* register map 4.2: reset, clock of the gyro, 44 Hz, 500 deg/s, 4 g */
    uint8_t who = 0;
    if (!get(IMU, 0x75, &who, 1) || who != 0x68 || !put(IMU, 0x6B, 0x80)) {
        return false;
    }
    delay(100);
    return put(IMU, 0x6B, 0x01) && put(IMU, 0x19, 0x00) && put(IMU, 0x1A, 0x03) && put(IMU, 0x1B, 0x08) &&
           put(IMU, 0x1C, 0x08);
}

static bool set_up_cell() { /* data sheet 1.7: reset, power, 3.0 V and 128, 320 a second, offset calibration, start */
    if (!put(CELL, 0x00, 0x01)) {
        return false;
    }
    delay(10);
    if (!put(CELL, 0x00, 0x02) || !await(CELL, 0x00, 0x08, 0x08, 400)) {
        return false;
    }
    if (!put(CELL, 0x01, 0x2F) || !put(CELL, 0x02, 0x70) || !put(CELL, 0x1C, 0x80) || !put(CELL, 0x15, 0x30) ||
        !put(CELL, 0x00, 0x86)) {
        return false;
    }
    delay(200);
    return put(CELL, 0x02, 0x74) && await(CELL, 0x02, 0x0C, 0x00, 2000) && put(CELL, 0x00, 0x96);
}

/* Frames */

static struct heft_node node;
static uint8_t frame[HEFT_DESCRIPTOR_BYTES(COUNT)];
static int64_t values[COUNT];
static bool imu_runs, cell_runs;
static uint32_t taken, taken_ms, described_ms;

static uint64_t clock_64() { /* microseconds; called more often than every 71 minutes */
    static uint32_t last, high;
    uint32_t now = micros();
    high += now < last;
    last = now;
    return (uint64_t)high << 32 | now;
}

static void describe() {
    size_t length = heft_node_descriptor(&node, clock_64(), frame, sizeof frame);
    if (LINK.availableForWrite() >= (int)length) {
        LINK.write(frame, length);
    }
    described_ms = millis();
}

static uint8_t sample() {
    uint8_t raw[14], status = 0;
    if (get(CELL, 0x12, raw, 3)) {
        int32_t counts = (int32_t)((uint32_t)raw[0] << 24 | (uint32_t)raw[1] << 16 | (uint32_t)raw[2] << 8) / 256;
        values[FORCE] = counts;
        status |= counts == 8388607 || counts == -8388608 ? HEFT_SATURATED : 0;
    } else {
        status |= HEFT_NOT_VALID;
        cell_runs = false;
    }
    if (imu_runs && get(IMU, 0x3B, raw, 14)) {
        for (uint8_t i = 0; i < 3; i++) { /* force, temperature, rate */
            values[i] = (int16_t)(raw[2 * i] << 8 | raw[2 * i + 1]);
            values[3 + i] = (int16_t)(raw[8 + 2 * i] << 8 | raw[9 + 2 * i]);
        }
    } else {
        status |= HEFT_NOT_VALID;
        imu_runs = false;
    }
    return status;
}

void setup() {
    pinMode(PIN_SYNC, INPUT);
    pinMode(PIN_READY, INPUT);
    pinMode(PIN_A, INPUT_PULLUP);
    pinMode(PIN_B, INPUT_PULLUP);
    Wire.begin();
    Wire.setClock(400000);
    LINK.begin(LINK_BAUD);
    heft_node_init(&node, NODE, CHANNELS, COUNT, 1000000, 0);
    lines = (uint8_t)((digitalRead(PIN_A) ? 2 : 0) | (digitalRead(PIN_B) ? 1 : 0));
    attachInterrupt(digitalPinToInterrupt(PIN_SYNC), on_sync, RISING);
    attachInterrupt(digitalPinToInterrupt(PIN_A), on_encoder, CHANGE);
    attachInterrupt(digitalPinToInterrupt(PIN_B), on_encoder, CHANGE);
    attachInterrupt(digitalPinToInterrupt(PIN_READY), on_ready, RISING);
    describe();
    imu_runs = set_up_imu();
    cell_runs = set_up_cell();
    noInterrupts();
    taken = ready_count; /* conversions of the set-up are none */
    interrupts();
    taken_ms = millis();
}

void loop() {
    noInterrupts();
    uint32_t conversion = ready_count, tick = ready_us, pulse = sync_count, pulse_us = sync_us;
    int32_t angle = angle_at_ready;
    interrupts();
    if (pulse != node.pulse) {
        node.pulse = pulse - 1;
        heft_node_pulse(&node, pulse_us);
    }
    if (conversion != taken) {
        node.sequence += conversion - taken - 1; /* those that came while it was busy: the log has a gap of them */
        taken = conversion;
        taken_ms = millis();
        values[ANGLE] = angle;
        uint8_t status = sample();
        size_t length = heft_node_data(&node, tick, status, values, frame, sizeof frame);
        if (LINK.availableForWrite() >= (int)length) { /* else its number is skipped */
            LINK.write(frame, length);
        }
    }
    if (millis() - described_ms >= SECOND_MS) {
        describe();
        if (!cell_runs || millis() - taken_ms > SILENCE_MS) { /* before what else takes time */
            cell_runs = set_up_cell();
            noInterrupts();
            taken = ready_count;
            interrupts();
        }
        if (!imu_runs) {
            imu_runs = set_up_imu();
        }
    }
}
