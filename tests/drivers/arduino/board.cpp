/* A board with the sketch on it, for seven seconds: bytes of its UART to stdout, what really was to stderr.
 *
 * A call takes a microsecond, a byte on I2C 23. Interrupts come between two calls, late where they are masked.
 * Conversion n of the cell reads 100000 + n. From 3.0 s on the bus is stretched for 10 ms; from 4.0 to 4.2 s the IMU does
 * not answer, from 5.5 to 5.7 s nobody reads the UART, which then has room for 64 bytes.
 */
#include "Arduino.h"
#include "Wire.h"

#include <deque>
#include <map>
#include <stdio.h>
#include <vector>

#include "arm_node.ino"

static double now_us = 0.0;
static bool masked = false;
static const double CONVERSION_US = 3125.0 / 1.013, STEP_US = 230.0;
static double next_conversion = 1e18, next_step = 50.0, next_sync = 170000.0;
static uint32_t conversions = 0, pulses = 0;
static int turned = 0;

struct Handler {
    void (*call)();
    int mode;
};
static std::map<int, Handler> handlers;
static std::deque<int> pending;
static std::map<int, int> level;
static std::map<uint8_t, uint8_t> cell, imu = {{0x75, 0x68}};

static void fire(int pin) {
    if (handlers.count(pin)) {
        pending.push_back(pin);
    }
    while (!masked && !pending.empty()) {
        int one = pending.front();
        pending.pop_front();
        handlers[one].call();
    }
}

static void step_encoder() { /* forward for two seconds, then back */
    static const int gray[4] = {0, 2, 3, 1}; /* A before B */
    turned += now_us < 2.0e6 ? 1 : -1;
    int now = gray[turned & 3];
    for (int pin : {PIN_A, PIN_B}) {
        int bit = pin == PIN_A ? now >> 1 : now & 1;
        if (level[pin] != bit) {
            level[pin] = bit;
            fire(pin);
        }
    }
}

static void advance(double us) {
    double until = now_us + us;
    for (;;) {
        double next = next_conversion < next_step ? next_conversion : next_step;
        next = next_sync < next ? next_sync : next;
        if (next > until) {
            break;
        }
        now_us = next;
        if (next == next_conversion) {
            next_conversion += CONVERSION_US;
            uint32_t counts = 100000 + conversions;
            cell[0x12] = (uint8_t)(counts >> 16), cell[0x13] = (uint8_t)(counts >> 8), cell[0x14] = (uint8_t)counts;
            fprintf(stderr, "conversion %u %u %d\n", conversions++, (uint32_t)now_us, turned);
            level[PIN_READY] = 1;
            fire(PIN_READY);
        } else if (next == next_sync) {
            next_sync += 150000.0 + 5000.0 * (++pulses % 7);
            fprintf(stderr, "pulse %u %u\n", pulses, (uint32_t)now_us);
            fire(PIN_SYNC);
        } else {
            next_step += STEP_US;
            step_encoder();
        }
    }
    now_us = until;
}

uint32_t micros() {
    return (uint32_t)(now_us + 4294967296.0 - 2.5e6); /* wraps after 2.5 s */
}
uint32_t millis() {
    advance(1.0);
    return (uint32_t)(now_us / 1e3);
}
void delay(uint32_t ms) { advance(1e3 * ms); }
void pinMode(uint8_t, uint8_t) {}
int digitalRead(uint8_t pin) { return level[pin]; }
void attachInterrupt(int pin, void (*handler)(), int mode) { handlers[pin] = {handler, mode}; }
void noInterrupts() { masked = true; }
void interrupts() {
    masked = false;
    while (!pending.empty()) {
        int one = pending.front();
        pending.pop_front();
        handlers[one].call();
    }
    advance(1.0);
}

/* UART: 46 bytes a millisecond leave it; it holds 512. */
Uart Serial1;
static double drained_us = 0.0, held = 0.0;
void Uart::begin(uint32_t baud) { fprintf(stderr, "baud %u\n", baud); }
int Uart::availableForWrite() {
    bool stands = now_us >= 5.5e6 && now_us < 5.7e6;
    held -= stands ? 0.0 : (now_us - drained_us) * 0.046;
    held = held < 0.0 ? 0.0 : stands && held < 448.0 ? 448.0 : held;
    drained_us = now_us;
    return (int)(512.0 - held);
}
size_t Uart::write(const uint8_t *bytes, size_t count) {
    held += (double)count;
    fwrite(bytes, 1, count, stdout);
    return count;
}

/* I2C */
TwoWire Wire;
static uint8_t address_now, pointer;
static std::vector<uint8_t> sent;
static std::deque<uint8_t> received;
static bool stretched = false;

static bool answers(uint8_t address) {
    bool away = address == IMU && now_us >= 4.0e6 && now_us < 4.2e6;
    return (address == IMU || address == CELL) && !away;
}
void TwoWire::begin() {}
void TwoWire::setClock(uint32_t) {}
void TwoWire::beginTransmission(uint8_t address) {
    address_now = address;
    sent.clear();
}
size_t TwoWire::write(uint8_t byte) {
    sent.push_back(byte);
    return 1;
}
uint8_t TwoWire::endTransmission(bool) {
    advance(23.0 * (1.0 + (double)sent.size()));
    if (now_us > 3.0e6 && !stretched) {
        stretched = true;
        advance(10000.0);
    }
    if (!answers(address_now)) {
        return 2;
    }
    pointer = sent[0];
    if (sent.size() > 1) {
        uint8_t value = sent[1];
        fprintf(stderr, "wrote %02x %02x %02x\n", address_now, pointer, value);
        if (address_now == CELL) {
            cell[pointer] = pointer == 0 ? (uint8_t)(value | 0x08) : pointer == 2 ? (uint8_t)(value & ~0x04) : value;
            bool starts = pointer == 0 && (value & 0x16) == 0x16;
            next_conversion = starts ? now_us + CONVERSION_US : pointer == 0 ? 1e18 : next_conversion;
        } else {
            imu[pointer] = value;
        }
    }
    return 0;
}
uint8_t TwoWire::requestFrom(uint8_t address, uint8_t count) {
    advance(23.0 * (1.0 + count));
    received.clear();
    if (!answers(address)) {
        return 0;
    }
    for (uint8_t i = 0; i < count; i++) {
        uint8_t reg = (uint8_t)(pointer + i);
        bool measured = address == IMU && reg >= 0x3B && reg <= 0x48; /* words 1000, -2000, 3000 ... -6000, 7000 */
        int16_t word = (int16_t)(((reg - 0x3B) / 2 % 2 ? -1000 : 1000) * (1 + (reg - 0x3B) / 2));
        uint8_t half = (uint8_t)((reg - 0x3B) % 2 ? word & 0xFF : (word >> 8) & 0xFF);
        received.push_back(measured ? half : address == CELL ? cell[reg] : imu[reg]);
    }
    return count;
}
int TwoWire::read() {
    int byte = received.front();
    received.pop_front();
    return byte;
}

int main() {
    setup();
    while (now_us < 7.0e6) {
        loop();
    }
    return 0;
}
