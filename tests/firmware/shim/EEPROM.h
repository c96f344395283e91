#ifndef SHIM_EEPROM_H
#define SHIM_EEPROM_H

#include <stdint.h>

class EEPROMShim {
  public:
    uint8_t read(int at);
    void update(int at, uint8_t value);
};
extern EEPROMShim EEPROM;

#endif
