/* FMI 2.0, Model Exchange and Co-Simulation: the thin face of the core. */
#include <math.h>
#include <stdarg.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>

#include "core.h"
#include "fmi2Functions.h"

#define LOG_ERRORS "logStatusError"

typedef struct {
    Instance *core;
    char *name;
    fmi2CallbackFunctions callbacks;
    bool logging;
} Component;

/* ---- which call is allowed when: FMI 2.0.4, the tables of sections 3.2.3 and 4.2.4 ---- */

typedef enum {
    FREE_INSTANCE, SET_DEBUG_LOGGING, SETUP_EXPERIMENT, ENTER_INITIALIZATION, EXIT_INITIALIZATION, TERMINATE, RESET,
    GET_VALUES, SET_VALUES,
    ENTER_EVENT, NEW_DISCRETE_STATES, ENTER_CONTINUOUS, COMPLETED_STEP, SET_TIME, SET_STATES, GET_DERIVATIVES,
    GET_EVENT_INDICATORS, GET_STATES, GET_NOMINALS,
    DO_STEP, CANCEL_STEP, GET_STATUS
} Call;

#define ANY (INSTANTIATED | INITIALIZATION | EVENT | CONTINUOUS | STEPPING | TERMINATED | FAILED)
#define AFTER_START_ME (EVENT | CONTINUOUS | TERMINATED | FAILED)

static const struct {
    const char *name;
    int model_exchange, co_simulation;
} CALLS[] = {
    [FREE_INSTANCE] = {"fmi2FreeInstance", ANY, ANY},
    [SET_DEBUG_LOGGING] = {"fmi2SetDebugLogging", ANY, ANY},
    [SETUP_EXPERIMENT] = {"fmi2SetupExperiment", INSTANTIATED, INSTANTIATED},
    [ENTER_INITIALIZATION] = {"fmi2EnterInitializationMode", INSTANTIATED, INSTANTIATED},
    [EXIT_INITIALIZATION] = {"fmi2ExitInitializationMode", INITIALIZATION, INITIALIZATION},
    [TERMINATE] = {"fmi2Terminate", EVENT | CONTINUOUS, STEPPING},
    [RESET] = {"fmi2Reset", ANY, ANY},
    [GET_VALUES] = {"fmi2GetXXX", INITIALIZATION | AFTER_START_ME, INITIALIZATION | STEPPING | TERMINATED | FAILED},
    [SET_VALUES] = {"fmi2SetXXX", INSTANTIATED | INITIALIZATION | EVENT | CONTINUOUS,
                    INSTANTIATED | INITIALIZATION | STEPPING},
    [ENTER_EVENT] = {"fmi2EnterEventMode", EVENT | CONTINUOUS, 0},
    [NEW_DISCRETE_STATES] = {"fmi2NewDiscreteStates", EVENT, 0},
    [ENTER_CONTINUOUS] = {"fmi2EnterContinuousTimeMode", EVENT, 0},
    [COMPLETED_STEP] = {"fmi2CompletedIntegratorStep", CONTINUOUS, 0},
    [SET_TIME] = {"fmi2SetTime", EVENT | CONTINUOUS, 0},
    [SET_STATES] = {"fmi2SetContinuousStates", CONTINUOUS, 0},
    [GET_DERIVATIVES] = {"fmi2GetDerivatives", INITIALIZATION | AFTER_START_ME, 0},
    [GET_EVENT_INDICATORS] = {"fmi2GetEventIndicators", INITIALIZATION | AFTER_START_ME, 0},
    [GET_STATES] = {"fmi2GetContinuousStates", INITIALIZATION | AFTER_START_ME, 0},
    [GET_NOMINALS] = {"fmi2GetNominalsOfContinuousStates", INSTANTIATED | INITIALIZATION | AFTER_START_ME, 0},
    [DO_STEP] = {"fmi2DoStep", 0, STEPPING},
    [CANCEL_STEP] = {"fmi2CancelStep", 0, 0},
    [GET_STATUS] = {"fmi2GetXXXStatus", 0, STEPPING | TERMINATED | FAILED},
};

static const char *phase_name(Phase phase) {
    switch (phase) {
        case INSTANTIATED: return "instantiated";
        case INITIALIZATION: return "initialization mode";
        case EVENT: return "event mode";
        case CONTINUOUS: return "continuous-time mode";
        case STEPPING: return "step complete";
        case TERMINATED: return "terminated";
        case FAILED: return "error";
    }
    return "unknown";
}

static void log_message(const Component *component, fmi2Status status, const char *format, ...) {
    char text[400], *percent;
    va_list arguments;

    if (!component->logging || !component->callbacks.logger) return;
    va_start(arguments, format);
    vsnprintf(text, sizeof text, format, arguments);
    va_end(arguments);
    /* The logger may take the message for a printf format or, as loggers that are no C, for the text. */
    while ((percent = strchr(text, '%')) != NULL) *percent = '?';
    component->callbacks.logger(component->callbacks.componentEnvironment, component->name, status, LOG_ERRORS, text);
}

/* The component where the call is allowed now, else NULL (and a line in the log). */
static Component *allowed(fmi2Component c, Call call) {
    Component *component = c;
    int phases;

    if (!component) return NULL;
    phases = component->core->kind == MODEL_EXCHANGE ? CALLS[call].model_exchange : CALLS[call].co_simulation;
    if (component->core->phase & phases) return component;
    log_message(component, fmi2Error, "%s is not allowed in %s of %s.", CALLS[call].name,
                phase_name(component->core->phase),
                component->core->kind == MODEL_EXCHANGE ? "Model Exchange" : "Co-Simulation");
    return NULL;
}

/* The status of a core function's answer; logs its reason. */
static fmi2Status answer(const Component *component, bool done, Call call) {
    if (done) return fmi2OK;
    log_message(component, fmi2Error, "%s: %s.", CALLS[call].name, component->core->message);
    return fmi2Error;
}

static fmi2Status refuse(const Component *component, Call call, const char *reason) {
    log_message(component, fmi2Error, "%s: %s.", CALLS[call].name, reason);
    return fmi2Error;
}

/* ---- common functions ---- */

const char *fmi2GetTypesPlatform(void) { return fmi2TypesPlatform; }

const char *fmi2GetVersion(void) { return fmi2Version; }

fmi2Component fmi2Instantiate(fmi2String instanceName, fmi2Type fmuType, fmi2String fmuGUID,
                              fmi2String fmuResourceLocation, const fmi2CallbackFunctions *functions,
                              fmi2Boolean visible, fmi2Boolean loggingOn) {
    Component *component;
    const size_t name_size = instanceName ? strlen(instanceName) + 1 : 0;

    (void)fmuResourceLocation;
    (void)visible;
    if (!functions) return NULL;
    component = calloc(1, sizeof *component);
    if (!component) return NULL;
    component->callbacks = *functions;
    component->logging = true; /* what prevents an instance is said even where logging is off */
    component->name = calloc(name_size ? name_size : 1, 1);
    if (component->name && instanceName) memcpy(component->name, instanceName, name_size);

    if (name_size <= 1) {
        log_message(component, fmi2Error, "fmi2Instantiate: the instance name is missing.");
    } else if (!fmuGUID || strcmp(fmuGUID, platoon_model.token) != 0) {
        log_message(component, fmi2Error, "fmi2Instantiate: the guid %s is not this binary's %s.",
                    fmuGUID ? fmuGUID : "(none)", platoon_model.token);
    } else if (fmuType != fmi2ModelExchange && fmuType != fmi2CoSimulation) {
        log_message(component, fmi2Error, "fmi2Instantiate: unknown fmuType %d.", (int)fmuType);
    } else {
        component->core = core_new(&platoon_model, fmuType == fmi2ModelExchange ? MODEL_EXCHANGE : CO_SIMULATION);
        if (!component->core) log_message(component, fmi2Error, "fmi2Instantiate: out of memory.");
    }
    component->logging = loggingOn;
    if (!component->core) {
        fmi2FreeInstance(component);
        return NULL;
    }
    return component;
}

void fmi2FreeInstance(fmi2Component c) {
    Component *component = c;

    if (!component) return;
    core_free(component->core);
    free(component->name);
    free(component);
}

fmi2Status fmi2SetDebugLogging(fmi2Component c, fmi2Boolean loggingOn, size_t nCategories, const fmi2String categories[]) {
    Component *component = allowed(c, SET_DEBUG_LOGGING);
    size_t i;

    if (!component) return fmi2Error;
    for (i = 0; i < nCategories; i++) {
        if (!categories || !categories[i] || strcmp(categories[i], LOG_ERRORS) != 0) {
            return refuse(component, SET_DEBUG_LOGGING, "the only log category is " LOG_ERRORS);
        }
    }
    component->logging = loggingOn;
    return fmi2OK;
}

fmi2Status fmi2SetupExperiment(fmi2Component c, fmi2Boolean toleranceDefined, fmi2Real tolerance, fmi2Real startTime,
                               fmi2Boolean stopTimeDefined, fmi2Real stopTime) {
    Component *component = allowed(c, SETUP_EXPERIMENT);

    (void)toleranceDefined; /* the solver's step is fixed */
    (void)tolerance;
    if (!component) return fmi2Error;
    if (!isfinite(startTime)) return refuse(component, SETUP_EXPERIMENT, "the start time is not finite");
    if (stopTimeDefined && !(stopTime >= startTime)) {
        return refuse(component, SETUP_EXPERIMENT, "the stop time is before the start time");
    }
    component->core->time = startTime;
    component->core->stop_time = stopTimeDefined ? stopTime : INFINITY;
    return fmi2OK;
}

fmi2Status fmi2EnterInitializationMode(fmi2Component c) {
    Component *component = allowed(c, ENTER_INITIALIZATION);

    if (!component) return fmi2Error;
    component->core->phase = INITIALIZATION;
    return fmi2OK;
}

fmi2Status fmi2ExitInitializationMode(fmi2Component c) {
    Component *component = allowed(c, EXIT_INITIALIZATION);

    if (!component) return fmi2Error;
    core_start(component->core);
    return fmi2OK;
}

fmi2Status fmi2Terminate(fmi2Component c) {
    Component *component = allowed(c, TERMINATE);

    if (!component) return fmi2Error;
    component->core->phase = TERMINATED;
    return fmi2OK;
}

fmi2Status fmi2Reset(fmi2Component c) {
    Component *component = allowed(c, RESET);

    if (!component) return fmi2Error;
    core_reset(component->core);
    return fmi2OK;
}

/* ---- values: all variables are Real ---- */

fmi2Status fmi2GetReal(fmi2Component c, const fmi2ValueReference vr[], size_t nvr, fmi2Real value[]) {
    Component *component = allowed(c, GET_VALUES);

    if (!component) return fmi2Error;
    if (nvr > 0 && (!vr || !value)) return refuse(component, GET_VALUES, "an array is missing");
    return answer(component, core_get(component->core, vr, nvr, value), GET_VALUES);
}

fmi2Status fmi2SetReal(fmi2Component c, const fmi2ValueReference vr[], size_t nvr, const fmi2Real value[]) {
    Component *component = allowed(c, SET_VALUES);

    if (!component) return fmi2Error;
    if (nvr > 0 && (!vr || !value)) return refuse(component, SET_VALUES, "an array is missing");
    return answer(component, core_set(component->core, vr, nvr, value), SET_VALUES);
}

static fmi2Status no_such_type(fmi2Component c, Call call, size_t nvr, const char *reason) {
    Component *component = allowed(c, call);

    if (!component) return fmi2Error;
    return nvr == 0 ? fmi2OK : refuse(component, call, reason);
}

/* One accessor of a type that no variable has. */
#define NO_SUCH_TYPE(Function, call, Argument, reason)                                                    \
    fmi2Status Function(fmi2Component c, const fmi2ValueReference vr[], size_t nvr, Argument value[]) { \
        (void)vr;                                                                                       \
        (void)value;                                                                                    \
        return no_such_type(c, call, nvr, reason);                                                      \
    }

NO_SUCH_TYPE(fmi2GetInteger, GET_VALUES, fmi2Integer, "no variable is an Integer")
NO_SUCH_TYPE(fmi2GetBoolean, GET_VALUES, fmi2Boolean, "no variable is a Boolean")
NO_SUCH_TYPE(fmi2GetString, GET_VALUES, fmi2String, "no variable is a String")
NO_SUCH_TYPE(fmi2SetInteger, SET_VALUES, const fmi2Integer, "no variable is an Integer")
NO_SUCH_TYPE(fmi2SetBoolean, SET_VALUES, const fmi2Boolean, "no variable is a Boolean")
NO_SUCH_TYPE(fmi2SetString, SET_VALUES, const fmi2String, "no variable is a String")

/* ---- capabilities the modelDescription does not claim ---- */

static fmi2Status not_provided(fmi2Component c, const char *name) {
    if (c) log_message(c, fmi2Error, "%s is not provided by this FMU (see its capability flags).", name);
    return fmi2Error;
}

fmi2Status fmi2GetFMUstate(fmi2Component c, fmi2FMUstate *FMUstate) {
    (void)FMUstate;
    return not_provided(c, "fmi2GetFMUstate");
}

fmi2Status fmi2SetFMUstate(fmi2Component c, fmi2FMUstate FMUstate) {
    (void)FMUstate;
    return not_provided(c, "fmi2SetFMUstate");
}

fmi2Status fmi2FreeFMUstate(fmi2Component c, fmi2FMUstate *FMUstate) {
    (void)FMUstate;
    return not_provided(c, "fmi2FreeFMUstate");
}

fmi2Status fmi2SerializedFMUstateSize(fmi2Component c, fmi2FMUstate FMUstate, size_t *size) {
    (void)FMUstate;
    (void)size;
    return not_provided(c, "fmi2SerializedFMUstateSize");
}

fmi2Status fmi2SerializeFMUstate(fmi2Component c, fmi2FMUstate FMUstate, fmi2Byte serializedState[], size_t size) {
    (void)FMUstate;
    (void)serializedState;
    (void)size;
    return not_provided(c, "fmi2SerializeFMUstate");
}

fmi2Status fmi2DeSerializeFMUstate(fmi2Component c, const fmi2Byte serializedState[], size_t size, fmi2FMUstate *FMUstate) {
    (void)serializedState;
    (void)size;
    (void)FMUstate;
    return not_provided(c, "fmi2DeSerializeFMUstate");
}

fmi2Status fmi2GetDirectionalDerivative(fmi2Component c, const fmi2ValueReference vUnknown_ref[], size_t nUnknown,
                                        const fmi2ValueReference vKnown_ref[], size_t nKnown, const fmi2Real dvKnown[],
                                        fmi2Real dvUnknown[]) {
    (void)vUnknown_ref;
    (void)nUnknown;
    (void)vKnown_ref;
    (void)nKnown;
    (void)dvKnown;
    (void)dvUnknown;
    return not_provided(c, "fmi2GetDirectionalDerivative");
}

fmi2Status fmi2SetRealInputDerivatives(fmi2Component c, const fmi2ValueReference vr[], size_t nvr,
                                       const fmi2Integer order[], const fmi2Real value[]) {
    (void)vr;
    (void)nvr;
    (void)order;
    (void)value;
    return not_provided(c, "fmi2SetRealInputDerivatives");
}

fmi2Status fmi2GetRealOutputDerivatives(fmi2Component c, const fmi2ValueReference vr[], size_t nvr,
                                        const fmi2Integer order[], fmi2Real value[]) {
    (void)vr;
    (void)nvr;
    (void)order;
    (void)value;
    return not_provided(c, "fmi2GetRealOutputDerivatives");
}

/* ---- Model Exchange ---- */

fmi2Status fmi2EnterEventMode(fmi2Component c) {
    Component *component = allowed(c, ENTER_EVENT);

    if (!component) return fmi2Error;
    component->core->phase = EVENT;
    return fmi2OK;
}

fmi2Status fmi2NewDiscreteStates(fmi2Component c, fmi2EventInfo *eventInfo) {
    static const fmi2EventInfo NOTHING_HAPPENED = {0};
    Component *component = allowed(c, NEW_DISCRETE_STATES);

    if (!component) return fmi2Error;
    if (!eventInfo) return refuse(component, NEW_DISCRETE_STATES, "the event information is missing");
    *eventInfo = NOTHING_HAPPENED;
    return fmi2OK;
}

fmi2Status fmi2EnterContinuousTimeMode(fmi2Component c) {
    Component *component = allowed(c, ENTER_CONTINUOUS);

    if (!component) return fmi2Error;
    component->core->phase = CONTINUOUS;
    return fmi2OK;
}

fmi2Status fmi2CompletedIntegratorStep(fmi2Component c, fmi2Boolean noSetFMUStatePriorToCurrentPoint,
                                       fmi2Boolean *enterEventMode, fmi2Boolean *terminateSimulation) {
    Component *component = allowed(c, COMPLETED_STEP);

    (void)noSetFMUStatePriorToCurrentPoint;
    if (!component) return fmi2Error;
    if (!enterEventMode || !terminateSimulation) return refuse(component, COMPLETED_STEP, "a result pointer is missing");
    *enterEventMode = fmi2False;
    *terminateSimulation = fmi2False;
    return fmi2OK;
}

fmi2Status fmi2SetTime(fmi2Component c, fmi2Real time) {
    Component *component = allowed(c, SET_TIME);

    if (!component) return fmi2Error;
    if (!isfinite(time)) return refuse(component, SET_TIME, "the time is not finite");
    component->core->time = time;
    return fmi2OK;
}

/* The component where the call is allowed and its array has the model's number of states. */
static Component *with_states(fmi2Component c, Call call, const fmi2Real values[], size_t nx) {
    Component *component = allowed(c, call);

    if (component && (!values || nx != component->core->model->n_states)) {
        log_message(component, fmi2Error, "%s: the model has %lu continuous states, not %lu.", CALLS[call].name,
                    (unsigned long)component->core->model->n_states, (unsigned long)nx);
        return NULL;
    }
    return component;
}

fmi2Status fmi2SetContinuousStates(fmi2Component c, const fmi2Real x[], size_t nx) {
    Component *component = with_states(c, SET_STATES, x, nx);

    if (!component) return fmi2Error;
    return answer(component, core_set_states(component->core, x), SET_STATES);
}

fmi2Status fmi2GetDerivatives(fmi2Component c, fmi2Real derivatives[], size_t nx) {
    Component *component = with_states(c, GET_DERIVATIVES, derivatives, nx);

    if (!component) return fmi2Error;
    memcpy(derivatives, core_derivatives(component->core), nx * sizeof(fmi2Real));
    return fmi2OK;
}

fmi2Status fmi2GetEventIndicators(fmi2Component c, fmi2Real eventIndicators[], size_t ni) {
    Component *component = allowed(c, GET_EVENT_INDICATORS);

    (void)eventIndicators;
    if (!component) return fmi2Error;
    return ni == 0 ? fmi2OK : refuse(component, GET_EVENT_INDICATORS, "the model has no event indicators");
}

fmi2Status fmi2GetContinuousStates(fmi2Component c, fmi2Real x[], size_t nx) {
    Component *component = with_states(c, GET_STATES, x, nx);

    if (!component) return fmi2Error;
    memcpy(x, core_states(component->core), nx * sizeof(fmi2Real));
    return fmi2OK;
}

fmi2Status fmi2GetNominalsOfContinuousStates(fmi2Component c, fmi2Real x_nominal[], size_t nx) {
    Component *component = with_states(c, GET_NOMINALS, x_nominal, nx);

    if (!component) return fmi2Error;
    memcpy(x_nominal, component->core->model->nominals, nx * sizeof(fmi2Real));
    return fmi2OK;
}

/* ---- Co-Simulation ---- */

fmi2Status fmi2DoStep(fmi2Component c, fmi2Real currentCommunicationPoint, fmi2Real communicationStepSize,
                      fmi2Boolean noSetFMUStatePriorToCurrentPoint) {
    Component *component = allowed(c, DO_STEP);

    (void)noSetFMUStatePriorToCurrentPoint;
    if (!component) return fmi2Error;
    return answer(component, core_step(component->core, currentCommunicationPoint, communicationStepSize), DO_STEP);
}

fmi2Status fmi2CancelStep(fmi2Component c) {
    /* Steps are never pending, so there is never one to cancel. */
    (void)allowed(c, CANCEL_STEP);
    return fmi2Error;
}

/* Steps are never asynchronous: the only status there is to ask for is the time reached. */
static fmi2Status no_such_status(fmi2Component c) {
    return allowed(c, GET_STATUS) ? fmi2Discard : fmi2Error;
}

fmi2Status fmi2GetStatus(fmi2Component c, const fmi2StatusKind s, fmi2Status *value) {
    (void)s;
    (void)value;
    return no_such_status(c);
}

fmi2Status fmi2GetRealStatus(fmi2Component c, const fmi2StatusKind s, fmi2Real *value) {
    Component *component = allowed(c, GET_STATUS);

    if (!component) return fmi2Error;
    if (s != fmi2LastSuccessfulTime || !value) return fmi2Discard;
    *value = component->core->time;
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
