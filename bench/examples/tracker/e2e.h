/* AUTOSAR E2E Profile 1, variant DATAID_BOTH: CRC and alive counter of a message.
 *
 * AUTOSAR Foundation, "E2E Protocol Specification" (PRS_E2EProtocol), Profile 1: byte 0 holds the CRC, the low nibble of
 * byte 1 the counter 0 to 14. The CRC is the CRC-8 of SAE J1850 (polynomial 0x1D, start and final value 0 here) over the
 * data id's low byte, its high byte and then bytes 1, 2, ... of the message.
 */
#ifndef E2E_H
#define E2E_H

#include <stddef.h>
#include <stdint.h>

#define E2E_COUNTER_MODULUS 15u

enum e2e_status { E2E_OK, E2E_REPEATED, E2E_WRONG_SEQUENCE, E2E_ERROR };

/* A receiver's state of one message. `counter` is that of the newest frame, -1 before the first; `allowed` is the largest
 * increment of the next one. */
struct e2e_receiver {
    uint16_t data_id;
    int counter;
    unsigned allowed;
};

void e2e_receiver_init(struct e2e_receiver *receiver, uint16_t data_id);

/* Writes counter (modulo 15) and CRC into a message of at least 2 bytes. */
void e2e_protect(uint8_t *data, size_t length, uint16_t data_id, unsigned counter);

/* Checks a frame; only frames that are E2E_OK may be used. */
enum e2e_status e2e_check(struct e2e_receiver *receiver, const uint8_t *data, size_t length);

/* Call this for every cycle without a valid frame, so that the next one is not out of sequence. */
void e2e_missed(struct e2e_receiver *receiver);

#endif
