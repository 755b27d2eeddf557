/* SPDX-License-Identifier: GPL-3.0-or-later
 * Hierarchy over volume samples for connections from afar. */
#include "field/scatter/volume_tree.h"

#include <string.h>

#include "base/memory.h"
#include "field/points/point_tree.h"

/* ---- Samples --------------------------------------------------------------------------------- */

/* Optical depth at which the clearest channel's light has gone. */
static const float DEPTH_MAX = 14.0f;

/* int exp(-sigma s) ds over a step from 0. */
static float decayed_length(float sigma, float step) {
    const float x = sigma * step;
    return x > 1e-4f ? -expm1f(-x) / sigma : step;
}

static Rgb decayed_lengths(const Medium *medium, float step) {
    return rgb(decayed_length(medium->sigma_t.r, step), decayed_length(medium->sigma_t.g, step),
               decayed_length(medium->sigma_t.b, step));
}

/* As far as there is light. */
static float lit_length(const LightBeam *beam, const Medium *medium) {
    return fminf(beam->length, DEPTH_MAX / rgb_min(medium->sigma_t));
}

static uint64_t samples_of(const LightBeam *beam, const Medium *medium, float spacing) {
    const float count = roundf(lit_length(beam, medium) / spacing);
    return count > 1.0f ? (uint64_t)count : 1;
}

float volume_tree_length(const LightBeams *beams, const Medium *medium) {
    double sum = 0.0;
    for (uint64_t i = 0; i < beams->count; ++i)
        sum += (double)lit_length(&beams->beams[i], medium);
    return (float)sum;
}

/* Where on the way to `end` a sample begins that has this share of the way before it, which is
 * half one of its length and half one of its light: samples are short where light falls off. */
static float place_begin(const Medium *medium, float share, float end) {
    const float all = rgb_mean(decayed_lengths(medium, end));
    float low = 0.0f, high = end;
    for (int i = 0; i < 20; ++i) {
        const float s = 0.5f * (low + high);
        if (0.5f * (s / end + rgb_mean(decayed_lengths(medium, s)) / all) < share)
            low = s;
        else
            high = s;
    }
    return 0.5f * (low + high);
}

/* Unlike the samples of single scattering these tile the light's way exactly: nothing reaches past
 * its ends, since all of their light is summed up. */
static PointSample *place_samples(const LightBeam *beam, const Medium *medium, uint64_t count,
                                  PointSample *out) {
    const float length = lit_length(beam, medium);
    float s = 0.0f;
    for (uint64_t k = 0; k < count; ++k) {
        float next = length;
        if (k + 1 < count)
            next = place_begin(medium, (float)(k + 1) / (float)count, length);
        *out++ = (PointSample){.origin = vec3_madd(beam->origin, s, beam->direction),
                               .direction = beam->direction,
                               .low = 0.0f,
                               .high = next - s,
                               .radius = sqrtf(beam->cell_area / AMB_PI),
                               .flux = rgb_mul(beam->flux, medium_transmittance(medium, s))};
        s = next;
    }
    return out;
}

/* ---- Nodes ----------------------------------------------------------------------------------- */

/* Mean of s over exp(-sigma s) ds. */
static float decayed_middle(float sigma, float step) {
    const float x = sigma * step;
    if (x < 1e-2f)
        return step * (0.5f - x / 12.0f);
    return 1.0f / sigma - step / expm1f(x);
}

static VolumeNode sample_node(const PointBlock *block, uint32_t lane, const Medium *medium) {
    const float step = block->high[lane];
    const Vec3 d =
        vec3(block->direction[0][lane], block->direction[1][lane], block->direction[2][lane]);
    const Vec3 origin =
        vec3(block->origin[0][lane], block->origin[1][lane], block->origin[2][lane]);
    const Rgb flux = {block->flux[0][lane], block->flux[1][lane], block->flux[2][lane]};
    const Rgb stretch = rgb_mul(flux, decayed_lengths(medium, step));
    const Rgb middle = {decayed_middle(medium->sigma_t.r, step),
                        decayed_middle(medium->sigma_t.g, step),
                        decayed_middle(medium->sigma_t.b, step)};
    const float weight = rgb_mean(stretch);
    const float along = weight > 0.0f ? rgb_mean(rgb_mul(stretch, middle)) / weight : 0.5f * step;
    /* A cylinder's variance is step^2 / 12 + radius^2 / 2, a ball's 3/5 ball^2. */
    const float variance = step * step / 12.0f + 0.5f * block->radius2[lane];
    return (VolumeNode){.center = vec3_madd(origin, along, d),
                        .ball = sqrtf(variance * (5.0f / 3.0f)),
                        .axis = d,
                        .mean_cosine = 1.0f,
                        .stretch = stretch};
}

/* The sum of children that are finished. */
static void sum_children(VolumeNode *nodes, VolumeNode *node) {
    const VolumeNode *children = nodes + node->first;
    float weight = 0.0f;
    Vec3 center = {0, 0, 0}, axis = {0, 0, 0};
    Rgb stretch = {0, 0, 0};
    for (uint32_t i = 0; i < node->count; ++i) {
        const float w = rgb_mean(children[i].stretch);
        weight += w;
        center = vec3_madd(center, w, children[i].center);
        axis = vec3_madd(axis, w * children[i].mean_cosine, children[i].axis);
        stretch = rgb_add(stretch, children[i].stretch);
    }
    node->stretch = stretch;
    node->center = weight > 0.0f ? vec3_scale(center, 1.0f / weight) : children[0].center;
    const float length = vec3_length(axis);
    node->axis = length > 0.0f ? vec3_scale(axis, 1.0f / length) : children[0].axis;
    node->mean_cosine = weight > 0.0f ? fminf(length / weight, 1.0f) : 0.0f;
    float variance = 0.0f;
    for (uint32_t i = 0; i < node->count; ++i) {
        const VolumeNode *child = &children[i];
        const float distance = vec3_length(vec3_sub(child->center, node->center));
        variance +=
            rgb_mean(child->stretch) * (distance * distance + 0.6f * child->ball * child->ball);
    }
    node->ball = weight > 0.0f ? sqrtf(variance / weight * (5.0f / 3.0f)) : 0.0f;
}

typedef struct Builder {
    const PointTree *points;
    uint64_t sample_count;
    const Medium *medium;
    Job *job;
    VolumeNode *nodes;
    uint64_t next; /* first node not yet taken */
} Builder;

static void fill_block(Builder *builder, uint64_t index, uint64_t block) {
    VolumeNode *node = &builder->nodes[index];
    node->first = (uint32_t)builder->next;
    const uint64_t rest = builder->sample_count - block * POINT_LANES;
    node->count = rest < POINT_LANES ? (uint32_t)rest : POINT_LANES;
    for (uint32_t lane = 0; lane < node->count; ++lane)
        builder->nodes[node->first + lane] =
            sample_node(&builder->points->blocks[block], lane, builder->medium);
    builder->next += node->count;
    sum_children(builder->nodes, node);
}

static AmbStatus fill_node(Builder *builder, uint64_t index, int32_t source) {
    if (source < 0) {
        fill_block(builder, index, (uint64_t)~source);
        return AMB_OK;
    }
    if (job_is_cancelled(builder->job))
        return AMB_CANCELLED;
    const PointNode *from = &builder->points->nodes[source];
    VolumeNode *node = &builder->nodes[index];
    node->first = (uint32_t)builder->next;
    while (node->count < POINT_LANES && from->child[node->count] != 0)
        ++node->count;
    builder->next += node->count;
    for (uint32_t i = 0; i < node->count; ++i)
        AMB_TRY(fill_node(builder, node->first + i, from->child[i]));
    sum_children(builder->nodes, node);
    return AMB_OK;
}

static AmbStatus fill_tree(const PointTree *points, const Medium *medium, Job *job,
                           VolumeTree *tree) {
    tree->node_count = tree->sample_count + points->block_count + points->node_count;
    tree->nodes = memory_zero_array(tree->node_count, sizeof *tree->nodes);
    if (tree->nodes == NULL)
        return status_fail(AMB_OUT_OF_MEMORY, "no memory for the hierarchy of volume samples");
    Builder builder = {.points = points,
                       .sample_count = tree->sample_count,
                       .medium = medium,
                       .job = job,
                       .nodes = tree->nodes,
                       .next = 1};
    return fill_node(&builder, 0, 0);
}

AmbStatus volume_tree_build(const LightBeams *beams, const Medium *medium, float spacing, Job *job,
                            VolumeTree *out_tree) {
    memset(out_tree, 0, sizeof *out_tree);
    uint64_t count = 0;
    for (uint64_t i = 0; i < beams->count; ++i)
        count += samples_of(&beams->beams[i], medium, spacing);
    if (count == 0)
        return AMB_OK;
    PointSample *samples = memory_alloc_array(count, sizeof *samples);
    if (samples == NULL)
        return status_fail(AMB_OUT_OF_MEMORY, "no memory for %llu volume samples",
                           (unsigned long long)count);
    PointSample *next = samples;
    for (uint64_t i = 0; i < beams->count; ++i) {
        const LightBeam *beam = &beams->beams[i];
        next = place_samples(beam, medium, samples_of(beam, medium, spacing), next);
    }
    PointTree points;
    AmbStatus status = point_tree_build(samples, count, job, &points);
    memory_free(samples);
    if (status != AMB_OK)
        return status;
    out_tree->sample_count = count;
    status = fill_tree(&points, medium, job, out_tree);
    point_tree_clear(&points);
    if (status != AMB_OK)
        volume_tree_clear(out_tree);
    return status;
}

void volume_tree_clear(VolumeTree *tree) {
    memory_free(tree->nodes);
    memset(tree, 0, sizeof *tree);
}

uint64_t volume_tree_bytes(const VolumeTree *tree) {
    return tree->node_count * sizeof *tree->nodes;
}
