/* See gyrorig_board.h. */
#include "gyrorig_board.h"

#include <string.h>

#define BATCH_HEAD_BYTES 9
#define CRC_BYTES 2
#define TIME_REQUEST_BYTES 13
#define REDRAWS 8           /* moments drawn anew for a busy line, then it waits its turn */
#define REDRAW_SPAN 4096UL  /* ticks within which they lie */

#define PATIENCE 50000UL    /* ticks that a clock frame waits for the port to be empty */

/* What is to be sent as soon as it can, in this order. */
#define PENDING_REPLY 1
#define PENDING_SLOW 2
#define PENDING_ACK 4
#define PENDING_HELLO 8

/* A batch has one set of flags: how its stamp came about is that of the last sample, one
 * saturated sample marks all, and where any other flag differs a new batch begins. */
#define OF_THE_STAMP (GYB_STAMPED_AT_DATA_READY | GYB_STAMP_FROM_FIFO)
#define OF_EACH_BATCH (0xFF & ~(GYB_SATURATED | OF_THE_STAMP))

/* ---- bytes ---- */

static uint8_t *put16(uint8_t *at, uint16_t value) {
    at[0] = (uint8_t)(value & 0xFFu);
    at[1] = (uint8_t)(value >> 8);
    return at + 2;
}

static uint8_t *put32(uint8_t *at, uint32_t value) {
    at = put16(at, (uint16_t)(value & 0xFFFFu));
    return put16(at, (uint16_t)(value >> 16));
}

static uint8_t *put_ticks(uint8_t *at, gyb_ticks time) {
    at = put32(at, time.low);
    return put32(at, time.high);
}

static uint8_t *put_triple(uint8_t *at, const int16_t values[3]) {
    uint8_t i;
    for (i = 0; i < 3; i++) {
        at = put16(at, (uint16_t)values[i]);
    }
    return at;
}

/* ---- wire ---- */

uint16_t gyb_crc16(const uint8_t *data, uint8_t size) {
    uint16_t crc = 0xFFFFu;
    uint8_t i;
    for (i = 0; i < size; i++) {
        /* one byte of the polynomial 0x1021 without a table or a loop over bits: its
         * powers x^12, x^5 and 1 applied to the byte that leaves */
        uint16_t out = (uint16_t)((crc >> 8) ^ data[i]);
        out = (uint16_t)(out ^ (out >> 4));
        crc = (uint16_t)((crc << 8) ^ (out << 12) ^ (out << 5) ^ out);
    }
    return crc;
}

uint8_t gyb_seal(uint8_t wire[GYB_MAX_WIRE], uint8_t size) {
    uint8_t code_at = 1, at, end;
    if (size == 0 || size > GYB_MAX_PAYLOAD) {
        return 0;
    }
    end = (uint8_t)(GYB_PAYLOAD_AT + size + CRC_BYTES);
    put16(wire + GYB_PAYLOAD_AT + size, gyb_crc16(wire + GYB_PAYLOAD_AT, size));
    /* at most 250 bytes: every code is below 255 and stands for one zero */
    for (at = GYB_PAYLOAD_AT; at < end; at++) {
        if (wire[at] == 0) {
            wire[code_at] = (uint8_t)(at - code_at);
            code_at = at;
        }
    }
    wire[code_at] = (uint8_t)(end - code_at);
    wire[0] = 0;
    wire[end] = 0;
    return (uint8_t)(end + 1);
}

uint8_t gyb_unstuff(uint8_t *data, uint8_t size) {
    uint16_t at = 0;
    uint8_t length;
    uint16_t crc;
    while (at < size) {
        uint8_t code = data[at];
        if (code == 0) {
            return 0;
        }
        data[at] = 0;
        at = (uint16_t)(at + code);
    }
    if (at != size || size < 1 + 1 + CRC_BYTES) {
        return 0;
    }
    length = (uint8_t)(size - 1 - CRC_BYTES);
    crc = (uint16_t)(data[1 + length] | ((uint16_t)data[2 + length] << 8));
    return gyb_crc16(data + 1, length) == crc ? length : 0;
}

/* ---- payloads ---- */

uint8_t gyb_pack_sample(uint8_t payload[GYB_SAMPLE_BYTES], const gyb_sample *sample) {
    uint8_t *at = payload;
    *at++ = GYB_SAMPLE;
    *at++ = sample->flags;
    at = put16(at, sample->sequence);
    at = put32(at, sample->time);
    at = put_triple(at, sample->gyro);
    at = put_triple(at, sample->accel);
    put16(at, (uint16_t)sample->temperature);
    return GYB_SAMPLE_BYTES;
}

uint8_t gyb_pack_slow(uint8_t payload[GYB_SLOW_BYTES], const gyb_slow *slow) {
    uint8_t *at = payload;
    *at++ = GYB_SLOW;
    at = put_ticks(at, slow->time);
    at = put16(at, slow->boot);
    at = put32(at, slow->sequence);
    at = put32(at, slow->overruns);
    at = put32(at, slow->dropped);
    at = put32(at, slow->bus_errors);
    at = put32(at, slow->saturations);
    at = put16(at, (uint16_t)slow->temperature);
    at = put16(at, (uint16_t)slow->air_decidegc);
    put16(at, slow->supply_mv);
    return GYB_SLOW_BYTES;
}

uint8_t gyb_pack_edge(uint8_t payload[GYB_EDGE_BYTES], gyb_ticks time, uint8_t input,
                      uint8_t rising) {
    uint8_t *at = payload;
    *at++ = GYB_EDGE;
    at = put_ticks(at, time);
    *at++ = input;
    *at = rising ? 1 : 0;
    return GYB_EDGE_BYTES;
}

uint8_t gyb_pack_time_reply(uint8_t payload[GYB_TIME_REPLY_BYTES], const uint8_t *ping,
                            gyb_ticks received, gyb_ticks sent) {
    payload[0] = GYB_TIME_REPLY;
    memcpy(payload + 1, ping, 12);
    put_ticks(put_ticks(payload + 13, received), sent);
    return GYB_TIME_REPLY_BYTES;
}

void gyb_batch_begin(gyb_batch *batch, uint16_t sequence, uint8_t axes) {
    batch->payload[0] = GYB_BATCH;
    put16(batch->payload + 2, sequence);
    batch->length = BATCH_HEAD_BYTES;
    batch->count = 0;
    batch->axes = axes == 6 ? 6 : 3;
}

uint8_t gyb_batch_add(gyb_batch *batch, const int16_t gyro[3], const int16_t accel[3]) {
    uint8_t *at = batch->payload + batch->length;
    if (batch->length < BATCH_HEAD_BYTES ||
        (uint16_t)batch->length + 2u * batch->axes + 2u > GYB_BATCH_BYTES) {
        return 0;
    }
    at = put_triple(at, gyro);
    if (batch->axes == 6) {
        put_triple(at, accel);
    }
    batch->length = (uint8_t)(batch->length + 2 * batch->axes);
    batch->count++;
    return 1;
}

uint8_t gyb_batch_end(gyb_batch *batch, uint8_t flags, uint32_t time, int16_t temperature) {
    uint8_t length = batch->length;
    if (batch->count == 0) {
        batch->length = 0;
        return 0;
    }
    batch->payload[1] = flags;
    put32(batch->payload + 4, time);
    batch->payload[8] = batch->count;
    put16(batch->payload + length, (uint16_t)temperature);
    batch->length = 0;
    batch->count = 0;
    return (uint8_t)(length + 2);
}

/* ---- JSON ---- */

typedef struct {
    uint8_t *payload;
    uint8_t length;
    uint8_t fits;
} writer;

static void put_char(writer *to, char c) {
    if (to->length < GYB_MAX_PAYLOAD) {
        to->payload[to->length++] = (uint8_t)c;
    } else {
        to->fits = 0;
    }
}

static void put_text(writer *to, const char *text) {
    while (*text) {
        put_char(to, *text++);
    }
}

/* A value that would end the string or is no printable ASCII shows as '?'. */
static void put_string(writer *to, const char *key, const char *text) {
    put_text(to, key);
    put_char(to, '"');
    for (; *text; text++) {
        put_char(to, *text < ' ' || *text > '~' || *text == '"' || *text == '\\' ? '?' : *text);
    }
    put_char(to, '"');
}

static void put_number(writer *to, const char *key, uint32_t number) {
    char digits[10];
    uint8_t count = 0;
    put_text(to, key);
    do {
        digits[count++] = (char)('0' + number % 10u);
        number /= 10u;
    } while (number);
    while (count) {
        put_char(to, digits[--count]);
    }
}

static void put_tenths(writer *to, const char *key, uint32_t tenths) {
    if (tenths) {
        put_number(to, key, tenths / 10u);
        if (tenths % 10u) {
            put_char(to, '.');
            put_char(to, (char)('0' + tenths % 10u));
        }
    }
}

static void put_hash(writer *to, const char *key, uint32_t hash) {
    uint8_t i;
    put_text(to, key);
    put_char(to, '"');
    for (i = 0; i < 8; i++) {
        put_char(to, "0123456789abcdef"[(hash >> (28 - 4 * i)) & 15u]);
    }
    put_char(to, '"');
}

static void put_sensor(writer *to, const gyb_sensor *sensor) {
    put_number(to, "{\"who\":", sensor->who);
    put_number(to, ",\"fs\":", sensor->full_scale);
    put_tenths(to, ",\"odr\":", sensor->rate_deci_hz);
    put_tenths(to, ",\"bw\":", sensor->bandwidth_deci_hz);
    put_text(to, ",\"lsb\":");
    put_text(to, sensor->per_count);
    if (*sensor->unit) {
        put_string(to, ",\"unit\":", sensor->unit);
    }
    put_char(to, '}');
}

static uint8_t write_hello(uint8_t *payload, const gyb_identity *identity, uint32_t config,
                           uint8_t sensors) {
    writer to;
    uint8_t i;
    to.payload = payload;
    to.length = 0;
    to.fits = 1;
    put_char(&to, GYB_HELLO);
    put_text(&to, "{\"proto\":1");
    put_string(&to, ",\"fw\":", identity->firmware);
    put_string(&to, ",\"board\":", identity->board);
    put_string(&to, ",\"uid\":", identity->uid);
    put_number(&to, ",\"boot\":", identity->boot);
    put_hash(&to, ",\"config\":", config);
    put_text(&to, ",\"sensors\":[");
    for (i = 0; i < sensors; i++) {
        if (i) {
            put_char(&to, ',');
        }
        put_sensor(&to, &identity->sensors[i]);
    }
    put_char(&to, ']');
    if (*identity->reset) {
        put_string(&to, ",\"reset\":", identity->reset);
    }
    put_char(&to, '}');
    return to.fits ? to.length : 0;
}

uint8_t gyb_pack_hello(uint8_t payload[GYB_MAX_PAYLOAD], const gyb_identity *identity,
                       uint32_t config) {
    uint8_t sensors =
        identity->sensor_count < GYB_MAX_SENSORS ? identity->sensor_count : GYB_MAX_SENSORS;
    uint8_t size;
    do {
        size = write_hello(payload, identity, config, sensors);
    } while (!size && sensors-- > 1); /* the gyro alone is better than silence */
    return size;
}

uint8_t gyb_pack_ack(uint8_t payload[GYB_MAX_PAYLOAD], const gyb_sensor *gyro, uint8_t batch,
                     uint8_t accel, uint32_t config) {
    writer to;
    to.payload = payload;
    to.length = 0;
    to.fits = 1;
    put_char(&to, GYB_ACK);
    put_hash(&to, "{\"config\":", config);
    put_tenths(&to, ",\"odr\":", gyro->rate_deci_hz);
    put_tenths(&to, ",\"bw\":", gyro->bandwidth_deci_hz);
    put_number(&to, ",\"fs\":", gyro->full_scale);
    put_number(&to, ",\"batch\":", batch);
    put_text(&to, accel ? ",\"accel\":true}" : ",\"accel\":false}");
    return to.fits ? to.length : 0;
}

typedef struct {
    const uint8_t *at;
    const uint8_t *end;
} reader;

static uint8_t take_char(reader *from, char c) {
    while (from->at < from->end && (*from->at == ' ' || *from->at == '\n')) {
        from->at++;
    }
    if (from->at < from->end && *from->at == (uint8_t)c) {
        from->at++;
        return 1;
    }
    return 0;
}

static uint8_t take_word(reader *from, const char *word) {
    uint8_t size = (uint8_t)strlen(word);
    take_char(from, ' '); /* passes spaces, takes none */
    if (from->end - from->at < size || memcmp(from->at, word, size) != 0) {
        return 0;
    }
    from->at += size;
    return 1;
}

static uint8_t is_digit(const reader *from) {
    return from->at < from->end && *from->at >= '0' && *from->at <= '9';
}

/* A number in tenths, cut after the first decimal; below 10^8. */
static uint8_t take_tenths(reader *from, uint32_t *tenths) {
    uint8_t digits = 0;
    uint32_t value = 0;
    take_char(from, ' ');
    for (; is_digit(from); from->at++) {
        if (++digits > 8) {
            return 0;
        }
        value = 10u * value + (uint32_t)(*from->at - '0');
    }
    value *= 10u;
    if (digits && from->at < from->end && *from->at == '.') {
        from->at++;
        if (is_digit(from)) {
            value += (uint32_t)(*from->at - '0');
        }
        while (is_digit(from)) {
            from->at++;
        }
    }
    *tenths = value;
    return digits != 0;
}

static uint8_t take_setting(reader *from, gyb_wanted *wanted) {
    uint32_t tenths = 0;
    if (take_word(from, "\"accel\"")) {
        uint8_t yes;
        if (!take_char(from, ':')) {
            return 0;
        }
        yes = take_word(from, "true");
        wanted->accel = (int8_t)yes;
        return yes || take_word(from, "false");
    }
    if (take_word(from, "\"odr\"")) {
        return take_char(from, ':') && take_tenths(from, &wanted->rate_deci_hz);
    }
    if (take_word(from, "\"bw\"")) {
        return take_char(from, ':') && take_tenths(from, &wanted->bandwidth_deci_hz);
    }
    if (take_word(from, "\"fs\"")) {
        if (!take_char(from, ':') || !take_tenths(from, &tenths)) {
            return 0;
        }
        wanted->full_scale_dps = tenths / 10u;
        return 1;
    }
    if (take_word(from, "\"batch\"")) {
        if (!take_char(from, ':') || !take_tenths(from, &tenths) || tenths > 2550u) {
            return 0;
        }
        wanted->batch = (uint8_t)(tenths / 10u);
        return 1;
    }
    return 0;
}

uint8_t gyb_read_set(const uint8_t *json, uint8_t size, gyb_wanted *wanted) {
    reader from;
    from.at = json;
    from.end = json + size;
    memset(wanted, 0, sizeof *wanted);
    wanted->accel = -1;
    if (!take_char(&from, '{')) {
        return 0;
    }
    if (!take_char(&from, '}')) {
        do {
            if (!take_setting(&from, wanted)) {
                return 0;
            }
        } while (take_char(&from, ','));
        if (!take_char(&from, '}')) {
            return 0;
        }
    }
    return from.at == from.end;
}

/* ---- the clock ---- */

static gyb_ticks now(gyb_board *board) {
    gyb_ticks time;
    time.low = board->port.clock(board->port.context);
    if (time.low < board->clock_last) {
        board->clock_high++;
    }
    board->clock_last = time.low;
    time.high = board->clock_high;
    return time;
}

/* The whole stamp of a half that was taken a little while ago. */
static gyb_ticks whole(gyb_board *board, uint32_t low) {
    gyb_ticks time = now(board);
    if (low > time.low && time.high) {
        time.high--;
    }
    time.low = low;
    return time;
}

static gyb_ticks at_first_byte(gyb_board *board) {
    gyb_ticks time = now(board);
    uint32_t before = time.low;
    time.low += board->transmit_lead;
    time.high += time.low < before;
    return time;
}

/* Marsaglia's 32-bit xorshift (J. Stat. Software 8(14), 2003): never 0. */
static uint32_t draw(gyb_board *board, uint32_t span) {
    uint32_t x = board->random;
    x ^= x << 13;
    x ^= x >> 17;
    x ^= x << 5;
    board->random = x;
    return x % span;
}

static void plan_clock(gyb_board *board, uint32_t from) {
    uint32_t period = board->clock_period;
    board->clock_due = from + period / 2u + draw(board, period ? period : 1u);
    board->clock_tries = 0;
}

/* A clock frame is due. */
static void want_clock(gyb_board *board, uint8_t which, uint32_t time) {
    if (!(board->pending & (PENDING_REPLY | PENDING_SLOW))) {
        board->clock_waits = time;
    }
    board->pending |= which;
}

/* ---- the queue ---- */

static uint8_t push(gyb_board *board, const uint8_t *payload, uint8_t size) {
    uint16_t at = (uint16_t)((board->queue_head + board->queue_used) % GYB_QUEUE_BYTES);
    uint8_t i;
    if ((uint32_t)board->queue_used + size + 1u > GYB_QUEUE_BYTES) {
        board->dropped++;
        return 0;
    }
    board->queue[at] = size;
    for (i = 0; i < size; i++) {
        at = (uint16_t)((at + 1u) % GYB_QUEUE_BYTES);
        board->queue[at] = payload[i];
    }
    board->queue_used = (uint16_t)(board->queue_used + size + 1u);
    return 1;
}

static uint8_t pull(gyb_board *board, uint8_t *payload) {
    uint16_t at = board->queue_head;
    uint8_t size = board->queue[at], i;
    for (i = 0; i < size; i++) {
        at = (uint16_t)((at + 1u) % GYB_QUEUE_BYTES);
        payload[i] = board->queue[at];
    }
    board->queue_head = (uint16_t)((at + 1u) % GYB_QUEUE_BYTES);
    board->queue_used = (uint16_t)(board->queue_used - size - 1u);
    return size;
}

static void push_samples(gyb_board *board, const uint8_t *payload, uint8_t size) {
    if (push(board, payload, size)) {
        board->flags &= (uint8_t)~(GYB_FRAMES_DROPPED | GYB_OVERRUN);
    } else {
        board->flags |= GYB_FRAMES_DROPPED;
    }
}

/* ---- the board ---- */

uint32_t gyb_config_hash(const gyb_board *board) {
    /* FNV-1a, 32 bits */
    uint32_t hash = 2166136261UL;
    uint8_t i, j;
    for (i = 0; i < board->identity.sensor_count && i < GYB_MAX_SENSORS; i++) {
        const gyb_sensor *sensor = &board->identity.sensors[i];
        uint8_t numbers[8];
        put16(numbers, sensor->who);
        put16(numbers + 2, sensor->full_scale);
        put16(numbers + 4, sensor->rate_deci_hz);
        put16(numbers + 6, sensor->bandwidth_deci_hz);
        for (j = 0; j < sizeof numbers; j++) {
            hash = (hash ^ numbers[j]) * 16777619UL;
        }
    }
    hash = (hash ^ board->batch_size) * 16777619UL;
    return ((hash ^ (board->accel ? 1u : 0u)) * 16777619UL) & 0xFFFFFFFFUL;
}

void gyb_begin(gyb_board *board, const gyb_identity *identity, const gyb_port *port,
               uint32_t seed) {
    memset(board, 0, sizeof *board);
    board->identity = *identity;
    board->port = *port;
    board->accel = 1;
    board->air_decidegc = GYB_NO_AIR;
    board->clock_period = 100000UL;
    board->batch_size = 1;
    board->random = seed ? seed : 1u;
    board->pending = PENDING_HELLO;
    plan_clock(board, now(board).low);
}

static void flush_batch(gyb_board *board, uint8_t flags, uint32_t time, int16_t temperature) {
    uint8_t size = gyb_batch_end(&board->batch, flags, time, temperature);
    if (size) {
        push_samples(board, board->batch.payload, size);
    }
}

/* End a batch before its time, with what its last sample left in its head. */
static void cut_batch(gyb_board *board) {
    if (board->batch.count) {
        const uint8_t *head = board->batch.payload;
        uint32_t time = head[4] | ((uint32_t)head[5] << 8) | ((uint32_t)head[6] << 16) |
                        ((uint32_t)head[7] << 24);
        flush_batch(board, head[1], time, board->batch_temperature);
    }
    board->batch.length = 0;
}

static void take_into_batch(gyb_board *board, const gyb_sample *sample) {
    gyb_batch *batch = &board->batch;
    uint8_t flags = sample->flags;
    if (batch->count) {
        uint8_t before = batch->payload[1];
        if (((before ^ flags) & OF_EACH_BATCH) || batch->axes != (board->accel ? 6 : 3)) {
            cut_batch(board);
        } else {
            flags = (uint8_t)(flags | (before & GYB_SATURATED));
        }
    }
    if (!batch->length) {
        gyb_batch_begin(batch, sample->sequence, board->accel ? 6 : 3);
    }
    gyb_batch_add(batch, sample->gyro, sample->accel);
    batch->payload[1] = flags;
    put32(batch->payload + 4, sample->time);
    board->batch_temperature = sample->temperature;
    if (batch->count >= board->batch_size ||
        (uint16_t)batch->length + 2u * batch->axes + 2u > GYB_BATCH_BYTES) {
        flush_batch(board, flags, sample->time, sample->temperature);
    }
}

void gyb_take(gyb_board *board, uint32_t time, uint8_t flags, const int16_t gyro[3],
              const int16_t accel[3], int16_t temperature) {
    gyb_sample sample;
    sample.flags = (uint8_t)(flags | board->flags);
    sample.sequence = (uint16_t)(board->sequence++ & 0xFFFFu);
    sample.time = time;
    memcpy(sample.gyro, gyro, sizeof sample.gyro);
    if (board->accel) {
        memcpy(sample.accel, accel, sizeof sample.accel);
    } else {
        memset(sample.accel, 0, sizeof sample.accel);
    }
    sample.temperature = temperature;
    board->saturations += (flags & GYB_SATURATED) != 0;
    if (board->batch_size > 1) {
        take_into_batch(board, &sample);
    } else {
        uint8_t payload[GYB_SAMPLE_BYTES];
        push_samples(board, payload, gyb_pack_sample(payload, &sample));
    }
}

void gyb_lost(gyb_board *board, uint32_t count) {
    if (count) {
        cut_batch(board); /* numbers within a batch have no gap */
        board->sequence += count;
        board->overruns += count;
        board->flags |= GYB_OVERRUN;
    }
}

void gyb_edge(gyb_board *board, uint32_t time, uint8_t input, uint8_t rising) {
    uint8_t payload[GYB_EDGE_BYTES];
    push(board, payload, gyb_pack_edge(payload, whole(board, time), input, rising));
}

void gyb_set_batch(gyb_board *board, uint8_t samples) {
    cut_batch(board);
    board->batch_size = samples ? samples : 1;
    if (board->batch_size > 1) {
        uint8_t most = (uint8_t)((GYB_BATCH_BYTES - BATCH_HEAD_BYTES - 2) / (board->accel ? 12 : 6));
        if (board->batch_size > most) {
            board->batch_size = most;
        }
    }
}

static void take_set(gyb_board *board, const uint8_t *json, uint8_t size) {
    gyb_wanted wanted;
    uint32_t before = gyb_config_hash(board);
    if (!gyb_read_set(json, size, &wanted)) {
        board->receive_faults++;
        return;
    }
    cut_batch(board);
    if (board->port.configure) {
        board->port.configure(board->port.context, board, &wanted);
    }
    if (gyb_config_hash(board) != before) {
        board->flags |= GYB_CONFIGURATION_CHANGED; /* from here to the next start */
    }
    board->pending |= PENDING_ACK;
}

static void take_frame(gyb_board *board, const uint8_t *payload, uint8_t size, uint32_t time) {
    if (size == 1 && payload[0] == GYB_HELLO) {
        board->pending |= PENDING_HELLO;
    } else if (size == TIME_REQUEST_BYTES && payload[0] == GYB_TIME_REQUEST) {
        /* of two at once the later is answered: the host knows its questions by nonce */
        memcpy(board->ping, payload + 1, sizeof board->ping);
        board->ping_received = whole(board, time);
        want_clock(board, PENDING_REPLY, now(board).low);
    } else if (payload[0] == GYB_SET) {
        take_set(board, payload + 1, (uint8_t)(size - 1));
    } else {
        board->receive_faults++;
    }
}

void gyb_receive(gyb_board *board, const uint8_t *data, uint8_t size, uint32_t time) {
    uint8_t i;
    for (i = 0; i < size; i++) {
        if (data[i]) {
            if (board->received_length < GYB_RECEIVE_BYTES) {
                board->received[board->received_length++] = data[i];
            } else {
                board->receive_overlong = 1;
            }
            continue;
        }
        if (board->received_length) {
            uint8_t length = 0;
            if (!board->receive_overlong) {
                length = gyb_unstuff(board->received, board->received_length);
            }
            if (length) {
                take_frame(board, board->received + 1, length, time);
            } else {
                board->receive_faults++;
            }
        }
        board->received_length = 0;
        board->receive_overlong = 0;
    }
}

static uint8_t write_slow(gyb_board *board, uint8_t *payload) {
    gyb_slow slow;
    slow.boot = board->identity.boot;
    slow.sequence = board->sequence;
    slow.overruns = board->overruns;
    slow.dropped = board->dropped;
    slow.bus_errors = board->bus_errors;
    slow.saturations = board->saturations;
    slow.temperature = board->temperature;
    slow.air_decidegc = board->air_decidegc;
    slow.supply_mv = board->supply_mv;
    slow.time = at_first_byte(board);
    return gyb_pack_slow(payload, &slow);
}

/* Write the payload whose turn it is; return its length, 0 for none. */
static uint8_t next_payload(gyb_board *board, uint8_t *payload) {
    if (board->pending & (PENDING_REPLY | PENDING_SLOW)) {
        if (board->port.unsent(board->port.context)) {
            /* its stamp would not be that of its first byte */
            if (!board->never_empty &&
                (uint32_t)(now(board).low - board->clock_waits) < PATIENCE) {
                return 0;
            }
            /* samples without a clock are better than silence */
            board->never_empty = 1;
            board->pending &= (uint8_t)~(PENDING_REPLY | PENDING_SLOW);
            return next_payload(board, payload);
        }
        board->never_empty = 0;
        if (board->pending & PENDING_REPLY) {
            board->pending &= (uint8_t)~PENDING_REPLY;
            return gyb_pack_time_reply(payload, board->ping, board->ping_received,
                                       at_first_byte(board));
        }
        board->pending &= (uint8_t)~PENDING_SLOW;
        return write_slow(board, payload);
    }
    if (board->pending & PENDING_ACK) {
        board->pending &= (uint8_t)~PENDING_ACK;
        return gyb_pack_ack(payload, &board->identity.sensors[0], board->batch_size,
                            board->accel, gyb_config_hash(board));
    }
    if (board->pending & PENDING_HELLO) {
        board->pending &= (uint8_t)~PENDING_HELLO;
        return gyb_pack_hello(payload, &board->identity, gyb_config_hash(board));
    }
    return board->queue_used ? pull(board, payload) : 0;
}

static void look_at_clock(gyb_board *board) {
    uint32_t time = now(board).low;
    uint8_t busy;
    if (!board->clock_period || (board->pending & PENDING_SLOW) ||
        (uint32_t)(time - board->clock_due) >= 0x80000000UL) {
        return;
    }
    busy = board->wire_sent < board->wire_length || board->queue_used ||
           board->port.unsent(board->port.context);
    if (busy && board->clock_tries < REDRAWS) {
        board->clock_tries++;
        board->clock_due = time + draw(board, REDRAW_SPAN);
        return;
    }
    want_clock(board, PENDING_SLOW, time);
    plan_clock(board, time);
}

void gyb_poll(gyb_board *board) {
    look_at_clock(board);
    if (board->wire_sent == board->wire_length) {
        board->wire_sent = 0;
        board->wire_length = gyb_seal(board->wire, next_payload(board, board->wire + GYB_PAYLOAD_AT));
    }
    if (board->wire_sent < board->wire_length) {
        uint8_t left = (uint8_t)(board->wire_length - board->wire_sent);
        uint8_t taken =
            board->port.write(board->port.context, board->wire + board->wire_sent, left);
        board->wire_sent = (uint8_t)(board->wire_sent + (taken < left ? taken : left));
    }
}
