/* Throw random bytes, damaged frames and random calls at a board: fuzz_board SEED ROUNDS.
 * Built with sanitizers. Every frame that leaves must be one that `gyb_unstuff` takes. */
#include <stdio.h>
#include <stdlib.h>
#include <string.h>

#include "gyrorig_board.h"

static uint32_t state;
static uint32_t ticks;
static uint8_t piece[256];
static uint32_t piece_size, frames, answers, inputs;

static uint32_t any(uint32_t span) {
    state ^= state << 13;
    state ^= state >> 17;
    state ^= state << 5;
    return state % span;
}

static uint32_t clock_ticks(void *context) {
    (void)context;
    ticks += any(300);
    return ticks;
}

static void end_of_piece(void) {
    uint8_t length;
    if (!piece_size) {
        return;
    }
    length = gyb_unstuff(piece, (uint8_t)piece_size);
    if (!length) {
        fprintf(stderr, "a frame that is none\n");
        abort();
    }
    frames++;
    answers += piece[1] == GYB_ACK || piece[1] == GYB_TIME_REPLY;
    piece_size = 0;
}

static uint8_t take_some(void *context, const uint8_t *data, uint8_t size) {
    uint8_t i, taken = (uint8_t)any((uint32_t)size + 1u);
    (void)context;
    for (i = 0; i < taken; i++) {
        if (data[i]) {
            if (piece_size >= 251) {
                abort();
            }
            piece[piece_size++] = data[i];
        } else {
            end_of_piece();
        }
    }
    return taken;
}

static uint16_t unsent(void *context) {
    (void)context;
    return (uint16_t)any(3);
}

static void configure(void *context, gyb_board *board, const gyb_wanted *wanted) {
    (void)context;
    board->identity.sensors[0].rate_deci_hz = (uint16_t)wanted->rate_deci_hz;
    board->accel = wanted->accel > 0;
    gyb_set_batch(board, wanted->batch);
}

/* A frame from the host, damaged now and then. */
static void say(gyb_board *board) {
    static const char *const texts[] = {
        "{\"odr\":200,\"fs\":500}", "{\"batch\":39,\"accel\":false}", "{\"bw\":12.5}", "{}",
        "{\"batch\":255}", "{\"odr\":99999999.99,\"accel\":true}", "{\"odr\":1e9}", "{\"x\":\"y\"}"};
    uint8_t wire[GYB_MAX_WIRE], size, i;
    switch (any(4)) {
    case 0: /* noise */
        size = (uint8_t)any(GYB_MAX_WIRE);
        for (i = 0; i < size; i++) {
            wire[i] = (uint8_t)(size % 2 ? any(any(2) ? 256 : 3) : 1 + any(255)); /* or overlong */
        }
        break;
    case 1:
        wire[GYB_PAYLOAD_AT] = GYB_HELLO;
        size = gyb_seal(wire, 1);
        break;
    case 2:
        wire[GYB_PAYLOAD_AT] = GYB_TIME_REQUEST;
        for (i = 1; i < 14; i++) {
            wire[GYB_PAYLOAD_AT + i] = (uint8_t)any(256);
        }
        size = gyb_seal(wire, (uint8_t)(13 + !any(8)));
        break;
    default: {
        const char *text = texts[any(sizeof texts / sizeof *texts)];
        wire[GYB_PAYLOAD_AT] = GYB_SET;
        memcpy(wire + GYB_PAYLOAD_AT + 1, text, strlen(text));
        if (!any(3)) { /* a good check over a damaged text */
            wire[GYB_PAYLOAD_AT + 1 + any((uint32_t)strlen(text))] = (uint8_t)any(256);
        }
        size = gyb_seal(wire, (uint8_t)(1 + strlen(text)));
    }
    }
    if (size && !any(4)) {
        wire[any(size)] ^= (uint8_t)(1u << any(8));
    }
    inputs++;
    gyb_receive(board, wire, size, ticks);
}

int main(int count, char **arguments) {
    static const gyb_identity identity = {
        "1.0", "fuzz \"\\\n", "00112233", "reset", 3, 2,
        {{211, 250, 2000, 500, "0.00875", ""}, {229, 16, 0, 0, "0.00390625", "g"}}};
    static gyb_board board;
    gyb_port port = {NULL, clock_ticks, take_some, unsent, configure};
    long round, rounds;
    if (count != 3) {
        return 2;
    }
    state = (uint32_t)strtoul(arguments[1], NULL, 10) | 1u;
    rounds = strtol(arguments[2], NULL, 10);
    gyb_begin(&board, &identity, &port, state);
    for (round = 0; round < rounds; round++) {
        int16_t gyro[3], accel[3];
        uint8_t i;
        for (i = 0; i < 3; i++) {
            gyro[i] = (int16_t)(any(65536) - 32768);
            accel[i] = (int16_t)(any(65536) - 32768);
        }
        switch (any(8)) {
        case 0: say(&board); break;
        case 1: gyb_lost(&board, any(100)); break;
        case 2: gyb_edge(&board, ticks - any(1000), (uint8_t)any(256), (uint8_t)any(256)); break;
        case 3:
        case 4: gyb_take(&board, ticks, (uint8_t)any(any(8) ? 8 : 256), gyro, accel, accel[0]); break;
        default: gyb_poll(&board);
        }
    }
    printf("%lu %lu %lu %lu\n", (unsigned long)inputs, (unsigned long)frames, (unsigned long)answers,
           (unsigned long)board.receive_faults);
    return 0;
}
