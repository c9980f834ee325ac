/* The whole life of an instance: two runs, states saved and restored, everything read. `number` is the solver. */
#include <stdio.h>
#include <stdlib.h>

#include "host.h"

#define STEP 0.013

static void set_start_values(Fmu *fmu, int solver) {
    must(fmu, set(fmu, "v_x_start", 20.0), "set v_x_start");
    must(fmu, set(fmu, "v_y_start", 0.3), "set v_y_start");
    must(fmu, set(fmu, "gamma_start", 0.1), "set gamma_start");
    must(fmu, set(fmu, "mu", 0.7), "set mu");
    must(fmu, set(fmu, "M", 1800.0), "set M");
    must(fmu, set_solver(fmu, solver), "set the solver");
}

static void print_directional(Fmu *fmu, const char *label, const Group *knowns) {
    const Group *unknowns = &fmu->subject->unknowns;
    double seed[MOST], sensitivity[MOST];
    size_t i;

    for (i = 0; i < knowns->n; i++) seed[i] = 0.125 * (double)(i + 1);
    must(fmu, fmu_directional(fmu, unknowns, knowns, seed, sensitivity), label);
    print_values(label, sensitivity, unknowns->n);
}

static void five_steps(Fmu *fmu, const char *label) {
    int i;

    for (i = 0; i < 5; i++) {
        drive(fmu, i + 3);
        advance(fmu, STEP);
    }
    print_unknowns(fmu, label);
}

static void print_bytes(const char *label, const unsigned char *bytes, size_t size) {
    size_t i;

    printf("%s: ", label);
    for (i = 0; i < size; i++) printf("%02x", bytes[i]);
    printf("\n");
}

/* A state's bytes, to be freed by the caller. */
static unsigned char *serialized(Fmu *fmu, void *state, size_t *size, const char *label) {
    unsigned char *bytes;

    must(fmu, fmu_serialized_size(fmu, state, size), "ask for the state's size");
    bytes = malloc(*size);
    must(fmu, bytes ? fmu_serialize(fmu, state, bytes, *size) : ERROR, "serialize the state");
    if (bytes) print_bytes(label, bytes, *size);
    return bytes;
}

static void print_state(Fmu *fmu, const char *label) {
    void *state = NULL;
    size_t size;

    must(fmu, fmu_save(fmu, &state), "save the state");
    free(serialized(fmu, state, &size, label));
    must(fmu, fmu_discard(fmu, &state), "discard the state");
}

/* Goes on three times from one state: as it is, from its copy, and from its bytes. */
static void save_and_restore(Fmu *fmu) {
    const double time = fmu->time;
    void *state = NULL, *other = NULL;
    unsigned char *bytes;
    size_t size;

    must(fmu, fmu_save(fmu, &state), "save the state");
    bytes = serialized(fmu, state, &size, "bytes");
    five_steps(fmu, "went on");
    must(fmu, fmu_restore(fmu, state), "restore the state");
    fmu->time = time;
    five_steps(fmu, "again");
    must(fmu, fmu_deserialize(fmu, bytes, size, &other), "deserialize the state");
    must(fmu, fmu_restore(fmu, other), "restore the deserialized state");
    fmu->time = time;
    five_steps(fmu, "from bytes");
    /* Into the place of a state that there is already. */
    must(fmu, fmu_save(fmu, &state), "save over the state");
    tune(fmu, 1650.0, 0.4);
    five_steps(fmu, "tuned");
    must(fmu, fmu_restore(fmu, state), "restore the state saved over");
    fmu->time = time + 5 * STEP;
    must(fmu, fmu_discard(fmu, &state), "discard the state");
    must(fmu, fmu_discard(fmu, &other), "discard the deserialized state");
    must(fmu, state || other ? ERROR : fmu_discard(fmu, &state), "discard no state");
    free(bytes);
}

static void print_numbers(Fmu *fmu) {
    const unsigned int solver = reference_of(fmu->subject, "solver"), time = reference_of(fmu->subject, "time");
    const size_t n = fmu->subject->states.n;
    double values[MOST];
    int number;

    must(fmu, fmu_get_integer(fmu, &solver, &number), "get the solver");
    must(fmu, fmu_get(fmu, &time, 1, values), "get the time");
    printf("solver: %d\n", number);
    print_values("time", values, 1);
    if (fmu->kind == CO_SIMULATION) {
        must(fmu, fmu_output_derivatives(fmu, &fmu->subject->unknowns, 1, values), "get output derivatives");
        print_values("output derivatives", values, fmu->subject->unknowns.n);
    } else {
        must(fmu, fmu_get_nominals(fmu, values, n), "get the nominals");
        print_values("nominals", values, n);
        must(fmu, fmu_get_states(fmu, values, n), "get the states");
        print_values("states", values, n);
    }
}

void life(const Subject *subject, int number) {
    const char *const everything[] = {"logAll"};
    char label[20];
    Fmu fmu;
    int i;

    printf("version: %s\n", fmu_version());
    must(&fmu, fmu_instantiate(&fmu, subject, subject->kind, "car", subject->token) ? OK : ERROR, "instantiate");
    fmu.aloud = true;
    must(&fmu, fmu_set_logging(&fmu, true, 1, everything), "log everything");
    set_start_values(&fmu, number);
    print_state(&fmu, "bytes before the start");
    fmu.time = 0.5;
    must(&fmu, fmu_initialize(&fmu, fmu.time, 10.0, 1e-7), "initialize");
    print_unknowns(&fmu, "initial");
    print_directional(&fmu, "initial directional", &subject->beginning);
    start_initialized(&fmu);
    for (i = 0; i < 20; i++) {
        drive(&fmu, i);
        if (i == 10) tune(&fmu, 1700.0, 0.5);
        advance(&fmu, STEP);
        snprintf(label, sizeof label, "step %d", i);
        print_unknowns(&fmu, label);
    }
    print_directional(&fmu, "directional", &subject->running);
    print_numbers(&fmu);
    save_and_restore(&fmu);
    fmu_own_life(&fmu);
    must(&fmu, fmu_terminate(&fmu), "terminate");
    print_unknowns(&fmu, "terminated");
    must(&fmu, fmu_reset(&fmu), "reset");
    must(&fmu, set(&fmu, "v_x_start", 10.0), "set v_x_start");
    start(&fmu, 0.0);
    five_steps(&fmu, "second run");
    fmu_free(&fmu);
}
