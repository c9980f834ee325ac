/* The model's face for FMI 3.0, Model Exchange and Co-Simulation; calls in the wrong mode are not its subject. */
#include "fmi3FunctionTypes.h"
#include "model.h"

const char *fmi3GetVersion(void) { return "3.0"; }
fmi3Status fmi3SetDebugLogging(void) { return fmi3OK; }

static Model *instance(void) {
    Model *m = calloc(1, sizeof *m);

    model_initialise(m);
    return m;
}

fmi3Instance fmi3InstantiateModelExchange(void) { return instance(); }
fmi3Instance fmi3InstantiateCoSimulation(void) { return instance(); }
fmi3Instance fmi3InstantiateScheduledExecution(void) { return NULL; }
void fmi3FreeInstance(fmi3Instance m) { free(m); }

fmi3Status fmi3EnterInitializationMode(fmi3Instance m, fmi3Boolean tolerance_defined, fmi3Float64 tolerance, fmi3Float64 start,
                                       fmi3Boolean stop_defined, fmi3Float64 stop) {
    (void)tolerance_defined, (void)tolerance, (void)stop_defined, (void)stop;
    ((Model *)m)->value[TIME] = start;
    return fmi3OK;
}

fmi3Status fmi3ExitInitializationMode(fmi3Instance m) { return (void)m, fmi3OK; }
fmi3Status fmi3Terminate(fmi3Instance m) { return (void)m, fmi3OK; }

#ifndef FAULT_INCOMPLETE
fmi3Status fmi3Reset(fmi3Instance m) {
    model_initialise(m);
    return fmi3OK;
}
#endif

/* ---- values: w is an array of two ---- */

static size_t elements(fmi3ValueReference vr) { return vr == W1 ? 2 : 1; }

fmi3Status fmi3GetFloat64(fmi3Instance m, const fmi3ValueReference vr[], size_t n, fmi3Float64 value[], size_t count) {
    for (size_t i = 0; i < n; i++) {
        for (size_t k = 0; k < elements(vr[i]); k++, count--) *value++ = model_get(m, vr[i] + k);
    }
    return count ? fmi3Error : fmi3OK;
}

fmi3Status fmi3SetFloat64(fmi3Instance m, const fmi3ValueReference vr[], size_t n, const fmi3Float64 value[], size_t count) {
    for (size_t i = 0; i < n; i++) {
        if (!model_can_set(vr[i])) return fmi3Error;
        model_set(m, vr[i], value[i]);
    }
    return count == n ? fmi3OK : fmi3Error;
}

/* ---- states and derivatives ---- */

fmi3Status fmi3GetFMUState(fmi3Instance m, fmi3FMUState *state) {
    if (!*state) *state = malloc(sizeof(State));
    *(State *)*state = model_save(m);
    return fmi3OK;
}

fmi3Status fmi3SetFMUState(fmi3Instance m, fmi3FMUState state) {
    model_restore(m, state);
    return fmi3OK;
}

fmi3Status fmi3FreeFMUState(fmi3Instance m, fmi3FMUState *state) {
    (void)m;
    free(*state);
    *state = NULL;
    return fmi3OK;
}

fmi3Status fmi3SerializedFMUStateSize(fmi3Instance m, fmi3FMUState state, size_t *size) {
    (void)m, (void)state;
    *size = sizeof(State);
    return fmi3OK;
}

fmi3Status fmi3SerializeFMUState(fmi3Instance m, fmi3FMUState state, fmi3Byte bytes[], size_t size) {
    (void)m;
    memcpy(bytes, state, size);
    return fmi3OK;
}

fmi3Status fmi3DeserializeFMUState(fmi3Instance m, const fmi3Byte bytes[], size_t size, fmi3FMUState *state) {
    (void)m;
    *state = malloc(sizeof(State));
    memcpy(*state, bytes, size);
    return fmi3OK;
}

fmi3Status fmi3GetDirectionalDerivative(fmi3Instance c, const fmi3ValueReference unknowns[], size_t m,
                                        const fmi3ValueReference knowns[], size_t n, const fmi3Float64 seed[], size_t seeds,
                                        fmi3Float64 sensitivity[], size_t count) {
    for (size_t i = 0; i < m; i++) {
        for (size_t k = 0; k < elements(unknowns[i]); k++, count--, sensitivity++) {
            *sensitivity = 0;
            for (size_t j = 0; j < n; j++) *sensitivity += model_partial(c, unknowns[i] + k, knowns[j]) * seed[j];
        }
    }
    return count || seeds != n ? fmi3Error : fmi3OK;
}

fmi3Status fmi3GetAdjointDerivative(fmi3Instance c, const fmi3ValueReference unknowns[], size_t m,
                                    const fmi3ValueReference knowns[], size_t n, const fmi3Float64 seed[], size_t seeds,
                                    fmi3Float64 sensitivity[], size_t count) {
    for (size_t j = 0; j < n; j++) {
        const fmi3Float64 *s = seed;

        sensitivity[j] = 0;
        for (size_t i = 0; i < m; i++) {
            for (size_t k = 0; k < elements(unknowns[i]); k++) {
                sensitivity[j] += model_partial(c, unknowns[i] + k, knowns[j]) * *s++;
            }
        }
#ifdef FAULT_ADJOINT
        sensitivity[j] *= knowns[j] == U ? 2 : 1;
#endif
        if (s != seed + seeds) return fmi3Error;
    }
    return count == n ? fmi3OK : fmi3Error;
}

/* ---- Model Exchange ---- */

fmi3Status fmi3EnterEventMode(fmi3Instance m) { return (void)m, fmi3OK; }
fmi3Status fmi3EnterContinuousTimeMode(fmi3Instance m) { return (void)m, fmi3OK; }

fmi3Status fmi3UpdateDiscreteStates(fmi3Instance m, fmi3Boolean *again, fmi3Boolean *end, fmi3Boolean *nominals,
                                    fmi3Boolean *values, fmi3Boolean *announced, fmi3Float64 *time) {
    (void)m;
    *again = *end = *nominals = *values = *announced = fmi3False;
    *time = 0;
#ifdef FAULT_UNSETTLED
    *again = fmi3True;
#endif
#ifdef WITH_TIME_EVENTS
    *announced = fmi3True;
    *time = model_next_event(m);
#endif
    return fmi3OK;
}

fmi3Status fmi3CompletedIntegratorStep(fmi3Instance m, fmi3Boolean final, fmi3Boolean *event, fmi3Boolean *end) {
    (void)m, (void) final;
    *event = *end = fmi3False;
    return fmi3OK;
}

fmi3Status fmi3SetTime(fmi3Instance m, fmi3Float64 time) {
    ((Model *)m)->value[TIME] = time;
    return fmi3OK;
}

fmi3Status fmi3SetContinuousStates(fmi3Instance m, const fmi3Float64 x[], size_t n) {
    for (size_t i = 0; i < n; i++) model_set(m, X + i, x[i]);
    return fmi3OK;
}

fmi3Status fmi3GetContinuousStates(fmi3Instance m, fmi3Float64 x[], size_t n) {
    for (size_t i = 0; i < n; i++) x[i] = model_get(m, X + i);
    return fmi3OK;
}

fmi3Status fmi3GetContinuousStateDerivatives(fmi3Instance m, fmi3Float64 dx[], size_t n) {
    for (size_t i = 0; i < n; i++) dx[i] = model_get(m, DER_X + i);
    return fmi3OK;
}

/* ---- Co-Simulation ---- */

fmi3Status fmi3DoStep(fmi3Instance m, fmi3Float64 time, fmi3Float64 h, fmi3Boolean final, fmi3Boolean *event, fmi3Boolean *end,
                      fmi3Boolean *early, fmi3Float64 *last) {
    (void) final;
    model_step(m, h);
    *event = *end = *early = fmi3False;
    *last = time + h;
    return fmi3OK;
}

/* ---- what the model does not have ---- */

#define NOT_THERE(function) \
    fmi3Status function(void) { return fmi3Error; }

NOT_THERE(fmi3ActivateModelPartition)
NOT_THERE(fmi3EnterConfigurationMode)
NOT_THERE(fmi3EnterStepMode)
NOT_THERE(fmi3EvaluateDiscreteStates)
NOT_THERE(fmi3ExitConfigurationMode)
NOT_THERE(fmi3GetEventIndicators)
NOT_THERE(fmi3GetIntervalDecimal)
NOT_THERE(fmi3GetIntervalFraction)
NOT_THERE(fmi3GetNominalsOfContinuousStates)
NOT_THERE(fmi3GetNumberOfContinuousStates)
NOT_THERE(fmi3GetNumberOfEventIndicators)
NOT_THERE(fmi3GetNumberOfVariableDependencies)
NOT_THERE(fmi3GetOutputDerivatives)
NOT_THERE(fmi3GetShiftDecimal)
NOT_THERE(fmi3GetShiftFraction)
NOT_THERE(fmi3GetVariableDependencies)
NOT_THERE(fmi3SetIntervalDecimal)
NOT_THERE(fmi3SetIntervalFraction)
NOT_THERE(fmi3SetShiftDecimal)
NOT_THERE(fmi3SetShiftFraction)

#define NO_TYPE(type) NOT_THERE(fmi3Get##type) NOT_THERE(fmi3Set##type)

NO_TYPE(Float32)
NO_TYPE(Int8)
NO_TYPE(UInt8)
NO_TYPE(Int16)
NO_TYPE(UInt16)
NO_TYPE(Int32)
NO_TYPE(UInt32)
NO_TYPE(Int64)
NO_TYPE(UInt64)
NO_TYPE(Boolean)
NO_TYPE(String)
NO_TYPE(Binary)
NO_TYPE(Clock)
