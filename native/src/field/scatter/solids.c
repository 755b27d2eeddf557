/* SPDX-License-Identifier: GPL-3.0-or-later
 * Closed opaque objects, by lines. */
#include "field/scatter/solids.h"

#include "base/memory.h"
#include "base/rng.h"
#include "math/sampling.h"

enum {
    CROSSING_MAX = 256, /* surfaces along one line */
    PROBES = 256        /* lines that ask whether an object is closed */
};

/* Whether a line along d comes from inside of the surface's object. */
static bool is_left(const SurfacePoint *wall, Vec3 d) {
    return vec3_dot(d, wall->ng) > 0.0f;
}

/* Whether the line from a surface along d, into its object, comes out of that again. */
static bool comes_out(const AmbScene *scene, const SurfacePoint *from, Vec3 d) {
    Vec3 o = scene_leave(from, d);
    for (int i = 0; i < CROSSING_MAX; ++i) {
        Hit hit;
        if (!scene_intersect(scene, o, d, INFINITY, &hit))
            return false;
        const SurfacePoint surface = scene_surface(scene, &hit);
        if (surface.object == from->object)
            return is_left(&surface, d);
        o = scene_leave(&surface, d);
    }
    return false;
}

/* Whether an object is closed: from a sheet, or a room that can be looked into, some line goes on
 * for ever. One along the axes alone would pass the opening by. */
static bool is_closed(const AmbScene *scene, uint32_t object) {
    const uint64_t count = scene->meshes[scene->objects[object].mesh].triangle_count;
    for (uint32_t i = 0; i < PROBES && count > 0; ++i) {
        const Rng rng = {rng_mix(i + 1)};
        const float root = sqrtf(rng_float(rng, 0)), part = rng_float(rng, 1);
        const Hit hit = {.geometry = object,
                         .triangle = (uint32_t)(rng_mix(rng.key) % count),
                         .u = root * (1.0f - part),
                         .v = root * part};
        const SurfacePoint from = scene_surface(scene, &hit);
        if (!(vec3_dot(from.ng, from.ng) > 0.5f))
            continue; /* without an area */
        Vec3 x, y;
        vec3_frame(from.ng, &x, &y);
        const Sample2 u = {rng_float(rng, 2), rng_float(rng, 3)};
        const Vec3 d = frame_to_world(x, y, from.ng, sample_cosine_hemisphere(u));
        if (!comes_out(scene, &from, vec3_negate(d)))
            return false;
    }
    return count > 0;
}

static bool is_listed(const SolidList *list, uint32_t object) {
    for (uint32_t i = 0; i < list->count; ++i)
        if (list->objects[i] == object)
            return true;
    return false;
}

/* A line leaves those that its beginning is in without having entered. */
static void find_rooms(const AmbScene *scene, Solids *solids) {
    const CameraRay ray = camera_ray(&scene->camera, 0.5f, 0.5f, (Sample2){0.5f, 0.5f});
    SolidList met = {.count = 0};
    Vec3 o = ray.o;
    for (int i = 0; i < CROSSING_MAX && met.count < SOLID_ROOM_MAX; ++i) {
        Hit hit;
        if (!scene_intersect(scene, o, ray.d, INFINITY, &hit))
            return;
        const SurfacePoint wall = scene_surface(scene, &hit);
        o = scene_leave(&wall, ray.d);
        if (!solids->is_solid[wall.object] || is_listed(&met, wall.object))
            continue;
        met.objects[met.count++] = wall.object;
        if (is_left(&wall, ray.d))
            solids->rooms.objects[solids->rooms.count++] = wall.object;
    }
}

AmbStatus solids_find(const AmbScene *scene, uint32_t object, Job *job, Solids *out_solids) {
    *out_solids =
        (Solids){.is_solid = memory_zero_array(scene->object_count, sizeof *out_solids->is_solid)};
    if (out_solids->is_solid == NULL)
        return status_fail(AMB_OUT_OF_MEMORY, "no memory for scattered light");
    for (uint32_t o = 0; o < scene->object_count; ++o) {
        if (job_is_cancelled(job)) {
            solids_clear(out_solids);
            return AMB_CANCELLED;
        }
        const SceneObject *other = &scene->objects[o];
        out_solids->is_solid[o] = !other->is_boundary &&
                                  scene_boxes_meet(other, &scene->objects[object]) &&
                                  is_closed(scene, o);
    }
    find_rooms(scene, out_solids);
    return AMB_OK;
}

void solids_clear(Solids *solids) {
    memory_free(solids->is_solid);
    *solids = (Solids){.is_solid = NULL};
}

SolidsAround solids_around(const AmbScene *scene, const Solids *solids, Vec3 o, Vec3 d) {
    const SolidList *rooms = &solids->rooms;
    SolidsAround around = {.missing = (int)rooms->count};
    SolidList met = {.count = 0};
    for (int i = 0; i < CROSSING_MAX && met.count < rooms->count; ++i) {
        Hit hit;
        if (!scene_intersect(scene, o, d, INFINITY, &hit))
            break;
        const SurfacePoint wall = scene_surface(scene, &hit);
        o = scene_leave(&wall, d);
        if (!is_listed(rooms, wall.object) || is_listed(&met, wall.object))
            continue;
        met.objects[met.count++] = wall.object;
        around.missing -= is_left(&wall, d) ? 1 : 0;
    }
    return around;
}

void solids_pass(const Solids *solids, const SurfacePoint *wall, Vec3 d, SolidsAround *around) {
    const int change = is_left(wall, d) ? -1 : 1;
    if (is_listed(&solids->rooms, wall->object))
        around->missing -= change;
    else if (solids->is_solid[wall->object])
        around->hiding = around->hiding + change > 0 ? around->hiding + change : 0;
}
