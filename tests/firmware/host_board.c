/* A board on this machine's clock, speaking through the descriptor named in its argument:
 * 200 samples a second whose values follow from their numbers. It ends when the line does. */
#include <errno.h>
#include <poll.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>
#include <time.h>
#include <unistd.h>

#include "gyrorig_board.h"

#define PERIOD_US 5000u
#ifndef GAP_EVERY
#define GAP_EVERY 100u /* of so many samples one is lost before it is read */
#endif

static int line;
static int over;

static uint32_t clock_us(void *context) {
    struct timespec now;
    (void)context;
    clock_gettime(CLOCK_MONOTONIC, &now);
    return (uint32_t)((uint64_t)now.tv_sec * 1000000u + (uint64_t)now.tv_nsec / 1000u);
}

static uint8_t write_some(void *context, const uint8_t *data, uint8_t size) {
    ssize_t sent = write(line, data, size);
    (void)context;
    if (sent < 0 && errno != EAGAIN) {
        over = 1;
    }
    return sent < 0 ? 0 : (uint8_t)sent;
}

static uint16_t unsent(void *context) {
    (void)context;
    return 0;
}

static void take(gyb_board *board, uint32_t time) {
    uint16_t n = (uint16_t)board->sequence;
    int16_t gyro[3], accel[3];
    gyro[0] = (int16_t)n;
    gyro[1] = (int16_t)(uint16_t)(0u - n);
    gyro[2] = (int16_t)(uint16_t)(n * 3u);
    accel[0] = 1;
    accel[1] = 2;
    accel[2] = 256;
    gyb_take(board, time, GYB_STAMPED_AT_DATA_READY, gyro, accel, 215);
}

int main(int count, char **arguments) {
    static const gyb_identity identity = {
        "1.0", "host", "00112233aabbccdd", "", 3, 1, {{211, 250, 2000, 500, "0.00875", ""}}};
    static gyb_board board;
    gyb_port port;
    uint32_t due;
    if (count != 3) {
        return 2;
    }
    line = atoi(arguments[1]);
    memset(&port, 0, sizeof port);
    port.clock = clock_us;
    port.write = write_some;
    port.unsent = unsent;
    gyb_begin(&board, &identity, &port, (uint32_t)getpid());
    gyb_set_batch(&board, (uint8_t)atoi(arguments[2]));
    due = clock_us(NULL);
    while (!over) {
        struct pollfd wait;
        wait.fd = line;
        wait.events = POLLIN;
        if (poll(&wait, 1, 1) > 0) {
            uint8_t data[64];
            ssize_t size = read(line, data, sizeof data);
            if (size <= 0 && errno != EAGAIN) {
                break;
            }
            if (size > 0) {
                gyb_receive(&board, data, (uint8_t)size, clock_us(NULL));
            }
        }
        while ((uint32_t)(clock_us(NULL) - due) < 0x80000000u) {
            if (board.sequence % GAP_EVERY == GAP_EVERY - 1u) {
                gyb_lost(&board, 1);
            } else {
                take(&board, due);
            }
            gyb_poll(&board); /* after a standstill there are more than its queue holds */
            due += PERIOD_US;
        }
        gyb_poll(&board);
        gyb_poll(&board);
    }
    return 0;
}
