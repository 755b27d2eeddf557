/* SPDX-License-Identifier: GPL-3.0-or-later
 * What photons send to a point, eight of them at a time. Compiled once for each instruction set,
 * with AMB_CAUSTIC_GATHER set to the name of the variant. */
#include "field/caustics/caustic_gather.h"
#include "math/lanes.h"

#if !defined(AMB_CAUSTIC_GATHER)
#error "AMB_CAUSTIC_GATHER names the variant"
#endif

/* Eleven levels hold 2^31 blocks; of each seven wait while the last child's are looked at. */
enum { STACK_MAX = 11 * 7 + 1 };

typedef struct Query {
    Lanes p[3], n[3];
    float dimmed;
} Query;

static uint32_t boxes_around(const CausticNode *node, const Lanes p[3]) {
    LaneMask inside = (p[0] >= lanes_load(node->low[0])) & (p[0] <= lanes_load(node->high[0]));
    for (int k = 1; k < 3; ++k)
        inside &= (p[k] >= lanes_load(node->low[k])) & (p[k] <= lanes_load(node->high[k]));
    return lanes_bits(inside);
}

static inline Lanes dot(const float a[3][CAUSTIC_LANES], const Lanes b[3]) {
    return lanes_load(a[0]) * b[0] + lanes_load(a[1]) * b[1] + lanes_load(a[2]) * b[2];
}

static void gather_block(const CausticBlock *block, const Query *q, Lanes sums[3]) {
    Lanes x[3];
    for (int k = 0; k < 3; ++k)
        x[k] = q->p[k] - lanes_load(block->p[k]);
    const Lanes a = dot(block->u, x), b = dot(block->v, x);
    const Lanes inside = 1.0f - a * a - b * b;
    const Lanes height = dot(block->n, x);
    const LaneMask counts = (inside > 0.0f) & (dot(block->n, q->n) >= CAUSTIC_NORMAL_COS_MIN) &
                            (height * height <= lanes_load(block->height2));
    if (lanes_bits(counts) == 0)
        return;
    Lanes peak[3];
    for (int k = 0; k < 3; ++k)
        peak[k] = lanes_load(block->peak[k]);
    const Lanes mean = (peak[0] + peak[1] + peak[2]) / 3.0f;
    const Lanes share = lanes_select(counts, inside / (1.0f + q->dimmed * mean), lanes_set(0.0f));
    for (int k = 0; k < 3; ++k)
        sums[k] += share * peak[k];
}

Rgb AMB_CAUSTIC_GATHER(const CausticTree *tree, Vec3 p, Vec3 n, float dimmed) {
    const Query q = {.p = {lanes_set(p.x), lanes_set(p.y), lanes_set(p.z)},
                     .n = {lanes_set(n.x), lanes_set(n.y), lanes_set(n.z)},
                     .dimmed = dimmed};
    const Lanes zero = lanes_set(0.0f);
    Lanes sums[3] = {zero, zero, zero};
    int32_t stack[STACK_MAX];
    int depth = 0;
    stack[depth++] = 0;
    while (depth > 0) {
        const CausticNode *node = &tree->nodes[stack[--depth]];
        for (uint32_t mask = boxes_around(node, q.p); mask != 0; mask &= mask - 1) {
            const int32_t child = node->child[__builtin_ctz(mask)];
            if (child < 0)
                gather_block(&tree->blocks[~child], &q, sums);
            else
                stack[depth++] = child;
        }
    }
    return rgb(lanes_sum(sums[0]), lanes_sum(sums[1]), lanes_sum(sums[2]));
}
