/* SPDX-License-Identifier: GPL-3.0-or-later
 * Cutting the lit boundary into tubes. */
#include "field/tubes/tubes.h"

#include <string.h>

#include "base/memory.h"
#include "field/tubes/tube_gather.h"
#include "scene/boundary.h"

enum {
    GRAIN = 256,       /* triangles of one unit of work */
    COARSE_LEVELS = 8, /* halvings at most of a triangle that is too large for what happens in it */
    GAP_SURFACE_MAX = 8, /* other things between leaving an object and coming back */
    EDGE_LEVELS = 3      /* further halvings where a shadow or a jump of the exit cuts a tube */
};

/* A tube's corners lie apart by at most this part of its object's radius, and its directions
 * within this angle (rad), each halved by every refinement: inside, the refracted map is taken to
 * be linear. Meshes with rounded shapes are finer anyway; this is for cubes and slabs. */
static const float SIZE_SHARE_MAX = 0.25f;
static const float ANGLE_MAX = 0.1f;
/* A spot's cone is covered by at least some tubes across, however large the triangle. */
static const float SPOT_SHARE_MAX = 0.25f;
/* Ends whose distances differ by more than this factor are on different surfaces. */
static const float LIMIT_RATIO_MAX = 1.2f;
/* Cosine of incidence that counts as grazing: what enters there carries nothing to speak of. */
static const float GRAZING_COS = 1e-3f;
/* In radii of the object: farther than anything in it. */
static const float LIMIT_MAX = 4.0f;
/* Visibility and exit are asked for beside a corner, towards the triangle's middle by this part:
 * exactly at a corner of the mesh, rays from a triangle graze its neighbours. */
static const float CORNER_SHRINK = 1e-3f;

/* A point of a triangle and the light there. */
typedef struct Corner {
    float u, v;           /* barycentric weights of the triangle's second and third vertex */
    Vec3 x, w;            /* world; w unit */
    float arriving, flux; /* per area of the flat triangle and unit colour, before and after
                           * refraction, 1/m^2 */
    float reach;          /* m, to the next surface */
    float limit;          /* m, to where the light ends for the gather; see light_limit */
    bool is_lit;
} Corner;

typedef struct Chunk {
    Tube *tubes;
    uint64_t count, room;
    TubeCount tally;
} Chunk;

typedef struct Cutter {
    const AmbScene *scene;
    const TubeParams *params;
    Job *job;
    Chunk *chunks;
    uint64_t triangle_chunks; /* chunks of one light */
    uint32_t object;
} Cutter;

/* One triangle under one light. */
typedef struct Face {
    const Cutter *cutter;
    const SceneLight *light;
    Chunk *chunk;
    uint32_t triangle;
    Vec3 ng;
    Rgb color;
    float area; /* of the whole triangle, m^2 */
} Face;

static AmbStatus chunk_append(Chunk *chunk, const Tube *tube) {
    if (chunk->count == chunk->room) {
        const uint64_t room = chunk->room > 0 ? 2 * chunk->room : GRAIN;
        Tube *tubes = memory_alloc_array(room, sizeof *tubes);
        if (tubes == NULL)
            return status_fail(AMB_OUT_OF_MEMORY, "no memory for light tubes");
        if (chunk->count > 0)
            memcpy(tubes, chunk->tubes, chunk->count * sizeof *tubes);
        memory_free(chunk->tubes);
        chunk->tubes = tubes;
        chunk->room = room;
    }
    chunk->tubes[chunk->count++] = *tube;
    return AMB_OK;
}

static Hit hit_of(const Face *face, float u, float v) {
    return (Hit){0.0f, u, v, face->cutter->object, face->triangle};
}

static float scale_of(Rgb value, Rgb unit) {
    const float largest = rgb_max(unit);
    return largest > 0.0f ? rgb_max(value) / largest : 0.0f;
}

/* Where the light along w from p, which leaves through the surface at exit, ends for the gather.
 * The gather never asks outside of the object; where the line comes back into it, the middle of
 * the gap parts what is lit from what is not with room for interpolation between corners, and
 * where it does not, nothing needs to be parted. Only a surface with medium behind it (an opaque
 * thing inside) is a sharp end. */
static float light_limit(const Face *face, Vec3 p, Vec3 w, const Hit *exit) {
    const AmbScene *scene = face->cutter->scene;
    const uint32_t object = face->cutter->object;
    const SurfacePoint surface = scene_surface(scene, exit);
    if (surface.object != object || vec3_dot(w, surface.ng) <= 0.0f)
        return exit->t;
    Vec3 o = scene_leave(&surface, w);
    for (int i = 0; i < GAP_SURFACE_MAX; ++i) {
        Hit next;
        if (!scene_intersect(scene, o, w, INFINITY, &next))
            break;
        const SurfacePoint beyond = scene_surface(scene, &next);
        if (beyond.object == object)
            return 0.5f * (exit->t + vec3_dot(vec3_sub(beyond.p, p), w));
        o = scene_leave(&beyond, w);
    }
    return LIMIT_MAX * scene->objects[object].radius;
}

/* Distance to the next surface from just inside, and whether the light is seen from just outside.
 */
static void trace_corner(const Face *face, Corner *corner) {
    const AmbScene *scene = face->cutter->scene;
    const float u = corner->u + CORNER_SHRINK * (1.0f / 3.0f - corner->u);
    const float v = corner->v + CORNER_SHRINK * (1.0f / 3.0f - corner->v);
    const Hit hit = hit_of(face, u, v);
    const SurfacePoint surface = scene_surface(scene, &hit);
    const LightArrival light = light_arrival(face->light, surface.p, (Sample2){0.5f, 0.5f});
    corner->is_lit =
        rgb_max(light.irradiance) > 0.0f &&
        !scene_is_occluded(scene, scene_leave(&surface, light.wi), light.wi, light.distance);
    Hit exit;
    const Vec3 start = scene_leave(&surface, corner->w);
    if (scene_intersect(scene, start, corner->w, INFINITY, &exit)) {
        corner->reach = exit.t;
        corner->limit = light_limit(face, start, corner->w, &exit);
    } else if (corner->is_lit) {
        ++face->chunk->tally.leak_count;
    }
}

static Corner make_corner(const Face *face, float u, float v) {
    const AmbScene *scene = face->cutter->scene;
    const Hit hit = hit_of(face, u, v);
    const SurfacePoint surface = scene_surface(scene, &hit);
    const LightArrival light = light_arrival(face->light, surface.p, (Sample2){0.5f, 0.5f});
    Corner corner = {.u = u, .v = v, .x = surface.p};
    const Vec3 d = vec3_negate(light.wi);
    /* Interpolation can turn the normal away from the light near a silhouette. It is turned back
     * until the light grazes it: unlike the face's own normal, which boundary_cross takes there,
     * that leaves the refracted map without a jump. */
    Vec3 n = surface.ns;
    const float cos_s = vec3_dot(light.wi, n);
    if (cos_s < GRAZING_COS)
        n = vec3_normalize(vec3_madd(n, GRAZING_COS - cos_s, light.wi));
    const DielectricSplit split = dielectric_split(d, n, 1.0f / surface.material->ior);
    corner.w = split.reflectance < 1.0f ? split.refracted : d;
    const float cos_g = vec3_dot(light.wi, surface.ng);
    const float below = -vec3_dot(corner.w, surface.ng);
    const float arriving = scale_of(light.irradiance, face->light->color) * fmaxf(cos_g, 0.0f);
    corner.arriving = arriving;
    if (below > 0.0f && cos_g > 0.0f && split.reflectance < 1.0f) {
        corner.flux = arriving * (1.0f - split.reflectance);
        if (face->cutter->params->adjoint_normals)
            corner.flux *= split.cos_i * below / (cos_g * split.cos_t);
    }
    trace_corner(face, &corner);
    return corner;
}

static float largest_difference(const Vec3 v[3]) {
    float largest = 0.0f;
    for (int k = 0; k < 3; ++k)
        largest = fmaxf(largest, vec3_length(vec3_sub(v[k], v[(k + 1) % 3])));
    return largest;
}

/* Whether a spot's cone may fall between the corners. */
static bool misses_spot(const Face *face, const Corner corners[3], float size) {
    const SceneLight *light = face->light;
    if (light->kind != AMB_LIGHT_SPOT)
        return false;
    const Vec3 sum = vec3_add(vec3_add(corners[0].x, corners[1].x), corners[2].x);
    const Vec3 to = vec3_sub(vec3_scale(sum, 1.0f / 3.0f), light->position);
    const float distance = vec3_length(to);
    const float outer = acosf(clampf(light->cos_outer, -1.0f, 1.0f));
    const float angle = acosf(clampf(vec3_dot(to, light->direction) / distance, -1.0f, 1.0f));
    const float half = size < distance ? asinf(size / distance) : AMB_PI;
    return half > SPOT_SHARE_MAX * outer && angle < outer + half;
}

static bool is_coarse(const Face *face, const Corner corners[3]) {
    const Cutter *cutter = face->cutter;
    const float share = ldexpf(1.0f, -(int)cutter->params->refinement);
    const float radius = cutter->scene->objects[cutter->object].radius;
    const Vec3 x[3] = {corners[0].x, corners[1].x, corners[2].x};
    const Vec3 w[3] = {corners[0].w, corners[1].w, corners[2].w};
    const float size = largest_difference(x);
    return size > SIZE_SHARE_MAX * share * radius || largest_difference(w) > ANGLE_MAX * share ||
           misses_spot(face, corners, size);
}

/* Whether the edge of a shadow or of a gap runs between the corners. */
static bool is_cut(const Corner corners[3]) {
    if (corners[0].is_lit != corners[1].is_lit || corners[1].is_lit != corners[2].is_lit)
        return true;
    const float low = fminf(fminf(corners[0].limit, corners[1].limit), corners[2].limit);
    const float high = fmaxf(fmaxf(corners[0].limit, corners[1].limit), corners[2].limit);
    return corners[0].is_lit && high > LIMIT_RATIO_MAX * low;
}

/* Cross-section a(s) = w . (e1 + s w1) x (e2 + s w2) / 2 over a(0). */
static void set_spread(Tube *tube) {
    const Vec3 e1 = vec3_sub(tube->x[1], tube->x[0]), e2 = vec3_sub(tube->x[2], tube->x[0]);
    const Vec3 w1 = vec3_sub(tube->w[1], tube->w[0]), w2 = vec3_sub(tube->w[2], tube->w[0]);
    const Vec3 w = vec3_add(vec3_add(tube->w[0], tube->w[1]), tube->w[2]);
    const float start = vec3_dot(w, vec3_cross(e1, e2));
    if (start == 0.0f)
        return;
    tube->spread[0] = vec3_dot(w, vec3_add(vec3_cross(e1, w2), vec3_cross(w1, e2))) / start;
    tube->spread[1] = vec3_dot(w, vec3_cross(w1, w2)) / start;
}

static void tally_add(double sum[3], Rgb color, double flux) {
    sum[0] += flux * (double)color.r;
    sum[1] += flux * (double)color.g;
    sum[2] += flux * (double)color.b;
}

static AmbStatus emit_tube(const Face *face, const Corner corners[3], float area) {
    const Cutter *cutter = face->cutter;
    const SceneObject *object = &cutter->scene->objects[cutter->object];
    const Medium *medium = &cutter->scene->materials[object->inside].medium;
    Tube tube = {.color = face->color};
    LightTally *tally = &face->chunk->tally.tally;
    bool is_bright = false;
    for (int k = 0; k < 3; ++k) {
        const Corner *corner = &corners[k];
        const float lit = corner->is_lit ? area : 0.0f;
        tube.x[k] = vec3_sub(corner->x, object->center);
        tube.w[k] = corner->w;
        tube.limit[k] = corner->limit;
        tube.far = fmaxf(tube.far, corner->reach);
        tube.flux[k] = lit * corner->flux;
        is_bright = is_bright || tube.flux[k] > 0.0f;
        const double third = (double)tube.flux[k] / 3.0;
        const Rgb left = medium_transmittance(medium, corner->reach);
        tally_add(tally->incident, face->light->color, (double)(lit * corner->arriving) / 3.0);
        tally_add(tally->entered, face->color, third);
        tally_add(tally->interacting,
                  rgb_mul(face->color, rgb(1.0f - left.r, 1.0f - left.g, 1.0f - left.b)), third);
    }
    if (!is_bright)
        return AMB_OK;
    set_spread(&tube);
    /* Between the corners the light may go farther before it leaves. */
    tube.far = 1.1f * tube.far + largest_difference(tube.x);
    return chunk_append(face->chunk, &tube);
}

static AmbStatus cut(const Face *face, const Corner corners[3], uint32_t level, uint32_t edges) {
    const uint32_t refinement = face->cutter->params->refinement;
    bool divides = level < refinement || (level < COARSE_LEVELS && is_coarse(face, corners));
    if (!divides && edges < EDGE_LEVELS && is_cut(corners)) {
        divides = true;
        ++edges;
    }
    if (!divides)
        return emit_tube(face, corners, face->area * ldexpf(1.0f, -2 * (int)level));
    if (job_is_cancelled(face->cutter->job))
        return AMB_CANCELLED;
    Corner middle[3]; /* of the edges 01, 12, 20 */
    for (int k = 0; k < 3; ++k) {
        const Corner *a = &corners[k], *b = &corners[(k + 1) % 3];
        middle[k] = make_corner(face, 0.5f * (a->u + b->u), 0.5f * (a->v + b->v));
    }
    for (int k = 0; k < 3; ++k) {
        const Corner part[3] = {corners[k], middle[k], middle[(k + 2) % 3]};
        AMB_TRY(cut(face, part, level + 1, edges));
    }
    return cut(face, middle, level + 1, edges);
}

static AmbStatus cut_triangle(const Cutter *cutter, const SceneLight *light, uint64_t triangle,
                              Chunk *chunk) {
    const AmbScene *scene = cutter->scene;
    const SceneObject *object = &scene->objects[cutter->object];
    const uint32_t *index = scene->meshes[object->mesh].triangles + 3 * triangle;
    const Vec3 *p = object->positions;
    const Vec3 normal =
        vec3_cross(vec3_sub(p[index[1]], p[index[0]]), vec3_sub(p[index[2]], p[index[0]]));
    Face face = {.cutter = cutter,
                 .light = light,
                 .chunk = chunk,
                 .triangle = (uint32_t)triangle,
                 .area = 0.5f * vec3_length(normal)};
    if (!(face.area > 0.0f))
        return AMB_OK;
    const Hit hit = hit_of(&face, 1.0f / 3.0f, 1.0f / 3.0f);
    const SurfacePoint middle = scene_surface(scene, &hit);
    if (middle.material->surface != AMB_SURFACE_DIELECTRIC)
        return AMB_OK;
    const Vec3 to_light = light->kind == AMB_LIGHT_SUN ? vec3_negate(light->direction)
                                                       : vec3_sub(light->position, middle.p);
    if (!(vec3_dot(to_light, middle.ng) > 0.0f))
        return AMB_OK;
    face.ng = middle.ng;
    face.color = rgb_mul(light->color, middle.material->transmit_color);
    const Corner corners[3] = {make_corner(&face, 0.0f, 0.0f), make_corner(&face, 1.0f, 0.0f),
                               make_corner(&face, 0.0f, 1.0f)};
    return cut(&face, corners, 0, 0);
}

static AmbStatus cut_chunk(void *user, uint64_t begin, uint64_t end, uint32_t thread) {
    (void)thread;
    const Cutter *cutter = user;
    const SceneObject *object = &cutter->scene->objects[cutter->object];
    const uint64_t triangle_count = cutter->scene->meshes[object->mesh].triangle_count;
    for (uint64_t c = begin; c < end; ++c) {
        const SceneLight *light = &cutter->scene->lights[c / cutter->triangle_chunks];
        if (!(rgb_max(light->color) > 0.0f))
            continue;
        const uint64_t first = c % cutter->triangle_chunks * GRAIN;
        for (uint64_t i = first; i < first + GRAIN && i < triangle_count; ++i)
            AMB_TRY(cut_triangle(cutter, light, i, &cutter->chunks[c]));
    }
    return AMB_OK;
}

/* Joins the chunks in the order of lights and triangles. */
static AmbStatus join_chunks(const Cutter *cutter, uint64_t chunk_count, TubeCount *count,
                             Tube **out_tubes, uint64_t *out_count) {
    uint64_t total = 0;
    for (uint64_t c = 0; c < chunk_count; ++c)
        total += cutter->chunks[c].count;
    Tube *tubes = memory_alloc_array(total, sizeof *tubes);
    if (tubes == NULL)
        return status_fail(AMB_OUT_OF_MEMORY, "no memory for %llu light tubes",
                           (unsigned long long)total);
    *out_tubes = tubes;
    *out_count = total;
    for (uint64_t c = 0; c < chunk_count; ++c) {
        const Chunk *chunk = &cutter->chunks[c];
        if (chunk->count > 0)
            memcpy(tubes, chunk->tubes, chunk->count * sizeof *tubes);
        tubes += chunk->count;
        count->leak_count += chunk->tally.leak_count;
        for (int k = 0; k < 3; ++k) {
            count->tally.incident[k] += chunk->tally.tally.incident[k];
            count->tally.entered[k] += chunk->tally.tally.entered[k];
            count->tally.interacting[k] += chunk->tally.tally.interacting[k];
        }
    }
    return AMB_OK;
}

AmbStatus tubes_build(const AmbScene *scene, uint32_t object, const TubeParams *params, Job *job,
                      TubeCount *count, TubeField *out_tubes) {
    memset(out_tubes, 0, sizeof *out_tubes);
    const SceneObject *body = &scene->objects[object];
    const uint64_t triangles = scene->meshes[body->mesh].triangle_count;
    Cutter cutter = {.scene = scene,
                     .params = params,
                     .job = job,
                     .triangle_chunks = triangles / GRAIN + 1,
                     .object = object};
    const uint64_t chunk_count = cutter.triangle_chunks * scene->light_count;
    cutter.chunks = memory_zero_array(chunk_count, sizeof(Chunk));
    if (cutter.chunks == NULL)
        return status_fail(AMB_OUT_OF_MEMORY, "no memory for light tubes");
    AmbStatus status = parallel_for(job, chunk_count, 1, cut_chunk, &cutter);
    Tube *tubes = NULL;
    uint64_t tube_count = 0;
    if (status == AMB_OK)
        status = join_chunks(&cutter, chunk_count, count, &tubes, &tube_count);
    for (uint64_t c = 0; c < chunk_count; ++c)
        memory_free(cutter.chunks[c].tubes);
    memory_free(cutter.chunks);
    if (status == AMB_OK && tube_count > 0)
        status =
            tube_tree_build(tubes, tube_count, body->center, body->radius, job, &out_tubes->tree);
    memory_free(tubes);
    if (status == AMB_OK) {
        out_tubes->tube_count = tube_count;
        out_tubes->medium = scene->materials[body->inside].medium;
    }
    return status;
}

void tubes_clear(TubeField *tubes) {
    tube_tree_clear(&tubes->tree);
    memset(tubes, 0, sizeof *tubes);
}

uint64_t tubes_bytes(const TubeField *tubes) {
    return tubes->tree.node_count * sizeof(TubeNode) + tubes->tree.block_count * sizeof(TubeBlock);
}

FieldRadiance tubes_gather(const TubeField *tubes, Vec3 o, Vec3 d, float length) {
    return tube_gather_select()(&tubes->tree, &tubes->medium, o, d, length);
}
