/* See gy80_sensors.h. */
#include "gy80_sensors.h"

#include <Arduino.h>
#include <Wire.h>

#define BUS_TIMEOUT_US 3000UL
#define AUTO_INCREMENT 0x80 /* L3G4200D: of the register's address */

/* L3G4200D */
#define WHO_AM_I 0x0F
#define CTRL_REG1 0x20
#define CTRL_REG2 0x21
#define CTRL_REG3 0x22
#define CTRL_REG4 0x23
#define CTRL_REG5 0x24
#define OUT_TEMP 0x26
#define OUT_X_L 0x28
#define FIFO_CTRL_REG 0x2E
#define FIFO_SRC_REG 0x2F

/* ADXL345 */
#define DEVID 0x00
#define BW_RATE 0x2C
#define POWER_CTL 0x2D
#define DATA_FORMAT 0x31
#define DATAX0 0x32
#define FIFO_CTL 0x38

/* BMP085 */
#define AC5 0xB2
#define AC6 0xB4
#define MC 0xBC
#define MD 0xBE
#define CHIP_ID 0xD0
#define CONTROL 0xF4
#define RESULT 0xF6
#define MEASURE_TEMPERATURE 0x2E
#define CONVERSION_US 5000UL /* the data sheet's longest is 4.5 ms */
#define AIR_PERIOD_US 1000000UL

static const GyroRate RATES[] = {
    {0x0, 100, 125}, {0x1, 100, 250}, {0x4, 200, 125}, {0x5, 200, 250}, {0x6, 200, 500},
    {0x7, 200, 700}, {0x8, 400, 200}, {0x9, 400, 250}, {0xA, 400, 500}, {0xB, 400, 1100},
    {0xC, 800, 300}, {0xD, 800, 350}, {0xE, 800, 500}, {0xF, 800, 1100},
};
static const GyroRange RANGES[] = {{0, 250, "0.00875"}, {1, 500, "0.0175"}, {2, 2000, "0.07"}};
const GyroRate &FIRST_RATE = RATES[1];
const GyroRange &FIRST_RANGE = RANGES[1];

uint32_t bus_errors;
static uint16_t air_ac5, air_ac6;
static int16_t air_mc, air_md;
static bool air_there, air_measuring;
static uint32_t air_since_us;

void bus_begin() {
    Wire.begin();
    Wire.setClock(400000UL);
#ifdef WIRE_HAS_TIMEOUT
    Wire.setWireTimeout(BUS_TIMEOUT_US, true);
#endif
}

static bool write_register(uint8_t device, uint8_t address, uint8_t value) {
    Wire.beginTransmission(device);
    Wire.write(address);
    Wire.write(value);
    if (Wire.endTransmission() != 0) {
        bus_errors++;
        return false;
    }
    return true;
}

static bool read_registers(uint8_t device, uint8_t address, uint8_t *data, uint8_t size) {
    uint8_t i;
    Wire.beginTransmission(device);
    Wire.write(address);
    if (Wire.endTransmission(false) != 0 || Wire.requestFrom(device, size) != size) {
        bus_errors++;
        return false;
    }
    for (i = 0; i < size; i++) {
        data[i] = (uint8_t)Wire.read();
    }
    return true;
}

static bool is_part(uint8_t device, uint8_t address, uint8_t who) {
    uint8_t value;
    return read_registers(device, address, &value, 1) && value == who;
}

static bool read_triple(uint8_t device, uint8_t address, int16_t counts[3]) {
    uint8_t data[6], i;
    if (!read_registers(device, address, data, sizeof data)) {
        return false;
    }
    for (i = 0; i < 3; i++) {
        counts[i] = (int16_t)(uint16_t)(data[2 * i] | (uint16_t)data[2 * i + 1] << 8);
    }
    return true;
}

static uint32_t apart(uint32_t a, uint32_t b) { return a > b ? a - b : b - a; }

const GyroRate &gyro_rate(uint32_t rate_deci_hz, uint32_t bandwidth_deci_hz, const GyroRate &now) {
    const GyroRate *best = &now;
    uint16_t rate_hz = now.rate_hz;
    for (const GyroRate &rate : RATES) {
        if (rate_deci_hz == 10UL * rate.rate_hz) {
            rate_hz = rate.rate_hz;
        }
    }
    uint32_t wanted = bandwidth_deci_hz ? bandwidth_deci_hz : now.bandwidth_deci_hz;
    for (const GyroRate &rate : RATES) {
        if (rate.rate_hz == rate_hz &&
            (best->rate_hz != rate_hz || apart(rate.bandwidth_deci_hz, wanted) <
                                             apart(best->bandwidth_deci_hz, wanted))) {
            best = &rate;
        }
    }
    return *best;
}

const GyroRange &gyro_range(uint32_t full_scale_dps, const GyroRange &now) {
    for (const GyroRange &range : RANGES) {
        if (range.full_scale_dps == full_scale_dps) {
            return range;
        }
    }
    return now;
}

bool gyro_begin(const GyroRate &rate, const GyroRange &range) {
    return is_part(L3G4200D_ADDRESS, WHO_AM_I, L3G4200D_WHO) &&
           /* bypass first: it empties the FIFO */
           write_register(L3G4200D_ADDRESS, FIFO_CTRL_REG, 0x00) &&
           write_register(L3G4200D_ADDRESS, CTRL_REG1, (uint8_t)(rate.code << 4 | 0x0F)) &&
           write_register(L3G4200D_ADDRESS, CTRL_REG2, 0x00) &&
           write_register(L3G4200D_ADDRESS, CTRL_REG3, 0x08) &&
           write_register(L3G4200D_ADDRESS, CTRL_REG4, (uint8_t)(0x80 | range.code << 4)) &&
           write_register(L3G4200D_ADDRESS, CTRL_REG5, 0x42) &&
           write_register(L3G4200D_ADDRESS, FIFO_CTRL_REG, 0x40);
}

uint8_t gyro_fifo() {
    uint8_t source;
    return read_registers(L3G4200D_ADDRESS, FIFO_SRC_REG, &source, 1) ? source : FIFO_EMPTY;
}

bool gyro_read(int16_t counts[3]) {
    return read_triple(L3G4200D_ADDRESS, OUT_X_L | AUTO_INCREMENT, counts);
}

bool gyro_temperature(int16_t *counts) {
    uint8_t value;
    if (!read_registers(L3G4200D_ADDRESS, OUT_TEMP, &value, 1)) {
        return false;
    }
    *counts = (int8_t)value;
    return true;
}

bool accel_begin() {
    return is_part(ADXL345_ADDRESS, DEVID, ADXL345_WHO) &&
           write_register(ADXL345_ADDRESS, POWER_CTL, 0x00) &&
           write_register(ADXL345_ADDRESS, BW_RATE, 0x0B) &&
           write_register(ADXL345_ADDRESS, DATA_FORMAT, 0x0B) &&
           write_register(ADXL345_ADDRESS, FIFO_CTL, 0x00) &&
           write_register(ADXL345_ADDRESS, POWER_CTL, 0x08);
}

bool accel_read(int16_t counts[3]) { return read_triple(ADXL345_ADDRESS, DATAX0, counts); }

static bool read_big_endian(uint8_t address, uint16_t *value) {
    uint8_t data[2];
    if (!read_registers(BMP085_ADDRESS, address, data, 2)) {
        return false;
    }
    *value = (uint16_t)((uint16_t)data[0] << 8 | data[1]);
    return true;
}

bool air_begin() {
    uint16_t mc = 0, md = 0;
    air_there = is_part(BMP085_ADDRESS, CHIP_ID, BMP085_WHO) && read_big_endian(AC5, &air_ac5) &&
                read_big_endian(AC6, &air_ac6) && read_big_endian(MC, &mc) &&
                read_big_endian(MD, &md);
    air_mc = (int16_t)mc;
    air_md = (int16_t)md;
    air_measuring = false;
    return air_there;
}

/* The data sheet's integer formula. */
static bool air_decidegc(uint16_t raw, int16_t *decidegc) {
    int32_t x1 = (int32_t)raw - air_ac6, b5;
    if (x1 > 32767 || x1 < -32767) {
        return false; /* no temperature of this world; the product would overflow */
    }
    x1 = x1 * (int32_t)air_ac5 / 32768;
    if (x1 + air_md == 0) {
        return false;
    }
    b5 = x1 + (int32_t)air_mc * 2048 / (x1 + air_md);
    b5 = (b5 + 8) / 16;
    if (b5 < -500 || b5 > 1000) {
        return false;
    }
    *decidegc = (int16_t)b5;
    return true;
}

bool air_poll(uint32_t now_us, int16_t *decidegc) {
    uint16_t raw;
    if (!air_there) {
        return false;
    }
    if (!air_measuring) {
        if (now_us - air_since_us >= AIR_PERIOD_US) {
            air_since_us = now_us;
            air_measuring = write_register(BMP085_ADDRESS, CONTROL, MEASURE_TEMPERATURE);
        }
        return false;
    }
    if (now_us - air_since_us < CONVERSION_US) {
        return false;
    }
    air_measuring = false;
    return read_big_endian(RESULT, &raw) && air_decidegc(raw, decidegc);
}
