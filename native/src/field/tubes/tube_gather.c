/* SPDX-License-Identifier: GPL-3.0-or-later
 * The inner loop of the tubes, eight of them at a time, sixteen with AVX-512: packets of rays go
 * through the tree and meet patches of tubes, whose light tube_chord.h adds up. Built once for each
 * instruction set, with AMB_TUBE_GATHER set to the name of the variant. */
#include "field/tubes/tube_gather.h"

#include "field/tubes/tube_refine.h"
#include "field/tubes/tube_soft.h"

#if !defined(AMB_TUBE_GATHER)
#error "AMB_TUBE_GATHER names the variant"
#endif

enum {
    BOXES = LANE_COUNT / TUBE_LANES, /* of children looked at together */
    HALVES = PATCH_CORNERS / LANE_COUNT,
    /* Of each level wait the children of one node, at most. */
    STACK_MAX = (TUBE_LEVEL_MAX + 1) * TUBE_LANES
};

_Static_assert((int)TUBE_LANES == 8, "bits of children are taken by eight");
_Static_assert((int)PATCH_CORNERS == 16, "bits of corners are words");
_Static_assert((int)PATCH_TUBES == 16, "and so are those of tubes");
_Static_assert((int)TUBE_PACKET == (int)PATCH_CORNERS, "rays fill as many vectors as corners");

/* Optical length of a tree's tubes along the boundary below which their light does not fade enough
 * for that: flux would have to double along a tube to be wrong by a two hundredth. */
static const float FADE_MIN = 0.03f;

/* Rays that go through the tree together. What one of them finds, and in which order, depends on
 * that ray alone. */
typedef struct Packet {
    _Alignas(64) float axes[LINE_AXES][TUBE_PACKET]; /* d and o x d, side by side */
    float o[3][TUBE_PACKET];
    float line[TUBE_PACKET][LINE_AXES]; /* the same, ray by ray */
    Query queries[TUBE_PACKET];
    Sums sums[TUBE_PACKET];
    Waiting touched[TUBE_PACKET]; /* the zero curve may touch them */
    Waiting bent[TUBE_PACKET];    /* it does, and they must be looked at more closely */
    uint32_t count;
    uint32_t parallel; /* bits: all light of a tube runs along the ray, which meets it everywhere */
} Packet;

/* Children of a node that the line of the ray meets, above which places are looked at, too: where
 * view and light are not near each other lines alone tell nearly all. */
enum { MANY_LINES = 4 };
/* So many rays are faster one after the other, through all children at once. */
enum { FEW_RAYS = 3 };

static inline LaneMask meets(Lanes middle, Lanes reach) {
    return lanes_abs(middle) <= reach;
}

/* Bit i is set where the line may meet light of child i. */
static inline uint32_t lines_hit(const TubeNode *node, const float line[LINE_AXES]) {
    Lanes middle = lanes_set(0.0f), reach = lanes_set(0.0f);
    for (int a = 0; a < LINE_AXES; ++a) {
        middle += line[a] * lanes_load_two(node->middle[a], node->middle[a]);
        reach += fabsf(line[a]) * lanes_load_two(node->extent[a], node->extent[a]);
    }
    return lanes_bits(meets(middle, reach)) & 0xFFu;
}

/* Of those children, the ones whose light may meet the segment. */
static inline uint32_t places_hit(const TubeNode *node, const Query *q, uint32_t lines) {
    uint32_t places = 0;
    const float o[3] = {q->o.x, q->o.y, q->o.z};
    for (int k = 0; k < TUBE_QUARTERS && (lines & ~places) != 0; k += BOXES) {
        Lanes near = lanes_set(q->near), far = lanes_set(q->far);
        for (int a = 0; a < 3; ++a) {
            const Lanes low = lanes_load_two(node->low[k][a], node->low[k + BOXES - 1][a]);
            const Lanes high = lanes_load_two(node->high[k][a], node->high[k + BOXES - 1][a]);
            const Lanes t0 = (low - o[a]) * q->inverse[a], t1 = (high - o[a]) * q->inverse[a];
            near = lanes_max(near, lanes_min(t0, t1));
            far = lanes_min(far, lanes_max(t0, t1));
        }
        const uint32_t bits = lanes_bits(near <= far);
        places |= (bits | bits >> TUBE_LANES) & 0xFFu;
    }
    return lines & places;
}

/* Sine between light and view below which single precision does not tell where they meet, and the
 * angle by which the view is then turned: less than a pixel. */
static const float PARALLEL_SINE = 5e-5f;
static const float NUDGE = 2e-4f;

/* f at the corners of a patch whose light runs nearly along the ray; whether all light of a tube is
 * parallel to it. */
static inline bool near_parallel_f(const TubePatch *patch, const Query *q, Lanes out[HALVES]) {
    const Lanes3 d = set3(q->d), o = set3(q->o);
    uint32_t parallel = 0;
    for (int h = 0; h < HALVES; ++h) {
        Lanes rows[CORNER_SIZE];
        const float *corners[LANE_COUNT];
        for (int i = 0; i < LANE_COUNT; ++i)
            corners[i] = patch->corners[h * LANE_COUNT + i];
        lanes_load_rows(corners, rows);
        const Lanes3 x = {rows[CORNER_X], rows[CORNER_X + 1], rows[CORNER_X + 2]};
        const Lanes3 w = {rows[CORNER_W], rows[CORNER_W + 1], rows[CORNER_W + 2]};
        out[h] = line_f(cross3(d, sub3(x, o)), w, d);
        const Lanes3 across = cross3(d, w);
        parallel |=
            lanes_bits((dot3(across, across) < PARALLEL_SINE * PARALLEL_SINE) & (dot3(w, w) > 0.0f))
            << (h * LANE_COUNT);
    }
    for (int k = 0; k < PATCH_TUBES && parallel != 0; ++k)
        if (patch->masks[k] != 0 && (patch->masks[k] & ~parallel) == 0)
            return true;
    return false;
}

/* Cosine between light and ray beyond which f is a difference of large numbers in Pluecker
 * coordinates. */
static const float PARALLEL_COS = 0.98f;

/* Adds to the lists of the rays the tubes of a patch that the zero curve may touch. */
static inline void touch_patch(const TubeTree *tree, uint32_t p, uint32_t rays, Packet *packet) {
    const TubePatch *patch = &tree->patches[p];
    float margins[TUBE_PACKET];
    uint32_t near_parallel = 0;
    for (uint32_t i = 0; i < packet->count; i += LANE_COUNT) {
        const Lanes3 d = {lanes_load(packet->axes[0] + i), lanes_load(packet->axes[1] + i),
                          lanes_load(packet->axes[2] + i)};
        const Lanes3 o = {lanes_load(packet->o[0] + i), lanes_load(packet->o[1] + i),
                          lanes_load(packet->o[2] + i)};
        const Lanes3 w = set3(vec3(patch->lines[3][0], patch->lines[4][0], patch->lines[5][0]));
        near_parallel |= lanes_bits(lanes_abs(dot3(w, d)) > PARALLEL_COS) << i;
        /* No corner is farther from the ray. */
        const Lanes3 across = cross3(sub3(set3(patch->center), o), d);
        const Lanes reach = lanes_sqrt(dot3(across, across)) + patch->radius;
        lanes_store(margins + i, (patch->bulge + tree->blur) * reach + tree->slack);
    }
    LaneMask codes[HALVES];
    for (int h = 0; h < HALVES; ++h)
        codes[h] = load_numbers(patch->codes + h * LANE_COUNT);
    const LaneMask patches = codes[0] * 0 + (int32_t)p;
    for (; rays != 0; rays &= rays - 1) {
        const uint32_t r = (uint32_t)__builtin_ctz(rays);
        Lanes values[HALVES];
        if ((near_parallel >> r & 1u) != 0) {
            if (near_parallel_f(patch, &packet->queries[r], values))
                packet->parallel |= 1u << r;
        } else {
            const float *line = packet->line[r];
            for (int h = 0; h < HALVES; ++h) {
                values[h] = lanes_set(0.0f);
                for (int a = 0; a < LINE_AXES; ++a)
                    values[h] += line[a] * lanes_load(patch->lines[a] + h * LANE_COUNT);
            }
        }
        const float margin = margins[r];
        uint32_t above = 0, below = 0;
        for (int h = 0; h < HALVES; ++h) {
            above |= lanes_bits(values[h] > -margin) << (h * LANE_COUNT);
            below |= lanes_bits(values[h] < margin) << (h * LANE_COUNT);
        }
        const uint32_t tubes = words_meeting(patch->masks, above, below);
        for (int h = 0; h < HALVES; ++h)
            add_waiting(&packet->touched[r], patches, codes[h],
                        tubes >> (h * LANE_COUNT) & LANES_ALL);
    }
}

/* Adds what tubes send that are crossed, or nearly. */
static inline void gather_crossed(Tubes *tubes, const TubeTree *tree, const Matter *matter,
                                  const Query *q, Sums *sums) {
    if (tree->blur > 0.0f) {
        const Lanes density = soften_tubes(tubes, &tree->light, q, matter->mean);
        gather_tubes(tubes, &density, tree, matter, q, sums);
    } else {
        gather_tubes(tubes, NULL, tree, matter, q, sums);
    }
}

/* Takes all that there is, by vectors as long as they are full. Bent tubes are quartered last in,
 * first out, so that few wait: each level leaves at most three quarters of the parts of one vector
 * behind. */
static inline void empty_queues(const TubeTree *tree, const Matter *matter, const Query *q,
                                Queues *queues, Sums *sums) {
    Tubes tubes;
    while (queues->bent.count > 0 || queues->parts.count > 0) {
        while (queues->parts.count >= LANE_COUNT ||
               (queues->parts.count > 0 && queues->bent.count == 0)) {
            take_loose(&queues->parts, &tubes);
            gather_crossed(&tubes, tree, matter, q, sums);
        }
        if (queues->bent.count > 0) {
            const uint32_t count = take_loose(&queues->bent, &tubes);
            refine_tubes(&tubes, count, tree, q, queues);
        }
    }
}

/* f at the corners of tubes, and how far the farthest is from the ray. */
static inline Lanes see_corners(Tubes *tubes, const Query *q) {
    const Lanes3 d = set3(q->d), o = set3(q->o);
    Lanes reach2 = lanes_set(0.0f);
    for (int k = 0; k < 3; ++k) {
        const Lanes3 across = cross3(d, sub3(row3(tubes, k, CORNER_X), o));
        tubes->f[k] = line_f(across, row3(tubes, k, CORNER_W), d);
        reach2 = lanes_max(reach2, dot3(across, across));
    }
    return lanes_sqrt(reach2);
}

/* Where light may turn over from one side of the view to the other inside a tube. */
static inline LaneMask may_turn(const Tubes *tubes, Lanes3 d) {
    Lanes sin2 = lanes_set(1.0f), spread2 = lanes_set(0.0f);
    for (int k = 0; k < 3; ++k) {
        const Lanes3 w = row3(tubes, k, CORNER_W), across = cross3(d, w);
        const Lanes3 change = sub3(row3(tubes, (k + 1) % 3, CORNER_W), w);
        sin2 = lanes_min(sin2, dot3(across, across));
        spread2 = lanes_max(spread2, dot3(change, change));
    }
    return sin2 < TURN_SPREADS * TURN_SPREADS * spread2;
}

/* See tube_code_bulge. */
static inline Lanes bulge_of(LaneMask codes) {
    const LaneMask number = codes >> CODE_BULGE;
    return (Lanes)((number + CODE_BULGE_BASE) << 20 & (number != 0));
}

/* Looks more closely at all tubes of a ray that wait for it. */
static inline void gather_bent(const TubeTree *tree, const Matter *matter, Packet *packet,
                               uint32_t r, Queues *queues) {
    const Query *q = &packet->queries[r];
    while (packet->bent[r].count > 0) {
        Tubes tubes;
        LaneMask patches, codes;
        const uint32_t count = take_waiting(tree, &packet->bent[r], &tubes, &patches, &codes);
        see_corners(&tubes, q);
        add_loose(&tubes, (1u << count) - 1u, &queues->bent);
    }
    empty_queues(tree, matter, q, queues, &packet->sums[r]);
}

/* Adds what touched tubes of a ray send, by vectors, as long as `least` of them wait. */
static inline void gather_touched(const TubeTree *tree, const Matter *matter, Packet *packet,
                                  uint32_t r, uint32_t least, Queues *queues) {
    const Query *q = &packet->queries[r];
    const Lanes3 d = set3(q->d);
    const Lanes zero = lanes_set(0.0f);
    Waiting *list = &packet->touched[r];
    while (list->count >= least) {
        Tubes tubes;
        LaneMask patches, codes;
        const uint32_t count = take_waiting(tree, list, &tubes, &patches, &codes);
        const Lanes reach = see_corners(&tubes, q);
        const LaneMask is_there = lanes_below(count);
        const Lanes blur = tree->blur * reach; /* f is averaged over so much to either side */
        const Lanes low = min_of(tubes.f), high = max_of(tubes.f);
        const Lanes margin = bulge_of(codes) * reach;
        Lanes bend_max = (BULGE * tree->bend_max) * (high - low + blur);
        const Lanes cosine = lanes_abs(dot3(row3(&tubes, 0, CORNER_W), d));
        const LaneMask is_near = cosine > PARALLEL_COS;
        if (lanes_bits(is_near) != 0)
            bend_max = lanes_select(is_near & may_turn(&tubes, d), zero, bend_max);
        const LaneMask is_bent =
            (margin > bend_max) & (low < margin + blur) & (high > -margin - blur) & is_there;
        const uint32_t bent = lanes_bits(is_bent);
        if (bent != 0) {
            const LanePack pack = lanes_pack_for(bent);
            Waiting *bends = &packet->bent[r];
            lanes_pack_numbers(bends->patches + bends->count, patches, &pack);
            lanes_pack_numbers(bends->codes + bends->count, codes, &pack);
            bends->count += (uint32_t)__builtin_popcount(bent);
            if (bends->count >= QUEUE_FULL)
                gather_bent(tree, matter, packet, r, queues);
        }
        const LaneMask is_crossed = (low <= blur) & (high > -blur) & is_there & ~is_bent;
        const uint32_t crossed = lanes_bits(is_crossed);
        if (crossed == 0)
            continue;
        if (count < LANE_COUNT) { /* the last ones, with what quartering will leave */
            add_loose(&tubes, crossed, &queues->parts);
            continue;
        }
        for (int k = 0; k < 3; ++k)
            tubes.f[k] = (Lanes)((LaneMask)tubes.f[k] & is_crossed);
        gather_crossed(&tubes, tree, matter, q, &packet->sums[r]);
    }
}

static inline void start_ray(const TubeTree *tree, const TubeRay *ray, uint32_t r, Packet *packet) {
    const Vec3 from = vec3_sub(ray->o, tree->center), d = ray->d;
    Query *q = &packet->queries[r];
    *q = (Query){.d = d,
                 .near = vec3_dot(from, d),
                 .straight = {ray->straight.r, ray->straight.g, ray->straight.b},
                 .has_frequency = ray->has_frequency,
                 .has_straight = rgb_max(ray->straight) > 0.0f};
    q->far = q->near + ray->length;
    q->o = vec3_madd(from, -q->near, d);
    const Vec3 moment = vec3_cross(q->o, d);
    const float axes[3] = {d.x, d.y, d.z}, o[3] = {q->o.x, q->o.y, q->o.z};
    const float moments[3] = {moment.x, moment.y, moment.z};
    for (int a = 0; a < 3; ++a) {
        /* 0 * infinity is not a number: a direction without this component gets a huge slope. */
        const float component = fabsf(axes[a]) < 1e-20f ? copysignf(1e-20f, axes[a]) : axes[a];
        q->inverse[a] = 1.0f / component;
        packet->o[a][r] = o[a];
        packet->line[r][a] = packet->axes[a][r] = axes[a];
        packet->line[r][3 + a] = packet->axes[3 + a][r] = moments[a];
    }
    const Lanes zero = lanes_set(0.0f);
    packet->sums[r] = (Sums){{zero, zero, zero}, {zero, zero, zero}, {zero, zero, zero}, zero};
    packet->touched[r].count = packet->bent[r].count = 0;
}

/* Which of the rays may meet light of each child of a node. */
static inline void children_hit(const TubeNode *node, uint32_t rays, const Packet *packet,
                                uint32_t out[TUBE_LANES]) {
    if (__builtin_popcount(rays) <= FEW_RAYS) {
        memset(out, 0, TUBE_LANES * sizeof *out);
        for (; rays != 0; rays &= rays - 1) {
            const uint32_t r = (uint32_t)__builtin_ctz(rays);
            uint32_t hit = lines_hit(node, packet->line[r]);
            if (__builtin_popcount(hit) > MANY_LINES)
                hit = places_hit(node, &packet->queries[r], hit);
            for (; hit != 0; hit &= hit - 1)
                out[__builtin_ctz(hit)] |= 1u << r;
        }
        return;
    }
    uint32_t many = 0;
    memset(out, 0, TUBE_LANES * sizeof *out);
    for (uint32_t i = 0; i < packet->count; i += LANE_COUNT) {
        Lanes line[LINE_AXES], size[LINE_AXES];
        for (int a = 0; a < LINE_AXES; ++a) {
            line[a] = lanes_load(packet->axes[a] + i);
            size[a] = lanes_abs(line[a]);
        }
        LaneMask total = (LaneMask)lanes_set(0.0f);
        for (int c = 0; c < TUBE_LANES; ++c) {
            Lanes middle = lanes_set(0.0f), reach = lanes_set(0.0f);
            for (int a = 0; a < LINE_AXES; ++a) {
                middle += line[a] * node->middle[a][c];
                reach += size[a] * node->extent[a][c];
            }
            const LaneMask hit = meets(middle, reach);
            total -= hit;
            out[c] |= lanes_bits(hit) << i;
        }
        many |= lanes_bits(total > MANY_LINES) << i;
    }
    for (int c = 0; c < TUBE_LANES; ++c)
        out[c] &= rays;
    for (many &= rays; many != 0; many &= many - 1) {
        const uint32_t r = (uint32_t)__builtin_ctz(many);
        uint32_t lines = 0;
        for (uint32_t c = 0; c < TUBE_LANES; ++c)
            lines |= (out[c] >> r & 1u) << c;
        const uint32_t hit = places_hit(node, &packet->queries[r], lines);
        for (uint32_t c = 0; c < TUBE_LANES; ++c)
            out[c] &= ~(((~hit >> c) & 1u) << r);
    }
}

static inline void gather_lists(const TubeTree *tree, const Matter *matter, uint32_t rays,
                                Packet *packet, Queues *queues) {
    for (; rays != 0; rays &= rays - 1) {
        const uint32_t r = (uint32_t)__builtin_ctz(rays);
        if (packet->touched[r].count >= QUEUE_FULL)
            gather_touched(tree, matter, packet, r, LANE_COUNT, queues);
    }
}

static inline void gather_packet(const TubeTree *tree, const Matter *matter, Packet *packet) {
    Queues queues;
    queues.parts.count = queues.bent.count = 0;
    uint32_t stack[STACK_MAX];
    uint16_t rays[STACK_MAX];
    uint8_t levels[STACK_MAX];
    uint32_t depth = 1;
    stack[0] = 0;
    rays[0] = (uint16_t)((1u << packet->count) - 1u);
    levels[0] = (uint8_t)(tree->level_count - 1);
    while (depth > 0) {
        --depth;
        const uint32_t level = levels[depth], first = stack[depth] * TUBE_LANES;
        uint32_t hit[TUBE_LANES];
        children_hit(&tree->nodes[tree->first[level] + stack[depth]], rays[depth], packet, hit);
        for (uint32_t c = 0; c < TUBE_LANES; ++c) {
            if (hit[c] == 0)
                continue;
            if (level > 0) {
                stack[depth] = first + c;
                rays[depth] = (uint16_t)hit[c];
                levels[depth++] = (uint8_t)(level - 1);
            } else {
                touch_patch(tree, first + c, hit[c], packet);
                gather_lists(tree, matter, hit[c], packet, &queues);
            }
        }
    }
    for (uint32_t r = 0; r < packet->count; ++r) {
        gather_touched(tree, matter, packet, r, 1, &queues);
        gather_bent(tree, matter, packet, r, &queues);
    }
}

static inline Rgb sum_lanes(const Lanes sums[3]) {
    return rgb(lanes_sum(sums[0]), lanes_sum(sums[1]), lanes_sum(sums[2]));
}

static inline FieldRadiance sum_up(const Sums *sums) {
    FieldRadiance out = {.radiance = sum_lanes(sums->radiance),
                         .straight_once = sum_lanes(sums->straight_once),
                         .straight_more = sum_lanes(sums->straight_more),
                         .frequency = lanes_sum(sums->frequency) / 3.0f};
    out.contribution = rgb_mean(out.radiance);
    return out;
}

static inline void gather_rays(const TubeTree *tree, const Matter *matter, const TubeRay rays[],
                               uint32_t count, Packet *packet, FieldRadiance out[]) {
    packet->count = count;
    packet->parallel = 0;
    for (uint32_t r = 0; r < count; ++r)
        start_ray(tree, &rays[r], r, packet);
    gather_packet(tree, matter, packet);
    for (uint32_t r = 0; r < count; ++r)
        out[r] = sum_up(&packet->sums[r]);
}

void AMB_TUBE_GATHER(const TubeTree *tree, const Medium *medium, const TubeRay rays[],
                     uint32_t count, FieldRadiance out[]) {
    Packet packet;
    const Rgb sigma_t = medium->sigma_t;
    const float max = rgb_max(sigma_t);
    const Matter matter = {.medium = medium,
                           .sigma_t = {sigma_t.r, sigma_t.g, sigma_t.b},
                           .mean = rgb_mean(sigma_t),
                           .max = max,
                           .fades = max * tree->edge > FADE_MIN};
    gather_rays(tree, &matter, rays, count, &packet, out);
    for (uint32_t left = packet.parallel; left != 0; left &= left - 1) {
        const uint32_t r = (uint32_t)__builtin_ctz(left);
        TubeRay turned = rays[r];
        Vec3 x, y;
        vec3_frame(turned.d, &x, &y);
        /* Turned out of one light's direction it may be in another's, which then loses some. */
        turned.d = vec3_normalize(vec3_madd(turned.d, NUDGE, x));
        gather_rays(tree, &matter, &turned, 1, &packet, &out[r]);
    }
}
