/* The chips of a GY-80: their registers, and reading them without waiting for ever.
 *
 * Register values and where each was checked: README.md beside the library. */
#ifndef GY80_SENSORS_H
#define GY80_SENSORS_H

#include <stdint.h>

#define L3G4200D_ADDRESS 0x69
#define ADXL345_ADDRESS 0x53
#define BMP085_ADDRESS 0x77
#define L3G4200D_WHO 0xD3
#define ADXL345_WHO 0xE5
#define BMP085_WHO 0x55
#define FIFO_EMPTY 0x20
#define FIFO_OVERRUN 0x40
#define FIFO_DEPTH 32

/* One of the gyro's 14 rates with their low-pass, as CTRL_REG1 has them in bits 7 to 4. */
struct GyroRate {
    uint8_t code;
    uint16_t rate_hz;
    uint16_t bandwidth_deci_hz;
};

/* One of its three ranges, as CTRL_REG4 has them in bits 5 and 4. */
struct GyroRange {
    uint8_t code;
    uint16_t full_scale_dps;
    const char *dps_per_count;
};

/* Bus faults since the start. */
extern uint32_t bus_errors;

/* Wait for nothing longer than this on the bus. */
void bus_begin();

/* The rate and low-pass nearest to what is wanted, 0 for as it is. */
const GyroRate &gyro_rate(uint32_t rate_deci_hz, uint32_t bandwidth_deci_hz, const GyroRate &now);
const GyroRange &gyro_range(uint32_t full_scale_dps, const GyroRange &now);
extern const GyroRate &FIRST_RATE;
extern const GyroRange &FIRST_RANGE;

/* Set the gyro up and empty its FIFO. False: it does not answer, or is another part. */
bool gyro_begin(const GyroRate &rate, const GyroRange &range);
/* FIFO_SRC_REG; what a silent bus gives is "empty". */
uint8_t gyro_fifo();
bool gyro_read(int16_t counts[3]);
bool gyro_temperature(int16_t *counts);

bool accel_begin();
bool accel_read(int16_t counts[3]);

/* Read the air's temperature in steps: call it often, it never waits. True when
 * `*decidegc` is new, about once a second. */
bool air_begin();
bool air_poll(uint32_t now_us, int16_t *decidegc);

#endif
