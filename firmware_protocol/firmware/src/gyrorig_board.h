/* A board that speaks GCB1: frames, their queue, and when clock frames go out.
 *
 * What to use when:
 *
 * - `gyb_begin` once, then from the main loop: `gyb_receive` with what the port read,
 *   `gyb_take` for every sample, `gyb_poll` in every turn. That is a whole board.
 * - `gyb_pack_*`, `gyb_batch_*`, `gyb_seal` and `gyb_unstuff` alone for a firmware with
 *   its own queue. They touch nothing but their arguments.
 *
 * Portable C99, also read by C++. No dynamic memory, no floating point, no 64-bit
 * arithmetic, nothing blocks. One thread: interrupts only keep stamps, the main loop calls.
 * The frames: gyrorig_protocol/board/board_frames.py, whose vectors are this file's too.
 *
 * Theory of operation. Samples wait in a queue as bare payloads; a frame gets its check
 * and its stuffing when it is its turn on the line. HELLO, ACK, SLOW and TIME replies are
 * not queued: they are written when they are sent, so that the stamp of a clock frame is
 * that of its own first byte. They pass queued samples, but those with a stamp begin only
 * when the port has nothing left to send; where that takes 50 ms they are given up. SLOW goes out at random phase: a regular one would beat against
 * the 1 ms frames of USB. Where the line is busy at the drawn moment a new moment is drawn,
 * for the end of the frame on the line has the phase of the samples.
 */
#ifndef GYRORIG_BOARD_H
#define GYRORIG_BOARD_H

#include <stdint.h>

#ifdef __cplusplus
extern "C" {
#endif

/* Memory, in bytes; define them before (for all files) to change them. The defaults fit
 * into the 2 KiB of an ATmega328P beside Wire and Serial. */
#ifndef GYB_QUEUE_BYTES
#ifdef __AVR__
#define GYB_QUEUE_BYTES 192
#else
#define GYB_QUEUE_BYTES 4096
#endif
#endif
#ifndef GYB_BATCH_BYTES /* of a batch's payload: 248 at most, which is 39 gyro samples */
#ifdef __AVR__
#define GYB_BATCH_BYTES 107
#else
#define GYB_BATCH_BYTES 248
#endif
#endif
#ifndef GYB_RECEIVE_BYTES /* of a stuffed frame from the host; a SET needs about 80 */
#define GYB_RECEIVE_BYTES 112
#endif

#define GYB_MAX_PAYLOAD 248
#define GYB_MAX_WIRE 253       /* payload, check 2, stuffing 1, delimiters 2 */
#define GYB_PAYLOAD_AT 2       /* where a payload stands in a wire buffer */
#define GYB_NO_AIR (-32767 - 1) /* SLOW without an air temperature */
#define GYB_SAMPLE_BYTES 22
#define GYB_SLOW_BYTES 37
#define GYB_EDGE_BYTES 11
#define GYB_TIME_REPLY_BYTES 29
#define GYB_MAX_SENSORS 4

/* Frame types. */
#define GYB_SAMPLE 0x01
#define GYB_BATCH 0x02
#define GYB_SLOW 0x03
#define GYB_EDGE 0x04
#define GYB_HELLO 0x10
#define GYB_TIME_REQUEST 0x20
#define GYB_TIME_REPLY 0x21
#define GYB_SET 0x30
#define GYB_ACK 0x31

/* Flags of a sample. `gyb_take` adds OVERRUN, CONFIGURATION_CHANGED and FRAMES_DROPPED. */
#define GYB_OVERRUN 1               /* the sensor lost samples before this one */
#define GYB_SATURATED 2             /* an axis is at its end */
#define GYB_STAMPED_AT_DATA_READY 4 /* else when it was read */
#define GYB_REPEATED 8              /* read again, nothing new */
#define GYB_STAMP_FROM_FIFO 16      /* computed from a neighbour's stamp */
#define GYB_CONFIGURATION_CHANGED 32
#define GYB_FRAMES_DROPPED 64 /* this firmware dropped frames before this one */
#define GYB_CLOCK_DISCIPLINED 128

/* Ticks (nominally microseconds) since the start, 64 bits in two halves. */
typedef struct {
    uint32_t low;
    uint32_t high;
} gyb_ticks;

/* One sample: raw counts in the sensor's own axes. */
typedef struct {
    uint8_t flags;
    uint16_t sequence; /* counts the sensor's samples, not frames */
    uint32_t time;     /* ticks at data-ready, low half */
    int16_t gyro[3];
    int16_t accel[3];
    int16_t temperature;
} gyb_sample;

/* The clock frame: the whole clock, and what went wrong since the start. */
typedef struct {
    gyb_ticks time;
    uint16_t boot;
    uint32_t sequence;
    uint32_t overruns; /* samples that the sensor lost */
    uint32_t dropped;  /* frames that this firmware dropped */
    uint32_t bus_errors;
    uint32_t saturations;
    int16_t temperature; /* raw, of the gyro */
    int16_t air_decidegc; /* GYB_NO_AIR where there is none */
    uint16_t supply_mv;   /* 0 where unknown */
} gyb_slow;

/* A batch under way: one stamp, that of the last sample. */
typedef struct {
    uint8_t length; /* 0: none under way */
    uint8_t count;
    uint8_t axes; /* 3 or 6 */
    uint8_t payload[GYB_BATCH_BYTES];
} gyb_batch;

/* A sensor as HELLO describes it, gyro first. Numbers that are not whole go as text or in
 * tenths, so that no floating point is needed. */
typedef struct {
    uint16_t who;        /* its identity register */
    uint16_t full_scale; /* in `unit` */
    uint16_t rate_deci_hz; /* 0: left out */
    uint16_t bandwidth_deci_hz;
    const char *per_count; /* in `unit`, such as "0.00875" */
    const char *unit;      /* "" is dps */
} gyb_sensor;

/* Who the board is. Texts of printable ASCII; `uid` is unique to the controller. */
typedef struct {
    const char *firmware;
    const char *board;
    const char *uid;
    const char *reset; /* why it started; "" is left out */
    uint16_t boot;     /* starts so far */
    uint8_t sensor_count;
    gyb_sensor sensors[GYB_MAX_SENSORS];
} gyb_identity;

/* What a SET asks for; 0 (and -1 for accel) is "as it is". */
typedef struct {
    uint32_t rate_deci_hz;
    uint32_t bandwidth_deci_hz;
    uint32_t full_scale_dps;
    uint8_t batch;
    int8_t accel;
} gyb_wanted;

struct gyb_board;

/* What the board stands on. Everything but `configure` must be there. */
typedef struct {
    void *context; /* handed to each */
    /* Return the clock's ticks; it wraps at 2^32 and nowhere else. */
    uint32_t (*clock)(void *context);
    /* Take up to `size` bytes without waiting; return how many. */
    uint8_t (*write)(void *context, const uint8_t *data, uint8_t size);
    /* Return how many of the bytes taken are not on the wire yet. */
    uint16_t (*unsent)(void *context);
    /* Do what is wanted as far as possible, and say in board->identity.sensors, by
     * `gyb_set_batch` and in board->accel what is in force. Or NULL: nothing can be set. */
    void (*configure)(void *context, struct gyb_board *board, const gyb_wanted *wanted);
} gyb_port;

/* A board. `identity`, `accel`, `temperature`, `air_decidegc`, `supply_mv`,
 * `clock_period` and `transmit_lead` are the caller's to write; the rest is to read. */
typedef struct gyb_board {
    gyb_identity identity;
    gyb_port port;
    uint8_t accel;           /* nonzero: samples carry it */
    int16_t temperature;     /* for SLOW */
    int16_t air_decidegc;
    uint16_t supply_mv;
    uint32_t clock_period;   /* ticks between SLOW frames on average; 0: none */
    uint32_t transmit_lead;  /* ticks from a transmit stamp to the first start bit */
    uint32_t sequence;       /* of the next sample */
    uint32_t overruns, dropped, bus_errors, saturations;
    uint32_t receive_faults; /* bytes from the host that were no frame of ours */
    /* inside */
    uint32_t clock_last, clock_high, clock_due, clock_waits, random;
    uint8_t clock_tries, never_empty, flags, batch_size, pending;
    gyb_ticks ping_received;
    uint8_t ping[12]; /* nonce and host stamp, as they came */
    uint8_t received_length, receive_overlong;
    uint8_t wire_length, wire_sent;
    uint16_t queue_head, queue_used;
    int16_t batch_temperature;
    gyb_batch batch;
    uint8_t received[GYB_RECEIVE_BYTES];
    uint8_t wire[GYB_MAX_WIRE];
    uint8_t queue[GYB_QUEUE_BYTES];
} gyb_board;

/* ---- frames: pure functions ---- */

/* Return the CRC-16/CCITT-FALSE of `size` bytes: 0x29B1 over "123456789". */
uint16_t gyb_crc16(const uint8_t *data, uint8_t size);

/* Make a frame in place of the payload of `size` <= GYB_MAX_PAYLOAD bytes that stands at
 * wire + GYB_PAYLOAD_AT. Return its length with both delimiters, 0 where it is too long. */
uint8_t gyb_seal(uint8_t wire[GYB_MAX_WIRE], uint8_t size);

/* Check what stood between two delimiters, in place: the payload then begins at
 * data + 1. Return its length without the check, 0 where it is no frame. */
uint8_t gyb_unstuff(uint8_t *data, uint8_t size);

/* Write a payload; return its length. */
uint8_t gyb_pack_sample(uint8_t payload[GYB_SAMPLE_BYTES], const gyb_sample *sample);
uint8_t gyb_pack_slow(uint8_t payload[GYB_SLOW_BYTES], const gyb_slow *slow);
uint8_t gyb_pack_edge(uint8_t payload[GYB_EDGE_BYTES], gyb_ticks time, uint8_t input,
                      uint8_t rising);
/* `ping` is the request's nonce and host stamp as they came, 12 bytes. */
uint8_t gyb_pack_time_reply(uint8_t payload[GYB_TIME_REPLY_BYTES], const uint8_t *ping,
                            gyb_ticks received, gyb_ticks sent);
/* HELLO and ACK, 0 where the text does not fit into a frame. HELLO leaves out the last
 * sensors before that. */
uint8_t gyb_pack_hello(uint8_t payload[GYB_MAX_PAYLOAD], const gyb_identity *identity,
                       uint32_t config);
uint8_t gyb_pack_ack(uint8_t payload[GYB_MAX_PAYLOAD], const gyb_sensor *gyro, uint8_t batch,
                     uint8_t accel, uint32_t config);

/* Begin a batch of samples of 3 or 6 axes; `sequence` is the first one's. */
void gyb_batch_begin(gyb_batch *batch, uint16_t sequence, uint8_t axes);
/* Add a sample; `accel` is not looked at with 3 axes. Return 0 where it is full. */
uint8_t gyb_batch_add(gyb_batch *batch, const int16_t gyro[3], const int16_t accel[3]);
/* End it with the stamp of the last sample; return the length of batch->payload. */
uint8_t gyb_batch_end(gyb_batch *batch, uint8_t flags, uint32_t time, int16_t temperature);

/* Read a SET's JSON, `size` bytes after its type. Return 0 where it is none. */
uint8_t gyb_read_set(const uint8_t *json, uint8_t size, gyb_wanted *wanted);

/* ---- the board ---- */

/* Start, and say HELLO. `seed` should differ from board to board and start to start. */
void gyb_begin(gyb_board *board, const gyb_identity *identity, const gyb_port *port,
               uint32_t seed);
/* Take a sample. `time` is the stamp of its data-ready, or what `flags` says. Its number
 * is counted here. Where the queue is full it is lost, counted, and the next one says so. */
void gyb_take(gyb_board *board, uint32_t time, uint8_t flags, const int16_t gyro[3],
              const int16_t accel[3], int16_t temperature);
/* The sensor lost `count` samples: the numbers skip them, the next sample says so. */
void gyb_lost(gyb_board *board, uint32_t count);
/* An edge at a pin: `time` is the interrupt's stamp, less than 35 minutes old. */
void gyb_edge(gyb_board *board, uint32_t time, uint8_t input, uint8_t rising);
/* Take bytes from the host. `time` is when the last of them came. */
void gyb_receive(gyb_board *board, const uint8_t *data, uint8_t size, uint32_t time);
/* Send what is due. Call in every turn of the loop, at least every 71 minutes. */
void gyb_poll(gyb_board *board);
/* Samples in a frame from now on; what does not fit is cut. Ends a batch under way. */
void gyb_set_batch(gyb_board *board, uint8_t samples);
/* Return the hash of the settings in force, as HELLO and ACK tell it. */
uint32_t gyb_config_hash(const gyb_board *board);

#ifdef __cplusplus
}
#endif
#endif
