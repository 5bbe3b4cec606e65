/* As much of Arduino's API as the sketch of deploy/node uses, on the board of board.cpp. */
#pragma once
#include <stddef.h>
#include <stdint.h>

enum { INPUT, OUTPUT, INPUT_PULLUP };
enum { LOW, HIGH, CHANGE, FALLING, RISING };

uint32_t micros();
uint32_t millis();
void delay(uint32_t ms);
void pinMode(uint8_t pin, uint8_t mode);
int digitalRead(uint8_t pin);
inline int digitalPinToInterrupt(int pin) { return pin; }
void attachInterrupt(int interrupt, void (*handler)(), int mode);
void noInterrupts();
void interrupts();

struct Uart {
    void begin(uint32_t baud);
    int availableForWrite();
    size_t write(const uint8_t *bytes, size_t count);
};
extern Uart Serial1;
