/* A GY-80 board (L3G4200D, ADXL345, BMP085) that speaks GCB1.
 *
 * Wiring, register settings and what is not checked on hardware: README.md beside the
 * library. Every edge of the gyro's data-ready line is stamped by an interrupt; its FIFO
 * keeps the samples while the loop is busy. A stamp belongs to the sample that was the
 * oldest unread one at its edge; samples without an edge of their own (the line stays high
 * while the FIFO is not empty) get a stamp one measured period after their predecessor and
 * say so. The ADXL345 is read right after the gyro and is up to 5 ms older.
 */
#include <Arduino.h>
#include <EEPROM.h>
#include <gyrorig_board.h>

#include "gy80_sensors.h"

#define BAUD 250000UL /* exact with a 16 MHz crystal; 115200 is off by 2.1 % */
#define DATA_READY_PIN 2
#define SATURATED_COUNTS 32760
#define EDGES 8 /* a power of two */
#define UID_BYTES 5 /* HELLO has to fit into one frame */
#define UID_AT 2 /* in the EEPROM: behind two bytes that say that it is ours */
#define BOOT_AT (UID_AT + UID_BYTES)
#define MARK_0 'G'
#define MARK_1 '1'

static gyb_board board;
static const GyroRate *rate = &FIRST_RATE;
static const GyroRange *range = &FIRST_RANGE;
static char uid[2 * UID_BYTES + 1];

/* Written by the interrupt, read with interrupts off. */
static volatile uint32_t edge_us[EDGES];
static volatile uint8_t edges_seen;

static uint8_t edges_taken;
static uint32_t last_us;      /* the last sample's stamp */
static bool last_was_edge;    /* it came from an edge */
static bool started;          /* there is a last sample */
static uint32_t period_q4_us; /* between samples, as measured, in 1/16 us */
static int16_t air = GYB_NO_AIR;
static int16_t last_accel[3];
static uint32_t second_us;

static void on_data_ready() {
    edge_us[edges_seen % EDGES] = micros();
    edges_seen++;
}

/* ---- the port ---- */

static bool has_written;

static uint32_t clock_us(void *) { return micros(); }

static uint8_t write_some(void *, const uint8_t *data, uint8_t size) {
    int room = Serial.availableForWrite();
    if (room < size) {
        size = (uint8_t)room;
    }
    if (size) {
        has_written = true;
        Serial.write(data, size);
    }
    return size;
}

static uint16_t unsent(void *) {
#if defined(__AVR__) && defined(UCSR0A)
    /* the ring and the two bytes in the UART itself: TXC0 is set when all are out */
    return has_written && (bit_is_set(UCSR0B, UDRIE0) || bit_is_clear(UCSR0A, TXC0)) ? 1 : 0;
#else
    static int most;
    int room = Serial.availableForWrite();
    if (room > most) {
        most = room;
    }
    return (uint16_t)(most - room);
#endif
}

/* ---- settings ---- */

static void tell_settings(gyb_identity *identity) {
    gyb_sensor *gyro = &identity->sensors[0];
    gyro->rate_deci_hz = (uint16_t)(10 * rate->rate_hz);
    gyro->bandwidth_deci_hz = rate->bandwidth_deci_hz;
    gyro->full_scale = range->full_scale_dps;
    gyro->per_count = range->dps_per_count;
}

static void restart_stamps() {
    noInterrupts();
    edges_taken = edges_seen;
    interrupts();
    started = false;
    period_q4_us = 16000000UL / rate->rate_hz;
}

static void configure(void *, gyb_board *it, const gyb_wanted *wanted) {
    rate = &gyro_rate(wanted->rate_deci_hz, wanted->bandwidth_deci_hz, *rate);
    range = &gyro_range(wanted->full_scale_dps, *range);
    if (wanted->accel >= 0) {
        it->accel = (uint8_t)wanted->accel;
    }
    gyb_set_batch(it, wanted->batch ? wanted->batch : it->batch_size);
    gyro_begin(*rate, *range);
    tell_settings(&it->identity);
    restart_stamps();
}

/* ---- who it is ---- */

/* A number that no other board has: noise of open analog inputs and of the time that
 * reading them takes, kept in the EEPROM from the first start on. */
static void make_uid() {
    uint32_t hash = 2166136261UL;
    for (uint8_t i = 0; i < UID_BYTES; i++) {
        for (uint8_t j = 0; j < 64; j++) {
            hash = (hash ^ (uint32_t)analogRead(j & 3)) * 16777619UL;
            hash = (hash ^ micros()) * 16777619UL;
        }
        EEPROM.update(UID_AT + i, (uint8_t)(hash >> 16));
    }
    EEPROM.update(BOOT_AT, 0);
    EEPROM.update(BOOT_AT + 1, 0);
    EEPROM.update(0, MARK_0);
    EEPROM.update(1, MARK_1);
}

/* Read the uid and count this start; return a seed that differs at each. */
static uint32_t identify(gyb_identity *identity) {
    uint32_t seed = micros();
    if (EEPROM.read(0) != MARK_0 || EEPROM.read(1) != MARK_1) {
        make_uid();
    }
    for (uint8_t i = 0; i < UID_BYTES; i++) {
        uint8_t value = EEPROM.read(UID_AT + i);
        uid[2 * i] = "0123456789abcdef"[value >> 4];
        uid[2 * i + 1] = "0123456789abcdef"[value & 15];
        seed = (seed ^ value) * 16777619UL;
    }
    identity->boot = (uint16_t)(EEPROM.read(BOOT_AT) | (uint16_t)EEPROM.read(BOOT_AT + 1) << 8);
    identity->boot++;
    EEPROM.update(BOOT_AT, (uint8_t)(identity->boot & 0xFF));
    EEPROM.update(BOOT_AT + 1, (uint8_t)(identity->boot >> 8));
    return (seed ^ identity->boot) * 16777619UL;
}

static void describe(gyb_identity *identity) {
    gyb_sensor *sensors = identity->sensors;
    identity->firmware = "1"; /* short: HELLO is one frame */
    identity->board = "GY80";
    identity->uid = uid;
    identity->reset = "";
    identity->sensor_count = 3;
    sensors[0].who = L3G4200D_WHO;
    sensors[0].unit = "";
    sensors[1].who = ADXL345_WHO;
    sensors[1].full_scale = 16;
    sensors[1].per_count = "0.00390625"; /* full resolution: 256 counts per g */
    sensors[1].unit = "g";
    sensors[2].who = BMP085_WHO;
    sensors[2].full_scale = 85;
    sensors[2].per_count = "0.1";
    sensors[2].unit = "degC";
}

/* ---- samples ---- */

static bool next_edge(uint32_t *time_us) {
    bool any = false;
    noInterrupts();
    if ((uint8_t)(edges_seen - edges_taken) > EDGES) {
        edges_taken = (uint8_t)(edges_seen - EDGES); /* the oldest are overwritten */
    }
    if (edges_taken != edges_seen) {
        *time_us = edge_us[edges_taken % EDGES];
        edges_taken++;
        any = true;
    }
    interrupts();
    return any;
}

/* The stamp of the next sample of the FIFO, and the flag that says what it is. */
static uint8_t next_stamp(uint32_t *time_us) {
    uint32_t apart_us;
    if (next_edge(time_us)) {
        apart_us = *time_us - last_us;
        /* neighbours only: a longer span is several periods */
        if (started && last_was_edge && 16 * apart_us < period_q4_us + period_q4_us / 4) {
            period_q4_us -= period_q4_us / 16;
            period_q4_us += apart_us;
        }
        last_was_edge = true;
        return GYB_STAMPED_AT_DATA_READY;
    }
    last_was_edge = false;
    if (!started) {
        *time_us = micros();
        return 0;
    }
    *time_us = last_us + period_q4_us / 16;
    return GYB_STAMP_FROM_FIFO;
}

static void take(uint32_t time_us, uint8_t flags, const int16_t gyro[3]) {
    for (uint8_t i = 0; i < 3; i++) {
        if (gyro[i] >= SATURATED_COUNTS || gyro[i] <= -SATURATED_COUNTS) {
            flags |= GYB_SATURATED;
        }
    }
    if (board.accel && !accel_read(last_accel)) {
        flags |= GYB_REPEATED; /* of its accelerometer */
    }
    last_us = time_us;
    started = true;
    gyb_take(&board, time_us, flags, gyro, last_accel, air == GYB_NO_AIR ? 0 : air);
}

/* The FIFO has run over: it holds the newest samples, and the edge was that of a lost one. */
static void after_overrun() {
    uint32_t now_us = micros();
    uint32_t passed = started ? (now_us - last_us) / (period_q4_us / 16) : 0;
    gyb_lost(&board, passed > FIFO_DEPTH ? passed - FIFO_DEPTH : 0);
    noInterrupts();
    edges_taken = edges_seen;
    interrupts();
    last_us = now_us - FIFO_DEPTH * (period_q4_us / 16);
    started = true;
}

/* Take what the FIFO holds, at most `FIFO_DEPTH`, so that the line gets its turn. */
static void take_samples() {
    for (uint8_t i = 0; i < FIFO_DEPTH; i++) {
        int16_t gyro[3];
        uint32_t time_us;
        uint8_t edges, source, flags;
        noInterrupts();
        edges = edges_seen;
        interrupts();
        if (edges == edges_taken && digitalRead(DATA_READY_PIN) == LOW) {
            return;
        }
        source = gyro_fifo();
        if (source & FIFO_EMPTY) {
            edges_taken = edges; /* they came before it was empty: of samples taken already */
            return;
        }
        if (source & FIFO_OVERRUN) {
            after_overrun();
        }
        if (!gyro_read(gyro)) {
            return;
        }
        flags = next_stamp(&time_us);
        take(time_us, flags, gyro);
    }
}

/* ---- the sketch ---- */

static void read_temperatures() {
    uint32_t now_us = micros();
    if (air_poll(now_us, &air)) {
        board.air_decidegc = air;
    } else if (now_us - second_us >= 1000000UL) {
        second_us = now_us;
        gyro_temperature(&board.temperature);
    }
    board.bus_errors = bus_errors;
}

static void receive() {
    uint8_t data[16], size = 0;
    while (size < sizeof data && Serial.available() > 0) {
        data[size++] = (uint8_t)Serial.read();
    }
    if (size) {
        gyb_receive(&board, data, size, micros());
    }
}

void setup() {
    gyb_identity identity = gyb_identity();
    gyb_port port = {0, clock_us, write_some, unsent, configure};
    uint32_t seed;
    Serial.begin(BAUD);
    bus_begin();
    seed = identify(&identity);
    describe(&identity);
    tell_settings(&identity);
    gyb_begin(&board, &identity, &port, seed);
    pinMode(DATA_READY_PIN, INPUT);
    attachInterrupt(digitalPinToInterrupt(DATA_READY_PIN), on_data_ready, RISING);
    board.accel = accel_begin() ? 1 : 0;
    air_begin();
    /* A gyro that does not answer shows as bus errors in SLOW and as silence. */
    gyro_begin(*rate, *range);
    restart_stamps();
}

void loop() {
    receive();
    take_samples();
    gyb_poll(&board);
    read_temperatures();
    gyb_poll(&board);
}
