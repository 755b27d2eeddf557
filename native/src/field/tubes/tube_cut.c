/* SPDX-License-Identifier: GPL-3.0-or-later
 * Light that enters the boundary, cut into tubes. */
#include "field/tubes/tube_cut.h"

#include <string.h>

#include "base/memory.h"
#include "scene/boundary.h"

enum {
    COARSE_HALVINGS = 16, /* at most of the area of a triangle too large for what happens in it */
    NEAR_HALVINGS = 40,   /* the same where a lamp is next to it */
    GAP_SURFACE_MAX = 8,  /* other things between leaving an object and coming back */
    EDGE_LEVELS = 3       /* further quarterings where a shadow or a jump of the exit cuts a tube,
                           * one less for each refinement below 0 */
};

/* A spot's cone is covered by at least some tubes across, however large the triangle. */
static const float SPOT_SHARE_MAX = 0.25f;
/* Longest edge to height: pieces that are longer are halved across, not quartered alike, which for
 * a sliver next to a lamp would take as many more. */
static const float ASPECT_MAX = 8.0f;
/* What a tube does wrong is its light times how far that is from linear, and scanned meshes have
 * many small faces whose normals lie far apart. A piece with less than this share of the light that
 * reaches its object may spread it wider, as the root of the share (what is not linear grows as the
 * square of its width), */
static const float WIDE_SHARE = 0x1p-16f;
/* be more bent, */
static const float BENT_SHARE = 0x1p-20f;
/* and is not cut by the edge of a shadow. Every refinement quarters all three. */
static const float EDGE_SHARE = 0x1p-24f;
static const float SHARE_TINY = 1e-20f; /* that of no light at all */
/* A tube's blur is larger than at its corners by no more than this. */
static const float BLUR_SLACK = 1.2f;
/* Free limits are this much beyond the surface, for what curves between corners. */
static const float FREE_ROOM = 1.1f;
/* Ends whose distances differ by more than this factor are on different surfaces. */
static const float LIMIT_RATIO_MAX = 1.2f;
/* In radii of the object: farther than anything in it. */
static const float LIMIT_MAX = 4.0f;
/* Visibility and exit are asked for beside a corner, towards the triangle's middle by this part:
 * exactly at a corner of the mesh, rays from a triangle graze its neighbours. */
static const float CORNER_SHRINK = 1e-3f;

static AmbStatus chunk_grow(TubeChunk *chunk) {
    const uint64_t room = chunk->room > 0 ? 2 * chunk->room : TUBE_CHUNK_TRIANGLES;
    CutTube *tubes = memory_alloc_array(room, sizeof *tubes);
    if (tubes == NULL)
        return status_fail(AMB_OUT_OF_MEMORY, "no memory for light tubes");
    if (chunk->count > 0)
        memcpy(tubes, chunk->tubes, chunk->count * sizeof *tubes);
    memory_free(chunk->tubes);
    chunk->tubes = tubes;
    chunk->room = room;
    return AMB_OK;
}

AmbStatus tube_chunk_append(TubeChunk *chunk, const CutTube *tube) {
    if (chunk->count == chunk->room)
        AMB_TRY(chunk_grow(chunk));
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
static float light_limit(const Face *face, Vec3 p, Vec3 w, const Hit *exit, bool *out_is_free) {
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
    *out_is_free = true;
    return LIMIT_MAX * scene->objects[object].radius;
}

void tube_limits(const LineEnd *const ends[3], float out[3]) {
    float least = INFINITY;
    for (int k = 0; k < 3; ++k)
        least = ends[k]->is_free ? least : fminf(least, ends[k]->limit);
    for (int k = 0; k < 3; ++k)
        out[k] = ends[k]->is_free && least < INFINITY ? fmaxf(least, FREE_ROOM * ends[k]->reach)
                                                      : ends[k]->limit;
}

LineEnd tube_line_end(const Face *face, Vec3 from, Vec3 w) {
    LineEnd end = {.is_there = false, .is_free = false};
    const AmbScene *scene = face->cutter->scene;
    if (scene_intersect(scene, from, w, INFINITY, &end.exit)) {
        end.is_there = true;
        end.reach = end.exit.t;
        end.limit = light_limit(face, from, w, &end.exit, &end.is_free);
    } else {
        end.reach = scene_end(scene, from);
        end.limit = fmaxf(end.reach, LIMIT_MAX * scene->objects[face->cutter->object].radius);
    }
    return end;
}

/* Where the light ends from just inside, and whether it is seen from just outside. */
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
    corner->end = tube_line_end(face, scene_leave(&surface, corner->w), corner->w);
    if (!corner->end.is_there && corner->is_lit)
        scene_leaks_add(&face->chunk->tally.leaks, 1, face->cutter->object);
}

/* Light and its refraction at a point of a triangle. */
typedef struct Entry {
    SurfacePoint surface;
    Vec3 x; /* world, the same for neighbours */
    LightArrival light;
    DielectricSplit split;
    Vec3 w;     /* unit, refracted */
    float blur; /* how far w moves over half of the source, both axes together */
} Entry;

/* Derivative of w by where the source is: of refraction, as in optics/tangent.h at a fixed point.
 */
static float blur_at(const Face *face, const Entry *entry, Vec3 n, float eta) {
    float sum = 0.0f;
    for (int k = 0; k < 2; ++k) {
        const Vec3 extent = face->source->extent[k], wi = entry->light.wi;
        Vec3 dd = extent;
        if (face->light->kind != AMB_LIGHT_SUN)
            dd = vec3_scale(vec3_madd(extent, -vec3_dot(extent, wi), wi),
                            -1.0f / entry->light.distance);
        const float dc = -vec3_dot(dd, n);
        const float bend = entry->split.cos_t > 0.0f
                               ? eta - eta * eta * entry->split.cos_i / entry->split.cos_t
                               : 0.0f;
        const Vec3 dw = vec3_madd(vec3_scale(dd, eta), bend * dc, n);
        sum += vec3_dot(dw, dw);
    }
    return sqrtf(sum);
}

static Entry enter_at(const Face *face, float u, float v) {
    const Hit hit = hit_of(face, u, v);
    const AmbScene *scene = face->cutter->scene;
    Entry entry = {.surface = scene_surface(scene, &hit), .x = scene_position(scene, &hit)};
    entry.light = light_arrival(face->light, entry.x, (Sample2){0.5f, 0.5f});
    const Vec3 wi = entry.light.wi, d = vec3_negate(wi);
    Vec3 n = entry.surface.ns;
    const float cos_s = vec3_dot(wi, n);
    if (cos_s < TUBE_GRAZING_COS)
        n = vec3_normalize(vec3_madd(n, TUBE_GRAZING_COS - cos_s, wi));
    entry.split = dielectric_split(d, n, 1.0f / entry.surface.material->ior);
    entry.w = entry.split.reflectance < 1.0f ? entry.split.refracted : d;
    entry.blur = blur_at(face, &entry, n, 1.0f / entry.surface.material->ior);
    return entry;
}

Corner tube_corner(const Face *face, float u, float v) {
    const Entry entry = enter_at(face, u, v);
    const Vec3 ng = entry.surface.ng;
    const DielectricSplit *split = &entry.split;
    Corner corner = {.u = u, .v = v, .x = entry.x, .w = entry.w, .blur = entry.blur};
    const float cos_g = vec3_dot(entry.light.wi, ng), below = -vec3_dot(corner.w, ng);
    const float irradiance = scale_of(entry.light.irradiance, face->light->color);
    corner.arriving = irradiance * fmaxf(cos_g, 0.0f);
    if (below > 0.0f && cos_g > 0.0f && split->reflectance < 1.0f) {
        const float entering = irradiance * (1.0f - split->reflectance);
        if (face->cutter->params->adjoint_normals) {
            corner.value = entering * split->cos_i / split->cos_t;
            corner.flux = corner.value * below;
        } else {
            corner.value =
                face->light->kind == AMB_LIGHT_SUN ? entering : entering / entry.light.distance;
            corner.flux = entering * cos_g;
        }
    }
    trace_corner(face, &corner);
    return corner;
}

/* See Tube. */
static float bulge_of(const Face *face, const Corner corners[3]) {
    float largest = 0.0f;
    for (int k = 0; k < 3; ++k) {
        const Corner *a = &corners[k], *b = &corners[(k + 1) % 3];
        const Entry middle = enter_at(face, 0.5f * (a->u + b->u), 0.5f * (a->v + b->v));
        const Vec3 mean = vec3_scale(vec3_add(a->w, b->w), 0.5f);
        largest = fmaxf(largest, vec3_length(vec3_sub(middle.w, mean)));
    }
    /* Quadratic over the triangle, it is 4/3 of that in the middle. */
    return (4.0f / 3.0f) * largest;
}

float tube_largest_difference(const Vec3 v[3]) {
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
    const float outer = 2.0f * asinf(sqrtf(0.5f * light->spot_cap));
    /* Not by acos, which does not know angles below a milliradian. */
    const Vec3 aside = vec3_sub(vec3_scale(to, 1.0f / distance), light->direction);
    const float angle = 2.0f * asinf(fminf(0.5f * vec3_length(aside), 1.0f));
    const float half = size < distance ? asinf(size / distance) : AMB_PI;
    return half > SPOT_SHARE_MAX * outer && angle < outer + half;
}

/* How far above the plane of the corners the lamp is, m. */
static float lamp_height(const Face *face, const Corner corners[3]) {
    const Vec3 a = corners[0].x;
    const Vec3 n = vec3_cross(vec3_sub(corners[1].x, a), vec3_sub(corners[2].x, a));
    const float length = vec3_length(n);
    const float height = vec3_dot(vec3_sub(face->light->position, a), n);
    return length > 0.0f ? fabsf(height) / length : 0.0f;
}

/* A piece's part of the light that reaches the object, in units of what a refinement makes of it; 0
 * in darkness, whose directions are nothing to be fine about; infinite: not known. */
static float light_share(const Face *face, const Corner corners[3], float area) {
    const float reaching = face->source->flux;
    if (!corners[0].is_lit && !corners[1].is_lit && !corners[2].is_lit)
        return 0.0f;
    if (!(reaching > 0.0f))
        return INFINITY;
    const float flux = fmaxf(fmaxf(corners[0].flux, corners[1].flux), corners[2].flux);
    return area * flux / reaching * ldexpf(1.0f, 2 * face->cutter->params->refinement);
}

static bool is_coarse(const Face *face, const Corner corners[3], float area) {
    const Cutter *cutter = face->cutter;
    const float share = ldexpf(1.0f, -cutter->params->refinement);
    const float radius = cutter->scene->objects[cutter->object].radius;
    const Vec3 x[3] = {corners[0].x, corners[1].x, corners[2].x};
    const Vec3 w[3] = {corners[0].w, corners[1].w, corners[2].w};
    const float size = tube_largest_difference(x), angle = tube_largest_difference(w);
    const float ease2 =
        fmaxf(WIDE_SHARE / fmaxf(light_share(face, corners, area), SHARE_TINY), 1.0f);
    /* What flat faces refract is linear however large they are; what leaves them is not. */
    return size > TUBE_SIZE_SHARE_MAX * fminf(share, 1.0f) * radius ||
           angle > TUBE_ANGLE_MAX * share * sqrtf(ease2) || misses_spot(face, corners, size);
}

/* Whether a lamp is so near that its light differs too much between the corners, or its cone so
 * narrow that it falls between them: cut as often as it takes, for that is around one place. */
static bool is_near_lamp(const Face *face, const Corner corners[3]) {
    if (face->light->kind == AMB_LIGHT_SUN)
        return false;
    const Vec3 x[3] = {corners[0].x, corners[1].x, corners[2].x};
    if (misses_spot(face, corners, tube_largest_difference(x)))
        return true;
    const float share = ldexpf(1.0f, -face->cutter->params->refinement);
    float distance = INFINITY;
    for (int k = 0; k < 3; ++k)
        distance = fminf(distance, vec3_length(vec3_sub(x[k], face->light->position)));
    const float size = tube_largest_difference(x);
    /* From outside, the lamp's foot may be in the middle. */
    return size > TUBE_ANGLE_MAX * share * fmaxf(distance - size, lamp_height(face, corners));
}

/* Whether the edge of a shadow or of a gap runs between the corners. */
static bool is_cut(const Corner corners[3]) {
    if (corners[0].is_lit != corners[1].is_lit || corners[1].is_lit != corners[2].is_lit)
        return true;
    float limits[3];
    tube_limits((const LineEnd *[3]){&corners[0].end, &corners[1].end, &corners[2].end}, limits);
    const float low = fminf(fminf(limits[0], limits[1]), limits[2]);
    const float high = fmaxf(fmaxf(limits[0], limits[1]), limits[2]);
    return corners[0].is_lit && high > LIMIT_RATIO_MAX * low;
}

void tube_tally_add(double sum[3], Rgb color, double flux) {
    sum[0] += flux * (double)color.r;
    sum[1] += flux * (double)color.g;
    sum[2] += flux * (double)color.b;
}

static AmbStatus emit_tube(const Face *face, const Corner corners[3], float area) {
    const Cutter *cutter = face->cutter;
    const SceneObject *object = &cutter->scene->objects[cutter->object];
    const Medium *medium = &cutter->scene->materials[object->inside].medium;
    CutTube cut_tube = {.material = face->material};
    Tube *tube = &cut_tube.tube;
    LightTally *tally = &face->chunk->tally.tally;
    bool is_bright = false;
    tube_limits((const LineEnd *[3]){&corners[0].end, &corners[1].end, &corners[2].end},
                tube->limit);
    for (int k = 0; k < 3; ++k) {
        const Corner *corner = &corners[k];
        const float lit = corner->is_lit ? area : 0.0f, flux = lit * corner->flux;
        tube->x[k] = vec3_sub(corner->x, object->center);
        tube->w[k] = corner->w;
        tube->far = fmaxf(tube->far, corner->end.reach);
        tube->blur = fmaxf(tube->blur, BLUR_SLACK * corner->blur);
        tube->value[k] = !corner->is_lit                   ? 0.0f
                         : cutter->params->adjoint_normals ? sqrtf(corner->value)
                                                           : corner->value;
        is_bright = is_bright || flux > 0.0f;
        const double third = (double)flux / 3.0;
        const Rgb left = medium_transmittance(medium, corner->end.reach);
        tube_tally_add(tally->incident, face->light->color, (double)(lit * corner->arriving) / 3.0);
        tube_tally_add(tally->entered, face->color, third);
        tube_tally_add(tally->interacting,
                       rgb_mul(face->color, rgb(1.0f - left.r, 1.0f - left.g, 1.0f - left.b)),
                       third);
    }
    if (!is_bright)
        return AMB_OK;
    /* Between the corners the light may go farther before it leaves. */
    tube->far = 1.1f * tube->far + tube_largest_difference(tube->x);
    tube->bulge =
        bulge_of(face, corners) * fminf(light_share(face, corners, area) / BENT_SHARE, 1.0f);
    AMB_TRY(tube_chunk_append(face->chunk, &cut_tube));
    return cutter->params->bounces > 0 ? tubes_reflect(face, corners, area) : AMB_OK;
}

static AmbStatus cut(const Face *face, const Corner corners[3], uint32_t halvings, uint32_t edges);

static Corner middle_of(const Face *face, const Corner *a, const Corner *b) {
    return tube_corner(face, 0.5f * (a->u + b->u), 0.5f * (a->v + b->v));
}

static AmbStatus cut_in_four(const Face *face, const Corner corners[3], uint32_t halvings,
                             uint32_t edges) {
    Corner middle[3]; /* of the edges 01, 12, 20 */
    for (int k = 0; k < 3; ++k)
        middle[k] = middle_of(face, &corners[k], &corners[(k + 1) % 3]);
    for (int k = 0; k < 3; ++k) {
        const Corner part[3] = {corners[k], middle[k], middle[(k + 2) % 3]};
        AMB_TRY(cut(face, part, halvings + 2, edges));
    }
    return cut(face, middle, halvings + 2, edges);
}

/* Through the middle of the edge from corner k. */
static AmbStatus cut_across(const Face *face, const Corner corners[3], int k, uint32_t halvings,
                            uint32_t edges) {
    const int next = (k + 1) % 3, last = (k + 2) % 3;
    const Corner middle = middle_of(face, &corners[k], &corners[next]);
    const Corner first[3] = {corners[k], middle, corners[last]};
    const Corner second[3] = {middle, corners[next], corners[last]};
    AMB_TRY(cut(face, first, halvings + 1, edges));
    return cut(face, second, halvings + 1, edges);
}

/* The longest edge, from which corner; -1: it is not long for a piece of that area. */
static int edge_of_sliver(const Corner corners[3], float area) {
    float length[3];
    int longest = 0;
    for (int k = 0; k < 3; ++k) {
        length[k] = vec3_length(vec3_sub(corners[k].x, corners[(k + 1) % 3].x));
        longest = length[k] > length[longest] ? k : longest;
    }
    return length[longest] * length[longest] > 2.0f * ASPECT_MAX * area ? longest : -1;
}

static AmbStatus cut(const Face *face, const Corner corners[3], uint32_t halvings, uint32_t edges) {
    const float area = face->area * ldexpf(1.0f, -(int)halvings);
    const bool is_near =
        halvings >= COARSE_HALVINGS && halvings < NEAR_HALVINGS && is_near_lamp(face, corners);
    const int32_t refinement = face->cutter->params->refinement;
    const int32_t edges_max = refinement < 0 ? EDGE_LEVELS + refinement : EDGE_LEVELS;
    bool divides = (int32_t)halvings < 2 * refinement ||
                   (halvings < COARSE_HALVINGS && is_coarse(face, corners, area)) || is_near;
    const int across = divides ? edge_of_sliver(corners, area) : -1;
    if (!divides && (int32_t)edges < edges_max && is_cut(corners) &&
        light_share(face, corners, area) > EDGE_SHARE) {
        divides = true;
        ++edges;
    }
    if (!divides)
        return emit_tube(face, corners, area);
    if (job_is_cancelled(face->cutter->job))
        return AMB_CANCELLED;
    return across >= 0 ? cut_across(face, corners, across, halvings, edges)
                       : cut_in_four(face, corners, halvings, edges);
}

static AmbStatus cut_triangle(const Cutter *cutter, const TubeSource *source, uint64_t triangle,
                              TubeChunk *chunk) {
    const AmbScene *scene = cutter->scene;
    const SceneObject *object = &scene->objects[cutter->object];
    const uint32_t *index = scene->meshes[object->mesh].triangles + 3 * triangle;
    const Vec3 *p = object->positions;
    const Vec3 normal =
        vec3_cross(vec3_sub(p[index[1]], p[index[0]]), vec3_sub(p[index[2]], p[index[0]]));
    Face face = {.cutter = cutter,
                 .source = source,
                 .light = &source->light,
                 .chunk = chunk,
                 .triangle = (uint32_t)triangle,
                 .area = 0.5f * vec3_length(normal)};
    if (!(face.area > 0.0f))
        return AMB_OK;
    const Hit hit = hit_of(&face, 1.0f / 3.0f, 1.0f / 3.0f);
    const SurfacePoint middle = scene_surface(scene, &hit);
    if (middle.material->surface != AMB_SURFACE_DIELECTRIC)
        return AMB_OK;
    const SceneLight *light = face.light;
    const Vec3 to_light = light->kind == AMB_LIGHT_SUN ? vec3_negate(light->direction)
                                                       : vec3_sub(light->position, middle.p);
    if (!(vec3_dot(to_light, middle.ng) > 0.0f))
        return AMB_OK;
    face.material = (uint32_t)(middle.material - scene->materials);
    face.color = rgb_mul(light->color, middle.material->transmit_color);
    const Corner corners[3] = {tube_corner(&face, 0.0f, 0.0f), tube_corner(&face, 1.0f, 0.0f),
                               tube_corner(&face, 0.0f, 1.0f)};
    return cut(&face, corners, 0, 0);
}

AmbStatus tube_cut_chunks(void *user, uint64_t begin, uint64_t end, uint32_t thread) {
    (void)thread;
    const Cutter *cutter = user;
    const SceneObject *object = &cutter->scene->objects[cutter->object];
    const uint64_t triangle_count = cutter->scene->meshes[object->mesh].triangle_count;
    for (uint64_t c = begin; c < end; ++c) {
        const TubeSource *source = &cutter->sources[c / cutter->triangle_chunks];
        const uint64_t first = c % cutter->triangle_chunks * TUBE_CHUNK_TRIANGLES;
        for (uint64_t i = first; i < first + TUBE_CHUNK_TRIANGLES && i < triangle_count; ++i)
            AMB_TRY(cut_triangle(cutter, source, i, &cutter->chunks[c]));
    }
    return AMB_OK;
}
