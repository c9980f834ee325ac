/* Checks at the start of every function of the core: whether the call is allowed now and its arguments are present; and
 * the log of refused calls. */
#include "internal.h"

#include <stdarg.h>
#include <stdio.h>
#include <string.h>

const char *core_category_name(LogCategory category) { return category == LOG_ERRORS ? "logStatusError" : "logEvents"; }

const char *core_phase_name(Phase phase) {
    switch (phase) {
        case INSTANTIATED: return "instantiated state";
        case INITIALIZATION: return "initialization mode";
        case EVENT: return "event mode";
        case CONTINUOUS: return "continuous-time mode";
        case STEPPING: return "step mode";
        case INTERMEDIATE: return "intermediate update mode";
        case TERMINATED: return "terminated state";
        case FAILED: return "error state";
    }
    return "unknown";
}

bool core_refuse(const Instance *instance, const Rule *rule, const char *reason, ...) {
    char text[LONGEST_MESSAGE];
    va_list arguments;
    int length;

    if (!(instance->logged & LOG_ERRORS)) return false;
    length = snprintf(text, sizeof text, "%s: ", rule->name);
    va_start(arguments, reason);
    vsnprintf(text + length, sizeof text - (size_t)length, reason, arguments);
    va_end(arguments);
    instance->sink(instance, LOG_ERRORS, text);
    return false;
}

bool core_allows(const Instance *instance, const Rule *rule) {
    bool exchange;

    if (!instance) return false;
    exchange = instance->kind == MODEL_EXCHANGE;
    if (instance->status.phase & (exchange ? rule->model_exchange : rule->co_simulation)) return true;
    return core_refuse(instance, rule, "not allowed in %s of %s.", core_phase_name(instance->status.phase),
                       exchange ? "Model Exchange" : "Co-Simulation");
}

bool core_has_places(const Instance *instance, const Rule *rule, size_t n, const void *const places[]) {
    size_t i;

    if (!core_allows(instance, rule)) return false;
    for (i = 0; i < n; i++) {
        if (!places[i]) return core_refuse(instance, rule, "a pointer for a result is missing.");
    }
    return true;
}

bool core_has_array(const Instance *instance, const Rule *rule, size_t n, const void *array) {
    return n == 0 || array || core_refuse(instance, rule, "an array is missing.");
}

bool core_has_arrays(const Instance *instance, const Rule *rule, size_t n, const void *one, const void *other) {
    return core_allows(instance, rule) && core_has_array(instance, rule, n, one) && core_has_array(instance, rule, n, other);
}

bool core_has_none(const Instance *instance, const Rule *rule, size_t n) {
    return core_allows(instance, rule) && (n == 0 || core_refuse(instance, rule, "the model has none of these."));
}

bool core_set_logging(Instance *instance, const Rule *rule, bool on, size_t n, const char *const categories[]) {
    int chosen = n == 0 ? LOG_ERRORS | LOG_EVENTS : 0;
    size_t i;

    if (!core_allows(instance, rule) || !core_has_array(instance, rule, n, categories)) return false;
    for (i = 0; i < n; i++) {
        const char *name = categories[i] ? categories[i] : "(none)";
        if (strcmp(name, core_category_name(LOG_ERRORS)) == 0) {
            chosen |= LOG_ERRORS;
        } else if (strcmp(name, core_category_name(LOG_EVENTS)) == 0) {
            chosen |= LOG_EVENTS;
        } else if (strcmp(name, "logAll") == 0) {
            chosen |= LOG_ERRORS | LOG_EVENTS;
        } else {
            return core_refuse(instance, rule, "there is no log category %s; allowed: logStatusError, logEvents, logAll.",
                               name);
        }
    }
    instance->logged = on ? chosen : 0;
    return true;
}
