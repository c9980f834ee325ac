/* Drives one Co-Simulation instance of the vehicle and prints the bits of what it gives.
 *
 * host LIBRARY TOKEN STEPS REFERENCE=VALUE... READ-FIRST READ-LAST
 *
 * Sets the variables, takes the steps of 10 ms and prints, after every one, the values of the references from
 * READ-FIRST to READ-LAST as 16 hexadecimal digits each. Compiled with FMI3 defined it speaks FMI 3.0, else FMI 2.0.
 */
#include <inttypes.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>

#ifdef _WIN32
#include <windows.h>
#define OPEN(path) (void *)LoadLibraryA(path)
#define FIND(library, name) (void *)GetProcAddress((HMODULE)(library), name)
#else
#include <dlfcn.h>
#define OPEN(path) dlopen(path, RTLD_NOW | RTLD_LOCAL)
#define FIND(library, name) dlsym(library, name)
#endif

#ifdef FMI3
#include "fmi3FunctionTypes.h"
#else
#include "fmi2FunctionTypes.h"
#endif

#define STEP 0.01
#define MOST 1000

static void *library;

static void fail(const char *what) {
    printf("failed: %s\n", what);
    exit(1);
}

static void *function(const char *name) {
    void *found = FIND(library, name);

    if (!found) fail(name);
    return found;
}

#define CALL(name, ...) \
    if (((name##TYPE *)function(#name))(__VA_ARGS__) != 0) fail(#name)

#ifdef FMI3
static void log_message(fmi3InstanceEnvironment environment, fmi3Status status, fmi3String category, fmi3String message) {
    (void)environment;
    printf("%d %s %s\n", (int)status, category, message);
}
#else
static void log_message(fmi2ComponentEnvironment environment, fmi2String name, fmi2Status status, fmi2String category,
                        fmi2String message, ...) {
    (void)environment;
    printf("%s %d %s %s\n", name, (int)status, category, message);
}
#endif

int main(int count, char **words) {
    static unsigned int references[MOST];
    static double values[MOST];
    unsigned int first, last;
    size_t n = 0, i;
    int word, step;
    void *instance;

    if (count < 6) return 2;
    library = OPEN(words[1]);
    if (!library) fail("the library does not load");
#ifdef FMI3
    instance = ((fmi3InstantiateCoSimulationTYPE *)function("fmi3InstantiateCoSimulation"))(
        "car", words[2], NULL, fmi3False, fmi3True, fmi3False, fmi3False, NULL, 0, NULL, log_message, NULL);
#else
    const fmi2CallbackFunctions callbacks = {log_message, calloc, free, NULL, NULL};
    instance = ((fmi2InstantiateTYPE *)function("fmi2Instantiate"))("car", fmi2CoSimulation, words[2], "", &callbacks,
                                                                    fmi2False, fmi2True);
#endif
    if (!instance) fail("no instance");
    for (word = 4; word < count - 2; word++) {
        references[n] = (unsigned int)strtoul(words[word], NULL, 10);
        values[n++] = strtod(strchr(words[word], '=') + 1, NULL);
    }
#ifdef FMI3
    CALL(fmi3EnterInitializationMode, instance, fmi3False, 0.0, 0.0, fmi3False, 0.0);
    CALL(fmi3SetFloat64, instance, references, n, values, n);
    CALL(fmi3ExitInitializationMode, instance);
#else
    CALL(fmi2SetupExperiment, instance, fmi2False, 0.0, 0.0, fmi2False, 0.0);
    CALL(fmi2EnterInitializationMode, instance);
    CALL(fmi2SetReal, instance, references, n, values);
    CALL(fmi2ExitInitializationMode, instance);
#endif
    first = (unsigned int)strtoul(words[count - 2], NULL, 10);
    last = (unsigned int)strtoul(words[count - 1], NULL, 10);
    n = last - first + 1;
    for (i = 0; i < n; i++) references[i] = first + (unsigned int)i;
    for (step = 0; step < atoi(words[3]); step++) {
#ifdef FMI3
        fmi3Boolean event, terminate, early;
        double reached;
        CALL(fmi3DoStep, instance, step * STEP, STEP, fmi3True, &event, &terminate, &early, &reached);
        CALL(fmi3GetFloat64, instance, references, n, values, n);
#else
        CALL(fmi2DoStep, instance, step * STEP, STEP, fmi2True);
        CALL(fmi2GetReal, instance, references, n, values);
#endif
        for (i = 0; i < n; i++) {
            uint64_t bits;
            memcpy(&bits, &values[i], sizeof bits);
            printf("%016" PRIx64 "%c", bits, i + 1 < n ? ' ' : '\n');
        }
    }
    return 0;
}
