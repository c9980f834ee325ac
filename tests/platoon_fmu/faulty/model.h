/* A mass on a spring, pushed and damped, sound or with one fault that the compiler is told by -DFAULT_..., or otherwise
 * sound by -DWITH_...:
 *
 *   x' = v,  v' = u - k x - 0.2 v^3,  y = x^2 + u / 2,  w = (x, v)
 */
#include <math.h>
#include <stdlib.h>
#include <string.h>

/* In the order of modelDescription.xml; these are the value references, but that FMI 3.0 has w as one array. */
enum { X, V, DER_X, DER_V, U, K, Y, W1, W2, TIME, VALUES };

typedef struct {
    double value[VALUES];
} Model;

#ifdef FAULT_SHARED
static double shared_v;
#define VELOCITY(m) shared_v
#else
#define VELOCITY(m) ((m)->value[V])
#endif

static inline void model_initialise(Model *m) {
    double v = VELOCITY(m);

    memset(m, 0, sizeof *m);
    m->value[X] = 1.0;
    m->value[U] = 0.5;
    m->value[K] = 4.0;
    VELOCITY(m) = 0.0;
#ifdef FAULT_RESET
    VELOCITY(m) = v;
#endif
    (void)v;
}

static inline double model_get(Model *m, size_t reference) {
    double *value = m->value, v = VELOCITY(m);

    value[V] = v;
    value[DER_X] = v;
    value[DER_V] = value[U] - value[K] * value[X] - 0.2 * v * v * v;
    value[Y] = value[X] * value[X] + value[U] / 2;
#ifdef FAULT_DEPENDENCY
    value[Y] += 0.1 * v;
#endif
#ifdef WITH_KINK
    value[Y] += fabs(value[X] - 1);
#endif
#ifdef FAULT_NAN
    if (value[TIME] > 0) value[Y] = NAN;
#endif
    value[W1] = value[X];
    value[W2] = v;
    return value[reference];
}

static inline int model_can_set(unsigned reference) { return reference <= V || reference == U || reference == K; }

static inline void model_set(Model *m, size_t reference, double value) {
    if (reference == V) VELOCITY(m) = value;
    m->value[reference] = value;
}

static inline double model_partial(Model *m, size_t unknown, size_t known) {
    double x = m->value[X], v = VELOCITY(m);

    switch (unknown * VALUES + known) {
        case X *VALUES + X:
        case V *VALUES + V:
        case W1 *VALUES + X:
        case W2 *VALUES + V: return 1.0;
        case DER_X *VALUES + V: return 1.0;
        case DER_V *VALUES + X: return -m->value[K];
#ifndef FAULT_DAMPING
        case DER_V *VALUES + V: return -0.6 * v * v;
#endif
        case DER_V *VALUES + U: return 1.0;
#ifdef WITH_KINK
        case Y *VALUES + X: return 2 * x + (x > 1) - (x < 1);
#else
        case Y *VALUES + X: return 2 * x;
#endif
#ifdef FAULT_DEPENDENCY
        case Y *VALUES + V: return 0.1;
#endif
#ifdef FAULT_DERIVATIVE
        case Y *VALUES + U: return 1.0;
#else
        case Y *VALUES + U: return 0.5;
#endif
        default: return 0.0;
    }
}

/* Euler, in steps of a ten-thousandth of a second at most. */
static inline void model_step(Model *m, double h) {
    int steps = (int)ceil(h / 1e-4);

#ifdef FAULT_CRASH
    *(volatile int *)8 = 1;
#endif
#ifdef FAULT_HANG
    for (volatile int forever = 1; forever;) {
    }
#endif
    for (int i = 0; i < steps; i++) {
        double dx = model_get(m, DER_X), dv = model_get(m, DER_V);

#ifdef FAULT_SOLVER
        dv /= 2;
#endif
        m->value[X] += dx * h / steps;
        VELOCITY(m) += dv * h / steps;
    }
    m->value[TIME] += h;
}

/* When the next time event is; there is one every 0.05 s. */
static inline double model_next_event(const Model *m) { return 0.05 * floor(m->value[TIME] / 0.05 + 1.0 + 1e-9); }

/* ---- saved states ---- */

typedef struct {
    Model model;
    double v;
    const void *home;
} State;

static inline State model_save(Model *m) {
    State state = {*m, VELOCITY(m), m};

    return state;
}

static inline void model_restore(Model *m, const State *state) {
    double v = VELOCITY(m);

    *m = state->model;
    VELOCITY(m) = state->v;
#ifdef FAULT_RESTORE
    VELOCITY(m) = v;
#endif
#ifdef FAULT_POINTER
    /* Takes it from where it was, which in another process is no place at all. */
    VELOCITY(m) += 0 * ((const Model *)state->home)->value[V];
#endif
    (void)v;
}
