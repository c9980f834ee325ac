/* Many instances at once, in one thread and in many: each goes the way it goes alone. */
#include <pthread.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>

#include "host.h"

#define N_THREADS 8
#define N_STEPS 12

/* The i-th of the crowd, which differs from all others from the start. */
typedef struct {
    const Subject *subject;
    int i;
    Fmu fmu;
    double values[MOST]; /* of the unknowns in the end */
} Member;

static void enter(Member *member, const Subject *subject, int i) {
    Fmu *fmu = &member->fmu;

    member->subject = subject;
    member->i = i;
    must(fmu, fmu_instantiate(fmu, subject, subject->kind, "member", subject->token) ? OK : ERROR, "instantiate");
    must(fmu, set_solver(fmu, 1 + i % 2), "set the solver");
    must(fmu, set(fmu, "v_x_start", 10.0 + 0.01 * i), "set v_x_start");
    must(fmu, set(fmu, "M", 1500.0 + i), "set M");
    start(fmu, 0.0);
}

static void walk(Member *member, int step) {
    drive(&member->fmu, member->i + step);
    advance(&member->fmu, 0.01);
}

static void leave(Member *member) {
    get_unknowns(&member->fmu, member->values);
    fmu_free(&member->fmu);
}

/* Members from `first` on, a step of each in turn. */
static void walk_together(Member *members, const Subject *subject, int first, int n) {
    int i, step;

    for (i = 0; i < n; i++) enter(&members[i], subject, first + i);
    for (step = 0; step < N_STEPS; step++) {
        for (i = 0; i < n; i++) walk(&members[i], step);
    }
    for (i = 0; i < n; i++) leave(&members[i]);
}

static void walk_alone(Member *members, const Subject *subject, int n) {
    int i;

    for (i = 0; i < n; i++) walk_together(&members[i], subject, i, 1);
}

static bool equal(const Member *a, const Member *b) {
    return memcmp(a->values, b->values, a->subject->unknowns.n * sizeof(double)) == 0;
}

static void print_comparison(const Member *together, const Member *alone, int n) {
    int i, n_equal = 0, n_neighbours = 0;

    for (i = 0; i < n; i++) n_equal += equal(&together[i], &alone[i]);
    for (i = 1; i < n; i++) n_neighbours += equal(&together[i - 1], &together[i]);
    printf("members: %d\nas alone: %d\nas their neighbours: %d\n", n, n_equal, n_neighbours);
    print_values("last", together[n - 1].values, together->subject->unknowns.n);
}

static Member *room_for(int n) {
    Member *members = calloc((size_t)n, sizeof *members);

    if (!members) abort();
    return members;
}

void crowd(const Subject *subject, int number) {
    Member *together = room_for(number), *alone = room_for(number);

    walk_together(together, subject, 0, number);
    walk_alone(alone, subject, number);
    print_comparison(together, alone, number);
    free(together);
    free(alone);
}

typedef struct {
    const Subject *subject;
    Member *members;
    int first, n;
} Part;

static void *walk_part(void *argument) {
    Part *part = argument;

    walk_together(part->members, part->subject, part->first, part->n);
    return NULL;
}

/* `number` members in each thread. */
void threads(const Subject *subject, int number) {
    const int n = N_THREADS * number;
    Member *together = room_for(n), *alone = room_for(n);
    pthread_t ids[N_THREADS];
    Part parts[N_THREADS];
    int i;

    for (i = 0; i < N_THREADS; i++) {
        parts[i] = (Part){subject, together + (ptrdiff_t)i * number, i * number, number};
        if (pthread_create(&ids[i], NULL, walk_part, &parts[i]) != 0) abort();
    }
    for (i = 0; i < N_THREADS; i++) pthread_join(ids[i], NULL);
    walk_alone(alone, subject, n);
    print_comparison(together, alone, n);
    free(together);
    free(alone);
}
