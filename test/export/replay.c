/* Replay what a controller in Python was given, and compare what becomes of it, byte for byte.

   `replay RECORDS < calls`: each call has a `head`, the writes that come before it, each an offset,
   a size and bytes, and, if it is compared, all bytes of the controller after it. */
#include <stdio.h>
#include <stdlib.h>

#include "multicontact_tick.h"

enum { TAKE, SEE, ACT, TICK, FAIL, HOLD, LOCK, RETRY, STOP };

typedef struct {
    int64_t entry;
    int64_t argument;
    int64_t writes;
    int64_t result;
    int64_t compared;
} head;

/* Each in memory of its own, so that valgrind sees what is read or written beyond. */
static mc_controller *controller, *expected;

static void take(void *place, size_t size)
{
    if (fread(place, 1, size, stdin) != size) {
        fprintf(stderr, "the calls end within one\n");
        exit(2);
    }
}

static int64_t call(int64_t entry, int64_t argument)
{
    switch (entry) {
    case TAKE:
        return mc_take(controller);
    case SEE:
        return mc_see(controller);
    case ACT:
        return mc_act(controller);
    case TICK:
        return mc_tick(controller);
    case FAIL:
        return mc_fail(controller, argument);
    case HOLD:
        return mc_hold(controller, argument);
    case LOCK:
        return mc_lock(controller, argument);
    case RETRY:
        return mc_retry(controller);
    case STOP:
        return mc_stop(controller);
    }
    fprintf(stderr, "entry %ld is unknown\n", (long)entry);
    exit(2);
}

static void configure(const char *path)
{
    static char content[sizeof(mc_records) + 1];
    FILE *file = fopen(path, "rb");
    if (file == NULL) {
        perror(path);
        exit(2);
    }
    size_t size = fread(content, 1, sizeof content, file);
    fclose(file);
    int refused = mc_configure(controller, content, size);
    if (refused) {
        fprintf(stderr, "records refused: %d\n", refused);
        exit(2);
    }
}

int main(int count, char **arguments)
{
    if (count != 2) {
        return 2;
    }
    controller = malloc(sizeof *controller);
    expected = malloc(sizeof *expected);
    if (controller == NULL || expected == NULL) {
        return 2;
    }
    configure(arguments[1]);
    long calls = 0;
    for (head next; fread(&next, sizeof next, 1, stdin) == 1; calls++) {
        for (int64_t i = 0; i < next.writes; i++) {
            int64_t part[2]; /* offset, size */
            take(part, sizeof part);
            take((char *)controller + part[0], (size_t)part[1]);
        }
        int64_t result = call(next.entry, next.argument);
        if (result != next.result) {
            printf("%ld result %ld instead of %ld\n", calls, (long)result, (long)next.result);
            return 1;
        }
        if (!next.compared) {
            continue;
        }
        take(expected, sizeof *expected);
        if (memcmp(controller, expected, sizeof *expected) == 0) {
            continue;
        }
        const char *found = (const char *)controller, *right = (const char *)expected;
        size_t i = 0;
        while (found[i] == right[i]) {
            i++;
        }
        printf("%ld byte %zu\n", calls, i);
        return 1;
    }
    printf("%ld equal\n", calls);
    free(controller);
    free(expected);
    return 0;
}
