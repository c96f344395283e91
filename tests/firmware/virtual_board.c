/* A board on a virtual clock and line, for tests that call it from Python.
 *
 * The line takes bytes into a ring of `room` bytes and sends one every `byte_ticks`. */
#include <string.h>

#include "gyrorig_board.h"

static gyb_board board;
static uint64_t now_ticks, sent_until;
static uint32_t byte_ticks, room;
static uint16_t stuck; /* what the port says it holds although it does not */
static uint8_t out[1 << 20];
static uint64_t first_byte_at[1 << 20];
static uint32_t out_size;

static uint32_t waiting(void) {
    return sent_until <= now_ticks ? 0 : (uint32_t)((sent_until - now_ticks + byte_ticks - 1) / byte_ticks);
}

static uint32_t clock_ticks(void *context) {
    (void)context;
    return (uint32_t)now_ticks;
}

static uint8_t take_bytes(void *context, const uint8_t *data, uint8_t size) {
    uint32_t left = room - (waiting() < room ? waiting() : room);
    uint8_t i, taken = size < left ? size : (uint8_t)left;
    (void)context;
    for (i = 0; i < taken && out_size < sizeof out; i++) {
        if (sent_until < now_ticks) {
            sent_until = now_ticks;
        }
        first_byte_at[out_size] = sent_until;
        out[out_size++] = data[i];
        sent_until += byte_ticks;
    }
    return taken;
}

static uint16_t unsent(void *context) {
    (void)context;
    return (uint16_t)(waiting() + stuck);
}

static void configure(void *context, gyb_board *it, const gyb_wanted *wanted) {
    (void)context;
    if (wanted->rate_deci_hz) {
        it->identity.sensors[0].rate_deci_hz = (uint16_t)wanted->rate_deci_hz;
    }
    if (wanted->full_scale_dps) {
        it->identity.sensors[0].full_scale = (uint16_t)wanted->full_scale_dps;
    }
    if (wanted->accel >= 0) {
        it->accel = (uint8_t)wanted->accel;
    }
    gyb_set_batch(it, wanted->batch ? wanted->batch : it->batch_size);
}

void vb_begin(uint64_t ticks, uint32_t seed, uint32_t ticks_a_byte, uint32_t ring, uint32_t period) {
    static const gyb_identity identity = {
        "1.0", "virtual", "00112233", "power", 7, 1, {{211, 250, 1000, 250, "0.00875", ""}}};
    gyb_port port;
    memset(&port, 0, sizeof port);
    now_ticks = ticks;
    sent_until = 0;
    out_size = 0;
    stuck = 0;
    byte_ticks = ticks_a_byte;
    room = ring;
    port.clock = clock_ticks;
    port.write = take_bytes;
    port.unsent = unsent;
    port.configure = configure;
    gyb_begin(&board, &identity, &port, seed);
    board.clock_high = (uint32_t)(ticks >> 32); /* as if it had run so long */
    board.clock_period = period;
}

void vb_at(uint64_t ticks) { now_ticks = ticks; }
void vb_stuck(uint16_t bytes) { stuck = bytes; }
void vb_poll(void) { gyb_poll(&board); }
void vb_lost(uint32_t count) { gyb_lost(&board, count); }
void vb_edge(uint32_t time) { gyb_edge(&board, time, 3, 1); }
void vb_batch(uint8_t samples) { gyb_set_batch(&board, samples); }
void vb_accel(uint8_t on) { board.accel = on; }
void vb_receive(const uint8_t *data, uint8_t size) { gyb_receive(&board, data, size, (uint32_t)now_ticks); }

void vb_take(uint8_t flags, const int16_t *gyro, const int16_t *accel, int16_t temperature) {
    gyb_take(&board, (uint32_t)now_ticks, flags, gyro, accel, temperature);
}

uint32_t vb_out(uint8_t *data, uint64_t *begun, uint32_t most) {
    uint32_t size = out_size < most ? out_size : most;
    memcpy(data, out, size);
    memcpy(begun, first_byte_at, size * sizeof *begun);
    return size;
}

/* Frames alone, with plain arguments. */

uint8_t vf_sample(uint8_t *wire, uint8_t flags, uint16_t sequence, uint32_t time, const int16_t *gyro,
                  const int16_t *accel, int16_t temperature) {
    gyb_sample sample;
    sample.flags = flags;
    sample.sequence = sequence;
    sample.time = time;
    memcpy(sample.gyro, gyro, 6);
    memcpy(sample.accel, accel, 6);
    sample.temperature = temperature;
    return gyb_seal(wire, gyb_pack_sample(wire + GYB_PAYLOAD_AT, &sample));
}

uint8_t vf_batch(uint8_t *wire, uint8_t flags, uint16_t sequence, uint32_t time, uint8_t axes,
                 uint8_t count, const int16_t *gyro, const int16_t *accel, int16_t temperature) {
    gyb_batch batch;
    uint8_t i, size;
    gyb_batch_begin(&batch, sequence, axes);
    for (i = 0; i < count; i++) {
        if (!gyb_batch_add(&batch, gyro + 3 * i, accel + 3 * i)) {
            return 0;
        }
    }
    size = gyb_batch_end(&batch, flags, time, temperature);
    memcpy(wire + GYB_PAYLOAD_AT, batch.payload, size);
    return gyb_seal(wire, size);
}

static gyb_ticks halves(uint64_t ticks) {
    gyb_ticks time;
    time.low = (uint32_t)ticks;
    time.high = (uint32_t)(ticks >> 32);
    return time;
}

uint8_t vf_slow(uint8_t *wire, uint64_t time, uint16_t boot, const uint32_t *counts, int16_t temperature,
                int16_t air, uint16_t supply) {
    gyb_slow slow;
    slow.time = halves(time);
    slow.boot = boot;
    slow.sequence = counts[0];
    slow.overruns = counts[1];
    slow.dropped = counts[2];
    slow.bus_errors = counts[3];
    slow.saturations = counts[4];
    slow.temperature = temperature;
    slow.air_decidegc = air;
    slow.supply_mv = supply;
    return gyb_seal(wire, gyb_pack_slow(wire + GYB_PAYLOAD_AT, &slow));
}

uint8_t vf_edge(uint8_t *wire, uint64_t time, uint8_t input, uint8_t rising) {
    return gyb_seal(wire, gyb_pack_edge(wire + GYB_PAYLOAD_AT, halves(time), input, rising));
}

uint8_t vf_time_reply(uint8_t *wire, const uint8_t *ping, uint64_t received, uint64_t sent) {
    return gyb_seal(wire, gyb_pack_time_reply(wire + GYB_PAYLOAD_AT, ping, halves(received), halves(sent)));
}

uint8_t vf_hello(uint8_t *wire, const char *firmware, const char *name, const char *uid, uint16_t boot,
                 uint32_t config, uint16_t who, uint16_t full_scale, uint16_t rate, uint16_t bandwidth,
                 const char *per_count, const char *unit) {
    gyb_identity identity;
    identity.firmware = firmware;
    identity.board = name;
    identity.uid = uid;
    identity.reset = "";
    identity.boot = boot;
    identity.sensor_count = 1;
    identity.sensors[0].who = who;
    identity.sensors[0].full_scale = full_scale;
    identity.sensors[0].rate_deci_hz = rate;
    identity.sensors[0].bandwidth_deci_hz = bandwidth;
    identity.sensors[0].per_count = per_count;
    identity.sensors[0].unit = unit;
    return gyb_seal(wire, gyb_pack_hello(wire + GYB_PAYLOAD_AT, &identity, config));
}

uint8_t vf_ack(uint8_t *wire, uint16_t rate, uint16_t bandwidth, uint16_t full_scale, uint8_t batch,
               uint8_t accel, uint32_t config) {
    gyb_sensor gyro;
    memset(&gyro, 0, sizeof gyro);
    gyro.rate_deci_hz = rate;
    gyro.bandwidth_deci_hz = bandwidth;
    gyro.full_scale = full_scale;
    return gyb_seal(wire, gyb_pack_ack(wire + GYB_PAYLOAD_AT, &gyro, batch, accel, config));
}
