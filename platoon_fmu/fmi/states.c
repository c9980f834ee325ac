/* An instance's state: saved, restored, and as bytes. */
#include "internal.h"

#include <stdint.h>
#include <stdlib.h>
#include <string.h>

struct State {
    const Model *model;
    Kind kind;
    Status status;
    double values[]; /* x, u, p */
};

bool core_save(const Instance *instance, const Rule *rule, State **state) {
    size_t size;

    if (!core_has_places(instance, rule, 1, (const void *[]){state})) return false;
    size = core_n_values(instance->model) * sizeof(double);
    if (!*state) *state = malloc(sizeof **state + size);
    if (!*state) return core_refuse(instance, rule, "out of memory.");
    (*state)->model = instance->model;
    (*state)->kind = instance->kind;
    (*state)->status = instance->status;
    memcpy((*state)->values, instance->x, size);
    return true;
}

bool core_discard(const Instance *instance, const Rule *rule, State **state) {
    if (!core_allows(instance, rule)) return false;
    if (!state) return true;
    free(*state);
    *state = NULL;
    return true;
}

bool core_restore(Instance *instance, const Rule *rule, const State *state) {
    if (!core_allows(instance, rule)) return false;
    if (!state) return core_refuse(instance, rule, "the state is missing.");
    if (state->model != instance->model || state->kind != instance->kind) {
        return core_refuse(instance, rule, "the state is of another model or interface type.");
    }
    instance->status = state->status;
    memcpy(instance->x, state->values, core_n_values(instance->model) * sizeof(double));
    instance->x_current = true;
    core_outdate(instance);
    return true;
}

/* Layout: token, then eight little-endian bytes each: the fields named here, the values x, u and p, and a checksum of all
 * preceding bytes. */
enum { OF_KIND, OF_PHASE, OF_METHOD, OF_STEP, OF_TOLERANCE, OF_TIME, OF_STOP, OF_EXPERIMENT, OF_PROPOSAL, N_HEADER };

#define N_CHECKSUMS 1

static size_t serialized_size(const Model *model) {
    return strlen(model->token) + (N_HEADER + core_n_values(model) + N_CHECKSUMS) * sizeof(uint64_t);
}

bool core_serialized_size(const Instance *instance, const Rule *rule, size_t *size) {
    if (!core_has_places(instance, rule, 1, (const void *[]){size})) return false;
    *size = serialized_size(instance->model);
    return true;
}

static unsigned char *put(unsigned char *bytes, uint64_t value) {
    size_t i;

    for (i = 0; i < sizeof value; i++) *bytes++ = (unsigned char)(value >> (8 * i));
    return bytes;
}

static uint64_t take(const unsigned char **bytes) {
    uint64_t value = 0;
    size_t i;

    for (i = 0; i < sizeof value; i++) {
        const uint64_t byte = *(*bytes)++;
        value |= byte << (8 * i);
    }
    return value;
}

static uint64_t bits_of(double value) {
    uint64_t bits;

    memcpy(&bits, &value, sizeof bits);
    return bits;
}

static double double_of(uint64_t bits) {
    double value;

    memcpy(&value, &bits, sizeof value);
    return value;
}

/* FNV-1a. */
static uint64_t checksum(const unsigned char *bytes, size_t size) {
    uint64_t sum = 14695981039346656037u;
    size_t i;

    for (i = 0; i < size; i++) sum = (sum ^ bytes[i]) * 1099511628211u;
    return sum;
}

static void pack(const State *state, uint64_t header[N_HEADER]) {
    const Status *status = &state->status;

    header[OF_KIND] = state->kind;
    header[OF_PHASE] = status->phase;
    header[OF_METHOD] = status->solver.method;
    header[OF_STEP] = bits_of(status->solver.step);
    header[OF_TOLERANCE] = bits_of(status->solver.tolerance);
    header[OF_TIME] = bits_of(status->time);
    header[OF_STOP] = bits_of(status->stop_time);
    header[OF_EXPERIMENT] = bits_of(status->experiment_tolerance);
    header[OF_PROPOSAL] = bits_of(status->step_proposal);
}

static Status unpacked(const uint64_t header[N_HEADER]) {
    const Status status = {
        .phase = (Phase)header[OF_PHASE],
        .solver = {.method = (SolverMethod)header[OF_METHOD],
                   .step = double_of(header[OF_STEP]),
                   .tolerance = double_of(header[OF_TOLERANCE])},
        .time = double_of(header[OF_TIME]),
        .stop_time = double_of(header[OF_STOP]),
        .experiment_tolerance = double_of(header[OF_EXPERIMENT]),
        .step_proposal = double_of(header[OF_PROPOSAL]),
    };

    return status;
}

bool core_serialize(const Instance *instance, const Rule *rule, const State *state, unsigned char *bytes, size_t size) {
    unsigned char *end = bytes;
    uint64_t header[N_HEADER];
    size_t token_size, n, i;

    if (!core_allows(instance, rule)) return false;
    if (!state || !bytes) return core_refuse(instance, rule, "the state or the buffer for its bytes is missing.");
    if (size < serialized_size(instance->model)) {
        return core_refuse(instance, rule, "the state needs %lu bytes, not %lu.",
                           (unsigned long)serialized_size(instance->model), (unsigned long)size);
    }
    token_size = strlen(instance->model->token);
    n = core_n_values(instance->model);
    if (state->model != instance->model) return core_refuse(instance, rule, "the state is of another model.");
    memcpy(end, instance->model->token, token_size);
    end += token_size;
    pack(state, header);
    for (i = 0; i < N_HEADER; i++) end = put(end, header[i]);
    for (i = 0; i < n; i++) end = put(end, bits_of(state->values[i]));
    put(end, checksum(bytes, (size_t)(end - bytes)));
    return true;
}

bool core_deserialize(const Instance *instance, const Rule *rule, const unsigned char *bytes, size_t size, State **state) {
    const unsigned char *next;
    uint64_t header[N_HEADER];
    size_t token_size, n, i;

    if (!core_allows(instance, rule)) return false;
    if (!bytes) return core_refuse(instance, rule, "the bytes are missing.");
    token_size = strlen(instance->model->token);
    n = core_n_values(instance->model);
    if (size != serialized_size(instance->model) || memcmp(bytes, instance->model->token, token_size) != 0) {
        return core_refuse(instance, rule, "the bytes are not a state of this FMU.");
    }
    next = bytes + size - sizeof(uint64_t);
    if (take(&next) != checksum(bytes, size - sizeof(uint64_t))) return core_refuse(instance, rule, "the bytes were changed.");
    next = bytes + token_size;
    for (i = 0; i < N_HEADER; i++) header[i] = take(&next);
    if (header[OF_KIND] != (uint64_t)instance->kind) {
        return core_refuse(instance, rule, "the bytes are a state of the other interface type.");
    }
    if (!core_save(instance, rule, state)) return false;
    (*state)->status = unpacked(header);
    for (i = 0; i < n; i++) (*state)->values[i] = double_of(take(&next));
    return true;
}
