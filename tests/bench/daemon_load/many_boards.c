/* Many boards at once, cheaply: serial ones with the real firmware on pseudo-terminals, CAN ones
 * as python-can's multicast datagrams. A sample's stamp is when it was due, on CLOCK_MONOTONIC_RAW
 * in us, so that the recording alone tells how late its arrival stamp was; how late this program
 * itself was with sending it says at the end.
 *
 *   many_boards RATE_HZ SECONDS SERIAL_FD... -- GROUP:PORT:NODES:INTERFACE_ADDRESS ...
 *
 * Rates differ by up to 5 % from board to board, as those of real parts do. A program that was held
 * up for more than a second has lost the samples in between, as a sensor's FIFO would. At the end each
 * board says on standard output: name, samples taken, frames that its firmware had to drop, samples
 * lost before it; and then the program how late it was, in us: median, 99th percentile, worst. */
#define _GNU_SOURCE
#include <arpa/inet.h>
#include <errno.h>
#include <fcntl.h>
#include <netinet/in.h>
#include <poll.h>
#include <signal.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>
#include <sys/prctl.h>
#include <sys/socket.h>
#include <sys/time.h>
#include <time.h>
#include <unistd.h>

#include "gyrorig_board.h"

#define MOST 64
#define STATUS_EVERY 80u
#define US 1000000ull

typedef struct {
    int fd; /* pty master, or the bus's socket to send with */
    gyb_board serial;
    int bus;     /* -1: serial */
    int node;
    uint16_t boot;
    uint64_t due, period_ns, taken, dropped, lost;
    uint64_t hello_due;
} board;

typedef struct {
    int sender, receiver;
    struct sockaddr_in to;
    int own_port;
} bus;

static board boards[MOST];
static bus buses[MOST];
#define LATE_BINS 4000u /* of 50 us */
static uint64_t late_bins[LATE_BINS + 1], late_worst;
static int board_count, bus_count;
static volatile sig_atomic_t over;

static void stop(int signal_number) {
    (void)signal_number;
    over = 1;
}

static uint64_t raw_ns(void) {
    struct timespec now;
    clock_gettime(CLOCK_MONOTONIC_RAW, &now);
    return (uint64_t)now.tv_sec * 1000000000ull + (uint64_t)now.tv_nsec;
}

static uint32_t clock_us(void *context) {
    (void)context;
    return (uint32_t)(raw_ns() / 1000u);
}

static uint8_t write_some(void *context, const uint8_t *data, uint8_t size) {
    ssize_t sent = write(*(int *)context, data, size);
    return sent < 0 ? 0 : (uint8_t)sent;
}

static uint16_t unsent(void *context) {
    (void)context;
    return 0;
}

/* ---- CAN: a datagram is a map in msgpack whose first ten keys never change ---- */

static uint8_t *put_text(uint8_t *at, const char *text) {
    size_t size = strlen(text);
    *at++ = (uint8_t)(0xa0u | size);
    memcpy(at, text, size);
    return at + size;
}

static uint8_t *put_flag(uint8_t *at, const char *key, int value) {
    at = put_text(at, key);
    *at++ = value ? 0xc3 : 0xc2;
    return at;
}

static int send_frame(const bus *on, uint16_t identifier, const uint8_t *data, uint8_t size) {
    uint8_t out[256], *at = out;
    *at++ = 0x8b;
    at = put_text(at, "timestamp");
    *at++ = 0xcb;
    memset(at, 0, 8);
    at += 8;
    at = put_text(at, "arbitration_id");
    *at++ = 0xcd;
    *at++ = (uint8_t)(identifier >> 8);
    *at++ = (uint8_t)identifier;
    at = put_flag(at, "is_extended_id", 0);
    at = put_flag(at, "is_remote_frame", 0);
    at = put_flag(at, "is_error_frame", 0);
    at = put_text(at, "channel");
    *at++ = 0xc0;
    at = put_text(at, "dlc");
    *at++ = size;
    at = put_text(at, "data");
    *at++ = 0xc4;
    *at++ = size;
    memcpy(at, data, size);
    at += size;
    at = put_flag(at, "is_fd", 0);
    at = put_flag(at, "bitrate_switch", 0);
    at = put_flag(at, "error_state_indicator", 0);
    return sendto(on->sender, out, (size_t)(at - out), MSG_DONTWAIT, (const struct sockaddr *)&on->to,
                  sizeof on->to) >= 0;
}

static void put16(uint8_t *at, uint16_t value) {
    at[0] = (uint8_t)value;
    at[1] = (uint8_t)(value >> 8);
}

static void can_hello(const board *it) {
    char text[256];
    uint8_t whole[300], segment[8];
    size_t size, at;
    uint16_t check;
    int number = 0;
    size = (size_t)snprintf(text, sizeof text,
                            "{\"proto\":1,\"fw\":\"1\",\"board\":\"load\",\"uid\":\"can%02d%02d\",\"boot\":%u,\"config\":"
                            "\"1\",\"sensors\":[{\"who\":211,\"fs\":250,\"odr\":800,\"bw\":110,\"lsb\":0.00875}]}",
                            it->bus, it->node, it->boot);
    memcpy(whole, text, size);
    check = gyb_crc16(whole, (uint8_t)size);
    put16(whole + size, check);
    size += 2;
    for (at = 0; at < size; at += 7, number++) {
        uint8_t length = (uint8_t)(size - at < 7 ? size - at : 7);
        segment[0] = (uint8_t)(number | (at + 7 >= size ? 0x80 : 0));
        memcpy(segment + 1, whole + at, length);
        send_frame(&buses[it->bus], (uint16_t)(7 << 7 | it->node), segment, (uint8_t)(length + 1));
    }
}

static void can_sample(board *it, uint64_t now) {
    uint8_t data[8];
    uint64_t us = now / 1000u;
    uint16_t n = (uint16_t)it->taken;
    if (it->taken % STATUS_EVERY == 0) {
        put16(data, (uint16_t)us);
        put16(data + 2, (uint16_t)(us >> 16));
        put16(data + 4, n);
        put16(data + 6, it->boot);
        send_frame(&buses[it->bus], (uint16_t)(5 << 7 | it->node), data, 8);
    }
    put16(data, (uint16_t)(n % 997u));
    put16(data + 2, (uint16_t)(n % 499u));
    put16(data + 4, (uint16_t)(0u - n % 251u));
    put16(data + 6, (uint16_t)(us / 4u));
    if (!send_frame(&buses[it->bus], (uint16_t)(4 << 7 | it->node), data, 8)) {
        it->dropped++;
    }
    it->taken++;
}

/* A datagram's identifier and first byte, by looking for its keys: enough for the host's frames. */
static int read_frame(const uint8_t *in, size_t size, unsigned *identifier, uint8_t *first) {
    const uint8_t *id = memmem(in, size, "arbitration_id", 14), *data = memmem(in, size, "\xa4" "data", 5);
    if (!id || !data || data + 8 > in + size || id + 17 > in + size) {
        return 0;
    }
    id += 14;
    *identifier = *id == 0xcd ? (unsigned)id[1] << 8 | id[2] : *id == 0xcc ? id[1] : *id;
    *first = data[7];
    return 1;
}

static void hear(int number) {
    uint8_t in[512], latch[8];
    struct sockaddr_in from;
    socklen_t length = sizeof from;
    ssize_t size;
    int at;
    while ((size = recvfrom(buses[number].receiver, in, sizeof in, MSG_DONTWAIT, (struct sockaddr *)&from,
                            &length)) > 0) {
        unsigned identifier;
        uint8_t first;
        uint64_t us = raw_ns() / 1000u;
        if (ntohs(from.sin_port) == buses[number].own_port ||
            !read_frame(in, (size_t)size, &identifier, &first)) {
            continue;
        }
        for (at = 0; at < board_count; at++) {
            board *it = &boards[at];
            if (it->bus != number) {
                continue;
            }
            if (identifier == 0x80) {
                latch[0] = first;
                latch[1] = (uint8_t)it->boot;
                put16(latch + 2, (uint16_t)us);
                put16(latch + 4, (uint16_t)(us >> 16));
                put16(latch + 6, (uint16_t)(us >> 32));
                send_frame(&buses[number], (uint16_t)(2 << 7 | it->node), latch, 8);
            } else if (identifier == (8u << 7) || identifier == (8u << 7 | (unsigned)it->node)) {
                can_hello(it);
            }
        }
    }
}

static void open_bus(const char *group, int port, const char *interface) {
    bus *it = &buses[bus_count++];
    struct sockaddr_in own;
    socklen_t length = sizeof own;
    struct ip_mreq join;
    int one = 1;
    memset(it, 0, sizeof *it);
    it->to.sin_family = AF_INET;
    it->to.sin_port = htons((uint16_t)port);
    it->to.sin_addr.s_addr = inet_addr(group);
    it->sender = socket(AF_INET, SOCK_DGRAM, 0);
    it->receiver = socket(AF_INET, SOCK_DGRAM, 0);
    setsockopt(it->receiver, SOL_SOCKET, SO_REUSEADDR, &one, sizeof one);
    setsockopt(it->receiver, SOL_SOCKET, SO_REUSEPORT, &one, sizeof one);
    join.imr_multiaddr = it->to.sin_addr;
    join.imr_interface.s_addr = inet_addr(interface);
    setsockopt(it->sender, IPPROTO_IP, IP_MULTICAST_IF, &join.imr_interface, sizeof join.imr_interface);
    if (bind(it->receiver, (struct sockaddr *)&it->to, sizeof it->to) < 0 ||
        setsockopt(it->receiver, IPPROTO_IP, IP_ADD_MEMBERSHIP, &join, sizeof join) < 0) {
        perror("many_boards: multicast");
        exit(1);
    }
    memset(&own, 0, sizeof own);
    own.sin_family = AF_INET;
    bind(it->sender, (struct sockaddr *)&own, sizeof own);
    getsockname(it->sender, (struct sockaddr *)&own, &length);
    it->own_port = ntohs(own.sin_port);
}

static void begin_serial(board *it, int number) {
    static char uids[MOST][12];
    gyb_identity identity = {"1", "load", uids[number], "", 1, 1, {{211, 250, 8000, 1100, "0.00875", ""}}};
    gyb_port port;
    snprintf(uids[number], sizeof uids[number], "serial%02d", number);
    memset(&port, 0, sizeof port);
    port.context = &it->fd;
    port.clock = clock_us;
    port.write = write_some;
    port.unsent = unsent;
    gyb_begin(&it->serial, &identity, &port, (uint32_t)number * 2654435761u + 1u);
    it->serial.accel = 1;
    it->serial.clock_high = (uint32_t)(raw_ns() / 1000u >> 32);
    it->serial.clock_period = 200000;
}

static void serve_serial(board *it) {
    uint8_t in[64];
    ssize_t size = read(it->fd, in, sizeof in);
    if (size > 0) {
        gyb_receive(&it->serial, in, (uint8_t)size, clock_us(NULL));
    }
    do { /* a board's loop turns many times between two samples */
        gyb_poll(&it->serial);
    } while (it->serial.queue_used && it->serial.wire_sent == it->serial.wire_length);
}

static void take(board *it, uint64_t now) {
    int16_t gyro[3], accel[3] = {1, 2, 256};
    if (it->bus >= 0) {
        can_sample(it, now);
        return;
    }
    gyro[0] = (int16_t)(it->taken % 997u);
    gyro[1] = (int16_t)(it->taken % 499u);
    gyro[2] = (int16_t)-(int)(it->taken % 251u);
    gyb_take(&it->serial, (uint32_t)(now / 1000u), GYB_STAMPED_AT_DATA_READY, gyro, accel, 215);
    it->taken++;
    serve_serial(it);
}

static unsigned late_us(double share) {
    uint64_t total = 0, sum = 0;
    unsigned bin;
    for (bin = 0; bin <= LATE_BINS; bin++) {
        total += late_bins[bin];
    }
    for (bin = 0; bin < LATE_BINS && (double)sum < share * (double)total; bin++) {
        sum += late_bins[bin];
    }
    return bin * 50u;
}

static void run(uint64_t until) {
    while (!over && raw_ns() < until) {
        uint64_t next = until, now;
        struct timespec wait;
        int at;
        for (at = 0; at < board_count; at++) {
            board *it = &boards[at];
            now = raw_ns();
            if (it->due + 1000000000ull < now) {
                uint64_t lost = (now - it->due) / it->period_ns;
                it->due += lost * it->period_ns;
                it->taken += lost;
                it->lost += lost;
                if (it->bus < 0) {
                    gyb_lost(&it->serial, (uint32_t)lost);
                }
            }
            if (it->due <= now) {
                uint64_t late = now - it->due, bin = late / 50000u;
                late_bins[bin < LATE_BINS ? bin : LATE_BINS]++;
                late_worst = late > late_worst ? late : late_worst;
                take(it, it->due);
                it->due += it->period_ns;
            }
            next = it->due < next ? it->due : next;
        }
        for (at = 0; at < bus_count; at++) {
            hear(at);
        }
        now = raw_ns();
        if (next > now) {
            uint64_t left = next - now;
            wait.tv_sec = 0;
            wait.tv_nsec = (long)(left < 1000000u ? left : 1000000u);
            nanosleep(&wait, NULL);
        }
    }
}

int main(int count, char **arguments) {
    double rate;
    uint64_t start;
    int at, serial = 1;
    if (count < 4) {
        return 2;
    }
    rate = atof(arguments[1]);
    prctl(PR_SET_TIMERSLACK, 1UL);
    signal(SIGTERM, stop);
    signal(SIGINT, stop);
    signal(SIGPIPE, SIG_IGN);
    start = raw_ns();
    for (at = 3; at < count && board_count < MOST; at++) {
        if (strcmp(arguments[at], "--") == 0) {
            serial = 0;
        } else if (serial) {
            board *it = &boards[board_count];
            it->fd = atoi(arguments[at]);
            it->bus = -1;
            fcntl(it->fd, F_SETFL, O_NONBLOCK);
            begin_serial(it, board_count++);
        } else {
            char group[64], interface[64];
            int port, nodes, node;
            if (sscanf(arguments[at], "%63[0-9.]:%d:%d:%63[0-9.]", group, &port, &nodes, interface) != 4) {
                return 2;
            }
            open_bus(group, port, interface);
            for (node = 1; node <= nodes && board_count < MOST; node++) {
                board *it = &boards[board_count++];
                it->bus = bus_count - 1;
                it->node = node;
                it->boot = 1;
                can_hello(it);
            }
        }
    }
    for (at = 0; at < board_count; at++) { /* 2 % to 5 % fast, as L3G4200D are */
        double fast = 1.02 + 0.03 * at / (board_count > 1 ? board_count - 1 : 1);
        boards[at].period_ns = (uint64_t)(1e9 / (rate * fast));
        boards[at].due = start + boards[at].period_ns * (uint64_t)(at + 1) / (uint64_t)board_count;
    }
    printf("ready\n");
    fflush(stdout);
    run(start + (uint64_t)(atof(arguments[2]) * 1e9));
    for (at = 0; at < board_count; at++) {
        board *it = &boards[at];
        if (it->bus < 0) {
            printf("serial%02d %llu %lu %llu\n", at, (unsigned long long)it->taken,
                   (unsigned long)it->serial.dropped, (unsigned long long)it->lost);
        } else {
            printf("can%02d%02d %llu %llu %llu\n", it->bus, it->node, (unsigned long long)it->taken,
                   (unsigned long long)it->dropped, (unsigned long long)it->lost);
        }
    }
    printf("late %u %u %llu\n", late_us(0.5), late_us(0.99), (unsigned long long)(late_worst / 1000u));
    return 0;
}
