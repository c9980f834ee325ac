/* See e2e.h. */
#include "e2e.h"

#define POLYNOMIAL 0x1Du
#define COUNTER_MASK 0x0Fu

static uint8_t crc_add(uint8_t crc, uint8_t byte) {
    crc ^= byte;
    for (int bit = 0; bit < 8; bit++) {
        unsigned shifted = (unsigned)crc << 1;
        crc = (uint8_t)((crc & 0x80u) ? shifted ^ POLYNOMIAL : shifted);
    }
    return crc;
}

static uint8_t crc_of(const uint8_t *data, size_t length, uint16_t data_id) {
    uint8_t crc = crc_add(crc_add(0, (uint8_t)(data_id & 0xFFu)), (uint8_t)(data_id >> 8));
    for (size_t i = 1; i < length; i++) {
        crc = crc_add(crc, data[i]);
    }
    return crc;
}

void e2e_receiver_init(struct e2e_receiver *receiver, uint16_t data_id) {
    *receiver = (struct e2e_receiver){.data_id = data_id, .counter = -1, .allowed = 1};
}

void e2e_protect(uint8_t *data, size_t length, uint16_t data_id, unsigned counter) {
    data[1] = (uint8_t)((data[1] & ~COUNTER_MASK) | counter % E2E_COUNTER_MODULUS);
    data[0] = crc_of(data, length, data_id);
}

enum e2e_status e2e_check(struct e2e_receiver *receiver, const uint8_t *data, size_t length) {
    if (length < 2 || (data[1] & COUNTER_MASK) >= E2E_COUNTER_MODULUS || data[0] != crc_of(data, length, receiver->data_id)) {
        return E2E_ERROR;
    }
    int previous = receiver->counter;
    receiver->counter = (int)(data[1] & COUNTER_MASK);
    if (previous < 0) {
        return E2E_OK;
    }
    unsigned step = (unsigned)(receiver->counter - previous + (int)E2E_COUNTER_MODULUS) % E2E_COUNTER_MODULUS;
    if (step == 0) {
        return E2E_REPEATED;
    }
    unsigned allowed = receiver->allowed;
    receiver->allowed = 1;
    return step <= allowed ? E2E_OK : E2E_WRONG_SEQUENCE;
}

void e2e_missed(struct e2e_receiver *receiver) {
    if (receiver->allowed < E2E_COUNTER_MODULUS - 1) {
        receiver->allowed++;
    }
}
