/* FMI 2.0 for the host. */
#include <dlfcn.h>
#include <math.h>
#include <stdarg.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>

#include "fmi2FunctionTypes.h"
#include "host.h"

/* Every function of the standard. */
/* Formatted by hand: clang-format would indent each line more than the last. */
/* clang-format off */
#define FUNCTIONS(F)                                                                                                      \
    F(GetTypesPlatform) F(GetVersion) F(SetDebugLogging) F(Instantiate) F(FreeInstance) F(SetupExperiment)                \
    F(EnterInitializationMode) F(ExitInitializationMode) F(Terminate) F(Reset) F(GetReal) F(GetInteger) F(GetBoolean)     \
    F(GetString) F(SetReal) F(SetInteger) F(SetBoolean) F(SetString) F(GetFMUstate) F(SetFMUstate) F(FreeFMUstate)        \
    F(SerializedFMUstateSize) F(SerializeFMUstate) F(DeSerializeFMUstate) F(GetDirectionalDerivative) F(EnterEventMode)   \
    F(NewDiscreteStates) F(EnterContinuousTimeMode) F(CompletedIntegratorStep) F(SetTime) F(SetContinuousStates)          \
    F(GetDerivatives) F(GetEventIndicators) F(GetContinuousStates) F(GetNominalsOfContinuousStates)                       \
    F(SetRealInputDerivatives) F(GetRealOutputDerivatives) F(DoStep) F(CancelStep) F(GetStatus) F(GetRealStatus)          \
    F(GetIntegerStatus) F(GetBooleanStatus) F(GetStringStatus)
/* clang-format on */

/* Written once, before any thread starts. */
static struct {
#define DECLARE(name) fmi2##name##TYPE *name;
    FUNCTIONS(DECLARE)
} fmi;

void fmu_load(void *library) {
#define LOOK_UP(name)                                         \
    *(void **)(&fmi.name) = dlsym(library, "fmi2" #name);     \
    if (!fmi.name) {                                          \
        printf("failed: fmi2" #name ": not in the binary\n"); \
        exit(1);                                              \
    }
    FUNCTIONS(LOOK_UP)
}

/* The message is a printf format, as the standard has it. */
static void listen(fmi2ComponentEnvironment environment, fmi2String name, fmi2Status status, fmi2String category,
                   fmi2String message, ...) {
    char text[500];
    va_list arguments;

    (void)name;
    (void)status;
    va_start(arguments, message);
    vsnprintf(text, sizeof text, message, arguments);
    va_end(arguments);
    hear(environment, category, text);
}

bool fmu_instantiate(Fmu *fmu, const Subject *subject, Kind kind, const char *name, const char *token) {
    fmi2CallbackFunctions *callbacks = calloc(1, sizeof *callbacks);

    if (!callbacks) abort();
    memset(fmu, 0, sizeof *fmu);
    callbacks->logger = listen;
    callbacks->allocateMemory = calloc;
    callbacks->freeMemory = free;
    callbacks->componentEnvironment = fmu;
    fmu->subject = subject;
    fmu->kind = kind;
    fmu->own = callbacks;
    fmu->instance = fmi.Instantiate(name, kind == MODEL_EXCHANGE ? fmi2ModelExchange : fmi2CoSimulation, token,
                                    "file:///nowhere/resources", callbacks, fmi2False, fmi2True);
    return fmu->instance;
}

void fmu_free(Fmu *fmu) {
    fmi.FreeInstance(fmu->instance);
    free(fmu->own);
}

const char *fmu_version(void) { return fmi.GetVersion(); }

Status fmu_set_logging(Fmu *fmu, bool on, size_t n, const char *const *categories) {
    return (Status)fmi.SetDebugLogging(fmu->instance, on, n, categories);
}

Status fmu_initialize(Fmu *fmu, double start_time, double stop_time, double tolerance) {
    const Status status =
        (Status)fmi.SetupExperiment(fmu->instance, fmi2True, tolerance, start_time, !isinf(stop_time), stop_time);

    return status == OK ? (Status)fmi.EnterInitializationMode(fmu->instance) : status;
}

Status fmu_exit_initialization(Fmu *fmu) { return (Status)fmi.ExitInitializationMode(fmu->instance); }

Status fmu_terminate(Fmu *fmu) { return (Status)fmi.Terminate(fmu->instance); }

Status fmu_reset(Fmu *fmu) { return (Status)fmi.Reset(fmu->instance); }

Status fmu_get(Fmu *fmu, const unsigned int *references, size_t n, double *values) {
    return (Status)fmi.GetReal(fmu->instance, references, n, values);
}

Status fmu_set(Fmu *fmu, const unsigned int *references, size_t n, const double *values) {
    return (Status)fmi.SetReal(fmu->instance, references, n, values);
}

Status fmu_get_integer(Fmu *fmu, const unsigned int *reference, int *value) {
    return (Status)fmi.GetInteger(fmu->instance, reference, 1, value);
}

Status fmu_set_integer(Fmu *fmu, const unsigned int *reference, const int *value) {
    return (Status)fmi.SetInteger(fmu->instance, reference, 1, value);
}

Status fmu_directional(Fmu *fmu, const Group *unknowns, const Group *knowns, const double *seed, double *sensitivity) {
    return (Status)fmi.GetDirectionalDerivative(fmu->instance, unknowns->references, unknowns->n, knowns->references, knowns->n,
                                                seed, sensitivity);
}

Status fmu_event_mode(Fmu *fmu) { return (Status)fmi.EnterEventMode(fmu->instance); }

Status fmu_settle(Fmu *fmu) {
    fmi2EventInfo info = {.newDiscreteStatesNeeded = fmi2True};
    Status status = OK;

    while (status == OK && info.newDiscreteStatesNeeded) status = (Status)fmi.NewDiscreteStates(fmu->instance, &info);
    return status;
}

Status fmu_continuous_mode(Fmu *fmu) { return (Status)fmi.EnterContinuousTimeMode(fmu->instance); }

Status fmu_completed_step(Fmu *fmu) {
    fmi2Boolean event = fmi2True, terminate = fmi2True;
    const Status status = (Status)fmi.CompletedIntegratorStep(fmu->instance, fmi2True, &event, &terminate);

    return event || terminate ? ERROR : status;
}

Status fmu_set_time(Fmu *fmu, double time) { return (Status)fmi.SetTime(fmu->instance, time); }

Status fmu_set_states(Fmu *fmu, const double *x, size_t n) { return (Status)fmi.SetContinuousStates(fmu->instance, x, n); }

Status fmu_get_states(Fmu *fmu, double *x, size_t n) { return (Status)fmi.GetContinuousStates(fmu->instance, x, n); }

Status fmu_get_derivatives(Fmu *fmu, double *dx, size_t n) { return (Status)fmi.GetDerivatives(fmu->instance, dx, n); }

Status fmu_get_nominals(Fmu *fmu, double *nominals, size_t n) {
    return (Status)fmi.GetNominalsOfContinuousStates(fmu->instance, nominals, n);
}

Status fmu_step(Fmu *fmu, double time, double h) { return (Status)fmi.DoStep(fmu->instance, time, h, fmi2True); }

Status fmu_output_derivatives(Fmu *fmu, const Group *unknowns, int order, double *values) {
    int orders[MOST];
    size_t i;

    for (i = 0; i < unknowns->n; i++) orders[i] = order;
    return (Status)fmi.GetRealOutputDerivatives(fmu->instance, unknowns->references, unknowns->n, orders, values);
}

Status fmu_save(Fmu *fmu, void **state) { return (Status)fmi.GetFMUstate(fmu->instance, state); }

Status fmu_restore(Fmu *fmu, void *state) { return (Status)fmi.SetFMUstate(fmu->instance, state); }

Status fmu_discard(Fmu *fmu, void **state) { return (Status)fmi.FreeFMUstate(fmu->instance, state); }

Status fmu_serialized_size(Fmu *fmu, void *state, size_t *size) {
    return (Status)fmi.SerializedFMUstateSize(fmu->instance, state, size);
}

Status fmu_serialize(Fmu *fmu, void *state, unsigned char *bytes, size_t size) {
    return (Status)fmi.SerializeFMUstate(fmu->instance, state, (char *)bytes, size);
}

Status fmu_deserialize(Fmu *fmu, const unsigned char *bytes, size_t size, void **state) {
    return (Status)fmi.DeSerializeFMUstate(fmu->instance, (const char *)bytes, size, state);
}

void fmu_own_life(Fmu *fmu) {
    double reached;

    printf("platform: %s\n", fmi.GetTypesPlatform());
    if (fmu->kind == CO_SIMULATION) {
        must(fmu, (Status)fmi.GetRealStatus(fmu->instance, fmi2LastSuccessfulTime, &reached), "get the time reached");
        print_values("reached", &reached, 1);
    } else {
        must(fmu, (Status)fmi.GetEventIndicators(fmu->instance, NULL, 0), "get no event indicators");
    }
}

void fmu_own_misuse(Fmu *fmu) {
    const unsigned int friction = reference_of(fmu->subject, "mu");
    const fmi2Integer order = 1;
    const fmi2String word = "word";
    fmi2Boolean flag = fmi2True;
    fmi2String text;
    double value = 0.0;
    fmi2Status status;
    int number;

    refused(fmu, "get a Boolean", (Status)fmi.GetBoolean(fmu->instance, &friction, 1, &flag));
    refused(fmu, "get a String", (Status)fmi.GetString(fmu->instance, &friction, 1, &text));
    if (fmu->kind == MODEL_EXCHANGE) {
        refused(fmu, "get an event indicator", (Status)fmi.GetEventIndicators(fmu->instance, &value, 1));
        return;
    }
    refused(fmu, "set a Boolean", (Status)fmi.SetBoolean(fmu->instance, &friction, 1, &flag));
    refused(fmu, "set a String", (Status)fmi.SetString(fmu->instance, &friction, 1, &word));
    refused(fmu, "set input derivatives", (Status)fmi.SetRealInputDerivatives(fmu->instance, &friction, 1, &order, &value));
    refused(fmu, "ask for derivatives of no order",
            (Status)fmi.GetRealOutputDerivatives(fmu->instance, &friction, 1, NULL, &value));
    refused(fmu, "cancel a step", (Status)fmi.CancelStep(fmu->instance));
    refused(fmu, "ask for the status of a step", (Status)fmi.GetStatus(fmu->instance, fmi2DoStepStatus, &status));
    refused(fmu, "ask for a time nowhere", (Status)fmi.GetRealStatus(fmu->instance, fmi2LastSuccessfulTime, NULL));
    refused(fmu, "ask for an Integer status", (Status)fmi.GetIntegerStatus(fmu->instance, fmi2DoStepStatus, &number));
    refused(fmu, "ask for a Boolean status", (Status)fmi.GetBooleanStatus(fmu->instance, fmi2Terminated, &flag));
    refused(fmu, "ask for a String status", (Status)fmi.GetStringStatus(fmu->instance, fmi2PendingStatus, &text));
}
