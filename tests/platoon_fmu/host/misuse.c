/* Calls that must not go through, each with its reason, and an instance that is none the worse for them. */
#include <limits.h>
#include <math.h>
#include <stdio.h>
#include <string.h>

#include "host.h"

#define STOP 10.0

static void print_run(Fmu *fmu, const char *label) {
    int i;

    for (i = 0; i < 5; i++) {
        drive(fmu, i);
        advance(fmu, 0.01);
    }
    print_unknowns(fmu, label);
}

static void instantiate_wrongly(const Subject *subject, const char *label, const char *name, const char *token) {
    Fmu fmu;

    refused(&fmu, label, fmu_instantiate(&fmu, subject, subject->kind, name, token) ? OK : ERROR);
    fmu_free(&fmu);
}

static Status set_both(Fmu *fmu, const char *good, const char *bad, double value) {
    const unsigned int references[] = {reference_of(fmu->subject, good), reference_of(fmu->subject, bad)};
    const double values[] = {0.25, value};

    return fmu_set(fmu, references, 2, values);
}

static void set_wrongly(Fmu *fmu) {
    const unsigned int none = MOST, friction = reference_of(fmu->subject, "mu");
    const double value = 1.0;
    const int number = 1;

    refused(fmu, "set an unknown reference", fmu_set(fmu, &none, 1, &value));
    refused(fmu, "set an unknown integer", fmu_set_integer(fmu, &none, &number));
    refused(fmu, "set an integer as a real", set(fmu, "solver", 1.0));
    refused(fmu, "set a real as an integer", fmu_set_integer(fmu, &friction, &number));
    refused(fmu, "set a state", set_both(fmu, "mu", "v_x", 1.0));
    refused(fmu, "set the time", set_both(fmu, "mu", "time", 1.0));
    refused(fmu, "set to NaN", set_both(fmu, "mu", "M", NAN));
    refused(fmu, "set to infinity", set_both(fmu, "mu", "steering_angle", -INFINITY));
    refused(fmu, "set no references", fmu_set(fmu, NULL, 1, &value));
    refused(fmu, "set no values", fmu_set(fmu, &friction, 1, NULL));
    refused(fmu, "set no integer", fmu_set_integer(fmu, &friction, NULL));
}

static void get_wrongly(Fmu *fmu) {
    const unsigned int none = UINT_MAX, solver = reference_of(fmu->subject, "solver");
    const unsigned int friction = reference_of(fmu->subject, "mu");
    double value;
    int number;

    refused(fmu, "get an unknown reference", fmu_get(fmu, &none, 1, &value));
    refused(fmu, "get an integer as a real", fmu_get(fmu, &solver, 1, &value));
    refused(fmu, "get a real as an integer", fmu_get_integer(fmu, &friction, &number));
    refused(fmu, "get no references", fmu_get(fmu, NULL, 1, &value));
    refused(fmu, "get no values", fmu_get(fmu, &friction, 1, NULL));
    refused(fmu, "get no integer", fmu_get_integer(fmu, &solver, NULL));
}

static void differentiate_wrongly(Fmu *fmu) {
    const Subject *subject = fmu->subject;
    const Group friction = {{reference_of(subject, "mu")}, 1}, mass = {{reference_of(subject, "M")}, 1};
    double seed[MOST] = {1.0}, sensitivity[MOST];

    refused(fmu, "differentiate an input", fmu_directional(fmu, &friction, &subject->inputs, seed, sensitivity));
    refused(fmu, "differentiate over a parameter", fmu_directional(fmu, &subject->states, &mass, seed, sensitivity));
    refused(fmu, "differentiate without a seed", fmu_directional(fmu, &subject->states, &friction, NULL, sensitivity));
    refused(fmu, "differentiate into nothing", fmu_directional(fmu, &subject->states, &friction, seed, NULL));
}

static void misuse_states(Fmu *fmu) {
    unsigned char bytes[8] = {0};
    void *state = NULL;
    size_t size;

    refused(fmu, "save nowhere", fmu_save(fmu, NULL));
    refused(fmu, "restore nothing", fmu_restore(fmu, NULL));
    refused(fmu, "serialize nothing", fmu_serialize(fmu, NULL, bytes, sizeof bytes));
    refused(fmu, "deserialize nothing", fmu_deserialize(fmu, NULL, 8, &state));
    must(fmu, fmu_save(fmu, &state), "save");
    refused(fmu, "ask for a size nowhere", fmu_serialized_size(fmu, state, NULL));
    must(fmu, fmu_serialized_size(fmu, state, &size), "ask for the size");
    refused(fmu, "serialize nowhere", fmu_serialize(fmu, state, NULL, size));
    refused(fmu, "serialize into too little", fmu_serialize(fmu, state, bytes, sizeof bytes));
    must(fmu, fmu_discard(fmu, &state), "discard");
}

static void misuse_log(Fmu *fmu) {
    const char *const unknown[] = {"logEvents", "noSuchCategory"}, *const missing[] = {NULL};

    refused(fmu, "log an unknown category", fmu_set_logging(fmu, true, 2, unknown));
    refused(fmu, "log no category", fmu_set_logging(fmu, true, 1, missing));
    refused(fmu, "log no categories", fmu_set_logging(fmu, true, 1, NULL));
}

static void step_wrongly(Fmu *fmu) {
    double values[MOST];

    refused(fmu, "step by nothing", fmu_step(fmu, 0.0, 0.0));
    refused(fmu, "step back", fmu_step(fmu, 0.0, -0.01));
    refused(fmu, "step by NaN", fmu_step(fmu, 0.0, NAN));
    refused(fmu, "step by infinity", fmu_step(fmu, 0.0, INFINITY));
    refused(fmu, "step from elsewhere", fmu_step(fmu, 1.0, 0.01));
    refused(fmu, "step from NaN", fmu_step(fmu, NAN, 0.01));
    refused(fmu, "step past the stop time", fmu_step(fmu, 0.0, 2 * STOP));
    refused(fmu, "ask for second derivatives", fmu_output_derivatives(fmu, &fmu->subject->states, 2, values));
    refused(fmu, "ask for an input's derivative", fmu_output_derivatives(fmu, &fmu->subject->inputs, 1, values));
    refused(fmu, "ask for derivatives nowhere", fmu_output_derivatives(fmu, &fmu->subject->states, 1, NULL));
    refused(fmu, "set states of a slave", fmu_set_states(fmu, values, fmu->subject->states.n));
    refused(fmu, "enter the event mode of a slave", fmu_event_mode(fmu));
}

static void integrate_wrongly(Fmu *fmu) {
    const size_t n = fmu->subject->states.n;
    double x[MOST] = {0};

    refused(fmu, "set the time to NaN", fmu_set_time(fmu, NAN));
    refused(fmu, "set too few states", fmu_set_states(fmu, x, n - 1));
    refused(fmu, "get too many states", fmu_get_states(fmu, x, n + 1));
    refused(fmu, "get no states", fmu_get_states(fmu, x, 0));
    x[n - 1] = NAN;
    refused(fmu, "set a state to NaN", fmu_set_states(fmu, x, n));
    refused(fmu, "get states nowhere", fmu_get_states(fmu, NULL, n));
    refused(fmu, "get derivatives nowhere", fmu_get_derivatives(fmu, NULL, n));
    refused(fmu, "get nominals nowhere", fmu_get_nominals(fmu, NULL, n));
    refused(fmu, "tune within a step", set(fmu, "M", 1500.0));
    refused(fmu, "settle within a step", fmu_settle(fmu));
    refused(fmu, "step a model", fmu_step(fmu, 0.0, 0.01));
}

static void start_wrongly(Fmu *fmu) {
    refused(fmu, "step before the start", fmu_step(fmu, 0.0, 0.01));
    refused(fmu, "terminate before the start", fmu_terminate(fmu));
    refused(fmu, "exit no initialization", fmu_exit_initialization(fmu));
    refused(fmu, "start at NaN", fmu_initialize(fmu, NAN, STOP, 1e-6));
    refused(fmu, "stop before the start", fmu_initialize(fmu, 0.0, -1.0, 1e-6));
    refused(fmu, "stop at NaN", fmu_initialize(fmu, 0.0, NAN, 1e-6));
    refused(fmu, "tolerate nothing", fmu_initialize(fmu, 0.0, STOP, 0.0));
    refused(fmu, "no such solver", set_solver(fmu, 3));
    refused(fmu, "too long a solver step", set(fmu, "solver_step", 1.0));
}

void misuse(const Subject *subject, int number) {
    const double nothing = 0.0;
    Fmu fmu, fresh;

    instantiate_wrongly(subject, "wrong token", "car", "{00000000-0000-0000-0000-000000000000}");
    instantiate_wrongly(subject, "a token with percent signs", "car", "%s%s%n");
    instantiate_wrongly(subject, "no token", "car", NULL);
    instantiate_wrongly(subject, "no name", NULL, subject->token);
    instantiate_wrongly(subject, "an empty name", "", subject->token);
    must(&fmu, fmu_instantiate(&fmu, subject, subject->kind, "car", subject->token) ? OK : ERROR, "instantiate");
    start_wrongly(&fmu);
    set_wrongly(&fmu);
    must(&fmu, set_solver(&fmu, number), "set the solver");
    must(&fmu, set(&fmu, "v_x_start", 20.0), "set v_x_start");
    must(&fmu, fmu_initialize(&fmu, 0.0, STOP, 1e-6), "initialize");
    refused(&fmu, "initialize twice", fmu_initialize(&fmu, 0.0, STOP, 1e-6));
    must(&fmu, fmu_set(&fmu, NULL, 0, &nothing), "set nothing");
    fmu.time = 0.0;
    start_initialized(&fmu);
    get_wrongly(&fmu);
    differentiate_wrongly(&fmu);
    misuse_states(&fmu);
    misuse_log(&fmu);
    refused(&fmu, "set a start value late", set(&fmu, "v_x_start", 10.0));
    refused(&fmu, "set the solver late", set_solver(&fmu, 1));
    (subject->kind == CO_SIMULATION ? step_wrongly : integrate_wrongly)(&fmu);
    fmu_own_misuse(&fmu);
    print_run(&fmu, "the misused");

    must(&fresh, fmu_instantiate(&fresh, subject, subject->kind, "car", subject->token) ? OK : ERROR, "instantiate");
    must(&fresh, set_solver(&fresh, number), "set the solver");
    must(&fresh, set(&fresh, "v_x_start", 20.0), "set v_x_start");
    must(&fresh, fmu_initialize(&fresh, 0.0, STOP, 1e-6), "initialize");
    fresh.time = 0.0;
    start_initialized(&fresh);
    print_run(&fresh, "a fresh one");
    fmu_free(&fresh);

    must(&fmu, fmu_terminate(&fmu), "terminate");
    refused(&fmu, "set after the end", set(&fmu, "mu", 0.5));
    refused(&fmu, "terminate twice", fmu_terminate(&fmu));
    fmu_free(&fmu);
}
