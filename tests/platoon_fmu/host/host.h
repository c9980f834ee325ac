/* A host of the vehicle's FMU that is no Python: it loads the binary and drives it as an importer written in C does.
 *
 * The scenarios (life.c, misuse.c, states.c, memory.c, crowd.c) know no version of the standard; host2.c and host3.c give
 * them the functions declared here, one of the two is linked. Results are printed as lines `label: value ...`, reals as
 * hexadecimal floats, so that they can be compared bit for bit.
 */
#ifndef PLATOON_HOST_H
#define PLATOON_HOST_H

#include <stdbool.h>
#include <stddef.h>

typedef enum { MODEL_EXCHANGE, CO_SIMULATION } Kind;

/* As both versions of the standard number them. */
typedef enum { OK, WARNING, DISCARD, ERROR } Status;

#define MOST 256 /* variables */

/* Variables by their value references. */
typedef struct {
    unsigned int references[MOST];
    size_t n;
} Group;

/* What is driven, as the modelDescription has it. */
typedef struct {
    const char *token;
    Kind kind;
    char names[MOST][64]; /* by value reference */
    Group states, unknowns /* states, derivatives, outputs */, inputs;
    Group running, beginning; /* knowns: states and inputs; inputs and parameters */
} Subject;

/* An instance, or the attempt at one. */
typedef struct {
    const Subject *subject;
    Kind kind;
    void *instance; /* the FMU's, NULL where there is none */
    void *own;      /* of host2.c or host3.c */
    double time;
    bool aloud;     /* prints what the FMU logs */
    char said[500]; /* the last message */
} Fmu;

/* ---- host.c ---- */

unsigned int reference_of(const Subject *subject, const char *name);

/* Ends the program with the last message unless a call went well. */
void must(Fmu *fmu, Status status, const char *what);

void print_values(const char *label, const double *values, size_t n);

/* What the FMU said, into the instance's place for it. */
void hear(Fmu *fmu, const char *category, const char *text);

/* Single variables by name. */
Status set(Fmu *fmu, const char *name, double value);
Status set_solver(Fmu *fmu, int solver);

/* Gets all unknowns; prints them. */
void get_unknowns(Fmu *fmu, double *values);
void print_unknowns(Fmu *fmu, const char *label);

/* From a new instance to where it is stepped or integrated; `initialized` begins in initialization mode. */
void start(Fmu *fmu, double time);
void start_initialized(Fmu *fmu);

/* Sets the inputs of the i-th step. */
void drive(Fmu *fmu, int i);

/* Goes h seconds on: by a step or, in Model Exchange, by one of the classical Runge-Kutta method. */
void advance(Fmu *fmu, double h);

/* Sets tunable parameters, between steps. */
void tune(Fmu *fmu, double mass, double drag);

/* ---- scenarios; `number` is the solver or a count ---- */

void life(const Subject *subject, int number);
void misuse(const Subject *subject, int number);
void damage(const Subject *subject, int number);
void no_memory(const Subject *subject, int number);
void growth(const Subject *subject, int number);
void crowd(const Subject *subject, int number);
void threads(const Subject *subject, int number);

/* A call that must not go through: prints its label, status and message. */
void refused(Fmu *fmu, const char *label, Status status);

/* ---- host2.c, host3.c ---- */

/* Looks all functions up in the binary; ends the program where one is missing. */
void fmu_load(void *library);

/* False, and fmu->said has the reason, where there is no instance. fmu_free goes with it in any case. */
bool fmu_instantiate(Fmu *fmu, const Subject *subject, Kind kind, const char *name, const char *token);
void fmu_free(Fmu *fmu);

const char *fmu_version(void);
Status fmu_set_logging(Fmu *fmu, bool on, size_t n, const char *const *categories);
Status fmu_initialize(Fmu *fmu, double start_time, double stop_time, double tolerance);
Status fmu_exit_initialization(Fmu *fmu);
Status fmu_terminate(Fmu *fmu);
Status fmu_reset(Fmu *fmu);

Status fmu_get(Fmu *fmu, const unsigned int *references, size_t n, double *values);
Status fmu_set(Fmu *fmu, const unsigned int *references, size_t n, const double *values);
Status fmu_get_integer(Fmu *fmu, const unsigned int *reference, int *value);
Status fmu_set_integer(Fmu *fmu, const unsigned int *reference, const int *value);
Status fmu_directional(Fmu *fmu, const Group *unknowns, const Group *knowns, const double *seed, double *sensitivity);

Status fmu_event_mode(Fmu *fmu);
Status fmu_settle(Fmu *fmu);
Status fmu_continuous_mode(Fmu *fmu);
Status fmu_completed_step(Fmu *fmu);
Status fmu_set_time(Fmu *fmu, double time);
Status fmu_set_states(Fmu *fmu, const double *x, size_t n);
Status fmu_get_states(Fmu *fmu, double *x, size_t n);
Status fmu_get_derivatives(Fmu *fmu, double *dx, size_t n);
Status fmu_get_nominals(Fmu *fmu, double *nominals, size_t n);

Status fmu_step(Fmu *fmu, double time, double h);
Status fmu_output_derivatives(Fmu *fmu, const Group *unknowns, int order, double *values);

Status fmu_save(Fmu *fmu, void **state);
Status fmu_restore(Fmu *fmu, void *state);
Status fmu_discard(Fmu *fmu, void **state);
Status fmu_serialized_size(Fmu *fmu, void *state, size_t *size);
Status fmu_serialize(Fmu *fmu, void *state, unsigned char *bytes, size_t size);
Status fmu_deserialize(Fmu *fmu, const unsigned char *bytes, size_t size, void **state);

/* What only the version has: at work, while `fmu` is stepped or integrated, and misused. */
void fmu_own_life(Fmu *fmu);
void fmu_own_misuse(Fmu *fmu);

#endif
