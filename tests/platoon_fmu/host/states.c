/* Bytes that are no state: every length but the right one, every bit flipped, those of the other kind. */
#include <stdio.h>
#include <stdlib.h>
#include <string.h>

#include "host.h"

typedef struct {
    unsigned char *bytes;
    size_t size;
} Bytes;

static void start_new(Fmu *fmu, const Subject *subject, Kind kind) {
    must(fmu, fmu_instantiate(fmu, subject, kind, "car", subject->token) ? OK : ERROR, "instantiate");
    must(fmu, set(fmu, "v_x_start", 20.0), "set v_x_start");
    start(fmu, 0.0);
    drive(fmu, 1);
    advance(fmu, 0.01);
}

static Bytes serialized(Fmu *fmu) {
    void *state = NULL;
    Bytes saved;

    must(fmu, fmu_save(fmu, &state), "save");
    must(fmu, fmu_serialized_size(fmu, state, &saved.size), "ask for the size");
    saved.bytes = malloc(saved.size);
    must(fmu, saved.bytes ? fmu_serialize(fmu, state, saved.bytes, saved.size) : ERROR, "serialize");
    must(fmu, fmu_discard(fmu, &state), "discard");
    return saved;
}

/* Whether the bytes are refused, with a word on the bytes, and give no state. They are copied to a block of their very
 * size, so that a read past it shows. */
static bool are_refused(Fmu *fmu, const unsigned char *bytes, size_t size) {
    unsigned char *copy = malloc(size > 0 ? size : 1);
    void *state = NULL;
    bool refused;

    memcpy(copy, bytes, size);
    fmu->said[0] = '\0';
    refused = fmu_deserialize(fmu, copy, size, &state) == ERROR && !state && strstr(fmu->said, "the bytes");
    free(copy);
    return refused;
}

void damage(const Subject *subject, int number) {
    const Kind other_kind = subject->kind == MODEL_EXCHANGE ? CO_SIMULATION : MODEL_EXCHANGE;
    size_t i, n = 0, n_refused = 0;
    void *state = NULL;
    Bytes good, other;
    Fmu fmu, stranger;

    (void)number;
    start_new(&fmu, subject, subject->kind);
    start_new(&stranger, subject, other_kind);
    good = serialized(&fmu);
    other = serialized(&stranger);
    for (i = 0; i < good.size; i++, n++) n_refused += are_refused(&fmu, good.bytes, i);
    printf("shorter: %zu of %zu refused\n", n_refused, n);
    for (i = n = n_refused = 0; i < 8 * good.size; i++, n++) {
        good.bytes[i / 8] ^= (unsigned char)(1u << (i % 8));
        n_refused += are_refused(&fmu, good.bytes, good.size);
        good.bytes[i / 8] ^= (unsigned char)(1u << (i % 8));
    }
    printf("flipped: %zu of %zu refused\n", n_refused, n);
    refused(&fmu, "other kind", fmu_deserialize(&fmu, other.bytes, other.size, &state));
    refused(&fmu, "two in one", fmu_deserialize(&fmu, good.bytes, 2 * good.size, &state));
    memset(other.bytes, 0, other.size);
    refused(&fmu, "zeros", fmu_deserialize(&fmu, other.bytes, other.size, &state));
    refused(&fmu, "a state from the other kind",
            (must(&stranger, fmu_save(&stranger, &state), "save"), fmu_restore(&fmu, state)));
    must(&stranger, fmu_discard(&stranger, &state), "discard");

    print_unknowns(&fmu, "before");
    must(&fmu, fmu_deserialize(&fmu, good.bytes, good.size, &state), "deserialize the good bytes");
    must(&fmu, fmu_restore(&fmu, state), "restore");
    must(&fmu, fmu_discard(&fmu, &state), "discard");
    print_unknowns(&fmu, "restored");
    free(good.bytes);
    free(other.bytes);
    fmu_free(&fmu);
    fmu_free(&stranger);
}
