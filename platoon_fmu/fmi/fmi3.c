/* FMI 3.0, Model Exchange and Co-Simulation: the thin face of the core. */
#include <math.h>
#include <stdlib.h>
#include <string.h>

#include "core.h"
#include "fmi3Functions.h"

/* The importer's data of an instance. */
typedef struct {
    fmi3InstanceEnvironment environment;
    fmi3LogMessageCallback log;
    fmi3IntermediateUpdateCallback intermediate_update;
    bool early_return_allowed;
} Host;

/* ---- which call is allowed when: FMI 3.0.2, the state machines of sections 2.3, 3.2.1 and 4.2.1 ---- */

#define BEFORE_START (INSTANTIATED | INITIALIZATION)
#define SIMULATED_ME (EVENT | CONTINUOUS | TERMINATED | FAILED)
#define SIMULATED_CS (STEPPING | TERMINATED | FAILED)
#define BETWEEN_CALLS (ANY_PHASE & ~INTERMEDIATE)
#define SAVEABLE (BETWEEN_CALLS & ~FAILED)

#define RULE(name, function, model_exchange, co_simulation) static const Rule name = {#function, model_exchange, co_simulation}

RULE(INSTANTIATE_ME, fmi3InstantiateModelExchange, 0, 0);
RULE(INSTANTIATE_CS, fmi3InstantiateCoSimulation, 0, 0);
RULE(INSTANTIATE_SE, fmi3InstantiateScheduledExecution, 0, 0);
RULE(SET_DEBUG_LOGGING, fmi3SetDebugLogging, ANY_PHASE, ANY_PHASE);
RULE(ENTER_INITIALIZATION, fmi3EnterInitializationMode, INSTANTIATED, INSTANTIATED);
RULE(EXIT_INITIALIZATION, fmi3ExitInitializationMode, INITIALIZATION, INITIALIZATION);
RULE(TERMINATE, fmi3Terminate, EVENT | CONTINUOUS, STEPPING);
RULE(RESET, fmi3Reset, ANY_PHASE, BETWEEN_CALLS);
RULE(GET_FLOAT64, fmi3GetFloat64, ANY_PHASE, ANY_PHASE);
RULE(GET_INT64, fmi3GetInt64, ANY_PHASE, ANY_PHASE);
RULE(SET_FLOAT64, fmi3SetFloat64, BEFORE_START | EVENT | CONTINUOUS, BEFORE_START | STEPPING);
RULE(SET_INT64, fmi3SetInt64, BEFORE_START | EVENT, BEFORE_START | STEPPING);
RULE(GET_FMU_STATE, fmi3GetFMUState, SAVEABLE, SAVEABLE);
RULE(SET_FMU_STATE, fmi3SetFMUState, ANY_PHASE, BETWEEN_CALLS);
RULE(FREE_FMU_STATE, fmi3FreeFMUState, ANY_PHASE, ANY_PHASE);
RULE(SERIALIZED_SIZE, fmi3SerializedFMUStateSize, ANY_PHASE, BETWEEN_CALLS);
RULE(SERIALIZE, fmi3SerializeFMUState, ANY_PHASE, BETWEEN_CALLS);
RULE(DESERIALIZE, fmi3DeserializeFMUState, ANY_PHASE, BETWEEN_CALLS);
RULE(DIRECTIONAL_DERIVATIVE, fmi3GetDirectionalDerivative, INITIALIZATION | SIMULATED_ME, INITIALIZATION | SIMULATED_CS);
RULE(ADJOINT_DERIVATIVE, fmi3GetAdjointDerivative, INITIALIZATION | SIMULATED_ME, INITIALIZATION | SIMULATED_CS);
RULE(ENTER_EVENT, fmi3EnterEventMode, EVENT | CONTINUOUS, 0);
RULE(UPDATE_DISCRETE_STATES, fmi3UpdateDiscreteStates, EVENT, 0);
RULE(ENTER_CONTINUOUS, fmi3EnterContinuousTimeMode, EVENT, 0);
RULE(COMPLETED_STEP, fmi3CompletedIntegratorStep, CONTINUOUS, 0);
RULE(SET_TIME, fmi3SetTime, CONTINUOUS, 0);
RULE(SET_STATES, fmi3SetContinuousStates, CONTINUOUS, 0);
RULE(GET_DERIVATIVES, fmi3GetContinuousStateDerivatives, INITIALIZATION | SIMULATED_ME, 0);
RULE(GET_EVENT_INDICATORS, fmi3GetEventIndicators, INITIALIZATION | SIMULATED_ME, 0);
RULE(GET_STATES, fmi3GetContinuousStates, INITIALIZATION | SIMULATED_ME, 0);
RULE(GET_NOMINALS, fmi3GetNominalsOfContinuousStates, BEFORE_START | SIMULATED_ME, 0);
RULE(GET_N_INDICATORS, fmi3GetNumberOfEventIndicators, ANY_PHASE, 0);
RULE(GET_N_STATES, fmi3GetNumberOfContinuousStates, ANY_PHASE, 0);
RULE(GET_OUTPUT_DERIVATIVES, fmi3GetOutputDerivatives, 0, STEPPING | INTERMEDIATE | TERMINATED);
RULE(DO_STEP, fmi3DoStep, 0, STEPPING);

static fmi3Status status_of(bool done) { return done ? fmi3OK : fmi3Error; }

/* Whether the call is allowed now and has as many values as variables, which are all scalar. */
static bool has_values(const Instance *instance, const Rule *rule, size_t n_references, size_t n) {
    if (!core_allows(instance, rule)) return false;
    if (n == n_references) return true;
    return core_refuse(instance, rule, "all variables are scalar, so there must be %lu values, not %lu.",
                       (unsigned long)n_references, (unsigned long)n);
}

/* ---- life cycle ---- */

static void to_importer(const Instance *instance, LogCategory category, const char *text) {
    const Host *host = instance->host;

    if (!host->log) return;
    host->log(host->environment, category == LOG_ERRORS ? fmi3Error : fmi3OK, core_category_name(category), text);
}

const char *fmi3GetVersion(void) { return fmi3Version; }

/* A new instance, or NULL with the reason logged. */
static Instance *instantiate(const Rule *rule, Kind kind, fmi3String name, fmi3String token, Host *given) {
    const Instance nobody = {.name = "(none)", .sink = to_importer, .logged = LOG_ERRORS, .host = given};
    Instance *instance;
    Host *host;

    if (!name || !*name) {
        core_refuse(&nobody, rule, "the instance name is missing.");
        return NULL;
    }
    if (!token || strcmp(token, platoon_model.token) != 0) {
        core_refuse(&nobody, rule, "the instantiation token %s is not this binary's %s.", token ? token : "(none)",
                    platoon_model.token);
        return NULL;
    }
    host = malloc(sizeof *host);
    instance = host ? core_new(&platoon_model, kind, name, to_importer, host) : NULL;
    if (!instance) {
        core_refuse(&nobody, rule, "out of memory.");
        free(host);
        return NULL;
    }
    *host = *given;
    /* Errors are logged even if logging is off (FMI 3.0.2, section 2.2.4). */
    instance->logged = LOG_ERRORS;
    return instance;
}

static void release(Instance *instance) {
    if (!instance) return;
    free(instance->host);
    core_free(instance);
}

fmi3Instance fmi3InstantiateModelExchange(fmi3String instanceName, fmi3String instantiationToken, fmi3String resourcePath,
                                          fmi3Boolean visible, fmi3Boolean loggingOn,
                                          fmi3InstanceEnvironment instanceEnvironment, fmi3LogMessageCallback logMessage) {
    Host host = {.environment = instanceEnvironment, .log = logMessage};

    (void)resourcePath;
    (void)visible;
    (void)loggingOn;
    return instantiate(&INSTANTIATE_ME, MODEL_EXCHANGE, instanceName, instantiationToken, &host);
}

fmi3Instance fmi3InstantiateCoSimulation(fmi3String instanceName, fmi3String instantiationToken, fmi3String resourcePath,
                                         fmi3Boolean visible, fmi3Boolean loggingOn, fmi3Boolean eventModeUsed,
                                         fmi3Boolean earlyReturnAllowed,
                                         const fmi3ValueReference requiredIntermediateVariables[],
                                         size_t nRequiredIntermediateVariables, fmi3InstanceEnvironment instanceEnvironment,
                                         fmi3LogMessageCallback logMessage, fmi3IntermediateUpdateCallback intermediateUpdate) {
    Host host = {.environment = instanceEnvironment,
                 .log = logMessage,
                 .intermediate_update = intermediateUpdate,
                 .early_return_allowed = earlyReturnAllowed};
    Instance *instance = instantiate(&INSTANTIATE_CS, CO_SIMULATION, instanceName, instantiationToken, &host);
    size_t i;

    (void)resourcePath;
    (void)visible;
    (void)loggingOn;
    if (!instance) return NULL;
    if (eventModeUsed) {
        core_refuse(instance, &INSTANTIATE_CS, "there is no event mode (hasEventMode is false).");
    } else if (nRequiredIntermediateVariables > 0 && !requiredIntermediateVariables) {
        core_refuse(instance, &INSTANTIATE_CS, "the intermediate variables are missing.");
    } else {
        for (i = 0; i < nRequiredIntermediateVariables; i++) {
            if (!core_is_unknown(instance, requiredIntermediateVariables[i])) {
                core_refuse(instance, &INSTANTIATE_CS, "value reference %u is not available in intermediate updates.",
                            requiredIntermediateVariables[i]);
                break;
            }
        }
        if (i == nRequiredIntermediateVariables) return instance;
    }
    /* Not by the standard's function: the linker might choose another library's. */
    release(instance);
    return NULL;
}

fmi3Instance fmi3InstantiateScheduledExecution(fmi3String instanceName, fmi3String instantiationToken, fmi3String resourcePath,
                                               fmi3Boolean visible, fmi3Boolean loggingOn,
                                               fmi3InstanceEnvironment instanceEnvironment, fmi3LogMessageCallback logMessage,
                                               fmi3ClockUpdateCallback clockUpdate, fmi3LockPreemptionCallback lockPreemption,
                                               fmi3UnlockPreemptionCallback unlockPreemption) {
    Host host = {.environment = instanceEnvironment, .log = logMessage};
    const Instance nobody = {.name = "(none)", .sink = to_importer, .logged = LOG_ERRORS, .host = &host};

    (void)instanceName;
    (void)instantiationToken;
    (void)resourcePath;
    (void)visible;
    (void)loggingOn;
    (void)clockUpdate;
    (void)lockPreemption;
    (void)unlockPreemption;
    core_refuse(&nobody, &INSTANTIATE_SE, "this FMU is for Model Exchange and Co-Simulation.");
    return NULL;
}

void fmi3FreeInstance(fmi3Instance i) { release(i); }

fmi3Status fmi3SetDebugLogging(fmi3Instance i, fmi3Boolean loggingOn, size_t nCategories, const fmi3String categories[]) {
    Instance *instance = i;

    if (!core_set_logging(instance, &SET_DEBUG_LOGGING, loggingOn, nCategories, categories)) return fmi3Error;
    instance->logged |= LOG_ERRORS;
    return fmi3OK;
}

fmi3Status fmi3EnterInitializationMode(fmi3Instance i, fmi3Boolean toleranceDefined, fmi3Float64 tolerance,
                                       fmi3Float64 startTime, fmi3Boolean stopTimeDefined, fmi3Float64 stopTime) {
    return status_of(core_set_experiment(i, &ENTER_INITIALIZATION, toleranceDefined ? tolerance : (double)INFINITY, startTime,
                                         stopTimeDefined ? stopTime : (double)INFINITY) &&
                     core_enter(i, &ENTER_INITIALIZATION, INITIALIZATION, INITIALIZATION));
}

fmi3Status fmi3ExitInitializationMode(fmi3Instance i) {
    return status_of(core_enter(i, &EXIT_INITIALIZATION, EVENT, STEPPING));
}

fmi3Status fmi3Terminate(fmi3Instance i) { return status_of(core_enter(i, &TERMINATE, TERMINATED, TERMINATED)); }

fmi3Status fmi3Reset(fmi3Instance i) { return status_of(core_reset(i, &RESET)); }

/* ---- values: Float64, and Int64 for enumerations ---- */

fmi3Status fmi3GetFloat64(fmi3Instance i, const fmi3ValueReference valueReferences[], size_t nValueReferences,
                          fmi3Float64 values[], size_t nValues) {
    return status_of(has_values(i, &GET_FLOAT64, nValueReferences, nValues) &&
                     core_get(i, &GET_FLOAT64, valueReferences, nValues, values));
}

fmi3Status fmi3SetFloat64(fmi3Instance i, const fmi3ValueReference valueReferences[], size_t nValueReferences,
                          const fmi3Float64 values[], size_t nValues) {
    return status_of(has_values(i, &SET_FLOAT64, nValueReferences, nValues) &&
                     core_set(i, &SET_FLOAT64, valueReferences, nValues, values));
}

fmi3Status fmi3GetInt64(fmi3Instance i, const fmi3ValueReference valueReferences[], size_t nValueReferences, fmi3Int64 values[],
                        size_t nValues) {
    size_t k;
    int value;

    if (!has_values(i, &GET_INT64, nValueReferences, nValues)) return fmi3Error;
    if (!core_has_arrays(i, &GET_INT64, nValues, valueReferences, values)) return fmi3Error;
    for (k = 0; k < nValues; k++) {
        if (!core_get_integer(i, &GET_INT64, valueReferences[k], &value)) return fmi3Error;
        values[k] = value;
    }
    return fmi3OK;
}

fmi3Status fmi3SetInt64(fmi3Instance i, const fmi3ValueReference valueReferences[], size_t nValueReferences,
                        const fmi3Int64 values[], size_t nValues) {
    size_t k;

    if (!has_values(i, &SET_INT64, nValueReferences, nValues)) return fmi3Error;
    if (!core_has_arrays(i, &SET_INT64, nValues, valueReferences, values)) return fmi3Error;
    for (k = 0; k < nValues; k++) {
        if (!core_can_set_integer(i, &SET_INT64, valueReferences[k], (double)values[k])) return fmi3Error;
    }
    for (k = 0; k < nValues; k++) core_set_integer(i, (int)values[k]);
    return fmi3OK;
}

/* Getter and setter for a type without variables. */
#define NO_SUCH_TYPE(Type)                                                                                        \
    fmi3Status fmi3Get##Type(fmi3Instance i, const fmi3ValueReference valueReferences[], size_t nValueReferences, \
                             fmi3##Type values[], size_t nValues) {                                               \
        RULE(rule, fmi3Get##Type, ANY_PHASE, ANY_PHASE);                                                          \
        (void)valueReferences;                                                                                    \
        (void)values;                                                                                             \
        (void)nValues;                                                                                            \
        return status_of(core_has_none(i, &rule, nValueReferences));                                              \
    }                                                                                                             \
    fmi3Status fmi3Set##Type(fmi3Instance i, const fmi3ValueReference valueReferences[], size_t nValueReferences, \
                             const fmi3##Type values[], size_t nValues) {                                         \
        RULE(rule, fmi3Set##Type, ANY_PHASE, BETWEEN_CALLS);                                                      \
        (void)valueReferences;                                                                                    \
        (void)values;                                                                                             \
        (void)nValues;                                                                                            \
        return status_of(core_has_none(i, &rule, nValueReferences));                                              \
    }

NO_SUCH_TYPE(Float32)
NO_SUCH_TYPE(Int8)
NO_SUCH_TYPE(UInt8)
NO_SUCH_TYPE(Int16)
NO_SUCH_TYPE(UInt16)
NO_SUCH_TYPE(Int32)
NO_SUCH_TYPE(UInt32)
NO_SUCH_TYPE(UInt64)
NO_SUCH_TYPE(Boolean)
NO_SUCH_TYPE(String)

fmi3Status fmi3GetBinary(fmi3Instance i, const fmi3ValueReference valueReferences[], size_t nValueReferences,
                         size_t valueSizes[], fmi3Binary values[], size_t nValues) {
    RULE(rule, fmi3GetBinary, ANY_PHASE, ANY_PHASE);
    (void)valueReferences;
    (void)valueSizes;
    (void)values;
    (void)nValues;
    return status_of(core_has_none(i, &rule, nValueReferences));
}

fmi3Status fmi3SetBinary(fmi3Instance i, const fmi3ValueReference valueReferences[], size_t nValueReferences,
                         const size_t valueSizes[], const fmi3Binary values[], size_t nValues) {
    RULE(rule, fmi3SetBinary, ANY_PHASE, BETWEEN_CALLS);
    (void)valueReferences;
    (void)valueSizes;
    (void)values;
    (void)nValues;
    return status_of(core_has_none(i, &rule, nValueReferences));
}

fmi3Status fmi3GetClock(fmi3Instance i, const fmi3ValueReference valueReferences[], size_t nValueReferences,
                        fmi3Clock values[]) {
    RULE(rule, fmi3GetClock, ANY_PHASE, ANY_PHASE);
    (void)valueReferences;
    (void)values;
    return status_of(core_has_none(i, &rule, nValueReferences));
}

fmi3Status fmi3SetClock(fmi3Instance i, const fmi3ValueReference valueReferences[], size_t nValueReferences,
                        const fmi3Clock values[]) {
    RULE(rule, fmi3SetClock, ANY_PHASE, BETWEEN_CALLS);
    (void)valueReferences;
    (void)values;
    return status_of(core_has_none(i, &rule, nValueReferences));
}

/* ---- states and derivatives ---- */

fmi3Status fmi3GetFMUState(fmi3Instance i, fmi3FMUState *FMUState) {
    return status_of(core_save(i, &GET_FMU_STATE, (State **)FMUState));
}

fmi3Status fmi3SetFMUState(fmi3Instance i, fmi3FMUState FMUState) {
    return status_of(core_restore(i, &SET_FMU_STATE, FMUState));
}

fmi3Status fmi3FreeFMUState(fmi3Instance i, fmi3FMUState *FMUState) {
    return status_of(core_discard(i, &FREE_FMU_STATE, (State **)FMUState));
}

fmi3Status fmi3SerializedFMUStateSize(fmi3Instance i, fmi3FMUState FMUState, size_t *size) {
    (void)FMUState;
    return status_of(core_serialized_size(i, &SERIALIZED_SIZE, size));
}

fmi3Status fmi3SerializeFMUState(fmi3Instance i, fmi3FMUState FMUState, fmi3Byte serializedState[], size_t size) {
    return status_of(core_serialize(i, &SERIALIZE, FMUState, serializedState, size));
}

fmi3Status fmi3DeserializeFMUState(fmi3Instance i, const fmi3Byte serializedState[], size_t size, fmi3FMUState *FMUState) {
    return status_of(core_deserialize(i, &DESERIALIZE, serializedState, size, (State **)FMUState));
}

fmi3Status fmi3GetDirectionalDerivative(fmi3Instance i, const fmi3ValueReference unknowns[], size_t nUnknowns,
                                        const fmi3ValueReference knowns[], size_t nKnowns, const fmi3Float64 seed[],
                                        size_t nSeed, fmi3Float64 sensitivity[], size_t nSensitivity) {
    return status_of(
        has_values(i, &DIRECTIONAL_DERIVATIVE, nKnowns, nSeed) &&
        has_values(i, &DIRECTIONAL_DERIVATIVE, nUnknowns, nSensitivity) &&
        core_differentiate(i, &DIRECTIONAL_DERIVATIVE, false, unknowns, nUnknowns, knowns, nKnowns, seed, sensitivity));
}

fmi3Status fmi3GetAdjointDerivative(fmi3Instance i, const fmi3ValueReference unknowns[], size_t nUnknowns,
                                    const fmi3ValueReference knowns[], size_t nKnowns, const fmi3Float64 seed[], size_t nSeed,
                                    fmi3Float64 sensitivity[], size_t nSensitivity) {
    return status_of(has_values(i, &ADJOINT_DERIVATIVE, nUnknowns, nSeed) &&
                     has_values(i, &ADJOINT_DERIVATIVE, nKnowns, nSensitivity) &&
                     core_differentiate(i, &ADJOINT_DERIVATIVE, true, unknowns, nUnknowns, knowns, nKnowns, seed, sensitivity));
}

/* ---- Model Exchange ---- */

fmi3Status fmi3EnterEventMode(fmi3Instance i) { return status_of(core_enter(i, &ENTER_EVENT, EVENT, EVENT)); }

fmi3Status fmi3UpdateDiscreteStates(fmi3Instance i, fmi3Boolean *discreteStatesNeedUpdate, fmi3Boolean *terminateSimulation,
                                    fmi3Boolean *nominalsOfContinuousStatesChanged,
                                    fmi3Boolean *valuesOfContinuousStatesChanged, fmi3Boolean *nextEventTimeDefined,
                                    fmi3Float64 *nextEventTime) {
    const void *places[] = {discreteStatesNeedUpdate,        terminateSimulation,  nominalsOfContinuousStatesChanged,
                            valuesOfContinuousStatesChanged, nextEventTimeDefined, nextEventTime};

    if (!core_has_places(i, &UPDATE_DISCRETE_STATES, sizeof places / sizeof *places, places)) return fmi3Error;
    *discreteStatesNeedUpdate = fmi3False;
    *terminateSimulation = fmi3False;
    *nominalsOfContinuousStatesChanged = fmi3False;
    *valuesOfContinuousStatesChanged = fmi3False;
    *nextEventTimeDefined = fmi3False;
    *nextEventTime = 0;
    return fmi3OK;
}

fmi3Status fmi3EnterContinuousTimeMode(fmi3Instance i) {
    return status_of(core_enter(i, &ENTER_CONTINUOUS, CONTINUOUS, CONTINUOUS));
}

fmi3Status fmi3CompletedIntegratorStep(fmi3Instance i, fmi3Boolean noSetFMUStatePriorToCurrentPoint,
                                       fmi3Boolean *enterEventMode, fmi3Boolean *terminateSimulation) {
    (void)noSetFMUStatePriorToCurrentPoint;
    if (!core_has_places(i, &COMPLETED_STEP, 2, (const void *[]){enterEventMode, terminateSimulation})) return fmi3Error;
    *enterEventMode = fmi3False;
    *terminateSimulation = fmi3False;
    return fmi3OK;
}

fmi3Status fmi3SetTime(fmi3Instance i, fmi3Float64 time) { return status_of(core_set_time(i, &SET_TIME, time)); }

fmi3Status fmi3SetContinuousStates(fmi3Instance i, const fmi3Float64 continuousStates[], size_t nContinuousStates) {
    return status_of(core_set_states(i, &SET_STATES, continuousStates, nContinuousStates));
}

fmi3Status fmi3GetContinuousStateDerivatives(fmi3Instance i, fmi3Float64 derivatives[], size_t nContinuousStates) {
    return status_of(core_get_derivatives(i, &GET_DERIVATIVES, derivatives, nContinuousStates));
}

fmi3Status fmi3GetEventIndicators(fmi3Instance i, fmi3Float64 eventIndicators[], size_t nEventIndicators) {
    (void)eventIndicators;
    return status_of(core_has_none(i, &GET_EVENT_INDICATORS, nEventIndicators));
}

fmi3Status fmi3GetContinuousStates(fmi3Instance i, fmi3Float64 continuousStates[], size_t nContinuousStates) {
    return status_of(core_get_states(i, &GET_STATES, continuousStates, nContinuousStates));
}

fmi3Status fmi3GetNominalsOfContinuousStates(fmi3Instance i, fmi3Float64 nominals[], size_t nContinuousStates) {
    return status_of(core_get_nominals(i, &GET_NOMINALS, nominals, nContinuousStates));
}

static fmi3Status give_number(fmi3Instance i, const Rule *rule, size_t number, size_t *place) {
    if (!core_has_places(i, rule, 1, (const void *[]){place})) return fmi3Error;
    *place = number;
    return fmi3OK;
}

fmi3Status fmi3GetNumberOfEventIndicators(fmi3Instance i, size_t *nEventIndicators) {
    return give_number(i, &GET_N_INDICATORS, 0, nEventIndicators);
}

fmi3Status fmi3GetNumberOfContinuousStates(fmi3Instance i, size_t *nContinuousStates) {
    return give_number(i, &GET_N_STATES, platoon_model.n_states, nContinuousStates);
}

/* ---- Co-Simulation ---- */

fmi3Status fmi3GetOutputDerivatives(fmi3Instance i, const fmi3ValueReference valueReferences[], size_t nValueReferences,
                                    const fmi3Int32 orders[], fmi3Float64 values[], size_t nValues) {
    return status_of(has_values(i, &GET_OUTPUT_DERIVATIVES, nValueReferences, nValues) &&
                     core_time_derivatives(i, &GET_OUTPUT_DERIVATIVES, valueReferences, nValues, orders, values));
}

/* Lets the importer read the instance after a step of the solver and request an early return. */
static double intermediate_update(Instance *instance, double end) {
    const Host *host = instance->host;
    const bool can_return = host->early_return_allowed && instance->status.time < end;
    fmi3Boolean requested = fmi3False;
    fmi3Float64 wish = instance->status.time;

    host->intermediate_update(host->environment, instance->status.time, fmi3False, fmi3True, fmi3True, can_return, &requested,
                              &wish);
    return can_return && requested ? wish : end;
}

fmi3Status fmi3DoStep(fmi3Instance i, fmi3Float64 currentCommunicationPoint, fmi3Float64 communicationStepSize,
                      fmi3Boolean noSetFMUStatePriorToCurrentPoint, fmi3Boolean *eventHandlingNeeded,
                      fmi3Boolean *terminateSimulation, fmi3Boolean *earlyReturn, fmi3Float64 *lastSuccessfulTime) {
    const fmi3Float64 end = currentCommunicationPoint + communicationStepSize;
    const void *places[] = {eventHandlingNeeded, terminateSimulation, earlyReturn, lastSuccessfulTime};
    const Instance *instance = i;
    const Host *host;

    (void)noSetFMUStatePriorToCurrentPoint;
    if (!core_has_places(instance, &DO_STEP, sizeof places / sizeof *places, places)) return fmi3Error;
    host = instance->host;
    if (!core_step(i, &DO_STEP, currentCommunicationPoint, communicationStepSize,
                   host->intermediate_update ? intermediate_update : NULL)) {
        return fmi3Error;
    }
    *eventHandlingNeeded = fmi3False;
    *terminateSimulation = fmi3False;
    *lastSuccessfulTime = instance->status.time;
    *earlyReturn = instance->status.time < end;
    return fmi3OK;
}

/* ---- not supported by this FMU (see its capability flags): clocks, event mode in Co-Simulation, structural parameters ---- */

static fmi3Status not_provided(fmi3Instance i, const Rule *rule) {
    if (i) core_refuse(i, rule, "not provided by this FMU (see its capability flags).");
    return fmi3Error;
}

#define NOT_PROVIDED(Function)            \
    fmi3Status Function(fmi3Instance i) { \
        RULE(rule, Function, 0, 0);       \
        return not_provided(i, &rule);    \
    }

NOT_PROVIDED(fmi3EnterConfigurationMode)
NOT_PROVIDED(fmi3ExitConfigurationMode)
NOT_PROVIDED(fmi3EvaluateDiscreteStates)
NOT_PROVIDED(fmi3EnterStepMode)

fmi3Status fmi3ActivateModelPartition(fmi3Instance i, fmi3ValueReference clockReference, fmi3Float64 activationTime) {
    RULE(rule, fmi3ActivateModelPartition, 0, 0);
    (void)clockReference;
    (void)activationTime;
    return not_provided(i, &rule);
}

fmi3Status fmi3GetNumberOfVariableDependencies(fmi3Instance i, fmi3ValueReference valueReference, size_t *nDependencies) {
    RULE(rule, fmi3GetNumberOfVariableDependencies, 0, 0);
    (void)valueReference;
    (void)nDependencies;
    return not_provided(i, &rule);
}

fmi3Status fmi3GetVariableDependencies(fmi3Instance i, fmi3ValueReference dependent, size_t elementIndicesOfDependent[],
                                       fmi3ValueReference independents[], size_t elementIndicesOfIndependents[],
                                       fmi3DependencyKind dependencyKinds[], size_t nDependencies) {
    RULE(rule, fmi3GetVariableDependencies, 0, 0);
    (void)dependent;
    (void)elementIndicesOfDependent;
    (void)independents;
    (void)elementIndicesOfIndependents;
    (void)dependencyKinds;
    (void)nDependencies;
    return not_provided(i, &rule);
}

/* A function of clocks, with one or two arrays behind the value references. */
#define NO_CLOCKS_1(Function, First)                                                                                          \
    fmi3Status Function(fmi3Instance i, const fmi3ValueReference valueReferences[], size_t nValueReferences, First first[]) { \
        RULE(rule, Function, ANY_PHASE, ANY_PHASE);                                                                           \
        (void)valueReferences;                                                                                                \
        (void)first;                                                                                                          \
        return status_of(core_has_none(i, &rule, nValueReferences));                                                          \
    }

#define NO_CLOCKS_2(Function, First, Second)                                                                                \
    fmi3Status Function(fmi3Instance i, const fmi3ValueReference valueReferences[], size_t nValueReferences, First first[], \
                        Second second[]) {                                                                                  \
        RULE(rule, Function, ANY_PHASE, ANY_PHASE);                                                                         \
        (void)valueReferences;                                                                                              \
        (void)first;                                                                                                        \
        (void)second;                                                                                                       \
        return status_of(core_has_none(i, &rule, nValueReferences));                                                        \
    }

NO_CLOCKS_2(fmi3GetIntervalDecimal, fmi3Float64, fmi3IntervalQualifier)
NO_CLOCKS_1(fmi3GetShiftDecimal, fmi3Float64)
NO_CLOCKS_2(fmi3GetShiftFraction, fmi3UInt64, fmi3UInt64)
NO_CLOCKS_1(fmi3SetIntervalDecimal, const fmi3Float64)
NO_CLOCKS_2(fmi3SetIntervalFraction, const fmi3UInt64, const fmi3UInt64)
NO_CLOCKS_1(fmi3SetShiftDecimal, const fmi3Float64)
NO_CLOCKS_2(fmi3SetShiftFraction, const fmi3UInt64, const fmi3UInt64)

fmi3Status fmi3GetIntervalFraction(fmi3Instance i, const fmi3ValueReference valueReferences[], size_t nValueReferences,
                                   fmi3UInt64 counters[], fmi3UInt64 resolutions[], fmi3IntervalQualifier qualifiers[]) {
    RULE(rule, fmi3GetIntervalFraction, ANY_PHASE, ANY_PHASE);
    (void)valueReferences;
    (void)counters;
    (void)resolutions;
    (void)qualifiers;
    return status_of(core_has_none(i, &rule, nValueReferences));
}
