/* SPDX-License-Identifier: GPL-3.0-or-later
 * The lit boundary as cells to search. */
#include "field/specular/specular.h"

#include <string.h>

#include "base/memory.h"
#include "field/specular/specular_face.h"

enum {
    GRAIN = 256,  /* triangles of one unit of work */
    LEVEL_MAX = 8 /* halvings at most of a triangle that is too large for what happens in it */
};

/* Cells are smaller than this part of their object's radius, and their refracted directions differ
 * by less than this angle (rad): so that the six points at which a cell's light is looked at tell
 * its bounds. Meshes with rounded shapes are finer anyway; this is for cubes and slabs. */
static const double SIZE_SHARE_MAX = 0.25;
static const double ANGLE_MAX = 0.2;
/* Towards total reflection (an index below 1) the refracted direction turns faster and faster: a
 * quarter of that angle where its cosine to the normal is less than this. */
static const double TOTAL_COS = 0.3;
/* A spot's cone is covered by some cells across. */
static const double SPOT_SHARE_MAX = 0.25;
/* Bounds from six points count so much more: cubic terms. */
static const float BOUND_SAFETY = 1.25f;
/* Visibility is asked for beside a corner, towards the cell's middle by this part: exactly at a
 * corner of the mesh, rays from a triangle graze its neighbours. */
static const double CORNER_SHRINK = 1e-3;

typedef struct Chunk {
    SpecularCell *cells;
    uint64_t count, room;
    SpecularCount tally;
} Chunk;

typedef struct Cutter {
    const AmbScene *scene;
    Job *job;
    Chunk *chunks;
    uint64_t triangle_chunks; /* chunks of one light */
    uint32_t object;
    bool adjoint_normals;
} Cutter;

/* One triangle under one light. */
typedef struct Task {
    const Cutter *cutter;
    Chunk *chunk;
    SpecularFace face;
    const SceneMaterial *material;
    uint32_t triangle, light;
} Task;

/* Corners 0, 1, 2 and the middles of the edges 01, 12, 20. */
typedef struct Six {
    double u[6], v[6];
    SpecularLine lines[6];
} Six;

static AmbStatus chunk_append(Chunk *chunk, const SpecularCell *cell) {
    if (chunk->count == chunk->room) {
        const uint64_t room = chunk->room > 0 ? 2 * chunk->room : GRAIN;
        SpecularCell *cells = memory_alloc_array(room, sizeof *cells);
        if (cells == NULL)
            return status_fail(AMB_OUT_OF_MEMORY, "no memory for lit triangles");
        if (chunk->count > 0)
            memcpy(cells, chunk->cells, chunk->count * sizeof *cells);
        memory_free(chunk->cells);
        chunk->cells = cells;
        chunk->room = room;
    }
    chunk->cells[chunk->count++] = *cell;
    return AMB_OK;
}

static Six six_of(const SpecularFace *face, const double u[3], const double v[3]) {
    Six six;
    for (int k = 0; k < 3; ++k) {
        six.u[k] = u[k];
        six.v[k] = v[k];
        six.u[3 + k] = 0.5 * (u[k] + u[(k + 1) % 3]);
        six.v[3 + k] = 0.5 * (v[k] + v[(k + 1) % 3]);
    }
    for (int k = 0; k < 6; ++k)
        six.lines[k] = specular_line(face, six.u[k], six.v[k]);
    return six;
}

/* Whether a spot's cone may fall between the corners. */
static bool misses_spot(const SpecularFace *face, const Six *six, double size) {
    const SceneLight *light = face->light;
    if (light->kind != AMB_LIGHT_SPOT)
        return false;
    const Vec3d p = six->lines[3].p;
    const Vec3d to = vec3d_sub(p, face->to_light);
    const double distance = vec3d_length(to);
    const double outer = 2.0 * asin(sqrt(0.5 * (double)light->spot_cap));
    const double cosine = vec3d_dot(to, vec3d_from(light->direction)) / distance;
    const double angle = acos(fmin(fmax(cosine, -1.0), 1.0));
    const double half = size < distance ? asin(size / distance) : (double)AMB_PI;
    return half > SPOT_SHARE_MAX * outer && angle < outer + half;
}

/* Whether no light enters. */
static bool is_total(const Six *six) {
    for (int k = 0; k < 6; ++k)
        if (!six->lines[k].is_total)
            return false;
    return true;
}

static bool is_coarse(const Task *task, const Six *six) {
    const Cutter *cutter = task->cutter;
    double size = 0.0, turn = 0.0, least_cos = 1.0;
    for (int k = 0; k < 3; ++k) {
        const int next = (k + 1) % 3;
        size = fmax(size, vec3d_length(vec3d_sub(six->lines[k].p, six->lines[next].p)));
        turn = fmax(turn, vec3d_length(vec3d_sub(six->lines[k].w, six->lines[next].w)));
        turn = fmax(turn, vec3d_length(vec3d_sub(six->lines[k].w, six->lines[3 + k].w)));
    }
    for (int k = 0; k < 6; ++k)
        least_cos = fmin(least_cos, six->lines[k].cos_t);
    double turn_max = task->face.eta > 1.0 && least_cos < TOTAL_COS ? 0.25 * ANGLE_MAX : ANGLE_MAX;
    if (is_total(six))
        turn_max = INFINITY;
    const double radius = (double)cutter->scene->objects[cutter->object].radius;
    return size > SIZE_SHARE_MAX * radius || turn > turn_max || misses_spot(&task->face, six, size);
}

static LineBound bound_of(const Six *six) {
    Vec3d center = {0, 0, 0}, w = {0, 0, 0};
    double radius = 0.0, spread = 0.0;
    for (int k = 0; k < 3; ++k)
        center = vec3d_madd(center, 1.0 / 3.0, six->lines[k].p);
    for (int k = 0; k < 6; ++k)
        w = vec3d_madd(w, 1.0 / 6.0, six->lines[k].w);
    for (int k = 0; k < 3; ++k)
        radius = fmax(radius, vec3d_length(vec3d_sub(six->lines[k].p, center)));
    for (int k = 0; k < 6; ++k)
        spread = fmax(spread, vec3d_length(vec3d_sub(six->lines[k].w, w)));
    return (LineBound){.center = vec3d_round(center),
                       .radius = (float)radius * 1.00001f,
                       .w = vec3d_round(w),
                       .spread = (float)spread * BOUND_SAFETY + 1e-6f};
}

static void tally_add(double sum[3], Rgb color, double flux) {
    sum[0] += flux * (double)color.r;
    sum[1] += flux * (double)color.g;
    sum[2] += flux * (double)color.b;
}

/* Flux by the values at the middles of edges, which is exact for parabolas; visibility and the way
 * through the medium from the corners. Neither is used for the image. */
static void tally_cell(Task *task, const Six *six, double area, const bool is_lit[3],
                       const float reach[3]) {
    const AmbScene *scene = task->cutter->scene;
    const Medium *medium = &scene->materials[scene->objects[task->cutter->object].inside].medium;
    LightTally *tally = &task->chunk->tally.tally;
    double arriving = 0.0, entering = 0.0;
    for (int k = 3; k < 6; ++k) {
        arriving += area / 3.0 * specular_arriving(&task->face, &six->lines[k]);
        entering += area / 3.0 * specular_entering(&task->face, &six->lines[k]);
    }
    for (int k = 0; k < 3; ++k) {
        if (!is_lit[k])
            continue;
        const Rgb left = medium_transmittance(medium, reach[k]);
        tally_add(tally->incident, task->face.light->color, arriving / 3.0);
        tally_add(tally->entered, task->face.color, entering / 3.0);
        tally_add(tally->interacting,
                  rgb_mul(task->face.color, rgb(1.0f - left.r, 1.0f - left.g, 1.0f - left.b)),
                  entering / 3.0);
    }
}

/* Whether light reaches the cell beside a corner, and how far it goes on. */
static bool trace_corner(Task *task, const Six *six, int corner, float *out_reach) {
    const AmbScene *scene = task->cutter->scene;
    const double u = six->u[corner] +
                     CORNER_SHRINK * ((six->u[0] + six->u[1] + six->u[2]) / 3.0 - six->u[corner]);
    const double v = six->v[corner] +
                     CORNER_SHRINK * ((six->v[0] + six->v[1] + six->v[2]) / 3.0 - six->v[corner]);
    const SurfacePoint surface = scene_surface(
        scene, &(Hit){0.0f, (float)u, (float)v, task->cutter->object, task->triangle});
    const LightArrival light = light_arrival(task->face.light, surface.p, (Sample2){0.5f, 0.5f});
    const bool is_lit =
        !scene_is_occluded(scene, scene_leave(&surface, light.wi), light.wi, light.distance);
    const Vec3 w = vec3d_round(six->lines[corner].w);
    Hit exit;
    *out_reach = INFINITY;
    if (scene_intersect(scene, scene_leave(&surface, w), w, INFINITY, &exit))
        *out_reach = exit.t;
    else if (is_lit && specular_entering(&task->face, &six->lines[corner]) > 0.0)
        scene_leaks_add(&task->chunk->tally.leaks, 1, task->cutter->object);
    return is_lit;
}

static AmbStatus emit_cell(Task *task, const Six *six, double area) {
    SpecularCell cell = {.bound = bound_of(six),
                         .reach = INFINITY,
                         .material = task->material,
                         .triangle = task->triangle,
                         .light = task->light};
    bool is_lit[3];
    float reach[3];
    for (int k = 0; k < 3; ++k) {
        cell.w[k] = six->lines[k].w;
        const Vec3d mean = vec3d_scale(vec3d_add(cell.w[k], six->lines[(k + 1) % 3].w), 0.5);
        cell.bend[k] = vec3d_round(vec3d_sub(six->lines[3 + k].w, mean));
        cell.corners[k][0] = (float)six->u[k]; /* multiples of 2^-LEVEL_MAX: exact */
        cell.corners[k][1] = (float)six->v[k];
        is_lit[k] = trace_corner(task, six, k, &reach[k]);
        cell.reach = fminf(cell.reach, reach[k]);
        cell.lit_corners += is_lit[k];
    }
    tally_cell(task, six, area, is_lit, reach);
    if (is_total(six))
        return AMB_OK;
    return chunk_append(task->chunk, &cell);
}

static AmbStatus cut(Task *task, const double u[3], const double v[3], int level) {
    if (job_is_cancelled(task->cutter->job))
        return AMB_CANCELLED;
    const Six six = six_of(&task->face, u, v);
    if (level == LEVEL_MAX || !is_coarse(task, &six))
        return emit_cell(task, &six, ldexp(task->face.area, -2 * level));
    for (int k = 0; k < 3; ++k) {
        const int before = 3 + (k + 2) % 3;
        const double part_u[3] = {u[k], six.u[3 + k], six.u[before]};
        const double part_v[3] = {v[k], six.v[3 + k], six.v[before]};
        AMB_TRY(cut(task, part_u, part_v, level + 1));
    }
    return cut(task, six.u + 3, six.v + 3, level + 1);
}

/* Larger than 0 where the face is turned to the light. */
static double facing(const SpecularFace *face) {
    const bool is_sun = face->light->kind == AMB_LIGHT_SUN;
    const Vec3d to_light = is_sun ? face->to_light : vec3d_sub(face->to_light, face->p);
    return vec3d_dot(to_light, face->ng);
}

static AmbStatus cut_triangle(const Cutter *cutter, uint32_t light, uint32_t triangle,
                              Chunk *chunk) {
    const AmbScene *scene = cutter->scene;
    const SceneLight *lamp = &scene->lights[light];
    const SurfacePoint middle =
        scene_surface(scene, &(Hit){0.0f, 1.0f / 3.0f, 1.0f / 3.0f, cutter->object, triangle});
    if (middle.material->surface != AMB_SURFACE_DIELECTRIC)
        return AMB_OK;
    Task task = {.cutter = cutter,
                 .chunk = chunk,
                 .face = specular_face_places(scene, cutter->object, triangle),
                 .material = middle.material,
                 .triangle = triangle,
                 .light = light};
    specular_face_light(scene, cutter->object, triangle, middle.material, lamp,
                        cutter->adjoint_normals, &task.face);
    if (!(task.face.area > 0.0) || !(facing(&task.face) > 0.0))
        return AMB_OK;
    static const double u[3] = {0.0, 1.0, 0.0}, v[3] = {0.0, 0.0, 1.0};
    return cut(&task, u, v, 0);
}

static AmbStatus cut_chunk(void *user, uint64_t begin, uint64_t end, uint32_t thread) {
    (void)thread;
    const Cutter *cutter = user;
    const SceneObject *object = &cutter->scene->objects[cutter->object];
    const uint64_t triangle_count = cutter->scene->meshes[object->mesh].triangle_count;
    for (uint64_t c = begin; c < end; ++c) {
        const uint32_t light = (uint32_t)(c / cutter->triangle_chunks);
        if (!(rgb_max(cutter->scene->lights[light].color) > 0.0f))
            continue;
        const uint64_t first = c % cutter->triangle_chunks * GRAIN;
        for (uint64_t i = first; i < first + GRAIN && i < triangle_count; ++i)
            AMB_TRY(cut_triangle(cutter, light, (uint32_t)i, &cutter->chunks[c]));
    }
    return AMB_OK;
}

/* Joins the chunks in the order of lights and triangles. */
static AmbStatus join_chunks(const Cutter *cutter, uint64_t chunk_count, SpecularCount *count,
                             SpecularCell **out_cells, uint64_t *out_count) {
    uint64_t total = 0;
    for (uint64_t c = 0; c < chunk_count; ++c)
        total += cutter->chunks[c].count;
    SpecularCell *cells = memory_alloc_array(total, sizeof *cells);
    if (cells == NULL)
        return status_fail(AMB_OUT_OF_MEMORY, "no memory for %llu lit triangles",
                           (unsigned long long)total);
    *out_cells = cells;
    *out_count = total;
    for (uint64_t c = 0; c < chunk_count; ++c) {
        const Chunk *chunk = &cutter->chunks[c];
        if (chunk->count > 0)
            memcpy(cells, chunk->cells, chunk->count * sizeof *cells);
        cells += chunk->count;
        scene_leaks_add(&count->leaks, chunk->tally.leaks.count, chunk->tally.leaks.object);
        for (int k = 0; k < 3; ++k) {
            count->tally.incident[k] += chunk->tally.tally.incident[k];
            count->tally.entered[k] += chunk->tally.tally.entered[k];
            count->tally.interacting[k] += chunk->tally.tally.interacting[k];
        }
    }
    return AMB_OK;
}

AmbStatus specular_build(const AmbScene *scene, uint32_t object, bool adjoint_normals, Job *job,
                         SpecularCount *count, SpecularField *out_field) {
    memset(out_field, 0, sizeof *out_field);
    const SceneObject *body = &scene->objects[object];
    const uint64_t triangles = scene->meshes[body->mesh].triangle_count;
    Cutter cutter = {.scene = scene,
                     .job = job,
                     .triangle_chunks = triangles / GRAIN + 1,
                     .object = object,
                     .adjoint_normals = adjoint_normals};
    const uint64_t chunk_count = cutter.triangle_chunks * scene->light_count;
    cutter.chunks = memory_zero_array(chunk_count, sizeof(Chunk));
    if (cutter.chunks == NULL)
        return status_fail(AMB_OUT_OF_MEMORY, "no memory for lit triangles");
    AmbStatus status = parallel_for(job, chunk_count, 1, cut_chunk, &cutter);
    SpecularCell *cells = NULL;
    uint64_t cell_count = 0;
    if (status == AMB_OK)
        status = join_chunks(&cutter, chunk_count, count, &cells, &cell_count);
    for (uint64_t c = 0; c < chunk_count; ++c)
        memory_free(cutter.chunks[c].cells);
    memory_free(cutter.chunks);
    AMB_TRY(status);
    AMB_TRY(specular_tree_build(cells, cell_count, body->radius, job, &out_field->tree));
    out_field->scene = scene;
    out_field->object = object;
    out_field->adjoint_normals = adjoint_normals;
    return AMB_OK;
}

void specular_clear(SpecularField *field) {
    specular_tree_clear(&field->tree);
    memset(field, 0, sizeof *field);
}

uint64_t specular_bytes(const SpecularField *field) {
    return field->tree.node_count * sizeof(SpecularNode) +
           field->tree.cell_count * sizeof(SpecularCell);
}
