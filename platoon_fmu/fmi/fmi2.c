/* FMI 2.0, Model Exchange and Co-Simulation: the thin face of the core. */
#include <math.h>
#include <stdlib.h>
#include <string.h>

#include "core.h"
#include "fmi2Functions.h"

/* ---- which call is allowed when: FMI 2.0.4, the tables of sections 3.2.3 and 4.2.4 ---- */

#define BEFORE_START (INSTANTIATED | INITIALIZATION)
#define SIMULATED_ME (EVENT | CONTINUOUS | TERMINATED | FAILED)
#define SIMULATED_CS (STEPPING | TERMINATED | FAILED)
#define SAVEABLE (ANY_PHASE & ~FAILED)

#define RULE(name, function, model_exchange, co_simulation) static const Rule name = {#function, model_exchange, co_simulation}

RULE(INSTANTIATE, fmi2Instantiate, 0, 0);
RULE(SET_DEBUG_LOGGING, fmi2SetDebugLogging, ANY_PHASE, ANY_PHASE);
RULE(SETUP_EXPERIMENT, fmi2SetupExperiment, INSTANTIATED, INSTANTIATED);
RULE(ENTER_INITIALIZATION, fmi2EnterInitializationMode, INSTANTIATED, INSTANTIATED);
RULE(EXIT_INITIALIZATION, fmi2ExitInitializationMode, INITIALIZATION, INITIALIZATION);
RULE(TERMINATE, fmi2Terminate, EVENT | CONTINUOUS, STEPPING);
RULE(RESET, fmi2Reset, ANY_PHASE, ANY_PHASE);
RULE(GET_REAL, fmi2GetReal, INITIALIZATION | SIMULATED_ME, INITIALIZATION | SIMULATED_CS);
RULE(GET_INTEGER, fmi2GetInteger, INITIALIZATION | SIMULATED_ME, INITIALIZATION | SIMULATED_CS);
RULE(GET_BOOLEAN, fmi2GetBoolean, INITIALIZATION | SIMULATED_ME, INITIALIZATION | SIMULATED_CS);
RULE(GET_STRING, fmi2GetString, INITIALIZATION | SIMULATED_ME, INITIALIZATION | SIMULATED_CS);
RULE(SET_REAL, fmi2SetReal, BEFORE_START | EVENT | CONTINUOUS, BEFORE_START | STEPPING);
RULE(SET_INTEGER, fmi2SetInteger, BEFORE_START | EVENT, BEFORE_START | STEPPING);
RULE(SET_BOOLEAN, fmi2SetBoolean, BEFORE_START | EVENT, BEFORE_START | STEPPING);
RULE(SET_STRING, fmi2SetString, BEFORE_START | EVENT, BEFORE_START | STEPPING);
RULE(GET_FMU_STATE, fmi2GetFMUstate, SAVEABLE, SAVEABLE);
RULE(SET_FMU_STATE, fmi2SetFMUstate, ANY_PHASE, ANY_PHASE);
RULE(FREE_FMU_STATE, fmi2FreeFMUstate, ANY_PHASE, ANY_PHASE);
RULE(SERIALIZED_SIZE, fmi2SerializedFMUstateSize, ANY_PHASE, ANY_PHASE);
RULE(SERIALIZE, fmi2SerializeFMUstate, ANY_PHASE, ANY_PHASE);
RULE(DESERIALIZE, fmi2DeSerializeFMUstate, ANY_PHASE, ANY_PHASE);
RULE(DIRECTIONAL_DERIVATIVE, fmi2GetDirectionalDerivative, INITIALIZATION | SIMULATED_ME, INITIALIZATION | SIMULATED_CS);
RULE(ENTER_EVENT, fmi2EnterEventMode, EVENT | CONTINUOUS, 0);
RULE(NEW_DISCRETE_STATES, fmi2NewDiscreteStates, EVENT, 0);
RULE(ENTER_CONTINUOUS, fmi2EnterContinuousTimeMode, EVENT, 0);
RULE(COMPLETED_STEP, fmi2CompletedIntegratorStep, CONTINUOUS, 0);
RULE(SET_TIME, fmi2SetTime, EVENT | CONTINUOUS, 0);
RULE(SET_STATES, fmi2SetContinuousStates, CONTINUOUS, 0);
RULE(GET_DERIVATIVES, fmi2GetDerivatives, INITIALIZATION | SIMULATED_ME, 0);
RULE(GET_EVENT_INDICATORS, fmi2GetEventIndicators, INITIALIZATION | SIMULATED_ME, 0);
RULE(GET_STATES, fmi2GetContinuousStates, INITIALIZATION | SIMULATED_ME, 0);
RULE(GET_NOMINALS, fmi2GetNominalsOfContinuousStates, BEFORE_START | SIMULATED_ME, 0);
RULE(SET_INPUT_DERIVATIVES, fmi2SetRealInputDerivatives, 0, BEFORE_START | STEPPING);
RULE(GET_OUTPUT_DERIVATIVES, fmi2GetRealOutputDerivatives, 0, STEPPING | TERMINATED);
RULE(DO_STEP, fmi2DoStep, 0, STEPPING);
RULE(CANCEL_STEP, fmi2CancelStep, 0, 0);
RULE(GET_STATUS, fmi2GetXXXStatus, 0, SIMULATED_CS);

static fmi2Status status_of(bool done) { return done ? fmi2OK : fmi2Error; }

/* ---- common functions ---- */

static void to_importer(const Instance *instance, LogCategory category, const char *text) {
    const fmi2CallbackFunctions *callbacks = instance->host;
    char plain[LONGEST_MESSAGE], *percent;

    if (!callbacks->logger) return;
    strncpy(plain, text, sizeof plain - 1);
    plain[sizeof plain - 1] = '\0';
    /* The logger may treat the message as a printf format or, if not written in C, as plain text. */
    while ((percent = strchr(plain, '%')) != NULL) *percent = '?';
    callbacks->logger(callbacks->componentEnvironment, instance->name, category == LOG_ERRORS ? fmi2Error : fmi2OK,
                      core_category_name(category), plain);
}

const char *fmi2GetTypesPlatform(void) { return fmi2TypesPlatform; }

const char *fmi2GetVersion(void) { return fmi2Version; }

fmi2Component fmi2Instantiate(fmi2String instanceName, fmi2Type fmuType, fmi2String fmuGUID, fmi2String fmuResourceLocation,
                              const fmi2CallbackFunctions *functions, fmi2Boolean visible, fmi2Boolean loggingOn) {
    fmi2CallbackFunctions *callbacks;
    Instance *instance;
    /* The reason for a failed instantiation is logged even if logging is off. */
    Instance nobody = {.name = "(none)", .sink = to_importer, .logged = LOG_ERRORS};

    (void)fmuResourceLocation;
    (void)visible;
    if (!functions) return NULL;
    nobody.host = (void *)functions;
    if (instanceName && *instanceName) nobody.name = (char *)instanceName;
    if (!instanceName || !*instanceName) {
        core_refuse(&nobody, &INSTANTIATE, "the instance name is missing.");
        return NULL;
    }
    if (!fmuGUID || strcmp(fmuGUID, platoon_model.token) != 0) {
        core_refuse(&nobody, &INSTANTIATE, "the guid %s is not this binary's %s.", fmuGUID ? fmuGUID : "(none)",
                    platoon_model.token);
        return NULL;
    }
    if (fmuType != fmi2ModelExchange && fmuType != fmi2CoSimulation) {
        core_refuse(&nobody, &INSTANTIATE, "unknown fmuType %d.", (int)fmuType);
        return NULL;
    }
    callbacks = malloc(sizeof *callbacks);
    instance = callbacks ? core_new(&platoon_model, fmuType == fmi2ModelExchange ? MODEL_EXCHANGE : CO_SIMULATION, instanceName,
                                    to_importer, callbacks)
                         : NULL;
    if (!instance) {
        core_refuse(&nobody, &INSTANTIATE, "out of memory.");
        free(callbacks);
        return NULL;
    }
    *callbacks = *functions;
    instance->logged = loggingOn ? LOG_ERRORS : 0;
    return instance;
}

void fmi2FreeInstance(fmi2Component c) {
    Instance *instance = c;

    if (!instance) return;
    free(instance->host);
    core_free(instance);
}

fmi2Status fmi2SetDebugLogging(fmi2Component c, fmi2Boolean loggingOn, size_t nCategories, const fmi2String categories[]) {
    return status_of(core_set_logging(c, &SET_DEBUG_LOGGING, loggingOn, nCategories, categories));
}

fmi2Status fmi2SetupExperiment(fmi2Component c, fmi2Boolean toleranceDefined, fmi2Real tolerance, fmi2Real startTime,
                               fmi2Boolean stopTimeDefined, fmi2Real stopTime) {
    return status_of(core_set_experiment(c, &SETUP_EXPERIMENT, toleranceDefined ? tolerance : (double)INFINITY, startTime,
                                         stopTimeDefined ? stopTime : (double)INFINITY));
}

fmi2Status fmi2EnterInitializationMode(fmi2Component c) {
    return status_of(core_enter(c, &ENTER_INITIALIZATION, INITIALIZATION, INITIALIZATION));
}

fmi2Status fmi2ExitInitializationMode(fmi2Component c) {
    return status_of(core_enter(c, &EXIT_INITIALIZATION, EVENT, STEPPING));
}

fmi2Status fmi2Terminate(fmi2Component c) { return status_of(core_enter(c, &TERMINATE, TERMINATED, TERMINATED)); }

fmi2Status fmi2Reset(fmi2Component c) { return status_of(core_reset(c, &RESET)); }

/* ---- values: Reals, and Integers for enumerations ---- */

fmi2Status fmi2GetReal(fmi2Component c, const fmi2ValueReference vr[], size_t nvr, fmi2Real value[]) {
    return status_of(core_get(c, &GET_REAL, vr, nvr, value));
}

fmi2Status fmi2SetReal(fmi2Component c, const fmi2ValueReference vr[], size_t nvr, const fmi2Real value[]) {
    return status_of(core_set(c, &SET_REAL, vr, nvr, value));
}

fmi2Status fmi2GetInteger(fmi2Component c, const fmi2ValueReference vr[], size_t nvr, fmi2Integer value[]) {
    size_t i;

    if (!core_has_arrays(c, &GET_INTEGER, nvr, vr, value)) return fmi2Error;
    for (i = 0; i < nvr; i++) {
        if (!core_get_integer(c, &GET_INTEGER, vr[i], &value[i])) return fmi2Error;
    }
    return fmi2OK;
}

fmi2Status fmi2SetInteger(fmi2Component c, const fmi2ValueReference vr[], size_t nvr, const fmi2Integer value[]) {
    size_t i;

    if (!core_has_arrays(c, &SET_INTEGER, nvr, vr, value)) return fmi2Error;
    for (i = 0; i < nvr; i++) {
        if (!core_can_set_integer(c, &SET_INTEGER, vr[i], value[i])) return fmi2Error;
    }
    for (i = 0; i < nvr; i++) core_set_integer(c, value[i]);
    return fmi2OK;
}

/* An accessor for a type without variables. */
#define NO_SUCH_TYPE(Function, RULE_OF_IT, Argument)                                                    \
    fmi2Status Function(fmi2Component c, const fmi2ValueReference vr[], size_t nvr, Argument value[]) { \
        (void)vr;                                                                                       \
        (void)value;                                                                                    \
        return status_of(core_has_none(c, &RULE_OF_IT, nvr));                                           \
    }

NO_SUCH_TYPE(fmi2GetBoolean, GET_BOOLEAN, fmi2Boolean)
NO_SUCH_TYPE(fmi2GetString, GET_STRING, fmi2String)
NO_SUCH_TYPE(fmi2SetBoolean, SET_BOOLEAN, const fmi2Boolean)
NO_SUCH_TYPE(fmi2SetString, SET_STRING, const fmi2String)

/* ---- states and derivatives ---- */

fmi2Status fmi2GetFMUstate(fmi2Component c, fmi2FMUstate *FMUstate) {
    return status_of(core_save(c, &GET_FMU_STATE, (State **)FMUstate));
}

fmi2Status fmi2SetFMUstate(fmi2Component c, fmi2FMUstate FMUstate) {
    return status_of(core_restore(c, &SET_FMU_STATE, FMUstate));
}

fmi2Status fmi2FreeFMUstate(fmi2Component c, fmi2FMUstate *FMUstate) {
    return status_of(core_discard(c, &FREE_FMU_STATE, (State **)FMUstate));
}

fmi2Status fmi2SerializedFMUstateSize(fmi2Component c, fmi2FMUstate FMUstate, size_t *size) {
    (void)FMUstate;
    return status_of(core_serialized_size(c, &SERIALIZED_SIZE, size));
}

fmi2Status fmi2SerializeFMUstate(fmi2Component c, fmi2FMUstate FMUstate, fmi2Byte serializedState[], size_t size) {
    return status_of(core_serialize(c, &SERIALIZE, FMUstate, (unsigned char *)serializedState, size));
}

fmi2Status fmi2DeSerializeFMUstate(fmi2Component c, const fmi2Byte serializedState[], size_t size, fmi2FMUstate *FMUstate) {
    return status_of(core_deserialize(c, &DESERIALIZE, (const unsigned char *)serializedState, size, (State **)FMUstate));
}

fmi2Status fmi2GetDirectionalDerivative(fmi2Component c, const fmi2ValueReference vUnknown_ref[], size_t nUnknown,
                                        const fmi2ValueReference vKnown_ref[], size_t nKnown, const fmi2Real dvKnown[],
                                        fmi2Real dvUnknown[]) {
    return status_of(
        core_differentiate(c, &DIRECTIONAL_DERIVATIVE, false, vUnknown_ref, nUnknown, vKnown_ref, nKnown, dvKnown, dvUnknown));
}

fmi2Status fmi2SetRealInputDerivatives(fmi2Component c, const fmi2ValueReference vr[], size_t nvr, const fmi2Integer order[],
                                       const fmi2Real value[]) {
    (void)vr;
    (void)nvr;
    (void)order;
    (void)value;
    if (core_allows(c, &SET_INPUT_DERIVATIVES)) {
        core_refuse(c, &SET_INPUT_DERIVATIVES, "inputs are held (canInterpolateInputs is false).");
    }
    return fmi2Error;
}

fmi2Status fmi2GetRealOutputDerivatives(fmi2Component c, const fmi2ValueReference vr[], size_t nvr, const fmi2Integer order[],
                                        fmi2Real value[]) {
    return status_of(core_time_derivatives(c, &GET_OUTPUT_DERIVATIVES, vr, nvr, order, value));
}

/* ---- Model Exchange ---- */

fmi2Status fmi2EnterEventMode(fmi2Component c) { return status_of(core_enter(c, &ENTER_EVENT, EVENT, EVENT)); }

fmi2Status fmi2NewDiscreteStates(fmi2Component c, fmi2EventInfo *eventInfo) {
    static const fmi2EventInfo NOTHING_HAPPENED = {0};

    if (!core_has_places(c, &NEW_DISCRETE_STATES, 1, (const void *[]){eventInfo})) return fmi2Error;
    *eventInfo = NOTHING_HAPPENED;
    return fmi2OK;
}

fmi2Status fmi2EnterContinuousTimeMode(fmi2Component c) {
    return status_of(core_enter(c, &ENTER_CONTINUOUS, CONTINUOUS, CONTINUOUS));
}

fmi2Status fmi2CompletedIntegratorStep(fmi2Component c, fmi2Boolean noSetFMUStatePriorToCurrentPoint,
                                       fmi2Boolean *enterEventMode, fmi2Boolean *terminateSimulation) {
    (void)noSetFMUStatePriorToCurrentPoint;
    if (!core_has_places(c, &COMPLETED_STEP, 2, (const void *[]){enterEventMode, terminateSimulation})) return fmi2Error;
    *enterEventMode = fmi2False;
    *terminateSimulation = fmi2False;
    return fmi2OK;
}

fmi2Status fmi2SetTime(fmi2Component c, fmi2Real time) { return status_of(core_set_time(c, &SET_TIME, time)); }

fmi2Status fmi2SetContinuousStates(fmi2Component c, const fmi2Real x[], size_t nx) {
    return status_of(core_set_states(c, &SET_STATES, x, nx));
}

fmi2Status fmi2GetDerivatives(fmi2Component c, fmi2Real derivatives[], size_t nx) {
    return status_of(core_get_derivatives(c, &GET_DERIVATIVES, derivatives, nx));
}

fmi2Status fmi2GetEventIndicators(fmi2Component c, fmi2Real eventIndicators[], size_t ni) {
    (void)eventIndicators;
    return status_of(core_has_none(c, &GET_EVENT_INDICATORS, ni));
}

fmi2Status fmi2GetContinuousStates(fmi2Component c, fmi2Real x[], size_t nx) {
    return status_of(core_get_states(c, &GET_STATES, x, nx));
}

fmi2Status fmi2GetNominalsOfContinuousStates(fmi2Component c, fmi2Real x_nominal[], size_t nx) {
    return status_of(core_get_nominals(c, &GET_NOMINALS, x_nominal, nx));
}

/* ---- Co-Simulation ---- */

fmi2Status fmi2DoStep(fmi2Component c, fmi2Real currentCommunicationPoint, fmi2Real communicationStepSize,
                      fmi2Boolean noSetFMUStatePriorToCurrentPoint) {
    (void)noSetFMUStatePriorToCurrentPoint;
    return status_of(core_step(c, &DO_STEP, currentCommunicationPoint, communicationStepSize, NULL));
}

fmi2Status fmi2CancelStep(fmi2Component c) {
    /* Steps are never pending, so there is never one to cancel. */
    (void)core_allows(c, &CANCEL_STEP);
    return fmi2Error;
}

/* Steps are never asynchronous: the only available status is the time reached. */
static fmi2Status no_such_status(fmi2Component c) { return core_allows(c, &GET_STATUS) ? fmi2Discard : fmi2Error; }

fmi2Status fmi2GetStatus(fmi2Component c, const fmi2StatusKind s, fmi2Status *value) {
    (void)s;
    (void)value;
    return no_such_status(c);
}

fmi2Status fmi2GetRealStatus(fmi2Component c, const fmi2StatusKind s, fmi2Real *value) {
    const Instance *instance = c;

    if (!core_has_places(instance, &GET_STATUS, 1, (const void *[]){value})) return fmi2Error;
    if (s != fmi2LastSuccessfulTime) return fmi2Discard;
    *value = instance->status.time;
    return fmi2OK;
}

fmi2Status fmi2GetIntegerStatus(fmi2Component c, const fmi2StatusKind s, fmi2Integer *value) {
    (void)s;
    (void)value;
    return no_such_status(c);
}

fmi2Status fmi2GetBooleanStatus(fmi2Component c, const fmi2StatusKind s, fmi2Boolean *value) {
    (void)s;
    (void)value;
    return no_such_status(c);
}

fmi2Status fmi2GetStringStatus(fmi2Component c, const fmi2StatusKind s, fmi2String *value) {
    (void)s;
    (void)value;
    return no_such_status(c);
}
