/* SPDX-License-Identifier: GPL-3.0-or-later
 * The inner loop of the point estimators. Built with AMB_POINT_GATHER set to the name of each
 * variant; every loop over POINT_LANES is free of branches so that the compiler makes it one
 * vector instruction per line. */
#include "field/points/point_gather.h"

#include <string.h>

#if !defined(AMB_POINT_GATHER)
#error "AMB_POINT_GATHER names the variant"
#endif

enum { STACK_MAX = 256 };

/* sin^2 below which a ray and a sample count as parallel: the chord is then as long as the sample
 * anyway, and dividing by less would overflow. */
static const float SIN2_MIN = 1e-12f;

typedef struct Query {
    float o[3], d[3];
    float inverse[3];
    float length;
} Query;

typedef struct Sums {
    float radiance[3][POINT_LANES];
    float frequency[POINT_LANES];
} Sums;

/* exp(x) for x <= 0 by 2^(n + f), relative error below 3e-7; below -87 it is 0. */
static inline float exp_negative(float x) {
    const float y = (x < -87.0f ? -87.0f : x) * 1.44269504f;
    const float n = (float)(int)(y - 0.5f); /* rounds to nearest, for y <= 0 */
    const float f = (y - n) * 0.693147181f; /* in [-0.35, 0.35] */
    float p = 1.0f / 720.0f;
    p = p * f + 1.0f / 120.0f;
    p = p * f + 1.0f / 24.0f;
    p = p * f + 1.0f / 6.0f;
    p = p * f + 0.5f;
    p = p * f + 1.0f;
    p = p * f + 1.0f;
    const int32_t bits = ((int32_t)n + 127) << 23;
    float scale;
    memcpy(&scale, &bits, sizeof scale);
    return x < -87.0f ? 0.0f : p * scale;
}

static inline float lesser(float a, float b) {
    return a < b ? a : b;
}
static inline float greater(float a, float b) {
    return a > b ? a : b;
}

/* Bit i is set where child i's box meets the segment. */
static inline uint32_t boxes_hit(const PointNode *node, const Query *q) {
    int32_t hit[POINT_LANES];
    for (int i = 0; i < POINT_LANES; ++i) {
        float near = 0.0f, far = q->length;
        for (int a = 0; a < 3; ++a) {
            const float t0 = (node->low[a][i] - q->o[a]) * q->inverse[a];
            const float t1 = (node->high[a][i] - q->o[a]) * q->inverse[a];
            near = greater(near, lesser(t0, t1));
            far = lesser(far, greater(t0, t1));
        }
        hit[i] = near <= far ? 1 : 0;
    }
    uint32_t mask = 0;
    for (int i = 0; i < POINT_LANES; ++i)
        mask |= (uint32_t)hit[i] << i;
    return mask;
}

/* Adds what the samples of a block send along the segment. */
static inline void gather_block(const PointBlock *block, const Medium *medium, const Query *q,
                                Sums *sums) {
    float cross[3][POINT_LANES], sin2[POINT_LANES], miss[POINT_LANES];
    for (int i = 0; i < POINT_LANES; ++i) {
        /* Distance of the two lines is |delta . m| / |m| with m = d x w: no cancellation however
         * far the segment starts. */
        const float wx = block->direction[0][i], wy = block->direction[1][i],
                    wz = block->direction[2][i];
        cross[0][i] = q->d[1] * wz - q->d[2] * wy;
        cross[1][i] = q->d[2] * wx - q->d[0] * wz;
        cross[2][i] = q->d[0] * wy - q->d[1] * wx;
        sin2[i] = greater(cross[0][i] * cross[0][i] + cross[1][i] * cross[1][i] +
                              cross[2][i] * cross[2][i],
                          SIN2_MIN);
        const float side = (q->o[0] - block->origin[0][i]) * cross[0][i] +
                           (q->o[1] - block->origin[1][i]) * cross[1][i] +
                           (q->o[2] - block->origin[2][i]) * cross[2][i];
        miss[i] = side * side - block->radius2[i] * sin2[i];
    }
    float nearest = miss[0];
    for (int i = 1; i < POINT_LANES; ++i)
        nearest = lesser(nearest, miss[i]);
    if (!(nearest < 0.0f))
        return;

    float scatter[3][POINT_LANES], cosine[POINT_LANES];
    memset(scatter, 0, sizeof scatter);
    for (int i = 0; i < POINT_LANES; ++i)
        cosine[i] = q->d[0] * block->direction[0][i] + q->d[1] * block->direction[1][i] +
                    q->d[2] * block->direction[2][i];
    for (uint32_t l = 0; l < medium->lobe_count; ++l) {
        const MediumLobe lobe = medium->lobes[l];
        for (int i = 0; i < POINT_LANES; ++i) {
            /* Light turns from w to -d. */
            const float p = phase_hg(-cosine[i], lobe.g);
            scatter[0][i] += lobe.sigma_s.r * p;
            scatter[1][i] += lobe.sigma_s.g * p;
            scatter[2][i] += lobe.sigma_s.b * p;
        }
    }

    const float sigma_t[3] = {medium->sigma_t.r, medium->sigma_t.g, medium->sigma_t.b};
    for (int i = 0; i < POINT_LANES; ++i) {
        const float c = cosine[i];
        const float wx = block->direction[0][i], wy = block->direction[1][i],
                    wz = block->direction[2][i];
        const float dx = q->o[0] - block->origin[0][i], dy = q->o[1] - block->origin[1][i],
                    dz = q->o[2] - block->origin[2][i];
        const float along = dx * wx + dy * wy + dz * wz;
        /* Range of t between the end caps and inside the segment; s(t) = along + c t. */
        const float slow = c < 0.0f ? lesser(c, -1e-12f) : greater(c, 1e-12f);
        const float cap0 = (block->low[i] - along) / slow;
        const float cap1 = (block->high[i] - along) / slow;
        const float first = greater(0.0f, lesser(cap0, cap1));
        const float last = lesser(q->length, greater(cap0, cap1));
        /* From the point of that range that is nearest to the axis (exactly or nearly), squared
         * distance is C + 2 B tau + sin2 tau^2 with small numbers only. */
        const float closest = -(dx * q->d[0] + dy * q->d[1] + dz * q->d[2] - along * c) / sin2[i];
        const float origin = greater(first, lesser(last, closest));
        const float ex = dx + origin * q->d[0], ey = dy + origin * q->d[1],
                    ez = dz + origin * q->d[2];
        const float s = ex * wx + ey * wy + ez * wz;
        const float bx = ex - s * wx, by = ey - s * wy, bz = ez - s * wz;
        const float B = bx * q->d[0] + by * q->d[1] + bz * q->d[2];
        const float inside = block->radius2[i] - (bx * bx + by * by + bz * bz);
        const float discriminant = B * B + sin2[i] * inside;
        const float root = sqrtf(greater(discriminant, 0.0f));
        const float begin = greater((-B - root) / sin2[i], first - origin);
        const float end = lesser((-B + root) / sin2[i], last - origin);
        const float half = 0.5f * (end - begin);
        /* Epanechnikov kernel K = 2/(pi R^2) (1 - r^2/R^2), integrated with the attenuation by
         * two Gauss points: exact for K times a linear function of t. */
        const float middle = 0.5f * (end + begin);
        const float offset = half * 0.577350269f;
        const float tau0 = middle - offset, tau1 = middle + offset;
        const float k0 = inside - tau0 * (2.0f * B + tau0 * sin2[i]);
        const float k1 = inside - tau1 * (2.0f * B + tau1 * sin2[i]);
        const bool is_hit = discriminant > 0.0f && half > 0.0f && block->radius2[i] > 0.0f;
        const float r2 = is_hit ? block->radius2[i] : 1.0f;
        const float weight = is_hit ? half * 2.0f / (AMB_PI * r2 * r2) : 0.0f;
        /* Attenuation from the sample's origin to the point and on to the segment's start. What a
         * kernel adds before the ray's entry (see SLOPE_MAX) has travelled no distance yet. */
        const float path0 = origin + tau0 + greater(s + c * tau0, 0.0f);
        const float path1 = origin + tau1 + greater(s + c * tau1, 0.0f);
        float total = 0.0f;
        for (int a = 0; a < 3; ++a) {
            const float e0 = exp_negative(-sigma_t[a] * path0);
            const float e1 = exp_negative(-sigma_t[a] * path1);
            const float value = weight * (k0 * e0 + k1 * e1) * scatter[a][i] * block->flux[a][i];
            sums->radiance[a][i] += value;
            total += value;
        }
        sums->frequency[i] += total * block->frequency[i];
    }
}

static float sum_lanes(const float v[POINT_LANES]) {
    return ((v[0] + v[1]) + (v[2] + v[3])) + ((v[4] + v[5]) + (v[6] + v[7]));
}

FieldRadiance AMB_POINT_GATHER(const PointTree *tree, const Medium *medium, Vec3 o, Vec3 d,
                               float length) {
    Query q = {{o.x, o.y, o.z}, {d.x, d.y, d.z}, {0, 0, 0}, length};
    for (int a = 0; a < 3; ++a) {
        /* 0 * infinity is not a number: a direction without this component gets a huge slope. */
        const float component = fabsf(q.d[a]) < 1e-20f ? copysignf(1e-20f, q.d[a]) : q.d[a];
        q.inverse[a] = 1.0f / component;
    }
    Sums sums;
    memset(&sums, 0, sizeof sums);
    int32_t stack[STACK_MAX];
    int depth = 0;
    stack[depth++] = 0;
    while (depth > 0) {
        const PointNode *node = &tree->nodes[stack[--depth]];
        uint32_t mask = boxes_hit(node, &q);
        while (mask != 0) {
            const int i = __builtin_ctz(mask);
            mask &= mask - 1;
            if (node->child[i] < 0)
                gather_block(&tree->blocks[~node->child[i]], medium, &q, &sums);
            else
                stack[depth++] = node->child[i];
        }
    }
    FieldRadiance out;
    out.radiance =
        rgb(sum_lanes(sums.radiance[0]), sum_lanes(sums.radiance[1]), sum_lanes(sums.radiance[2]));
    out.frequency = sum_lanes(sums.frequency) / 3.0f;
    out.contribution = rgb_mean(out.radiance);
    return out;
}
