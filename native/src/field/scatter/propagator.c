/* SPDX-License-Identifier: GPL-3.0-or-later
 * The table of the medium without end. */
#include "field/scatter/propagator.h"

#include <string.h>

#include "base/memory.h"
#include "base/rng.h"
#include "optics/phase_sample.h"

enum {
    RADIAL_COUNT = 48,
    DIRECTION_COUNT = 16,
    AZIMUTH_COUNT = 9,
    BANK_COUNT = 8,       /* sums that are added in their order, whatever the number of threads */
    COLLISIONS = 1 << 20, /* about, of all walks; twice as many where g = 0, which is fast */
    WALKS_MIN = 1 << 11,
    ORDER_LIMIT = 1 << 12 /* of a walk; diffusion stands for what follows */
};

static const float TAU_UNIT = 0.3f; /* radial nodes: even below, by ratio above */
static const float ROULETTE_WEIGHT = 0.25f;
/* Transport mean free paths after which a walk is diffusion to within a percent. */
static const float DIFFUSION_BEGIN = 60.0f;

/* ---- Nodes ----------------------------------------------------------------------------------- */

typedef struct Place {
    uint32_t index; /* the node below; count - 2 at most */
    float x;        /* on the way to the next one, [0,1] */
} Place;

static Place place_on(float at, uint32_t count) {
    if (count == 1)
        return (Place){0, 0.0f};
    const float bounded = clampf(at, 0.0f, (float)(count - 1));
    uint32_t index = (uint32_t)bounded;
    index = index < count - 1 ? index : count - 2;
    return (Place){index, bounded - (float)index};
}

static Place place_tau(const Propagator *table, float tau) {
    return place_on(table->log_scale * logf(1.0f + tau / TAU_UNIT), RADIAL_COUNT);
}

static float tau_of(const Propagator *table, float at) {
    return TAU_UNIT * expm1f(at / table->log_scale);
}

/* Nodes at even steps of the sine of half the angle: dense where lobes are sharp. */
static Place place_cosine(const Propagator *table, float cosine) {
    const uint32_t count = table->direction_count;
    return place_on(safe_sqrtf(0.5f * (1.0f - cosine)) * (float)(count - 1), count);
}

static float cosine_of(const Propagator *table, float at) {
    const float sine = at / (float)(table->direction_count - 1);
    return 1.0f - 2.0f * sine * sine;
}

static uint32_t outgoing_count(const Propagator *table) {
    return table->direction_count * table->azimuth_count;
}

static uint64_t value_count(const Propagator *table) {
    return (uint64_t)RADIAL_COUNT * table->direction_count * outgoing_count(table);
}

/* ---- Walks ----------------------------------------------------------------------------------- */

enum { OUTGOING_MAX = DIRECTION_COUNT * AZIMUTH_COUNT };

typedef struct Outgoing {
    float x[OUTGOING_MAX], y[OUTGOING_MAX]; /* directions of the table: x towards d, */
    float z[OUTGOING_MAX];                  /* z along r */
    float measure[OUTGOING_MAX];            /* integrals of the hat functions over directions, sr */
} Outgoing;

typedef struct Build {
    const PropagatorParams *params;
    Propagator *table;
    Job *job;
    Outgoing outgoing;
    uint64_t walk_count;
    uint32_t order_end; /* scatterings of a walk */
    float *banks[BANK_COUNT];
    uint64_t collision_counts[BANK_COUNT];
} Build;

enum { HAT_STEPS = 64 };

/* Integrals of the hat functions over the cosine; their sum is 2. */
static void cosine_measures(const Propagator *table, double out[DIRECTION_COUNT]) {
    memset(out, 0, DIRECTION_COUNT * sizeof *out);
    if (table->direction_count == 1)
        out[0] = 2.0;
    for (uint32_t i = 0; i + 1 < table->direction_count; ++i)
        for (int k = 0; k < HAT_STEPS; ++k) {
            const float x = ((float)k + 0.5f) / HAT_STEPS;
            const double measure =
                (double)(cosine_of(table, (float)i + (float)k / HAT_STEPS) -
                         cosine_of(table, (float)i + ((float)k + 1.0f) / HAT_STEPS));
            out[i] += (1.0 - (double)x) * measure;
            out[i + 1] += (double)x * measure;
        }
}

/* The same over the azimuth, as shares of all of it. */
static double azimuth_share(const Propagator *table, uint32_t f) {
    if (table->azimuth_count == 1)
        return 1.0;
    const bool is_end = f == 0 || f + 1 == table->azimuth_count;
    return (is_end ? 0.5 : 1.0) / (double)(table->azimuth_count - 1);
}

static void list_outgoing(const Propagator *table, Outgoing *out) {
    double measures[DIRECTION_COUNT];
    cosine_measures(table, measures);
    for (uint32_t b = 0, i = 0; b < table->direction_count; ++b)
        for (uint32_t f = 0; f < table->azimuth_count; ++f, ++i) {
            const float z = table->direction_count > 1 ? cosine_of(table, (float)b) : 1.0f;
            const float phi = AMB_PI * (float)f / fmaxf((float)(table->azimuth_count - 1), 1.0f);
            const float sine = safe_sqrtf(1.0f - z * z);
            out->x[i] = sine * cosf(phi);
            out->y[i] = sine * sinf(phi);
            out->z[i] = z;
            out->measure[i] = (float)(measures[b] * azimuth_share(table, f) * 2.0 * (double)AMB_PI);
        }
}

static Vec3 sample_phase(const PropagatorParams *params, Vec3 d, Rng rng, uint32_t dimension) {
    float u = rng_float(rng, dimension);
    uint32_t lobe = 0;
    while (lobe + 1 < params->lobe_count && u >= params->shares[lobe]) {
        u -= params->shares[lobe];
        ++lobe;
    }
    const float cosine = phase_hg_sample(rng_float(rng, dimension + 1), params->g[lobe]);
    return phase_direction(d, cosine, rng_float(rng, dimension + 2));
}

/* Adds weight p(d . o) for all o of the table to one node, scaled so that what is read between
 * the table's directions adds up to the weight. */
static void add_scattered(const Build *build, float *node, float weight, Vec3 local) {
    const PropagatorParams *params = build->params;
    const Outgoing *out = &build->outgoing;
    const uint32_t count = outgoing_count(build->table);
    float values[OUTGOING_MAX] = {0};
    for (uint32_t l = 0; l < params->lobe_count; ++l) {
        const float g = params->g[l], least = (1.0f - fabsf(g)) * (1.0f - fabsf(g));
        const float share = params->shares[l] * (1.0f - g) * (1.0f + g);
        for (uint32_t i = 0; i < count; ++i) {
            const float cosine = local.x * out->x[i] + local.y * out->y[i] + local.z * out->z[i];
            /* See phase_hg; the scale is below. */
            const float plain = 1.0f + g * g - 2.0f * g * cosine;
            const float below = plain > least ? plain : least;
            values[i] += share / (below * sqrtf(below));
        }
    }
    float sum = 0.0f;
    for (uint32_t i = 0; i < count; ++i)
        sum += out->measure[i] * values[i];
    for (uint32_t i = 0; i < count; ++i)
        node[i] += weight / sum * values[i];
}

/* A collision at p of light that travels along d; the walk's first direction was +z. */
static void add_collision(const Build *build, float *bank, Vec3 p, Vec3 d, float weight, Rng rng,
                          uint32_t dimension) {
    const Propagator *table = build->table;
    const float tau = vec3_length(p);
    if (!(tau > 0.0f) || tau > table->tau_max)
        return;
    const Vec3 r = vec3_scale(p, 1.0f / tau);
    Vec3 x = vec3(-r.z * r.x, -r.z * r.y, 1.0f - r.z * r.z);
    const float sine = vec3_length(x);
    Vec3 y;
    if (sine > 1e-6f)
        x = vec3_scale(x, 1.0f / sine);
    else
        vec3_frame(r, &x, &y);
    y = vec3_cross(r, x);
    /* A node beside the place by chance, in proportion: the hat functions of the interpolation. */
    const Place radial = place_tau(table, tau), in = place_cosine(table, r.z);
    const uint32_t i = radial.index + (rng_float(rng, dimension) < radial.x ? 1 : 0);
    const uint32_t k = in.index + (rng_float(rng, dimension + 1) < in.x ? 1 : 0);
    float *node = bank + ((uint64_t)i * table->direction_count + k) * outgoing_count(table);
    /* What is seen from one side of the plane of r and d is seen from the other. */
    const Vec3 local = {vec3_dot(d, x), vec3_dot(d, y), vec3_dot(d, r)};
    add_scattered(build, node, weight * tau * expf(table->decay * tau), local);
}

enum { DIMENSIONS = 8 }; /* random numbers for each flight */

static uint64_t walk(const Build *build, uint64_t index, float *bank) {
    const PropagatorParams *params = build->params;
    const Rng rng = rng_create(0, RNG_STAGE_PROPAGATOR, index);
    Vec3 p = {0, 0, 0}, d = {0, 0, 1};
    float weight = 1.0f;
    uint32_t dimension = 0;
    for (uint32_t order = 1;; ++order, dimension += DIMENSIONS) {
        if (order >= 3)
            add_collision(build, bank, p, d, weight * params->albedo, rng, dimension);
        weight *= params->albedo;
        if (order >= build->order_end)
            return order;
        if (weight < ROULETTE_WEIGHT) {
            if (!(rng_float(rng, dimension + 2) * ROULETTE_WEIGHT < weight))
                return order;
            weight = ROULETTE_WEIGHT;
        }
        d = sample_phase(params, d, rng, dimension + 3);
        p = vec3_madd(p, -log1pf(-rng_float(rng, dimension + 6)), d);
    }
}

static AmbStatus fill_bank(void *user, uint64_t begin, uint64_t end, uint32_t thread) {
    (void)thread;
    Build *build = user;
    for (uint64_t b = begin; b < end; ++b)
        for (uint64_t i = b; i < build->walk_count; i += BANK_COUNT) {
            if (job_is_cancelled(build->job))
                return AMB_CANCELLED;
            build->collision_counts[b] += walk(build, i, build->banks[b]);
        }
    return AMB_OK;
}

/* ---- From sums to values --------------------------------------------------------------------- */

/* Integrals of the hat functions over tau^2 dtau. */
static void radial_measures(const Propagator *table, double out[RADIAL_COUNT]) {
    memset(out, 0, RADIAL_COUNT * sizeof *out);
    for (uint32_t i = 0; i + 1 < RADIAL_COUNT; ++i)
        for (int k = 0; k < HAT_STEPS; ++k) {
            const float x = ((float)k + 0.5f) / HAT_STEPS;
            const float tau = tau_of(table, (float)i + x);
            const double step = (double)(tau_of(table, (float)i + ((float)k + 1.0f) / HAT_STEPS) -
                                         tau_of(table, (float)i + (float)k / HAT_STEPS));
            const double measure = (double)tau * (double)tau * step;
            out[i] += (1.0 - (double)x) * measure;
            out[i + 1] += (double)x * measure;
        }
}

/* Radiance per optical length of what scatters more often than walks do: a Gaussian cloud that
 * widens by 2 / (3 (1 - g)) a flight along each axis. */
static double diffuse_rest(const Build *build, double tau) {
    enum { STEPS = 256 };
    const double albedo = (double)build->params->albedo;
    double cosine = 0.0;
    for (uint32_t l = 0; l < build->params->lobe_count; ++l)
        cosine += (double)build->params->shares[l] * (double)build->params->g[l];
    const double diffusion = 1.0 / (3.0 * (1.0 - cosine));
    const double begin = (double)build->order_end, pi = (double)AMB_PI;
    const double end = albedo < 1.0 ? fmin(begin - 30.0 / log(albedo), 1e7 * begin) : 1e7 * begin;
    const double ratio = pow(end / begin, 1.0 / STEPS);
    double sum = 0.0;
    for (int i = 0; i < STEPS; ++i) {
        const double low = begin * pow(ratio, i), flights = low * sqrt(ratio);
        const double spread = 4.0 * diffusion * flights;
        sum += low * (ratio - 1.0) * pow(albedo, flights) * pow(pi * spread, -1.5) *
               exp(-tau * tau / spread);
    }
    return sum * albedo / (4.0 * pi);
}

static void finish_values(const Build *build) {
    Propagator *table = build->table;
    double radial[RADIAL_COUNT], in[DIRECTION_COUNT];
    radial_measures(table, radial);
    cosine_measures(table, in);
    const uint32_t count = outgoing_count(table);
    const bool has_rest = build->params->order_max == 0 &&
                          powf(build->params->albedo, (float)build->order_end) > 1e-5f;
    for (uint32_t i = 0; i < RADIAL_COUNT; ++i) {
        const double tau = (double)tau_of(table, (float)i);
        const double scale = tau * exp((double)table->decay * tau);
        const float rest = has_rest ? (float)(scale * diffuse_rest(build, tau)) : 0.0f;
        for (uint32_t k = 0; k < table->direction_count; ++k) {
            const double volume = 2.0 * (double)AMB_PI * radial[i] * in[k];
            const float factor = (float)(1.0 / (volume * (double)build->walk_count));
            float *out = table->values + ((uint64_t)i * table->direction_count + k) * count;
            const uint64_t at = (uint64_t)(out - table->values);
            for (uint32_t j = 0; j < count; ++j) {
                float sum = 0.0f;
                for (int b = 0; b < BANK_COUNT; ++b)
                    sum += build->banks[b][at + j];
                out[j] = factor * sum + rest;
            }
        }
    }
    /* Beams of all directions: mean over d . r and, since the azimuth is that of o from d, over
     * it (trapezoids over 0 .. pi). */
    for (uint32_t i = 0; i < RADIAL_COUNT; ++i)
        for (uint32_t b = 0; b < table->direction_count; ++b) {
            double sum = 0.0;
            for (uint32_t k = 0; k < table->direction_count; ++k)
                for (uint32_t f = 0; f < table->azimuth_count; ++f) {
                    const uint64_t at =
                        (((uint64_t)i * table->direction_count + k) * table->direction_count + b) *
                            table->azimuth_count +
                        f;
                    sum += 0.5 * in[k] * azimuth_share(table, f) * (double)table->values[at];
                }
            table->means[i * table->direction_count + b] = (float)sum;
        }
}

/* ---- The whole ------------------------------------------------------------------------------- */

static void shape_table(const PropagatorParams *params, Propagator *out) {
    float g_max = 0.0f, cosine = 0.0f;
    for (uint32_t l = 0; l < params->lobe_count; ++l) {
        g_max = fmaxf(g_max, fabsf(params->g[l]));
        cosine += params->shares[l] * params->g[l];
    }
    out->tau_max = params->tau_max;
    out->log_scale = (float)(RADIAL_COUNT - 1) / logf(1.0f + params->tau_max / TAU_UNIT);
    out->direction_count = g_max > 1e-3f ? DIRECTION_COUNT : 1;
    out->azimuth_count = g_max > 1e-3f ? AZIMUTH_COUNT : 1;
    /* About the rate of the asymptotic decay: what is interpolated is flat then. */
    out->decay =
        fminf(safe_sqrtf(3.0f * (1.0f - params->albedo) * (1.0f - params->albedo * cosine)), 1.0f);
}

static void count_walks(const PropagatorParams *params, Build *build) {
    float cosine = 0.0f;
    for (uint32_t l = 0; l < params->lobe_count; ++l)
        cosine += params->shares[l] * params->g[l];
    const float end = fminf(DIFFUSION_BEGIN / (1.0f - cosine), (float)ORDER_LIMIT);
    build->order_end = (uint32_t)end > 64 ? (uint32_t)end : 64;
    if (params->order_max > 0 && params->order_max < build->order_end)
        build->order_end = params->order_max;
    const float mean =
        fminf(2.0f + 1.0f / fmaxf(1.0f - params->albedo, 1e-6f), (float)build->order_end);
    const float collisions = build->table->direction_count > 1 ? COLLISIONS : 2.0f * COLLISIONS;
    const uint64_t walks = (uint64_t)(collisions / mean);
    build->walk_count = walks > WALKS_MIN ? walks : WALKS_MIN;
}

AmbStatus propagator_build(const PropagatorParams *params, Job *job, Propagator *out) {
    memset(out, 0, sizeof *out);
    shape_table(params, out);
    Build *build = memory_zero_array(1, sizeof *build);
    out->values = memory_zero_array(value_count(out), sizeof(float));
    out->means = memory_zero_array((uint64_t)RADIAL_COUNT * out->direction_count, sizeof(float));
    bool has_memory = build != NULL && out->values != NULL && out->means != NULL;
    for (int b = 0; has_memory && b < BANK_COUNT; ++b) {
        build->banks[b] = memory_zero_array(value_count(out), sizeof(float));
        has_memory = build->banks[b] != NULL;
    }
    AmbStatus status = AMB_OK;
    if (!has_memory)
        status = status_fail(AMB_OUT_OF_MEMORY, "no memory for a table of multiple scattering");
    if (status == AMB_OK) {
        build->params = params;
        build->table = out;
        build->job = job;
        list_outgoing(out, &build->outgoing);
        count_walks(params, build);
        if (params->albedo > 0.0f && build->order_end >= 3)
            status = parallel_for(job, BANK_COUNT, 1, fill_bank, build);
    }
    if (status == AMB_OK) {
        finish_values(build);
        for (int b = 0; b < BANK_COUNT; ++b)
            out->collision_count += build->collision_counts[b];
    }
    for (int b = 0; build != NULL && b < BANK_COUNT; ++b)
        memory_free(build->banks[b]);
    memory_free(build);
    if (status != AMB_OK)
        propagator_clear(out);
    return status;
}

void propagator_clear(Propagator *propagator) {
    memory_free(propagator->values);
    memory_free(propagator->means);
    memset(propagator, 0, sizeof *propagator);
}

uint64_t propagator_bytes(const Propagator *propagator) {
    if (propagator->values == NULL)
        return 0;
    return (value_count(propagator) + (uint64_t)RADIAL_COUNT * propagator->direction_count) *
           sizeof(float);
}

/* ---- Reading --------------------------------------------------------------------------------- */

static float mix(float a, float b, float x) {
    return a + x * (b - a);
}

/* Linear in the cosine out and the azimuth, at one radial node and one cosine in. */
static float outgoing_at(const float *values, uint32_t row, Place out, Place azimuth) {
    const float *low = values + (uint64_t)out.index * row + azimuth.index;
    const float *high = low + row;
    return mix(mix(low[0], low[1], azimuth.x), mix(high[0], high[1], azimuth.x), out.x);
}

float propagator_at(const Propagator *propagator, float tau, float cos_in, float cos_out,
                    float cos_azimuth, float coherence) {
    const Place radial = place_tau(propagator, tau);
    const float fade = expf(-propagator->decay * tau);
    const float *values = propagator->values, *means = propagator->means;
    if (propagator->direction_count == 1)
        return fade * mix(values[radial.index], values[radial.index + 1], radial.x);
    const uint32_t count = propagator->direction_count;
    const Place in = place_cosine(propagator, cos_in), out = place_cosine(propagator, cos_out);
    float spread = 0.0f, straight = 0.0f;
    const float *mean = means + (uint64_t)radial.index * count + out.index;
    spread = mix(mix(mean[0], mean[1], out.x), mix(mean[count], mean[count + 1], out.x), radial.x);
    if (coherence > 0.0f) {
        const uint32_t row = propagator->azimuth_count;
        const Place azimuth =
            place_on(acosf(clampf(cos_azimuth, -1.0f, 1.0f)) / AMB_PI * (float)(row - 1), row);
        const uint64_t block = (uint64_t)count * row;
        const float *at = values + ((uint64_t)radial.index * count + in.index) * block;
        const float *next = at + count * block;
        straight = mix(mix(outgoing_at(at, row, out, azimuth),
                           outgoing_at(at + block, row, out, azimuth), in.x),
                       mix(outgoing_at(next, row, out, azimuth),
                           outgoing_at(next + block, row, out, azimuth), in.x),
                       radial.x);
    }
    return fade * mix(spread, straight, coherence);
}
