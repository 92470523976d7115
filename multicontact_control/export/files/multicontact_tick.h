/* One tick of multicontact_control: what came in is checked, the arm is seen, the task is limited,
   the law answers, and the torque passes the gate.

   Written by `multicontact export` for one configuration, whose forces and couples are, in the
   order of `contacts`: @COLUMNS@.

   A cycle:

       write controller.stages[0].sample        what came in, each reading with its stamp
       mc_take(&controller)                     what is valid is in `motion`
       write controller.terms, controller.added the arm's model at `motion`
       mc_tick(&controller)
       command joints[j].gate.commanded_torque less joints[j].drive_gravity_torque

   A reading that has not come is ABSENT, one that cannot be read INVALID; the newest valid one
   stands in for it until it is too old. `supervisions[0].reaction` says what has answered: the law
   (TO_NONE, TO_INFLATE), or, by itself, a hold, float or damp, and `causes` why. The torque that
   is commanded is always the one to send: it has passed the gate. `command` of a sample is
   `commanded_torque` of the tick before, if MC_COMMAND_DELAY is 0 or more.

   What is wanted is in `controls[0].wanted`, and `wanted` and `alpha_wanted` of `contacts`. Where
   `supervisions[0].begins` says that a task begins, the pose of the arm has just been written
   there, at rest, and no force; a caller with a task of its own calls mc_see, writes it, and calls
   mc_act. While `limits[0].held` or `locked`, what is wanted is the library's. A contact is
   approached where it is wanted; its state is `states[i].state`.

   What only the Python controller does: trajectories, scenarios and topics, explanations and
   events, estimates of R (`sample.variance`, ABSENT: as configured), other parameters and another
   tool without a restart, push test and tare, and taking velocities for refuted because they
   explain a collision.

   No call allocates, locks, waits or enters the operating system. A controller is used by one
   thread at a time; several controllers are independent of each other. All units are SI. */
#ifndef MULTICONTACT_TICK_H
#define MULTICONTACT_TICK_H

#include <stdbool.h>
#include <stddef.h>
#include <stdint.h>
#include <string.h>

#ifdef __cplusplus
#define MC_ASSERT(condition, text) static_assert(condition, text)
extern "C" {
#else
#define MC_ASSERT(condition, text) _Static_assert(condition, text)
#endif

/* Of names, types and places of all fields: library, header and records have the same. */
#define MC_LAYOUT UINT64_C(@LAYOUT@)

@CONSTANTS@

@STRUCTS@

/* What `multicontact_records.bin` holds: a controller as configured, before its first sample. */
typedef struct {
    char magic[8]; /* MC_MAGIC, without the 0 at its end */
    uint64_t layout; /* MC_LAYOUT */
    uint64_t size; /* of the controller [bytes] */
    mc_controller controller;
} mc_records;
#define MC_MAGIC "MCTICK01"

/* MC_LAYOUT of the library. */
extern const uint64_t mc_library_layout;

@CALLS@

/* The arm is seen, and it is decided what answers; returns flags. */
static inline int64_t mc_see(mc_controller *controller)
{
    return mc_run(controller, MC_SEE);
}

/* What was seen is answered, by the law or by a reaction; returns flags. */
static inline int64_t mc_act(mc_controller *controller)
{
    return mc_run(controller, MC_ACT);
}

/* Both; returns flags. */
static inline int64_t mc_tick(mc_controller *controller)
{
    return mc_run(controller, MC_SEE | MC_ACT);
}

/* Why mc_configure refuses records. */
#define MC_WRONG_SIZE 1 /* they are no records, or cut short */
#define MC_WRONG_LAYOUT 2 /* of another configuration or version than header or library */

/* Make a controller of the content of a file of records, `size` bytes; returns 0, or why not. */
static inline int mc_configure(mc_controller *controller, const void *content, size_t size)
{
    mc_records head;
    const size_t before = offsetof(mc_records, controller);
    if (size != sizeof(mc_records)) {
        return MC_WRONG_SIZE;
    }
    memcpy(&head, content, before);
    if (memcmp(head.magic, MC_MAGIC, sizeof head.magic) != 0 || head.size != sizeof(mc_controller)) {
        return MC_WRONG_SIZE;
    }
    if (head.layout != MC_LAYOUT || mc_library_layout != MC_LAYOUT) {
        return MC_WRONG_LAYOUT;
    }
    memcpy(controller, (const char *)content + before, sizeof(mc_controller));
    return 0;
}

/* Forget all that was measured and commanded: the next sample is the first. `content` has been
   accepted by mc_configure. */
static inline void mc_reset(mc_controller *controller, const void *content)
{
    memcpy(controller, (const char *)content + offsetof(mc_records, controller), sizeof(mc_controller));
}

#ifdef __cplusplus
}
#endif

#endif
