/* The tracker's output: its commands and its diagnostics, as in the DBC. */
#ifndef OUTGOING_H
#define OUTGOING_H

#include <stdbool.h>
#include <stdint.h>

#include "control.h"

#define CYCLE_MS 10u

/* The DBC's value tables of State, and of CommandState and ReferenceState. */
enum ecu_state { STATE_INIT = 0, STATE_RUN = 1, STATE_DEGRADED = 2, STATE_SAFE = 3, STATE_WAIT = 4 };
enum worth { WORTH_NONE = 0, WORTH_VALID = 1, WORTH_DEGRADED = 2 };

/* The DBC's value table of an input's reception state. */
enum reception {
    RECEPTION_INIT = 0,
    RECEPTION_OK = 1,
    RECEPTION_MISSING = 2,
    RECEPTION_REPEATED = 3,
    RECEPTION_WRONG_SEQUENCE = 4,
    RECEPTION_ERROR = 5,
    RECEPTION_LOST = 6,
};

/* The receiver's state in TrackerBusHealth. */
struct health {
    unsigned errors; /* frames discarded so far */
    enum reception motion, reference;
};

/* The socket, the cycle whose number the alive counters contain, and whether the wall clock paces the cycles. */
struct outgoing {
    int socket;
    uint32_t cycle;
    bool realtime;
};

/* Prints the error (errno) to standard error and exits with code 1. */
_Noreturn void fail(const char *what);

/* The E2E data id of a message; 0 if it is not protected. */
uint16_t data_id_of(uint32_t id);

/* The time without a valid frame (ms) after which a protected message is lost. */
unsigned timeout_of(uint32_t id);

/* The three commands, with E2E protection. */
void send_commands(struct outgoing out, struct command command, enum worth worth);

/* TrackerStatus alone. */
void send_status(struct outgoing out, enum ecu_state state);

/* The diagnostics that are due in this cycle, with the time of the step; those without content are not sent. */
void send_diagnostics(struct outgoing out, enum ecu_state state, struct health health, int64_t step_us);

#endif
