/* SPDX-License-Identifier: GPL-3.0-or-later
 * What effects take of the camera pass's time, by a few samples that are timed. */
#ifndef AMB_CAMERA_LEDGER_H
#define AMB_CAMERA_LEDGER_H

#include <stdatomic.h>
#include <stddef.h>

#include "base/parallel.h"

/* Each moment is counted once. What happens along the way of a reflection, or behind an object, is
 * that way's, the light that is gathered there, too: without the effect it would be saved. */
typedef enum LedgerEntry {
    LEDGER_RAYS, /* primary rays to what they see, and the shading that there is in any case */
    LEDGER_BOUNCES,
    LEDGER_REFLECTION,
    LEDGER_BACKGROUND,
    LEDGER_SINGLE, /* these four along all other ways */
    LEDGER_DOUBLE,
    LEDGER_MULTIPLE, /* and all later orders where they are looked up together */
    LEDGER_WORLD_LIGHT,
    LEDGER_LIGHT_BOUNCES, /* of these four's gathers that of light reflected inside, */
    LEDGER_TRANSMITTED,   /* and of light that has passed an object, reflected or not */
    LEDGER_SURFACES,      /* likewise what is asked for on the way of light to opaque surfaces */
    LEDGER_CAUSTICS,
    LEDGER_INTERREFLECTION, /* with all that is done for it */
    LEDGER_RETURN,          /* likewise; see CameraWay */
    LEDGER_ENTRY_COUNT
} LedgerEntry;

/* One of so many samples is timed. */
enum { LEDGER_PERIOD = 128 };

typedef struct Ledger {
    uint32_t object_count;
    atomic_uint_least64_t *ns; /* by object, and last by none, and entry */
} Ledger;

AmbStatus ledger_create(uint32_t object_count, Ledger *out_ledger);
void ledger_clear(Ledger *ledger);

/* Nanoseconds of an entry, of one object or (object_count) of none. */
uint64_t ledger_ns(const Ledger *ledger, uint32_t object, LedgerEntry entry);

/* Of one sample. */
typedef struct LedgerClock {
    Ledger *ledger; /* NULL: the sample is not timed */
    double since;   /* clock_thread_cpu when the entry was opened */
    LedgerEntry entry;
    uint32_t object; /* UINT32_MAX: none */
} LedgerClock;

/* Books the time until now and opens another entry. */
void ledger_switch(LedgerClock *clock, LedgerEntry entry, uint32_t object);

/* What is done along the way of these is theirs. */
static inline bool ledger_is_way(LedgerEntry entry) {
    return entry != LEDGER_RAYS && (entry < LEDGER_SINGLE || entry >= LEDGER_SURFACES);
}

/* Takes some of the time since the open entry was opened for another one, unless the open one has
 * precedence. */
void ledger_take(LedgerClock *clock, LedgerEntry entry, double seconds);

/* Opens an entry, unless the open one has precedence; returns that for ledger_close. */
static inline LedgerEntry ledger_open(LedgerClock *clock, LedgerEntry entry) {
    const LedgerEntry before = clock->entry;
    const bool yields =
        before >= LEDGER_INTERREFLECTION || (ledger_is_way(before) && !ledger_is_way(entry));
    if (clock->ledger != NULL && !yields && entry != before)
        ledger_switch(clock, entry, clock->object);
    return before;
}

static inline void ledger_close(LedgerClock *clock, LedgerEntry before) {
    if (clock->ledger != NULL && clock->entry != before)
        ledger_switch(clock, before, clock->object);
}

#endif
