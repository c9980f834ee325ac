/* Memory: what an instance takes, that stepping takes none, and what happens where there is none.
 *
 * For these the FMU's sources are compiled with its malloc, calloc and free named as the functions here, which count the
 * bytes and can fail.
 */
#include <stddef.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>

#include "host.h"

void *host_malloc(size_t size);
void *host_calloc(size_t n, size_t size);
void host_free(void *block);

/* Goes before each block; the union keeps the alignment. */
typedef union {
    size_t size;
    max_align_t alignment;
} Head;

/* Of all blocks there are, and since `allocations` was last set to 0. */
static struct {
    size_t bytes, blocks, allocations;
    size_t failing; /* the allocation, counted from 1, that fails with all that follow; 0 for none */
} heap;

void *host_malloc(size_t size) {
    Head *head;

    heap.allocations++;
    if (heap.failing > 0 && heap.allocations >= heap.failing) return NULL;
    head = malloc(sizeof *head + size);
    if (!head) abort();
    head->size = size;
    heap.bytes += size;
    heap.blocks++;
    return head + 1;
}

void *host_calloc(size_t n, size_t size) {
    void *block = host_malloc(n * size);

    return block ? memset(block, 0, n * size) : NULL;
}

void host_free(void *block) {
    Head *head = block;

    if (!block) return;
    head--;
    heap.bytes -= head->size;
    heap.blocks--;
    free(head);
}

/* From the next allocation on, the n-th fails; none for 0. */
static void fail_from(size_t n) {
    heap.allocations = 0;
    heap.failing = n;
}

static void print_heap(const char *label) {
    printf("%s: %zu bytes, %zu blocks, %zu allocations\n", label, heap.bytes, heap.blocks, heap.allocations);
}

static void some_steps(Fmu *fmu, const char *label) {
    double seed[MOST] = {1.0}, sensitivity[MOST];
    int i;

    for (i = 0; i < 5; i++) {
        drive(fmu, i);
        advance(fmu, 0.01);
    }
    must(fmu, fmu_directional(fmu, &fmu->subject->unknowns, &fmu->subject->running, seed, sensitivity), "differentiate");
    print_unknowns(fmu, label);
}

/* No instance for lack of its n-th block, for each n in turn; then the one that gets them all. */
static void instantiate_in_need(Fmu *fmu, const Subject *subject) {
    char label[40];
    size_t n;

    for (n = 1;; n++) {
        fail_from(n);
        if (fmu_instantiate(fmu, subject, subject->kind, "car", subject->token)) break;
        snprintf(label, sizeof label, "no block %zu", n);
        refused(fmu, label, ERROR);
        fmu_free(fmu);
        print_heap("left");
    }
    print_heap("instance");
}

void no_memory(const Subject *subject, int number) {
    void *state = NULL, *none = NULL;
    unsigned char *bytes;
    size_t size;
    Fmu fmu;

    instantiate_in_need(&fmu, subject);
    fail_from(1);
    must(&fmu, set_solver(&fmu, number), "set the solver");
    must(&fmu, set(&fmu, "v_x_start", 20.0), "set v_x_start");
    start(&fmu, 0.0);
    some_steps(&fmu, "in need");
    refused(&fmu, "save", fmu_save(&fmu, &none));
    fail_from(0);
    must(&fmu, fmu_save(&fmu, &state), "save");
    must(&fmu, fmu_serialized_size(&fmu, state, &size), "ask for the size");
    bytes = malloc(size);
    must(&fmu, bytes ? fmu_serialize(&fmu, state, bytes, size) : ERROR, "serialize");
    fail_from(1);
    refused(&fmu, "deserialize", fmu_deserialize(&fmu, bytes, size, &none));
    printf("state: %s\n", none ? "some" : "none");
    /* What is there already can be used. */
    must(&fmu, fmu_save(&fmu, &state), "save over a state");
    must(&fmu, fmu_deserialize(&fmu, bytes, size, &state), "deserialize over a state");
    must(&fmu, fmu_restore(&fmu, state), "restore");
    fmu.time = 0.05;
    some_steps(&fmu, "still in need");
    must(&fmu, fmu_discard(&fmu, &state), "discard");
    must(&fmu, fmu_discard(&fmu, &none), "discard none");
    free(bytes);
    fmu_free(&fmu);
    print_heap("end");
}

/* `number` steps, and a tenth as many states saved and restored. */
void growth(const Subject *subject, int number) {
    void *state = NULL, *kept = NULL;
    double values[MOST];
    Fmu fmu;
    int i;

    fail_from(0);
    must(&fmu, fmu_instantiate(&fmu, subject, subject->kind, "car", subject->token) ? OK : ERROR, "instantiate");
    print_heap("instance");
    must(&fmu, set(&fmu, "v_x_start", 20.0), "set v_x_start");
    start(&fmu, 0.0);
    fail_from(0);
    for (i = 0; i < number; i++) {
        if (i % 100 == 0) {
            drive(&fmu, i / 100 % 21);
            get_unknowns(&fmu, values);
        }
        advance(&fmu, 0.001);
    }
    print_heap("stepped");
    print_values("time", &fmu.time, 1);
    print_unknowns(&fmu, "unknowns");
    must(&fmu, fmu_save(&fmu, &kept), "save");
    print_heap("kept");
    for (i = 0; i < number / 10; i++) {
        must(&fmu, fmu_save(&fmu, &state), "save");
        must(&fmu, fmu_restore(&fmu, state), "restore");
        must(&fmu, fmu_discard(&fmu, &state), "discard");
        must(&fmu, fmu_save(&fmu, &kept), "save over");
    }
    print_heap("saved");
    must(&fmu, fmu_discard(&fmu, &kept), "discard");
    fmu_free(&fmu);
    print_heap("end");
}
