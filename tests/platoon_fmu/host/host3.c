/* FMI 3.0 for the host. */
#include <dlfcn.h>
#include <math.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>

#include "fmi3FunctionTypes.h"
#include "host.h"

/* The functions of the standard that the host calls. */
/* Formatted by hand: clang-format would indent each line more than the last. */
/* clang-format off */
#define FUNCTIONS(F)                                                                                                      \
    F(GetVersion) F(SetDebugLogging) F(InstantiateModelExchange) F(InstantiateCoSimulation)                               \
    F(InstantiateScheduledExecution) F(FreeInstance) F(EnterInitializationMode) F(ExitInitializationMode) F(Terminate)    \
    F(Reset) F(GetFloat64) F(SetFloat64) F(GetInt64) F(SetInt64) F(GetInt32) F(SetBinary) F(GetClock) F(GetFMUState)      \
    F(SetFMUState) F(FreeFMUState) F(SerializedFMUStateSize) F(SerializeFMUState) F(DeserializeFMUState)                  \
    F(GetDirectionalDerivative) F(GetAdjointDerivative) F(EnterEventMode) F(UpdateDiscreteStates)                         \
    F(EnterContinuousTimeMode) F(CompletedIntegratorStep) F(SetTime) F(SetContinuousStates)                               \
    F(GetContinuousStateDerivatives) F(GetEventIndicators) F(GetContinuousStates) F(GetNominalsOfContinuousStates)        \
    F(GetNumberOfEventIndicators) F(GetNumberOfContinuousStates) F(GetOutputDerivatives) F(DoStep)                        \
    F(EnterConfigurationMode) F(EnterStepMode) F(ActivateModelPartition)
/* clang-format on */

/* Written once, before any thread starts. */
static struct {
#define DECLARE(name) fmi3##name##TYPE *name;
    FUNCTIONS(DECLARE)
} fmi;

void fmu_load(void *library) {
#define LOOK_UP(name)                                         \
    *(void **)(&fmi.name) = dlsym(library, "fmi3" #name);     \
    if (!fmi.name) {                                          \
        printf("failed: fmi3" #name ": not in the binary\n"); \
        exit(1);                                              \
    }
    FUNCTIONS(LOOK_UP)
}

static void listen(fmi3InstanceEnvironment environment, fmi3Status status, fmi3String category, fmi3String message) {
    (void)status;
    hear(environment, category, message);
}

static void prepare(Fmu *fmu, const Subject *subject, Kind kind) {
    memset(fmu, 0, sizeof *fmu);
    fmu->subject = subject;
    fmu->kind = kind;
}

bool fmu_instantiate(Fmu *fmu, const Subject *subject, Kind kind, const char *name, const char *token) {
    prepare(fmu, subject, kind);
    fmu->instance = kind == MODEL_EXCHANGE
                        ? fmi.InstantiateModelExchange(name, token, NULL, false, true, fmu, listen)
                        : fmi.InstantiateCoSimulation(name, token, NULL, false, true, false, false, NULL, 0, fmu, listen, NULL);
    return fmu->instance;
}

void fmu_free(Fmu *fmu) { fmi.FreeInstance(fmu->instance); }

const char *fmu_version(void) { return fmi.GetVersion(); }

Status fmu_set_logging(Fmu *fmu, bool on, size_t n, const char *const *categories) {
    return (Status)fmi.SetDebugLogging(fmu->instance, on, n, categories);
}

Status fmu_initialize(Fmu *fmu, double start_time, double stop_time, double tolerance) {
    return (Status)fmi.EnterInitializationMode(fmu->instance, true, tolerance, start_time, !isinf(stop_time), stop_time);
}

Status fmu_exit_initialization(Fmu *fmu) { return (Status)fmi.ExitInitializationMode(fmu->instance); }

Status fmu_terminate(Fmu *fmu) { return (Status)fmi.Terminate(fmu->instance); }

Status fmu_reset(Fmu *fmu) { return (Status)fmi.Reset(fmu->instance); }

Status fmu_get(Fmu *fmu, const unsigned int *references, size_t n, double *values) {
    return (Status)fmi.GetFloat64(fmu->instance, references, n, values, n);
}

Status fmu_set(Fmu *fmu, const unsigned int *references, size_t n, const double *values) {
    return (Status)fmi.SetFloat64(fmu->instance, references, n, values, n);
}

Status fmu_get_integer(Fmu *fmu, const unsigned int *reference, int *value) {
    fmi3Int64 wide = 0;
    const Status status = (Status)fmi.GetInt64(fmu->instance, reference, 1, value ? &wide : NULL, 1);

    if (value) *value = (int)wide;
    return status;
}

Status fmu_set_integer(Fmu *fmu, const unsigned int *reference, const int *value) {
    const fmi3Int64 wide = value ? *value : 0;

    return (Status)fmi.SetInt64(fmu->instance, reference, 1, value ? &wide : NULL, 1);
}

Status fmu_directional(Fmu *fmu, const Group *unknowns, const Group *knowns, const double *seed, double *sensitivity) {
    return (Status)fmi.GetDirectionalDerivative(fmu->instance, unknowns->references, unknowns->n, knowns->references, knowns->n,
                                                seed, knowns->n, sensitivity, unknowns->n);
}

Status fmu_event_mode(Fmu *fmu) { return (Status)fmi.EnterEventMode(fmu->instance); }

Status fmu_settle(Fmu *fmu) {
    fmi3Boolean again = true, terminate, nominals, values, timed;
    Status status = OK;
    double when;

    while (status == OK && again) {
        status = (Status)fmi.UpdateDiscreteStates(fmu->instance, &again, &terminate, &nominals, &values, &timed, &when);
    }
    return status;
}

Status fmu_continuous_mode(Fmu *fmu) { return (Status)fmi.EnterContinuousTimeMode(fmu->instance); }

Status fmu_completed_step(Fmu *fmu) {
    fmi3Boolean event = true, terminate = true;
    const Status status = (Status)fmi.CompletedIntegratorStep(fmu->instance, true, &event, &terminate);

    return event || terminate ? ERROR : status;
}

Status fmu_set_time(Fmu *fmu, double time) { return (Status)fmi.SetTime(fmu->instance, time); }

Status fmu_set_states(Fmu *fmu, const double *x, size_t n) { return (Status)fmi.SetContinuousStates(fmu->instance, x, n); }

Status fmu_get_states(Fmu *fmu, double *x, size_t n) { return (Status)fmi.GetContinuousStates(fmu->instance, x, n); }

Status fmu_get_derivatives(Fmu *fmu, double *dx, size_t n) {
    return (Status)fmi.GetContinuousStateDerivatives(fmu->instance, dx, n);
}

Status fmu_get_nominals(Fmu *fmu, double *nominals, size_t n) {
    return (Status)fmi.GetNominalsOfContinuousStates(fmu->instance, nominals, n);
}

/* A step; where it came to goes into *reached, whether it returned early is said. */
static Status step(Fmu *fmu, double time, double h, double *reached, bool *early) {
    fmi3Boolean event = true, terminate = true;
    const Status status = (Status)fmi.DoStep(fmu->instance, time, h, true, &event, &terminate, early, reached);

    return status == OK && (event || terminate) ? ERROR : status;
}

Status fmu_step(Fmu *fmu, double time, double h) {
    double reached;
    bool early;
    const Status status = step(fmu, time, h, &reached, &early);

    return status == OK && (early || reached != time + h) ? ERROR : status;
}

Status fmu_output_derivatives(Fmu *fmu, const Group *unknowns, int order, double *values) {
    fmi3Int32 orders[MOST];
    size_t i;

    for (i = 0; i < unknowns->n; i++) orders[i] = order;
    return (Status)fmi.GetOutputDerivatives(fmu->instance, unknowns->references, unknowns->n, orders, values, unknowns->n);
}

Status fmu_save(Fmu *fmu, void **state) { return (Status)fmi.GetFMUState(fmu->instance, state); }

Status fmu_restore(Fmu *fmu, void *state) { return (Status)fmi.SetFMUState(fmu->instance, state); }

Status fmu_discard(Fmu *fmu, void **state) { return (Status)fmi.FreeFMUState(fmu->instance, state); }

Status fmu_serialized_size(Fmu *fmu, void *state, size_t *size) {
    return (Status)fmi.SerializedFMUStateSize(fmu->instance, state, size);
}

Status fmu_serialize(Fmu *fmu, void *state, unsigned char *bytes, size_t size) {
    return (Status)fmi.SerializeFMUState(fmu->instance, state, bytes, size);
}

Status fmu_deserialize(Fmu *fmu, const unsigned char *bytes, size_t size, void **state) {
    return (Status)fmi.DeserializeFMUState(fmu->instance, bytes, size, state);
}

/* ---- at work ---- */

/* From the third update of a step on it asks to return at a time later by this. */
#define PATIENCE 0.0025 /* [s] */

/* fmu->own counts the updates of a step. */
static void update(fmi3InstanceEnvironment environment, fmi3Float64 time, fmi3Boolean set_requested, fmi3Boolean get_allowed,
                   fmi3Boolean step_finished, fmi3Boolean can_return, fmi3Boolean *return_requested, fmi3Float64 *return_time) {
    Fmu *fmu = environment;
    int *n = fmu->own;
    double values[MOST];

    get_unknowns(fmu, values);
    printf("update %d: %a %d%d%d%d %a\n", ++*n, time, set_requested, get_allowed, step_finished, can_return, values[0]);
    *return_requested = *n == 3;
    *return_time = time + PATIENCE;
}

/* Two steps of an instance of its own, watched from step to step of its solver; the first returns early. */
static void watch(const Subject *subject) {
    double reached = 0.0;
    int i, n;
    bool early;
    Fmu fmu;

    prepare(&fmu, subject, CO_SIMULATION);
    fmu.own = &n;
    fmu.instance = fmi.InstantiateCoSimulation("watched", subject->token, NULL, false, true, false, true,
                                               subject->unknowns.references, subject->unknowns.n, &fmu, listen, update);
    must(&fmu, fmu.instance ? OK : ERROR, "instantiate");
    must(&fmu, set(&fmu, "v_x_start", 20.0), "set v_x_start");
    must(&fmu, set_solver(&fmu, 1), "set the solver");
    start(&fmu, 0.0);
    for (i = 0; i < 2; i++) {
        n = i;
        drive(&fmu, i);
        must(&fmu, step(&fmu, reached, 0.0085, &reached, &early), "step");
        printf("watched %d: %a %d\n", i, reached, early);
    }
    print_unknowns(&fmu, "watched");
    fmu_free(&fmu);
}

void fmu_own_life(Fmu *fmu) {
    const Group *unknowns = &fmu->subject->unknowns, *knowns = &fmu->subject->running;
    double seed[MOST], sensitivity[MOST];
    size_t i, n_states, n_indicators;

    for (i = 0; i < unknowns->n; i++) seed[i] = 0.125 * (double)(i + 1);
    must(fmu,
         (Status)fmi.GetAdjointDerivative(fmu->instance, unknowns->references, unknowns->n, knowns->references, knowns->n, seed,
                                          unknowns->n, sensitivity, knowns->n),
         "get the adjoint derivative");
    print_values("adjoint", sensitivity, knowns->n);
    if (fmu->kind == CO_SIMULATION) {
        watch(fmu->subject);
        return;
    }
    must(fmu, (Status)fmi.GetNumberOfContinuousStates(fmu->instance, &n_states), "count the states");
    must(fmu, (Status)fmi.GetNumberOfEventIndicators(fmu->instance, &n_indicators), "count the event indicators");
    must(fmu, (Status)fmi.GetEventIndicators(fmu->instance, NULL, n_indicators), "get the event indicators");
    printf("numbers: %zu %zu\n", n_states, n_indicators);
}

/* ---- misused ---- */

static void instantiate_wrongly(const Subject *subject) {
    const unsigned int friction = reference_of(subject, "mu");
    Fmu fmu;

    prepare(&fmu, subject, CO_SIMULATION);
    refused(&fmu, "instantiate with an event mode",
            fmi.InstantiateCoSimulation("car", subject->token, NULL, false, true, true, false, NULL, 0, &fmu, listen, NULL)
                ? OK
                : ERROR);
    refused(
        &fmu, "instantiate with an input as intermediate variable",
        fmi.InstantiateCoSimulation("car", subject->token, NULL, false, true, false, false, &friction, 1, &fmu, listen, NULL)
            ? OK
            : ERROR);
    refused(&fmu, "instantiate without the intermediate variables",
            fmi.InstantiateCoSimulation("car", subject->token, NULL, false, true, false, false, NULL, 1, &fmu, listen, NULL)
                ? OK
                : ERROR);
    refused(&fmu, "instantiate for scheduled execution",
            fmi.InstantiateScheduledExecution("car", subject->token, NULL, false, true, &fmu, listen, NULL, NULL, NULL)
                ? OK
                : ERROR);
    refused(&fmu, "instantiate without a log",
            fmi.InstantiateModelExchange("car", "{}", NULL, false, true, NULL, NULL) ? OK : ERROR);
}

void fmu_own_misuse(Fmu *fmu) {
    const unsigned int friction = reference_of(fmu->subject, "mu");
    const size_t length = 1;
    const fmi3Byte byte = 1;
    const fmi3Binary binary = &byte;
    double values[2] = {0.5, 0.5};
    fmi3Int32 number;
    fmi3Clock clock;

    instantiate_wrongly(fmu->subject);
    refused(fmu, "get two values of one variable", (Status)fmi.GetFloat64(fmu->instance, &friction, 1, values, 2));
    refused(fmu, "get an Int32", (Status)fmi.GetInt32(fmu->instance, &friction, 1, &number, 1));
    refused(fmu, "set a Binary", (Status)fmi.SetBinary(fmu->instance, &friction, 1, &length, &binary, 1));
    refused(fmu, "get a Clock", (Status)fmi.GetClock(fmu->instance, &friction, 1, &clock));
    refused(fmu, "enter the configuration mode", (Status)fmi.EnterConfigurationMode(fmu->instance));
    refused(fmu, "enter the step mode", (Status)fmi.EnterStepMode(fmu->instance));
    refused(fmu, "activate a partition", (Status)fmi.ActivateModelPartition(fmu->instance, friction, 0.0));
    refused(fmu, "differentiate without an adjoint seed",
            (Status)fmi.GetAdjointDerivative(fmu->instance, &friction, 1, &friction, 1, NULL, 1, values, 1));
    if (fmu->kind == MODEL_EXCHANGE) {
        refused(fmu, "count states nowhere", (Status)fmi.GetNumberOfContinuousStates(fmu->instance, NULL));
        refused(fmu, "get an event indicator", (Status)fmi.GetEventIndicators(fmu->instance, values, 1));
        return;
    }
    refused(fmu, "step nowhere", (Status)fmi.DoStep(fmu->instance, 0.0, 0.01, true, NULL, NULL, NULL, NULL));
    refused(fmu, "ask for derivatives of no order",
            (Status)fmi.GetOutputDerivatives(fmu->instance, &friction, 1, NULL, values, 1));
}
