/* The model's face for FMI 2.0, Model Exchange and Co-Simulation; calls in the wrong mode are not its subject. */
#include "fmi2FunctionTypes.h"
#include "model.h"

const char *fmi2GetTypesPlatform(void) { return fmi2TypesPlatform; }
const char *fmi2GetVersion(void) { return "2.0"; }

fmi2Component fmi2Instantiate(fmi2String name, fmi2Type type, fmi2String guid, fmi2String resources,
                              const fmi2CallbackFunctions *callbacks, fmi2Boolean visible, fmi2Boolean logging) {
    Model *m = calloc(1, sizeof *m);

    (void)name, (void)type, (void)guid, (void)resources, (void)callbacks, (void)visible, (void)logging;
    model_initialise(m);
    return m;
}

void fmi2FreeInstance(fmi2Component c) { free(c); }

fmi2Status fmi2SetupExperiment(fmi2Component c, fmi2Boolean tolerance_defined, fmi2Real tolerance, fmi2Real start,
                               fmi2Boolean stop_defined, fmi2Real stop) {
    (void)tolerance_defined, (void)tolerance, (void)stop_defined, (void)stop;
    ((Model *)c)->value[TIME] = start;
    return fmi2OK;
}

fmi2Status fmi2EnterInitializationMode(fmi2Component c) { return (void)c, fmi2OK; }
fmi2Status fmi2ExitInitializationMode(fmi2Component c) { return (void)c, fmi2OK; }
fmi2Status fmi2Terminate(fmi2Component c) { return (void)c, fmi2OK; }

#ifndef FAULT_INCOMPLETE
fmi2Status fmi2Reset(fmi2Component c) {
    model_initialise(c);
    return fmi2OK;
}
#endif

fmi2Status fmi2GetReal(fmi2Component c, const fmi2ValueReference vr[], size_t n, fmi2Real value[]) {
    for (size_t i = 0; i < n; i++) {
        if (vr[i] >= VALUES) return fmi2Error;
        value[i] = model_get(c, vr[i]);
    }
    return fmi2OK;
}

fmi2Status fmi2SetReal(fmi2Component c, const fmi2ValueReference vr[], size_t n, const fmi2Real value[]) {
    for (size_t i = 0; i < n; i++) {
        if (!model_can_set(vr[i])) return fmi2Error;
        model_set(c, vr[i], value[i]);
    }
    return fmi2OK;
}

/* ---- states and derivatives ---- */

fmi2Status fmi2GetFMUstate(fmi2Component c, fmi2FMUstate *state) {
    if (!*state) *state = malloc(sizeof(State));
    *(State *)*state = model_save(c);
    return fmi2OK;
}

fmi2Status fmi2SetFMUstate(fmi2Component c, fmi2FMUstate state) {
    model_restore(c, state);
    return fmi2OK;
}

fmi2Status fmi2FreeFMUstate(fmi2Component c, fmi2FMUstate *state) {
    (void)c;
    free(*state);
    *state = NULL;
    return fmi2OK;
}

fmi2Status fmi2SerializedFMUstateSize(fmi2Component c, fmi2FMUstate state, size_t *size) {
    (void)c, (void)state;
    *size = sizeof(State);
    return fmi2OK;
}

fmi2Status fmi2SerializeFMUstate(fmi2Component c, fmi2FMUstate state, fmi2Byte bytes[], size_t size) {
    (void)c;
    memcpy(bytes, state, size);
    return fmi2OK;
}

fmi2Status fmi2DeSerializeFMUstate(fmi2Component c, const fmi2Byte bytes[], size_t size, fmi2FMUstate *state) {
    (void)c;
    *state = malloc(sizeof(State));
    memcpy(*state, bytes, size);
    return fmi2OK;
}

fmi2Status fmi2GetDirectionalDerivative(fmi2Component c, const fmi2ValueReference unknowns[], size_t m,
                                        const fmi2ValueReference knowns[], size_t n, const fmi2Real seed[],
                                        fmi2Real sensitivity[]) {
    for (size_t i = 0; i < m; i++) {
        sensitivity[i] = 0;
        for (size_t j = 0; j < n; j++) sensitivity[i] += model_partial(c, unknowns[i], knowns[j]) * seed[j];
    }
    return fmi2OK;
}

/* ---- Model Exchange ---- */

fmi2Status fmi2EnterEventMode(fmi2Component c) { return (void)c, fmi2OK; }
fmi2Status fmi2EnterContinuousTimeMode(fmi2Component c) { return (void)c, fmi2OK; }

fmi2Status fmi2NewDiscreteStates(fmi2Component c, fmi2EventInfo *info) {
    (void)c;
    memset(info, 0, sizeof *info);
#ifdef FAULT_UNSETTLED
    info->newDiscreteStatesNeeded = fmi2True;
#endif
#ifdef WITH_TIME_EVENTS
    info->nextEventTimeDefined = fmi2True;
    info->nextEventTime = model_next_event(c);
#endif
    return fmi2OK;
}

fmi2Status fmi2CompletedIntegratorStep(fmi2Component c, fmi2Boolean final, fmi2Boolean *event, fmi2Boolean *end) {
    (void)c, (void) final;
    *event = *end = fmi2False;
    return fmi2OK;
}

fmi2Status fmi2SetTime(fmi2Component c, fmi2Real time) {
    ((Model *)c)->value[TIME] = time;
    return fmi2OK;
}

fmi2Status fmi2SetContinuousStates(fmi2Component c, const fmi2Real x[], size_t n) {
    for (size_t i = 0; i < n; i++) model_set(c, X + i, x[i]);
    return fmi2OK;
}

fmi2Status fmi2GetContinuousStates(fmi2Component c, fmi2Real x[], size_t n) {
    for (size_t i = 0; i < n; i++) x[i] = model_get(c, X + i);
    return fmi2OK;
}

fmi2Status fmi2GetDerivatives(fmi2Component c, fmi2Real dx[], size_t n) {
    for (size_t i = 0; i < n; i++) dx[i] = model_get(c, DER_X + i);
    return fmi2OK;
}

fmi2Status fmi2GetNominalsOfContinuousStates(fmi2Component c, fmi2Real nominal[], size_t n) {
    (void)c;
    for (size_t i = 0; i < n; i++) nominal[i] = 1;
    return fmi2OK;
}

/* ---- Co-Simulation ---- */

fmi2Status fmi2DoStep(fmi2Component c, fmi2Real time, fmi2Real h, fmi2Boolean final) {
    (void)time, (void) final;
    model_step(c, h);
    return fmi2OK;
}

/* ---- what the model does not have ---- */

fmi2Status fmi2SetDebugLogging(void) { return fmi2OK; }

#define NOT_THERE(function) \
    fmi2Status function(void) { return fmi2Error; }

NOT_THERE(fmi2GetInteger)
NOT_THERE(fmi2GetBoolean)
NOT_THERE(fmi2GetString)
NOT_THERE(fmi2SetInteger)
NOT_THERE(fmi2SetBoolean)
NOT_THERE(fmi2SetString)
NOT_THERE(fmi2GetEventIndicators)
NOT_THERE(fmi2SetRealInputDerivatives)
NOT_THERE(fmi2GetRealOutputDerivatives)
NOT_THERE(fmi2CancelStep)
NOT_THERE(fmi2GetStatus)
NOT_THERE(fmi2GetRealStatus)
NOT_THERE(fmi2GetIntegerStatus)
NOT_THERE(fmi2GetBooleanStatus)
NOT_THERE(fmi2GetStringStatus)
