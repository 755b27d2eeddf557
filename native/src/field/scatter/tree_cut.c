/* SPDX-License-Identifier: GPL-3.0-or-later
 * Double and multiple scattering by a cut of the hierarchy of volume samples. */
#include "field/scatter/tree_cut.h"

#include "base/memory.h"
#include "base/rng.h"
#include "field/scatter/ball_mean.h"
#include "field/scatter/propagator.h"
#include "field/scatter/volume_tree.h"

enum {
    SAMPLES_PER_RAY = 16,
    POINTS_MIN = 8, /* of a camera segment */
    POINTS_MAX = 16,
    CUT_MAX = 1024,    /* nodes of a cut */
    SIGHT_PROBES = 512 /* connections that tell whether walls stand in the way */
};

/* A node is replaced by its children where it may be wrong by more than this share of the sum;
 * [Walter05] takes 2 %. */
static const float CUT_ERROR = 0.005f;

/* One object. */
typedef struct Cloud {
    VolumeTree tree;
    Medium medium;
    Propagator tables[3]; /* by channel; those of channels alike are in the first of them */
    uint32_t table_of[3];
    bool has_walls; /* lines between samples may be blocked: each asks for a ray */
} Cloud;

struct TreeCut {
    const AmbScene *scene;
    uint32_t object_count;
    uint32_t order_max;
    Cloud *clouds; /* by object */
};

/* ---- Building -------------------------------------------------------------------------------- */

static PropagatorParams channel_params(const Medium *medium, int channel, float tau_max,
                                       uint32_t order_max) {
    const float *sigma_t = &medium->sigma_t.r;
    PropagatorParams params = {
        .lobe_count = medium->lobe_count, .tau_max = tau_max, .order_max = order_max};
    float sigma_s = 0.0f;
    for (uint32_t l = 0; l < medium->lobe_count; ++l) {
        params.shares[l] = (&medium->lobes[l].sigma_s.r)[channel];
        params.g[l] = medium->lobes[l].g;
        sigma_s += params.shares[l];
    }
    for (uint32_t l = 0; l < medium->lobe_count; ++l)
        params.shares[l] = sigma_s > 0.0f ? params.shares[l] / sigma_s : 0.0f;
    params.albedo = sigma_s > 0.0f ? sigma_s / sigma_t[channel] : 0.0f;
    return params;
}

static bool is_alike(const PropagatorParams *a, const PropagatorParams *b) {
    bool is_same = a->albedo == b->albedo;
    for (uint32_t l = 0; l < a->lobe_count; ++l)
        is_same = is_same && a->shares[l] == b->shares[l];
    return is_same;
}

static AmbStatus build_tables(Cloud *cloud, float radius, uint32_t order_max, Job *job) {
    if (order_max > 0 && order_max < 3)
        return AMB_OK;
    const float tau_max = 2.0f * radius * rgb_max(cloud->medium.sigma_t);
    PropagatorParams params[3];
    for (uint32_t c = 0; c < 3; ++c) {
        params[c] = channel_params(&cloud->medium, (int)c, tau_max, order_max);
        uint32_t same = 0;
        while (same < c && !is_alike(&params[same], &params[c]))
            ++same;
        cloud->table_of[c] = same;
        if (same == c)
            AMB_TRY(propagator_build(&params[c], job, &cloud->tables[c]));
    }
    return AMB_OK;
}

static bool is_blocked(const AmbScene *scene, Vec3 from, Vec3 to) {
    const Vec3 way = vec3_sub(to, from);
    const float distance = vec3_length(way);
    return distance > 0.0f &&
           scene_is_occluded(scene, from, vec3_scale(way, 1.0f / distance), distance);
}

/* A leaf by chance. */
static const VolumeNode *random_sample(const VolumeTree *tree, Rng rng, uint32_t *dimension) {
    const VolumeNode *node = tree->nodes;
    while (node->count > 0) {
        const float u = rng_float(rng, (*dimension)++);
        node = &tree->nodes[node->first + (uint32_t)(u * (float)node->count)];
    }
    return node;
}

/* A point just below the boundary, by chance. */
static Vec3 random_skin(const AmbScene *scene, uint32_t object, Rng rng, uint32_t *dimension) {
    const SceneObject *shape = &scene->objects[object];
    const SceneMesh *mesh = &scene->meshes[shape->mesh];
    const float u = rng_float(rng, (*dimension)++);
    const uint32_t *corners = mesh->triangles + 3 * (uint64_t)(u * (float)mesh->triangle_count);
    const Vec3 a = shape->positions[corners[0]];
    const Vec3 ab = vec3_sub(shape->positions[corners[1]], a);
    const Vec3 ac = vec3_sub(shape->positions[corners[2]], a);
    const Vec3 out = vec3_scale(vec3_cross(ab, ac), shape->is_flipped ? -1.0f : 1.0f);
    const Vec3 middle = vec3_madd(a, 1.0f / 3.0f, vec3_add(ab, ac));
    const float length = vec3_length(out);
    return length > 0.0f ? vec3_madd(middle, -1e-3f * shape->radius / length, out) : middle;
}

/* Whether anything stands between places that a camera may see and samples. */
static bool find_walls(const AmbScene *scene, uint32_t object, const VolumeTree *tree) {
    const Rng rng = rng_create(0, RNG_STAGE_PROPAGATOR, UINT64_MAX);
    uint32_t dimension = 0;
    for (int i = 0; i < SIGHT_PROBES; ++i) {
        const Vec3 eye = random_skin(scene, object, rng, &dimension);
        if (is_blocked(scene, random_sample(tree, rng, &dimension)->center, eye))
            return true;
    }
    return false;
}

static AmbStatus build_clouds(const AmbScene *scene, const TreeCutParams *params,
                              const LightField *light, Job *job, TreeCut *cut) {
    float length = 0.0f;
    for (uint32_t o = 0; o < scene->object_count; ++o)
        length += volume_tree_length(&light->objects[o],
                                     &scene->materials[scene->objects[o].inside].medium);
    const float spacing = length / (float)params->sample_count;
    for (uint32_t o = 0; o < scene->object_count; ++o) {
        Cloud *cloud = &cut->clouds[o];
        cloud->medium = scene->materials[scene->objects[o].inside].medium;
        if (light->objects[o].count == 0 || !medium_scatters(&cloud->medium))
            continue;
        AMB_TRY(volume_tree_build(&light->objects[o], &cloud->medium, spacing, job, &cloud->tree));
        AMB_TRY(build_tables(cloud, scene->objects[o].radius, params->order_max, job));
        cloud->has_walls = cloud->tree.sample_count > 0 && find_walls(scene, o, &cloud->tree);
    }
    return AMB_OK;
}

static AmbStatus build(const AmbScene *scene, const TreeCutParams *params, Job *job, TreeCut *cut) {
    LightTraceParams light_params = params->light;
    light_params.ray_count = params->sample_count / SAMPLES_PER_RAY;
    light_params.ray_count = light_params.ray_count > 0 ? light_params.ray_count : 1;
    LightField light;
    AMB_TRY(light_trace(scene, &light_params, job, &light));
    const AmbStatus status = build_clouds(scene, params, &light, job, cut);
    light_field_clear(&light);
    return status;
}

AmbStatus tree_cut_create(const AmbScene *scene, const TreeCutParams *params, Job *job,
                          TreeCut **out_cut) {
    TreeCut *cut = memory_zero_array(1, sizeof *cut);
    if (cut == NULL)
        return status_fail(AMB_OUT_OF_MEMORY, "no memory for scattered light");
    cut->scene = scene;
    cut->object_count = scene->object_count;
    cut->order_max = params->order_max;
    cut->clouds = memory_zero_array(scene->object_count, sizeof *cut->clouds);
    AmbStatus status = AMB_OK;
    if (cut->clouds == NULL)
        status = status_fail(AMB_OUT_OF_MEMORY, "no memory for scattered light");
    if (status == AMB_OK)
        status = build(scene, params, job, cut);
    if (status != AMB_OK) {
        tree_cut_destroy(cut);
        return status;
    }
    *out_cut = cut;
    return AMB_OK;
}

void tree_cut_destroy(TreeCut *cut) {
    if (cut == NULL)
        return;
    for (uint32_t o = 0; cut->clouds != NULL && o < cut->object_count; ++o) {
        volume_tree_clear(&cut->clouds[o].tree);
        for (int c = 0; c < 3; ++c)
            propagator_clear(&cut->clouds[o].tables[c]);
    }
    memory_free(cut->clouds);
    memory_free(cut);
}

uint64_t tree_cut_bytes(const TreeCut *cut) {
    uint64_t bytes = 0;
    for (uint32_t o = 0; o < cut->object_count; ++o) {
        bytes += volume_tree_bytes(&cut->clouds[o].tree);
        for (int c = 0; c < 3; ++c)
            bytes += propagator_bytes(&cut->clouds[o].tables[c]);
    }
    return bytes;
}

uint64_t tree_cut_sample_count(const TreeCut *cut) {
    uint64_t count = 0;
    for (uint32_t o = 0; o < cut->object_count; ++o)
        count += cut->clouds[o].tree.sample_count;
    return count;
}

/* ---- One connection -------------------------------------------------------------------------- */

/* sum of sigma_s p over the lobes; the lobe of light whose directions have the mean cosine
 * `coherence` is that of g coherence, exact where they are themselves distributed as a lobe. */
static Rgb scatter_towards(const Medium *medium, float cosine, float coherence) {
    Rgb sum = {0, 0, 0};
    for (uint32_t l = 0; l < medium->lobe_count; ++l)
        sum = rgb_add(sum, rgb_scale(medium->lobes[l].sigma_s,
                                     phase_hg(cosine, medium->lobes[l].g * coherence)));
    return sum;
}

/* Two scatterings through all directions between: lobes of g1 g2. */
static Rgb scatter_twice(const Medium *medium, float cosine, float coherence) {
    Rgb sum = {0, 0, 0};
    for (uint32_t l = 0; l < medium->lobe_count; ++l)
        for (uint32_t k = 0; k < medium->lobe_count; ++k) {
            const MediumLobe *a = &medium->lobes[l], *b = &medium->lobes[k];
            sum = rgb_add(sum, rgb_scale(rgb_mul(a->sigma_s, b->sigma_s),
                                         phase_hg(cosine, a->g * b->g * coherence)));
        }
    return sum;
}

/* A point of the camera's segment. */
typedef struct Eye {
    const TreeCut *cut;
    const Cloud *cloud;
    Vec3 p;
    Vec3 o; /* unit, direction of travel towards the camera */
} Eye;

/* What one node scatters per metre at the eye's point. */
typedef struct Link {
    Rgb twice, more;
    float error; /* bound on what its samples may be away from it, mean of channels */
    uint32_t node;
} Link;

/* What the extent of a ball adds to exp(-sigma r) / r^2 at its centre beside the mean of 1 / r^2,
 * to second order: a tenth of ball^2 times the rest of the Laplacian. */
static Rgb swell(const Medium *medium, float ball, float d) {
    const Rgb s = medium->sigma_t;
    const float x = 0.1f * ball * ball, y = 2.0f / fmaxf(d, ball);
    return rgb(1.0f + x * s.r * (s.r + y), 1.0f + x * s.g * (s.g + y), 1.0f + x * s.b * (s.b + y));
}

static Rgb connect_twice(const Eye *eye, const VolumeNode *node, Vec3 r, float cos_in,
                         const BallMean *mean, float d) {
    const Medium *medium = &eye->cloud->medium;
    const float h = mean->coherence;
    const float cos_out = vec3_dot(r, eye->o);
    const Rgb in = scatter_towards(medium, cos_in, node->mean_cosine * h);
    const Rgb out = scatter_towards(medium, cos_out, h);
    Rgb both = rgb_scale(rgb_mul(in, out), h);
    /* From inside of the node its light comes from all around. */
    if (h < 0.999f) {
        const Rgb around = scatter_twice(medium, vec3_dot(node->axis, eye->o), node->mean_cosine);
        both = rgb_add(both, rgb_scale(around, (1.0f - h) / (4.0f * AMB_PI)));
    }
    const Rgb arriving = rgb_mul(medium_transmittance(medium, d), swell(medium, node->ball, d));
    return rgb_scale(rgb_mul(rgb_mul(both, node->stretch), arriving), mean->inverse2);
}

static Rgb connect_more(const Eye *eye, const VolumeNode *node, Vec3 r, float cos_in,
                        const BallMean *mean, float d) {
    const Cloud *cloud = eye->cloud;
    if (cloud->tables[0].values == NULL)
        return rgb(0, 0, 0);
    const float cos_out = vec3_dot(r, eye->o);
    const float sine2 = (1.0f - cos_in * cos_in) * (1.0f - cos_out * cos_out);
    const float across = vec3_dot(node->axis, eye->o) - cos_in * cos_out;
    const float cos_azimuth = sine2 > 1e-12f ? across / sqrtf(sine2) : 1.0f;
    const float coherence = node->mean_cosine * mean->coherence;
    const float sigma_t[3] = {cloud->medium.sigma_t.r, cloud->medium.sigma_t.g,
                              cloud->medium.sigma_t.b};
    float out[3];
    for (uint32_t c = 0; c < 3; ++c) {
        const uint32_t table = cloud->table_of[c];
        if (table < c && sigma_t[table] == sigma_t[c]) {
            out[c] = out[table];
            continue;
        }
        /* stretch sigma_t watts collide; T sigma_t^3 is per volume, tau = sigma_t r. */
        const float s = sigma_t[c];
        const Propagator *values = &cloud->tables[table];
        float value = propagator_at(values, s * d, cos_in, cos_out, cos_azimuth, coherence);
        /* tau T over tau: to second order its mean over the ball is that of 1 / r and a tenth of
         * ball^2 times the second derivative of tau T. */
        value = 0.8f * value + 0.1f * (propagator_at(values, s * (d + node->ball), cos_in, cos_out,
                                                     cos_azimuth, coherence) +
                                       propagator_at(values, s * fabsf(d - node->ball), cos_in,
                                                     cos_out, cos_azimuth, coherence));
        out[c] = s * s * s * mean->inverse * value;
    }
    return rgb_mul(node->stretch, rgb_from(out));
}

/* cos(angle - width), 1 where it is inside of the width. */
static float nearer_cosine(float cosine, float cos_width, float sin_width) {
    if (cosine >= cos_width)
        return 1.0f;
    return cosine * cos_width + safe_sqrtf(1.0f - cosine * cosine) * sin_width;
}

/* Bound of what the samples of a node may add, times how much of it is unknown: the extent of the
 * node as an angle, squared since its centre is exact to first order. */
static float link_error(const Eye *eye, const VolumeNode *node, float cos_in, float cos_out,
                        float d, const Link *link) {
    const float near = fmaxf(d - node->ball, 0.0f);
    const float x = node->ball / d;
    if (!(x < 0.7f)) /* inside of it, or about: its own mean tells the size */
        return rgb_mean(link->twice) + rgb_mean(link->more);
    const float cos_width = safe_sqrtf(1.0f - x * x);
    const Medium *medium = &eye->cloud->medium;
    const Rgb in = scatter_towards(medium, nearer_cosine(cos_in, cos_width, x), node->mean_cosine);
    const Rgb out = scatter_towards(medium, nearer_cosine(cos_out, cos_width, x), 1.0f);
    const Rgb most = rgb_scale(
        rgb_mul(rgb_mul(rgb_mul(in, out), node->stretch), medium_transmittance(medium, near)),
        1.0f / (near * near));
    return 0.25f * x * x * (rgb_mean(most) + rgb_mean(link->more));
}

static Link connect(const Eye *eye, uint32_t index) {
    const VolumeNode *node = &eye->cloud->tree.nodes[index];
    const Vec3 way = vec3_sub(eye->p, node->center);
    const float d = fmaxf(vec3_length(way), 1e-6f * node->ball);
    const Vec3 r = vec3_scale(way, 1.0f / d);
    const float cos_in = clampf(vec3_dot(node->axis, r), -1.0f, 1.0f);
    const BallMean mean = ball_mean(d, node->ball);
    Link link = {.node = index};
    /* Inside of the ball its points are about 3/4 of its radius away. */
    const float way_inside = fmaxf(d, 0.75f * node->ball);
    link.more = connect_more(eye, node, r, cos_in, &mean, d);
    link.twice = connect_twice(eye, node, r, cos_in, &mean, way_inside);
    if (eye->cloud->has_walls && is_blocked(eye->cut->scene, node->center, eye->p))
        link.twice = rgb(0, 0, 0);
    if (node->count > 0)
        link.error =
            link_error(eye, node, cos_in, clampf(vec3_dot(r, eye->o), -1.0f, 1.0f), d, &link);
    return link;
}

/* ---- The cut --------------------------------------------------------------------------------- */

/* A heap, the largest error on top. */
typedef struct Heap {
    uint32_t count;
    Link links[CUT_MAX];
} Heap;

static void heap_push(Heap *heap, const Link *link) {
    uint32_t i = heap->count++;
    while (i > 0 && heap->links[(i - 1) / 2].error < link->error) {
        heap->links[i] = heap->links[(i - 1) / 2];
        i = (i - 1) / 2;
    }
    heap->links[i] = *link;
}

static Link heap_pop(Heap *heap) {
    const Link top = heap->links[0];
    const Link last = heap->links[--heap->count];
    uint32_t i = 0;
    for (;;) {
        uint32_t child = 2 * i + 1;
        if (child >= heap->count)
            break;
        if (child + 1 < heap->count && heap->links[child + 1].error > heap->links[child].error)
            ++child;
        if (!(heap->links[child].error > last.error))
            break;
        heap->links[i] = heap->links[child];
        i = child;
    }
    heap->links[i] = last;
    return top;
}

/* Radiance scattered per metre at the eye's point by the order of scattering. What is final
 * (samples, and nodes that are good enough) is in the sum, the rest in the heap. */
static TreeCutRadiance sum_cut(const Eye *eye) {
    Heap heap = {.count = 0};
    const Link root = connect(eye, 0);
    heap_push(&heap, &root);
    TreeCutRadiance sum = {root.twice, root.more};
    while (heap.count > 0 && heap.count + 8 <= CUT_MAX) {
        const float total = rgb_mean(sum.twice) + rgb_mean(sum.more);
        if (!(heap.links[0].error > CUT_ERROR * total))
            break;
        const Link worst = heap_pop(&heap);
        const VolumeNode *node = &eye->cloud->tree.nodes[worst.node];
        sum.twice = rgb_add(sum.twice, rgb_scale(worst.twice, -1.0f));
        sum.more = rgb_add(sum.more, rgb_scale(worst.more, -1.0f));
        for (uint32_t i = 0; i < node->count; ++i) {
            const Link child = connect(eye, node->first + i);
            sum.twice = rgb_add(sum.twice, child.twice);
            sum.more = rgb_add(sum.more, child.more);
            if (child.error > 0.0f)
                heap_push(&heap, &child);
        }
    }
    return sum;
}

/* ---- Along the segment ----------------------------------------------------------------------- */

/* int exp(-sigma t) dt from 0. */
static float seen_length(float sigma, float t) {
    const float x = sigma * t;
    return x > 1e-4f ? -expm1f(-x) / sigma : t;
}

/* Share of what a segment's channels see that lies before t, mean of channels. */
static float seen_share(const float sigma_t[3], float t, float length) {
    float sum = 0.0f;
    for (int c = 0; c < 3; ++c)
        sum += seen_length(sigma_t[c], t) / seen_length(sigma_t[c], length);
    return sum / 3.0f;
}

static float seen_inverse(const float sigma_t[3], float share, float length) {
    float low = 0.0f, high = length;
    for (int i = 0; i < 22; ++i) {
        const float middle = 0.5f * (low + high);
        if (seen_share(sigma_t, middle, length) < share)
            low = middle;
        else
            high = middle;
    }
    return 0.5f * (low + high);
}

TreeCutRadiance tree_cut_gather(const TreeCut *cut, const FieldSegment *segment) {
    const Cloud *cloud = &cut->clouds[segment->object];
    TreeCutRadiance radiance = {{0, 0, 0}, {0, 0, 0}};
    if (cloud->tree.sample_count == 0 || cut->order_max == 1)
        return radiance;
    const float sigma_t[3] = {cloud->medium.sigma_t.r, cloud->medium.sigma_t.g,
                              cloud->medium.sigma_t.b};
    /* The clearest channel sees farthest. */
    const float depth = segment->length * rgb_min(cloud->medium.sigma_t);
    const int count = (int)clampf(POINTS_MIN + 0.5f * depth, POINTS_MIN, POINTS_MAX);
    float seen[3] = {0, 0, 0}; /* up to where the last stretch ends */
    for (int i = 0; i < count; ++i) {
        const float share = 1.0f / (float)count;
        const float middle = seen_inverse(sigma_t, share * ((float)i + 0.5f), segment->length);
        float end = segment->length;
        if (i + 1 < count)
            end = seen_inverse(sigma_t, share * ((float)i + 1.0f), segment->length);
        float weight[3];
        for (int c = 0; c < 3; ++c) {
            const float next = seen_length(sigma_t[c], end);
            weight[c] = next - seen[c];
            seen[c] = next;
        }
        const Eye eye = {.cut = cut,
                         .cloud = cloud,
                         .p = vec3_madd(segment->o, middle, segment->d),
                         .o = vec3_negate(segment->d)};
        const TreeCutRadiance here = sum_cut(&eye);
        radiance.twice = rgb_add(radiance.twice, rgb_mul(here.twice, rgb_from(weight)));
        radiance.more = rgb_add(radiance.more, rgb_mul(here.more, rgb_from(weight)));
    }
    return radiance;
}
