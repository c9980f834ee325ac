/* host LIBRARY TOKEN VARIABLES me|cs SCENARIO NUMBER: runs one scenario with the FMU's binary.
 *
 * VARIABLES is a file with a line `group reference name` for each variable of the modelDescription, in its order; of the
 * groups state, derivative, output, input and parameter (of the model) the host makes use, the rest it knows by name.
 */
#include "host.h"

#include <dlfcn.h>
#include <math.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>

static _Noreturn void fail(const char *what, const char *why) {
    printf("failed: %s: %s\n", what, why);
    exit(1);
}

unsigned int reference_of(const Subject *subject, const char *name) {
    unsigned int reference;

    for (reference = 0; reference < MOST; reference++) {
        if (strcmp(subject->names[reference], name) == 0) return reference;
    }
    fail(name, "no such variable");
}

void must(Fmu *fmu, Status status, const char *what) {
    if (status != OK) fail(what, fmu->said);
}

void print_values(const char *label, const double *values, size_t n) {
    size_t i;

    printf("%s:", label);
    for (i = 0; i < n; i++) printf(" %a", values[i]);
    printf("\n");
}

void hear(Fmu *fmu, const char *category, const char *text) {
    snprintf(fmu->said, sizeof fmu->said, "%s", text);
    if (fmu->aloud) printf("%s: %s\n", category, text);
}

Status set(Fmu *fmu, const char *name, double value) {
    const unsigned int reference = reference_of(fmu->subject, name);

    return fmu_set(fmu, &reference, 1, &value);
}

Status set_solver(Fmu *fmu, int solver) {
    const unsigned int reference = reference_of(fmu->subject, "solver");

    return fmu_set_integer(fmu, &reference, &solver);
}

void get_unknowns(Fmu *fmu, double *values) {
    const Group *unknowns = &fmu->subject->unknowns;

    must(fmu, fmu_get(fmu, unknowns->references, unknowns->n, values), "get the unknowns");
}

void print_unknowns(Fmu *fmu, const char *label) {
    double values[MOST];

    get_unknowns(fmu, values);
    print_values(label, values, fmu->subject->unknowns.n);
}

void start(Fmu *fmu, double time) {
    fmu->time = time;
    must(fmu, fmu_initialize(fmu, time, INFINITY, 1e-7), "initialize");
    start_initialized(fmu);
}

void start_initialized(Fmu *fmu) {
    must(fmu, fmu_exit_initialization(fmu), "exit the initialization");
    if (fmu->kind == CO_SIMULATION) return;
    must(fmu, fmu_settle(fmu), "settle");
    must(fmu, fmu_continuous_mode(fmu), "enter the continuous-time mode");
}

void drive(Fmu *fmu, int i) {
    must(fmu, set(fmu, "steering_angle", 0.01 * (i % 7) - 0.02), "steer");
    must(fmu, set(fmu, "wheel_torque_fl", 40.0 * (i % 3)), "drive on the left");
    must(fmu, set(fmu, "wheel_torque_rr", -25.0 * (i % 4)), "brake on the right");
    must(fmu, set(fmu, "force_x", 100.0 * i), "push");
}

/* Model Exchange: the derivatives at a time and states. */
static void slope(Fmu *fmu, double time, const double *x, double *dx) {
    const size_t n = fmu->subject->states.n;

    must(fmu, fmu_set_time(fmu, time), "set the time");
    must(fmu, fmu_set_states(fmu, x, n), "set the states");
    must(fmu, fmu_get_derivatives(fmu, dx, n), "get the derivatives");
}

static void integrate(Fmu *fmu, double h) {
    const size_t n = fmu->subject->states.n;
    const double t = fmu->time;
    double x[MOST], at[MOST], k1[MOST], k2[MOST], k3[MOST], k4[MOST];
    size_t i;

    must(fmu, fmu_get_states(fmu, x, n), "get the states");
    slope(fmu, t, x, k1);
    for (i = 0; i < n; i++) at[i] = x[i] + h / 2 * k1[i];
    slope(fmu, t + h / 2, at, k2);
    for (i = 0; i < n; i++) at[i] = x[i] + h / 2 * k2[i];
    slope(fmu, t + h / 2, at, k3);
    for (i = 0; i < n; i++) at[i] = x[i] + h * k3[i];
    slope(fmu, t + h, at, k4);
    for (i = 0; i < n; i++) x[i] += h / 6 * (k1[i] + 2 * k2[i] + 2 * k3[i] + k4[i]);
    must(fmu, fmu_set_states(fmu, x, n), "set the new states");
    must(fmu, fmu_completed_step(fmu), "complete the step");
}

void advance(Fmu *fmu, double h) {
    if (fmu->kind == MODEL_EXCHANGE) {
        integrate(fmu, h);
    } else {
        must(fmu, fmu_step(fmu, fmu->time, h), "step");
    }
    fmu->time += h;
}

void tune(Fmu *fmu, double mass, double drag) {
    if (fmu->kind == MODEL_EXCHANGE) must(fmu, fmu_event_mode(fmu), "enter the event mode");
    must(fmu, set(fmu, "M", mass), "tune the mass");
    must(fmu, set(fmu, "C_d", drag), "tune the drag");
    if (fmu->kind == CO_SIMULATION) return;
    must(fmu, fmu_settle(fmu), "settle");
    must(fmu, fmu_continuous_mode(fmu), "enter the continuous-time mode");
}

void refused(Fmu *fmu, const char *label, Status status) {
    printf("%s: %d %s\n", label, (int)status, fmu->said);
    fmu->said[0] = '\0';
}

static void add(Group *group, unsigned int reference) { group->references[group->n++] = reference; }

static void read_variables(const char *path, Subject *subject) {
    FILE *file = fopen(path, "r");
    char group[16], name[64];
    unsigned int reference;

    if (!file) fail(path, "cannot be read");
    while (fscanf(file, "%15s %u %63s", group, &reference, name) == 3) {
        if (reference >= MOST) fail(name, "its value reference is too large");
        strcpy(subject->names[reference], name);
        if (strcmp(group, "state") == 0) {
            add(&subject->states, reference);
            add(&subject->running, reference);
            add(&subject->unknowns, reference);
        } else if (strcmp(group, "derivative") == 0 || strcmp(group, "output") == 0) {
            add(&subject->unknowns, reference);
        } else if (strcmp(group, "input") == 0) {
            add(&subject->inputs, reference);
            add(&subject->running, reference);
            add(&subject->beginning, reference);
        } else if (strcmp(group, "parameter") == 0) {
            add(&subject->beginning, reference);
        }
    }
    fclose(file);
}

int main(int argc, char **argv) {
    static const struct {
        const char *name;
        void (*run)(const Subject *subject, int number);
    } SCENARIOS[] = {{"life", life},     {"misuse", misuse}, {"damage", damage},  {"no_memory", no_memory},
                     {"growth", growth}, {"crowd", crowd},   {"threads", threads}};
    static Subject subject;
    void *library;
    size_t i;

    if (argc != 7) fail(argv[0], "needs LIBRARY TOKEN VARIABLES me|cs SCENARIO NUMBER");
    library = dlopen(argv[1], RTLD_NOW | RTLD_LOCAL);
    if (!library) fail(argv[1], dlerror());
    fmu_load(library);
    subject.token = argv[2];
    subject.kind = strcmp(argv[4], "me") == 0 ? MODEL_EXCHANGE : CO_SIMULATION;
    read_variables(argv[3], &subject);
    for (i = 0; i < sizeof SCENARIOS / sizeof *SCENARIOS; i++) {
        if (strcmp(argv[5], SCENARIOS[i].name) != 0) continue;
        SCENARIOS[i].run(&subject, atoi(argv[6]));
        dlclose(library);
        return 0;
    }
    fail(argv[5], "no such scenario");
}
