#ifndef SHIM_WIRE_H
#define SHIM_WIRE_H

#include <stdint.h>

#define WIRE_HAS_TIMEOUT 1

class WireShim {
  public:
    void begin();
    void setClock(uint32_t hz);
    void setWireTimeout(uint32_t microseconds, bool reset);
    void beginTransmission(uint8_t device);
    void write(uint8_t value);
    uint8_t endTransmission(bool stop = true);
    uint8_t requestFrom(uint8_t device, uint8_t size);
    int read();
};
extern WireShim Wire;

#endif
