/* A custom tracker in C, on SocketCAN: tracker vcan1 drives vehicle 1.
 *
 * platoon run --can vcan --without veh1.tracker
 *
 * What a participant must do, all of it in dbc/vehicle.dbc:
 * - Until its first BenchSync it sends its status with State Wait every 100 ms, so that the bench detects it.
 * - BenchSync opens a cycle. In virtual time (Run) it waits for all its inputs of that cycle, identified by
 *   their alive counter, which is the cycle modulo 15; in real time (RunRealtime) for at most INPUT_WAIT_MS.
 * - BenchAbsent announces, in virtual time, a frame that will not arrive in this cycle. If all its commands are announced,
 *   the others have continued without the tracker, and it skips the cycle.
 * - It answers with its three commands, whose counter is the cycle modulo 15, and with the diagnostics that are due; in
 *   virtual time it announces those that it does not send with BenchAbsent.
 * - It ends on BenchSync with Stop.
 * - Anybody can send anything: it follows a BenchSync only if that is consistent and its cycle follows.
 */
#include <errno.h>
#include <linux/can.h>
#include <linux/can/raw.h>
#include <net/if.h>
#include <poll.h>
#include <stdbool.h>
#include <stdio.h>
#include <stdint.h>
#include <stdlib.h>
#include <string.h>
#include <sys/socket.h>
#include <time.h>
#include <unistd.h>

#include "control.h"
#include "e2e.h"
#include "outgoing.h"
#include "vehicle.h"

#define WAIT_PERIOD_MS 100 /* between two signs of life before the first BenchSync */
#define INPUT_WAIT_MS 5    /* in real time, for the inputs after BenchSync */
#define SILENCE_MS 10000   /* without a new cycle once the bench runs: it is gone */
#define STOP_LAG 2         /* in real time, cycles by which the conductor may be behind with Stop */
#define AHEAD_CYCLES 100   /* in real time, by which BenchSync may be ahead of the clock, which began with the first */
#define LARGEST_TIME 0xFFFFFFu
#define MOST_FRAMES 1000 /* taken before a step, however many more there are */

/* The DBC's value table of Command. */
enum sync_command { SYNC_STOP = 0, SYNC_RUN = 1, SYNC_RUN_REALTIME = 2 };
enum { MOTION, REFERENCE, INPUTS };

/* A received message, and its state in this cycle. */
struct input {
    uint32_t id;
    uint8_t length;
    struct e2e_receiver receiver;
    bool fresh;      /* a valid frame waits for its step */
    bool settled;    /* no more frames are due in this cycle */
    unsigned age_ms; /* since the last valid frame */
    unsigned timeout_ms;
    enum reception refused; /* why the newest frame since the last step was discarded; RECEPTION_OK if none was */
    enum reception reception;
    uint8_t data[CAN_MAX_DLEN];
};

struct tracker {
    int socket;
    struct input inputs[INPUTS];
    struct e2e_receiver sync, absent;
    bool heard;   /* a BenchSync has arrived */
    bool certain; /* it was cycle 0, or the next has followed */
    bool open;    /* the cycle waits for its step */
    bool realtime;
    uint32_t cycle;
    uint32_t ahead;     /* in virtual time, of a BenchSync beyond the next: some were lost, or it is false; 0 if none */
    unsigned announced; /* which of its commands are announced as absent in this cycle, a bit each */
    int64_t opened_ms;
    bool has_reference;
    struct motion reference;
    unsigned held_ms;        /* since the last used reference */
    unsigned errors;         /* frames discarded */
    unsigned errors_at_sync; /* the same at the newest BenchSync, reported in this cycle */
};

static int64_t now_ms(void) {
    struct timespec now;
    clock_gettime(CLOCK_MONOTONIC, &now);
    return (int64_t)now.tv_sec * 1000 + now.tv_nsec / 1000000;
}

static int64_t now_us(void) {
    struct timespec now;
    clock_gettime(CLOCK_MONOTONIC, &now);
    return (int64_t)now.tv_sec * 1000000 + now.tv_nsec / 1000;
}

/* --- one cycle --- */

/* Takes the reference; returns its resulting state. */
static enum ecu_state take_reference(struct tracker *tracker) {
    const struct input *input = &tracker->inputs[REFERENCE];
    if (input->fresh) {
        struct vehicle_reference_t frame;
        vehicle_reference_unpack(&frame, input->data, VEHICLE_REFERENCE_LENGTH);
        if (frame.reference_state != WORTH_NONE) {
            tracker->has_reference = true;
            tracker->held_ms = 0;
            tracker->reference.v_x = vehicle_reference_velocity_x_decode(frame.velocity_x);
            tracker->reference.yaw_rate = vehicle_reference_yaw_rate_decode(frame.yaw_rate);
            return frame.reference_state == WORTH_VALID ? STATE_RUN : STATE_DEGRADED;
        }
    }
    if (!tracker->has_reference) {
        return STATE_INIT;
    }
    /* Missing, or with state None: the last one is used until the DBC's timeout. */
    tracker->held_ms += CYCLE_MS;
    return tracker->held_ms >= input->timeout_ms ? STATE_SAFE : STATE_DEGRADED;
}

/* Updates the reception state of each input. */
static void age_inputs(struct tracker *tracker) {
    for (int i = 0; i < INPUTS; i++) {
        struct input *input = &tracker->inputs[i];
        if (input->fresh) {
            input->age_ms = 0;
            input->reception = RECEPTION_OK;
        } else {
            e2e_missed(&input->receiver);
            input->age_ms += CYCLE_MS;
            if (input->age_ms >= input->timeout_ms) {
                input->reception = RECEPTION_LOST;
            } else if (input->refused != RECEPTION_OK) {
                input->reception = input->refused;
            } else if (input->reception != RECEPTION_INIT) {
                input->reception = RECEPTION_MISSING;
            }
        }
        input->refused = RECEPTION_OK;
    }
}

static void end_cycle(struct tracker *tracker) {
    for (int i = 0; i < INPUTS; i++) {
        tracker->inputs[i].fresh = tracker->inputs[i].settled = false;
    }
    tracker->open = false;
}

/* Skips a cycle that the others have completed without this ECU. */
static void skip_cycle(struct tracker *tracker) {
    age_inputs(tracker);
    end_cycle(tracker);
}

static void step(struct tracker *tracker) {
    int64_t begun_us = now_us();
    age_inputs(tracker);
    enum ecu_state state = take_reference(tracker);
    struct command command = {0};
    enum worth worth = WORTH_NONE;
    if (!tracker->inputs[MOTION].fresh && state != STATE_INIT) {
        /* Without the vehicle's motion there is no command: the actuators hold, then go to their safe state. */
        state = STATE_SAFE;
    }
    if (state == STATE_RUN || state == STATE_DEGRADED) {
        struct vehicle_vehicle_motion_t frame;
        vehicle_vehicle_motion_unpack(&frame, tracker->inputs[MOTION].data, VEHICLE_VEHICLE_MOTION_LENGTH);
        struct motion motion = {
            .v_x = vehicle_vehicle_motion_velocity_x_decode(frame.velocity_x),
            .yaw_rate = vehicle_vehicle_motion_yaw_rate_decode(frame.yaw_rate),
        };
        command = control(motion, tracker->reference);
        worth = state == STATE_RUN ? WORTH_VALID : WORTH_DEGRADED;
    }
    struct outgoing out = {tracker->socket, tracker->cycle, tracker->realtime};
    send_commands(out, command, worth);
    struct health health = {
        .errors = tracker->errors_at_sync,
        .motion = tracker->inputs[MOTION].reception,
        .reference = tracker->inputs[REFERENCE].reception,
    };
    send_diagnostics(out, state, health, now_us() - begun_us);
    end_cycle(tracker);
}

/* --- receiving --- */

/* Whether the counter and time of a BenchSync are those of its cycle. */
static bool is_consistent(const struct vehicle_bench_sync_t *sync) {
    uint32_t time_ms = sync->cycle < LARGEST_TIME / CYCLE_MS ? sync->cycle * CYCLE_MS : LARGEST_TIME;
    return sync->alive_counter == sync->cycle % E2E_COUNTER_MODULUS && sync->time == time_ms;
}

/* Whether the cycle of a consistent BenchSync follows those before. In virtual time one beyond the next does if it is
 * the second in a row: while this process was stopped, its receive queue may have overflowed. */
static bool follows(const struct tracker *tracker, const struct vehicle_bench_sync_t *sync) {
    if (!tracker->certain) {
        return sync->command != SYNC_STOP && !(tracker->heard && sync->cycle == tracker->cycle);
    }
    uint32_t next = tracker->cycle + 1;
    if (sync->command == SYNC_STOP) {
        return sync->cycle > 0 && sync->cycle <= next && next - sync->cycle <= (tracker->realtime ? STOP_LAG : 0);
    }
    if ((sync->command == SYNC_RUN_REALTIME) != tracker->realtime) {
        return false;
    }
    if (!tracker->realtime) {
        return sync->cycle == next || (tracker->ahead > 0 && sync->cycle == tracker->ahead + 1);
    }
    return sync->cycle >= next && sync->cycle <= next + AHEAD_CYCLES + (now_ms() - tracker->opened_ms) / CYCLE_MS;
}

/* Takes a BenchSync; whether it is Stop. */
static bool take_sync(struct tracker *tracker, const struct can_frame *frame) {
    struct vehicle_bench_sync_t sync;
    size_t length = frame->can_dlc == VEHICLE_BENCH_SYNC_LENGTH ? frame->can_dlc : 0;
    /* Its cycle tells more than its counter. */
    bool whole = e2e_check(&tracker->sync, frame->data, length) != E2E_ERROR;
    if (!whole || vehicle_bench_sync_unpack(&sync, frame->data, frame->can_dlc) != 0 || !is_consistent(&sync)) {
        tracker->errors++;
        return false;
    }
    if (!follows(tracker, &sync)) {
        tracker->errors++;
        tracker->ahead = sync.command == SYNC_RUN && sync.cycle > tracker->cycle ? sync.cycle : 0;
        return false;
    }
    if (sync.command == SYNC_STOP) {
        return true;
    }
    if (tracker->open) {
        /* Only in real time, or if the others have continued without this ECU: the awaited cycle is over. */
        skip_cycle(tracker);
    }
    tracker->certain = tracker->certain || sync.cycle == 0 || (tracker->heard && sync.cycle == tracker->cycle + 1);
    tracker->heard = tracker->open = true;
    tracker->announced = 0;
    tracker->errors_at_sync = tracker->errors;
    tracker->realtime = sync.command == SYNC_RUN_REALTIME;
    tracker->cycle = sync.cycle;
    tracker->ahead = 0;
    tracker->opened_ms = now_ms();
    return false;
}

static void take_absent(struct tracker *tracker, const struct can_frame *frame) {
    static const uint32_t commands[] = {
        VEHICLE_STEERING_COMMAND_FRAME_ID,
        VEHICLE_TORQUE_COMMAND_FRONT_FRAME_ID,
        VEHICLE_TORQUE_COMMAND_REAR_FRAME_ID,
    };
    enum { COMMANDS = sizeof commands / sizeof commands[0] };
    if (tracker->realtime || frame->can_dlc != VEHICLE_BENCH_ABSENT_LENGTH ||
        e2e_check(&tracker->absent, frame->data, frame->can_dlc) == E2E_ERROR) {
        tracker->errors++;
        return;
    }
    struct vehicle_bench_absent_t absent;
    vehicle_bench_absent_unpack(&absent, frame->data, frame->can_dlc);
    if (!tracker->open || absent.cycle != tracker->cycle) {
        return;
    }
    for (unsigned i = 0; i < COMMANDS; i++) {
        tracker->announced |= absent.identifier == commands[i] ? 1u << i : 0u;
    }
    if (tracker->announced == (1u << COMMANDS) - 1u) {
        skip_cycle(tracker);
    }
    for (int i = 0; i < INPUTS; i++) {
        tracker->inputs[i].settled |= tracker->inputs[i].id == absent.identifier;
    }
}

static void take_input(struct tracker *tracker, struct input *input, const struct can_frame *frame) {
    size_t length = frame->can_dlc == input->length ? frame->can_dlc : 0;
    enum e2e_status status = e2e_check(&input->receiver, frame->data, length);
    bool of_this_cycle = tracker->open && input->receiver.counter == (int)(tracker->cycle % E2E_COUNTER_MODULUS);
    if (status == E2E_OK && !of_this_cycle) {
        /* Late by whole cycles counts as out of sequence. */
        status = E2E_WRONG_SEQUENCE;
    }
    if (status != E2E_OK) {
        static const enum reception refused[] = {
            [E2E_REPEATED] = RECEPTION_REPEATED,
            [E2E_WRONG_SEQUENCE] = RECEPTION_WRONG_SEQUENCE,
            [E2E_ERROR] = RECEPTION_ERROR,
        };
        tracker->errors++;
        input->refused = refused[status];
    }
    if ((status == E2E_OK || status == E2E_WRONG_SEQUENCE) && of_this_cycle) {
        input->settled = true;
        input->fresh = status == E2E_OK;
        memcpy(input->data, frame->data, length);
    }
}

static bool is_complete(const struct tracker *tracker) {
    for (int i = 0; i < INPUTS; i++) {
        if (!tracker->inputs[i].settled) {
            return false;
        }
    }
    return true;
}

/* Takes one frame; returns whether the bench has stopped. */
static bool take(struct tracker *tracker, const struct can_frame *frame) {
    if (frame->can_id == VEHICLE_BENCH_SYNC_FRAME_ID) {
        return take_sync(tracker, frame);
    }
    if (frame->can_id == VEHICLE_BENCH_ABSENT_FRAME_ID) {
        take_absent(tracker, frame);
    }
    for (int i = 0; i < INPUTS; i++) {
        if (frame->can_id == tracker->inputs[i].id) {
            take_input(tracker, &tracker->inputs[i], frame);
        }
    }
    return false;
}

/* Takes all arrived frames before any step, since the awaited cycle may be over. Returns whether the bench has stopped. */
static bool take_all(struct tracker *tracker) {
    struct can_frame frame;
    ssize_t got = 0;
    for (int i = 0; i < MOST_FRAMES; i++) {
        got = recv(tracker->socket, &frame, sizeof frame, MSG_DONTWAIT);
        if (got != (ssize_t)sizeof frame) {
            break;
        }
        if (take(tracker, &frame)) {
            return true;
        }
    }
    if (got < 0 && errno != EAGAIN && errno != EINTR) {
        fail("no frames can be received");
    }
    return false;
}

static int wait_ms(const struct tracker *tracker) {
    if (!tracker->certain) {
        return WAIT_PERIOD_MS;
    }
    if (!tracker->open || !tracker->realtime) {
        return SILENCE_MS;
    }
    int64_t left = tracker->opened_ms + INPUT_WAIT_MS - now_ms();
    return left > 0 ? (int)left : 0;
}

/* Runs until the bench stops; returns the exit code. */
static int serve(struct tracker *tracker) {
    struct pollfd waiting = {.fd = tracker->socket, .events = POLLIN};
    int64_t next_sign_ms = 0;
    for (;;) {
        if (!tracker->certain && now_ms() >= next_sign_ms) {
            send_status((struct outgoing){.socket = tracker->socket}, STATE_WAIT);
            next_sign_ms = now_ms() + WAIT_PERIOD_MS;
        }
        int count = poll(&waiting, 1, wait_ms(tracker));
        if (count < 0 && errno != EINTR) {
            fail("waiting for frames");
        }
        if (count > 0 && take_all(tracker)) {
            return 0;
        }
        if (tracker->certain && now_ms() - tracker->opened_ms >= SILENCE_MS) {
            fprintf(stderr, "tracker: no new cycle for %d s; is the bench still running?\n", SILENCE_MS / 1000);
            return 1;
        }
        bool waited = tracker->realtime && tracker->certain && now_ms() - tracker->opened_ms >= INPUT_WAIT_MS;
        if (tracker->open && (is_complete(tracker) || waited)) {
            step(tracker);
        }
    }
}

static void init_input(struct input *input, uint32_t id, uint8_t length) {
    *input = (struct input){.id = id, .length = length, .timeout_ms = timeout_of(id), .refused = RECEPTION_OK};
    e2e_receiver_init(&input->receiver, data_id_of(id));
}

static int open_link(const char *link) {
    int can = socket(PF_CAN, SOCK_RAW, CAN_RAW);
    if (can < 0) {
        fail("this kernel has no SocketCAN");
    }
    struct sockaddr_can address = {.can_family = AF_CAN, .can_ifindex = (int)if_nametoindex(link)};
    if (address.can_ifindex == 0) {
        fprintf(stderr, "tracker: there is no CAN link %s; `ip link show` lists the existing ones\n", link);
        exit(1);
    }
    const struct can_filter wanted[] = {
        {VEHICLE_BENCH_SYNC_FRAME_ID, CAN_SFF_MASK | CAN_EFF_FLAG | CAN_RTR_FLAG},
        {VEHICLE_BENCH_ABSENT_FRAME_ID, CAN_SFF_MASK | CAN_EFF_FLAG | CAN_RTR_FLAG},
        {VEHICLE_VEHICLE_MOTION_FRAME_ID, CAN_SFF_MASK | CAN_EFF_FLAG | CAN_RTR_FLAG},
        {VEHICLE_REFERENCE_FRAME_ID, CAN_SFF_MASK | CAN_EFF_FLAG | CAN_RTR_FLAG},
    };
    if (setsockopt(can, SOL_CAN_RAW, CAN_RAW_FILTER, wanted, sizeof wanted) < 0 ||
        bind(can, (struct sockaddr *)&address, sizeof address) < 0) {
        fail(link);
    }
    return can;
}

int main(int argc, char **argv) {
    if (argc != 2) {
        fprintf(stderr, "usage: tracker LINK    e.g. tracker vcan1 for vehicle 1\n");
        return 2;
    }
    struct tracker tracker = {.socket = open_link(argv[1])};
    init_input(&tracker.inputs[MOTION], VEHICLE_VEHICLE_MOTION_FRAME_ID, VEHICLE_VEHICLE_MOTION_LENGTH);
    init_input(&tracker.inputs[REFERENCE], VEHICLE_REFERENCE_FRAME_ID, VEHICLE_REFERENCE_LENGTH);
    e2e_receiver_init(&tracker.sync, data_id_of(VEHICLE_BENCH_SYNC_FRAME_ID));
    e2e_receiver_init(&tracker.absent, data_id_of(VEHICLE_BENCH_ABSENT_FRAME_ID));
    fprintf(stderr, "tracker listens on %s\n", argv[1]);
    int code = serve(&tracker);
    close(tracker.socket);
    return code;
}
