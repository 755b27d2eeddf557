/* SPDX-License-Identifier: GPL-3.0-or-later
 * Tubes that wait for others, because vectors are best full. */
#ifndef AMB_FIELD_TUBES_TUBE_QUEUE_H
#define AMB_FIELD_TUBES_TUBE_QUEUE_H

#include <stddef.h>

#include "field/tubes/tube_lanes.h"

enum {
    QUEUE_FULL = 32,
    WAITING_ROOM = QUEUE_FULL + PATCH_TUBES + LANE_COUNT, /* one patch more, written by vectors */
    /* Those that wait for one ray, then what quartering adds to each level (see empty_queues), and
     * the next four parts as they are written. */
    LOOSE_ROOM = QUEUE_FULL + 2 * PATCH_TUBES + 3 * LANE_COUNT * 10 + 5 * LANE_COUNT
};
/* Rows must not displace each other from the cache. */
_Static_assert(LOOSE_ROOM % 256 != 0, "rows lie a power of two apart");

/* Tubes of patches, for one ray: the patches, and the tubes' codes there. */
typedef struct Waiting {
    uint32_t patches[WAITING_ROOM];
    uint32_t codes[WAITING_ROOM];
    uint32_t count;
} Waiting;

/* Tubes by themselves. */
typedef struct LooseQueue {
    float rows[3 * CORNER_ROWS + 4][LOOSE_ROOM];
    uint32_t count;
} LooseQueue;

typedef struct Queues {
    LooseQueue parts; /* crossed, parts of quartered ones */
    LooseQueue bent;  /* to be looked at more closely */
} Queues;

/* From the end of the queue, a vector or what there is; other lanes are zero. */
static inline uint32_t take_loose(LooseQueue *queue, Tubes *out) {
    const uint32_t count = queue->count < LANE_COUNT ? queue->count : LANE_COUNT;
    queue->count -= count;
    const LaneMask is_there = lanes_below(count);
    const Lanes zero = lanes_set(0.0f);
    for (int k = 0; k < 3; ++k) {
        for (int r = 0; r < CORNER_ROWS; ++r)
            out->rows[k][r] = lanes_select(
                is_there, lanes_load(queue->rows[k * CORNER_ROWS + r] + queue->count), zero);
        out->f[k] = lanes_select(is_there,
                                 lanes_load(queue->rows[3 * CORNER_ROWS + k] + queue->count), zero);
    }
    out->level =
        lanes_select(is_there, lanes_load(queue->rows[3 * CORNER_ROWS + 3] + queue->count), zero);
    return count;
}

static inline void add_loose(const Tubes *tubes, uint32_t bits, LooseQueue *queue) {
    const LanePack pack = lanes_pack_for(bits);
    const uint32_t end = queue->count;
    for (int k = 0; k < 3; ++k) {
        for (int r = 0; r < CORNER_ROWS; ++r)
            lanes_pack(queue->rows[k * CORNER_ROWS + r] + end, tubes->rows[k][r], &pack);
        lanes_pack(queue->rows[3 * CORNER_ROWS + k] + end, tubes->f[k], &pack);
    }
    lanes_pack(queue->rows[3 * CORNER_ROWS + 3] + end, tubes->level, &pack);
    queue->count = end + (uint32_t)__builtin_popcount(bits);
}

/* Patches as rows of eight numbers, of which a corner is one. */
enum {
    ROW_BYTES = CORNER_SIZE * sizeof(float),
    PATCH_ROWS = sizeof(TubePatch) / ROW_BYTES,
    FIRST_ROW = offsetof(TubePatch, corners) / ROW_BYTES
};
_Static_assert(sizeof(TubePatch) % ROW_BYTES == 0, "a patch is so many rows");
_Static_assert(offsetof(TubePatch, corners) % ROW_BYTES == 0, "and its corners are some of them");

/* A corner of each tube. */
static inline void load_corners(const TubeTree *tree, LaneMask patches, LaneMask corners,
                                Lanes rows[CORNER_ROWS]) {
    const LaneMask numbers = patches * PATCH_ROWS + FIRST_ROW + corners;
    uint32_t row[LANE_COUNT];
    memcpy(row, &numbers, sizeof row);
    /* Through memory: the compiler would take the vector apart, which costs more. */
    __asm__("" : "+m"(row));
    const float *from[LANE_COUNT];
    for (int i = 0; i < LANE_COUNT; ++i)
        from[i] = (const float *)tree->patches + (size_t)row[i] * CORNER_SIZE;
    lanes_load_rows(from, rows);
    rows[ROW_START] = lanes_set(0.0f);
    if (tree->light.value == TUBE_VALUE_IS_FLUX) { /* reflected: there is a way before */
        uint32_t patch[LANE_COUNT], corner[LANE_COUNT];
        memcpy(patch, &patches, sizeof patch);
        memcpy(corner, &corners, sizeof corner);
        __asm__("" : "+m"(patch), "+m"(corner));
        for (int i = 0; i < LANE_COUNT; ++i)
            rows[ROW_START][i] = tree->patches[patch[i]].starts[corner[i]];
    }
    rows[ROW_NORMAL_LENGTH] = lanes_set(1.0f);
}

static inline LaneMask load_numbers(const uint32_t numbers[LANE_COUNT]) {
    LaneMask lanes;
    memcpy(&lanes, numbers, sizeof lanes);
    return lanes;
}

/* Corners of the last tubes of a list, a vector or what there is, and what they are; the count.
 * f is not set. */
static inline uint32_t take_waiting(const TubeTree *tree, Waiting *list, Tubes *out,
                                    LaneMask *out_patches, LaneMask *out_codes) {
    const uint32_t count = list->count < LANE_COUNT ? list->count : LANE_COUNT;
    list->count -= count;
    const LaneMask is_there = lanes_below(count);
    const LaneMask patches = load_numbers(list->patches + list->count) & is_there;
    const LaneMask codes = load_numbers(list->codes + list->count) & is_there;
    for (int k = 0; k < 3; ++k)
        load_corners(tree, patches, codes >> (4 * k) & 15, out->rows[k]);
    out->level = lanes_set(0.0f);
    *out_patches = patches;
    *out_codes = codes;
    return count;
}

/* Adds those of a patch whose bits are set. */
static inline void add_waiting(Waiting *list, LaneMask patches, LaneMask codes, uint32_t bits) {
    const LanePack pack = lanes_pack_for(bits);
    memcpy(list->patches + list->count, &patches, sizeof patches);
    lanes_pack_numbers(list->codes + list->count, codes, &pack);
    list->count += (uint32_t)__builtin_popcount(bits);
}

#endif
