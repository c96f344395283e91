/* The GY-80 sketch on a virtual clock, with models of its chips.
 *
 *     gy80 SECONDS STALL_US FAIL_EVERY EEPROM_FILE [HEX_FROM_HOST]
 *
 * What it sends goes to standard output. Once, at 1 s, the loop stalls for STALL_US; every
 * FAIL_EVERY-th transfer on the bus fails (0: none); at 0.5 s the host's bytes arrive. The
 * gyro samples with 5 % more than its nominal rate; sample n has the counts n, -n, 100.
 * The models are from the data sheets' words as README.md has them, not from hardware:
 * the line of data-ready is high while the FIFO holds a sample. */
#include <cstdio>
#include <cstdlib>
#include <cstring>
#include <deque>

#include "Arduino.h"
#include "EEPROM.h"
#include "Wire.h"

SerialShim Serial;
WireShim Wire;
EEPROMShim EEPROM;

static uint64_t now_ns;
static bool enabled = true, edge_waits;
static void (*on_edge)();
static uint8_t eeprom[1024];

/* ---- the gyro ---- */

static uint8_t gyro[64];
static std::deque<uint32_t> fifo;
static uint32_t taken; /* samples since the FIFO was turned on */
static uint64_t next_sample_ns;
static bool overrun;

static void edge() {
    if ((gyro[0x22] & 0x08) == 0 || on_edge == nullptr) {
        return;
    }
    if (enabled) {
        on_edge();
    } else {
        edge_waits = true;
    }
}

static uint64_t period_ns() {
    static const uint32_t rates[] = {100, 200, 400, 800};
    return 1000000000ull * 100 / 105 / rates[gyro[0x20] >> 6];
}

static void pass(uint64_t ns) {
    now_ns += ns;
    while ((gyro[0x20] & 0x0F) == 0x0F && (gyro[0x24] & 0x40) && gyro[0x2E] == 0x40 &&
           next_sample_ns <= now_ns) {
        uint64_t after_ns = now_ns;
        now_ns = next_sample_ns; /* the interrupt reads the clock at the edge */
        fifo.push_back(taken++);
        if (fifo.size() == 1) {
            edge();
        }
        if (fifo.size() > 32) {
            fifo.pop_front();
            overrun = true;
        }
        now_ns = after_ns;
        next_sample_ns += period_ns();
    }
}

static void put(uint8_t *at, int16_t value) {
    at[0] = (uint8_t)(value & 0xFF);
    at[1] = (uint8_t)((uint16_t)value >> 8);
}

static void gyro_written(uint8_t at) {
    if (at == 0x2E) {
        fifo.clear();
        overrun = false;
        taken = 0;
        next_sample_ns = now_ns + period_ns();
    }
}

static void gyro_asked(uint8_t at) {
    if (at == 0x2F) {
        size_t level = fifo.size() > 31 ? 31 : fifo.size();
        gyro[at] = (uint8_t)((fifo.empty() ? 0x20 : 0) | (overrun ? 0x40 : 0) | level);
    } else if (at == 0x28 && !fifo.empty()) {
        put(gyro + 0x28, (int16_t)(uint16_t)fifo.front());
        put(gyro + 0x2A, (int16_t)(uint16_t)(0u - fifo.front()));
        put(gyro + 0x2C, 100);
        fifo.pop_front();
        overrun = false;
    }
}

/* ---- the others ---- */

static uint8_t accel[64], air[256];

static void power_up() {
    gyro[0x0F] = 0xD3;
    gyro[0x20] = 0x07;
    gyro[0x26] = (uint8_t)-7;
    accel[0x00] = 0xE5;
    put(accel + 0x32, 1);
    put(accel + 0x34, -2);
    put(accel + 0x36, 256);
    air[0xD0] = 0x55;
    /* the example of the BMP085's data sheet: 15.0 degC; most significant byte first */
    static const struct { uint8_t at; uint16_t value; } words[] = {
        {0xB2, 32757}, {0xB4, 23153}, {0xBC, (uint16_t)-8711}, {0xBE, 2868}};
    for (const auto &word : words) {
        air[word.at] = (uint8_t)(word.value >> 8);
        air[word.at + 1] = (uint8_t)(word.value & 0xFF);
    }
}

/* ---- the bus: 9 bits a byte at 400 kHz ---- */

static uint8_t bus_device, bus_at, bus_bytes[8], bus_count, bus_answer[32], bus_read, bus_size;
static uint32_t transfers, fail_every;

static uint8_t *chip(uint8_t device) {
    return device == 0x69 ? gyro : device == 0x53 ? accel : device == 0x77 ? air : nullptr;
}

static bool fails() { return fail_every && ++transfers % fail_every == 0; }

void WireShim::begin() {}
void WireShim::setClock(uint32_t) {}
void WireShim::setWireTimeout(uint32_t, bool) {}

void WireShim::beginTransmission(uint8_t device) {
    bus_device = device;
    bus_count = 0;
}

void WireShim::write(uint8_t value) { bus_bytes[bus_count++ % 8] = value; }

uint8_t WireShim::endTransmission(bool) {
    uint8_t *registers = chip(bus_device);
    pass(22500u * (1u + bus_count));
    if (registers == nullptr || fails()) {
        return 2;
    }
    bus_at = bus_bytes[0];
    if (bus_count == 2) {
        registers[bus_at] = bus_bytes[1];
        if (registers == gyro) {
            gyro_written(bus_at);
        }
        if (registers == air && bus_at == 0xF4 && bus_bytes[1] == 0x2E) {
            air[0xF6] = 27898 >> 8;
            air[0xF7] = 27898 & 0xFF;
        }
    }
    return 0;
}

uint8_t WireShim::requestFrom(uint8_t device, uint8_t size) {
    uint8_t *registers = chip(device);
    bus_read = bus_size = 0;
    if (registers == nullptr || fails()) {
        pass(22500);
        return 0;
    }
    if (registers == gyro) {
        if (size > 1 && (bus_at & 0x80) == 0) {
            return 0; /* without its auto-increment bit it repeats one register */
        }
        bus_at &= 0x7F;
        gyro_asked(bus_at);
    }
    for (uint8_t i = 0; i < size && i < sizeof bus_answer; i++) {
        bus_answer[i] = registers[(uint8_t)(bus_at + i)];
    }
    bus_size = size;
    pass(22500u * (1u + size));
    return size;
}

int WireShim::read() { return bus_read < bus_size ? bus_answer[bus_read++] : -1; }

/* ---- the line: 63 bytes of ring at 25000 bytes a second ---- */

static uint64_t sent_until_ns;
static std::deque<uint8_t> from_host;

void SerialShim::begin(unsigned long) {}
int SerialShim::available() { return (int)from_host.size(); }

int SerialShim::read() {
    int value = from_host.front();
    from_host.pop_front();
    return value;
}

int SerialShim::availableForWrite() {
    uint64_t left = sent_until_ns > now_ns ? (sent_until_ns - now_ns + 39999) / 40000 : 0;
    return left > 63 ? 0 : 63 - (int)left;
}

size_t SerialShim::write(const uint8_t *data, size_t size) {
    if (sent_until_ns < now_ns) {
        sent_until_ns = now_ns;
    }
    sent_until_ns += 40000u * size;
    return fwrite(data, 1, size, stdout);
}

/* ---- the rest ---- */

uint32_t micros() {
    return (uint32_t)(now_ns / 4000u * 4u); /* an AVR counts in steps of 4 us */
}

void noInterrupts() { enabled = false; }

void interrupts() {
    enabled = true;
    if (edge_waits) {
        edge_waits = false;
        on_edge();
    }
}

void pinMode(uint8_t, uint8_t) {}
int digitalRead(uint8_t) { return fifo.empty() ? LOW : HIGH; }
int analogRead(uint8_t) { return rand() & 1023; }
void attachInterrupt(uint8_t, void (*handler)(), int) { on_edge = handler; }
uint8_t EEPROMShim::read(int at) { return eeprom[at]; }
void EEPROMShim::update(int at, uint8_t value) { eeprom[at] = value; }

static void host_says(const char *hex) {
    for (; hex[0] && hex[1]; hex += 2) {
        char byte[3] = {hex[0], hex[1], 0};
        from_host.push_back((uint8_t)strtoul(byte, nullptr, 16));
    }
}

int main(int count, char **arguments) {
    uint64_t end_ns, stall_ns;
    bool stalled = false, said = count < 6;
    if (count < 5) {
        return 2;
    }
    end_ns = (uint64_t)(atof(arguments[1]) * 1e9);
    stall_ns = strtoull(arguments[2], nullptr, 10) * 1000u;
    fail_every = (uint32_t)strtoul(arguments[3], nullptr, 10);
    memset(eeprom, 0xFF, sizeof eeprom);
    if (FILE *kept = fopen(arguments[4], "rb")) {
        if (fread(eeprom, 1, sizeof eeprom, kept) != sizeof eeprom) {
            return 3;
        }
        fclose(kept);
    }
    power_up();
    setup();
    while (now_ns < end_ns) {
        loop();
        pass(20000);
        if (!said && now_ns > 500000000u) {
            said = true;
            host_says(arguments[5]);
        }
        if (!stalled && now_ns > 1000000000u) {
            stalled = true;
            pass(stall_ns);
        }
    }
    FILE *kept = fopen(arguments[4], "wb");
    if (kept == nullptr || fwrite(eeprom, 1, sizeof eeprom, kept) != sizeof eeprom) {
        return 3;
    }
    return fclose(kept);
}
