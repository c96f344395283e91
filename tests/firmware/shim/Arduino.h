/* As much of the Arduino API as the GY-80 sketch uses, on a virtual clock. */
#ifndef SHIM_ARDUINO_H
#define SHIM_ARDUINO_H

#include <stddef.h>
#include <stdint.h>

#define LOW 0
#define HIGH 1
#define INPUT 0
#define RISING 3
#define digitalPinToInterrupt(pin) ((pin) == 2 ? 0 : 1)

uint32_t micros();
void noInterrupts();
void interrupts();
void pinMode(uint8_t pin, uint8_t mode);
int digitalRead(uint8_t pin);
int analogRead(uint8_t pin);
void attachInterrupt(uint8_t number, void (*handler)(), int mode);

class SerialShim {
  public:
    void begin(unsigned long baud);
    int available();
    int read();
    int availableForWrite();
    size_t write(const uint8_t *data, size_t size);
};
extern SerialShim Serial;

void setup();
void loop();

#endif
