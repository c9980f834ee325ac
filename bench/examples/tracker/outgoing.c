/* See outgoing.h. */
#include "outgoing.h"

#include <errno.h>
#include <linux/can.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>
#include <unistd.h>

#include "e2e.h"
#include "messages.h"
#include "vehicle.h"

#define DEFAULT_TIMEOUT_MS 100u /* where the DBC has none */
#define LONGEST_US 1048575      /* end of the range of StepTime */

void fail(const char *what) {
    fprintf(stderr, "tracker: %s: %s\n", what, strerror(errno));
    exit(1);
}

uint16_t data_id_of(uint32_t id) {
    switch (id) {
#define X(can_id, length, data_id, timeout_ms) \
    case can_id: return data_id;
        PROTECTED_MESSAGES(X)
#undef X
        default: return 0;
    }
}

unsigned timeout_of(uint32_t id) {
    unsigned timeout = 0;
    switch (id) {
#define X(can_id, length, data_id, timeout_ms) \
    case can_id: timeout = timeout_ms; break;
        PROTECTED_MESSAGES(X)
#undef X
        default: break;
    }
    return timeout > 0 ? timeout : DEFAULT_TIMEOUT_MS;
}

static void send_frame(struct outgoing out, uint32_t id, const uint8_t *data, uint8_t length) {
    struct can_frame frame = {.can_id = id, .can_dlc = length};
    memcpy(frame.data, data, length);
    if (write(out.socket, &frame, sizeof frame) != (ssize_t)sizeof frame) {
        fail("a frame cannot be sent");
    }
}

static void send_protected(struct outgoing out, uint32_t id, uint8_t *data, uint8_t length) {
    e2e_protect(data, length, data_id_of(id), out.cycle);
    send_frame(out, id, data, length);
}

void send_commands(struct outgoing out, struct command command, enum worth worth) {
    uint8_t data[CAN_MAX_DLEN];
    struct vehicle_steering_command_t steering = {
        .steering_angle = vehicle_steering_command_steering_angle_encode(command.steering_angle),
        .command_state = (uint8_t)worth,
    };
    vehicle_steering_command_pack(data, &steering, sizeof data);
    send_protected(out, VEHICLE_STEERING_COMMAND_FRAME_ID, data, VEHICLE_STEERING_COMMAND_LENGTH);

    struct vehicle_torque_command_front_t front = {
        .torque_fl = vehicle_torque_command_front_torque_fl_encode(command.wheel_torque),
        .torque_fr = vehicle_torque_command_front_torque_fr_encode(command.wheel_torque),
    };
    vehicle_torque_command_front_pack(data, &front, sizeof data);
    send_protected(out, VEHICLE_TORQUE_COMMAND_FRONT_FRAME_ID, data, VEHICLE_TORQUE_COMMAND_FRONT_LENGTH);

    struct vehicle_torque_command_rear_t rear = {
        .torque_rl = vehicle_torque_command_rear_torque_rl_encode(command.wheel_torque),
        .torque_rr = vehicle_torque_command_rear_torque_rr_encode(command.wheel_torque),
    };
    vehicle_torque_command_rear_pack(data, &rear, sizeof data);
    send_protected(out, VEHICLE_TORQUE_COMMAND_REAR_FRAME_ID, data, VEHICLE_TORQUE_COMMAND_REAR_LENGTH);
}

void send_status(struct outgoing out, enum ecu_state state) {
    uint8_t data[CAN_MAX_DLEN];
    struct vehicle_tracker_status_t status;
    vehicle_tracker_status_init(&status);
    status.state = (uint8_t)state;
    vehicle_tracker_status_pack(data, &status, sizeof data);
    send_frame(out, VEHICLE_TRACKER_STATUS_FRAME_ID, data, VEHICLE_TRACKER_STATUS_LENGTH);
}

static void send_bus_health(struct outgoing out, struct health health) {
    uint8_t data[CAN_MAX_DLEN];
    struct vehicle_tracker_bus_health_t message;
    vehicle_tracker_bus_health_init(&message);
    message.e2_e_errors = (uint16_t)(health.errors < UINT16_MAX ? health.errors : UINT16_MAX);
    message.motion_reception = (uint8_t)health.motion;
    message.reference_reception = (uint8_t)health.reference;
    vehicle_tracker_bus_health_pack(data, &message, sizeof data);
    send_frame(out, VEHICLE_TRACKER_BUS_HEALTH_FRAME_ID, data, VEHICLE_TRACKER_BUS_HEALTH_LENGTH);
}

static void send_timing(struct outgoing out, int64_t step_us) {
    uint8_t data[CAN_MAX_DLEN];
    struct vehicle_tracker_timing_t timing;
    vehicle_tracker_timing_init(&timing);
    timing.step_time = vehicle_tracker_timing_step_time_encode(step_us < LONGEST_US ? (double)step_us : LONGEST_US);
    vehicle_tracker_timing_pack(data, &timing, sizeof data);
    send_frame(out, VEHICLE_TRACKER_TIMING_FRAME_ID, data, VEHICLE_TRACKER_TIMING_LENGTH);
}

/* In virtual time the others wait for every frame that is due, so one that will not be sent is announced. */
static void announce_absent(struct outgoing out, uint32_t id) {
    uint8_t data[CAN_MAX_DLEN];
    struct vehicle_bench_absent_t absent;
    vehicle_bench_absent_init(&absent);
    absent.identifier = (uint16_t)id;
    absent.cycle = out.cycle;
    vehicle_bench_absent_pack(data, &absent, sizeof data);
    send_protected(out, VEHICLE_BENCH_ABSENT_FRAME_ID, data, VEHICLE_BENCH_ABSENT_LENGTH);
}

void send_diagnostics(struct outgoing out, enum ecu_state state, struct health health, int64_t step_us) {
    static const struct {
        uint32_t id;
        uint32_t cycle_ms;
    } owed[] = {
#define X(id, cycle_ms) {id, cycle_ms},
        DIAGNOSTICS(X)
#undef X
    };
    /* Since the frame before; 0 would be no measurement. */
    static int64_t longest_us = 1;
    longest_us = step_us > longest_us ? step_us : longest_us;
    for (size_t i = 0; i < sizeof owed / sizeof owed[0]; i++) {
        if (out.cycle * CYCLE_MS % owed[i].cycle_ms != 0) {
            continue;
        }
        if (owed[i].id == VEHICLE_TRACKER_STATUS_FRAME_ID) {
            send_status(out, state);
        } else if (owed[i].id == VEHICLE_TRACKER_BUS_HEALTH_FRAME_ID) {
            send_bus_health(out, health);
        } else if (owed[i].id == VEHICLE_TRACKER_TIMING_FRAME_ID) {
            send_timing(out, longest_us);
            longest_us = 1;
        } else if (!out.realtime) {
            announce_absent(out, owed[i].id);
        }
    }
}
