/* SPDX-License-Identifier: GPL-3.0-or-later
 * What effects take of the camera pass's time. */
#include "camera/ledger.h"

#include "base/memory.h"

AmbStatus ledger_create(uint32_t object_count, Ledger *out_ledger) {
    *out_ledger = (Ledger){
        .object_count = object_count,
        .ns = memory_zero_array((uint64_t)(object_count + 1) * LEDGER_ENTRY_COUNT,
                                sizeof *out_ledger->ns),
    };
    if (out_ledger->ns == NULL)
        return status_fail(AMB_OUT_OF_MEMORY, "no memory for the account of a render's time");
    return AMB_OK;
}

void ledger_clear(Ledger *ledger) {
    memory_free(ledger->ns);
    *ledger = (Ledger){.ns = NULL};
}

static atomic_uint_least64_t *place(const Ledger *ledger, uint32_t object, LedgerEntry entry) {
    const uint32_t row = object < ledger->object_count ? object : ledger->object_count;
    return &ledger->ns[(uint64_t)row * LEDGER_ENTRY_COUNT + (uint64_t)entry];
}

uint64_t ledger_ns(const Ledger *ledger, uint32_t object, LedgerEntry entry) {
    return atomic_load(place(ledger, object, entry));
}

static void book(const LedgerClock *clock, LedgerEntry entry, double seconds) {
    atomic_fetch_add_explicit(place(clock->ledger, clock->object, entry), (uint64_t)(1e9 * seconds),
                              memory_order_relaxed);
}

void ledger_switch(LedgerClock *clock, LedgerEntry entry, uint32_t object) {
    const double now = clock_thread_cpu();
    book(clock, clock->entry, now - clock->since);
    clock->entry = entry;
    clock->object = object;
    clock->since = now;
}

void ledger_take(LedgerClock *clock, LedgerEntry entry, double seconds) {
    if (ledger_is_way(clock->entry) || !(seconds > 0.0))
        return;
    book(clock, entry, seconds);
    clock->since += seconds;
}
