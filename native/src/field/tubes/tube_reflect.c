/* SPDX-License-Identifier: GPL-3.0-or-later
 * Tubes of light that the walls reflect back inside. Their corners are where light lines of a piece
 * of the boundary end on the wall, traced one by one from that piece through all reflections so
 * far; their values are the watts of the whole piece, which no fold of the light on the wall can
 * make large. See docs/theory.md 6. */
#include "field/tubes/tube_cut.h"
#include "scene/boundary.h"

enum {
    BOUNCE_MAX = 64, /* a guard against light that total reflection never lets out */
    DEPTH_MAX = 4    /* halvings at most of a piece for the sake of one reflection */
};

/* Reflected light is mostly a small share of the light. Where it is, pieces may be larger, by the
 * root of that share, since what is not linear in them grows as their area; up to this factor. */
static const float EASE_MAX = 4.0f;
/* Corners whose exits differ more than this from what the walls' slopes allow (cosine to a wall's
 * normal of the line between them) lie on different parts of the wall. */
static const float STEP_COS_MAX = 0.5f;
/* What differs by more than this part of what it should after so many halvings jumps. */
static const float SMOOTH_FACTOR = 2.0f;
/* As in light_trace.c, and for the reasons given there. */
static const float GRAZING_COS = 1e-4f, FLUX_MIN = 1e-6f;
/* A tangent plane is taken to be met at no flatter angle than this (cosine): what is cut through by
 * a jump is not drawn out along it. */
static const float PLANE_COS_MIN = 0.1f;
/* And its normals and directions differ by no more than this. */
static const float TURN_MAX = 0.25f;

/* A straight stretch of light inside the object. */
typedef struct Stretch {
    Vec3 x, w;   /* m, world; from the wall along unit w */
    float start; /* m, inside before x */
    float flux;  /* W m^-2 per area of the face's triangle and unit colour, without absorption */
    Rgb tint;    /* product of the walls' colours */
    LineEnd end;
    Vec3 n, ng;     /* of the wall at x, unit, inwards: shading and geometric */
    bool goes_here; /* false: the wall at the end of the stretch before does not reflect */
} Stretch;

/* A light line from a point of the face's triangle: the stretch that a reflection begins, and the
 * one that it ends. */
typedef struct Trail {
    float u, v;
    float arriving; /* W m^-2, as Corner */
    Stretch before, after;
} Trail;

/* What one reflection makes of a piece. */
typedef struct Reflection {
    const Face *face;
    uint32_t bounce;         /* 1: the first */
    float angle, size;       /* largest differences of directions and places at its corners */
    float angle_max, length; /* most of both in a tube */
    uint32_t depth_max;
} Reflection;

static Stretch reflect(const Face *face, const Stretch *before) {
    const Cutter *cutter = face->cutter;
    Stretch after = {.goes_here = false};
    if (!before->end.is_there)
        return after;
    const SurfacePoint wall = scene_surface(cutter->scene, &before->end.exit);
    if (wall.object != cutter->object || wall.material->surface != AMB_SURFACE_DIELECTRIC ||
        vec3_dot(before->w, wall.ng) < GRAZING_COS)
        return after;
    const MediumStack inside = {.count = 1, .objects = {cutter->object}};
    const BoundaryCrossing crossing = boundary_cross(cutter->scene, &inside, &wall, before->w);
    if (!crossing.can_reflect || crossing.split.cos_i < GRAZING_COS)
        return after;
    float weight = crossing.split.reflectance;
    if (cutter->params->adjoint_normals)
        weight *= crossing.adjoint_reflect;
    after = (Stretch){.x = wall.p,
                      .w = crossing.split.reflected,
                      .start = before->start + before->end.reach,
                      .flux = weight * before->flux,
                      .tint = rgb_mul(before->tint, wall.material->reflect_color),
                      .n = crossing.n,
                      .ng = vec3_negate(wall.ng),
                      .goes_here = true};
    after.end = tube_line_end(face, scene_leave(&wall, after.w), after.w);
    if (!after.end.is_there && after.flux > 0.0f)
        scene_leaks_add(&face->chunk->tally.leaks, 1, face->cutter->object);
    return after;
}

static Trail begin_trail(const Face *face, const Corner *corner) {
    Trail trail = {.u = corner->u,
                   .v = corner->v,
                   .arriving = corner->arriving,
                   .before = {.x = corner->x,
                              .w = corner->w,
                              .flux = corner->is_lit ? corner->flux : 0.0f,
                              .tint = rgb(1.0f, 1.0f, 1.0f),
                              .end = corner->end,
                              .goes_here = true}};
    trail.after = reflect(face, &trail.before);
    return trail;
}

static void go_on(const Face *face, Trail *trail) {
    trail->before = trail->after;
    trail->after = reflect(face, &trail->before);
}

static Trail trail_at(const Reflection *reflection, float u, float v) {
    const Corner corner = tube_corner(reflection->face, u, v);
    Trail trail = begin_trail(reflection->face, &corner);
    for (uint32_t i = 1; i < reflection->bounce; ++i)
        go_on(reflection->face, &trail);
    return trail;
}

static const Medium *medium_of(const Face *face) {
    const AmbScene *scene = face->cutter->scene;
    return &scene->materials[scene->objects[face->cutter->object].inside].medium;
}

/* Largest share of the arriving light that is left at the beginning of a stretch. */
static float share_left(const Face *face, const Trail trails[3]) {
    float arriving = 0.0f, left = 0.0f;
    for (int k = 0; k < 3; ++k) {
        const Stretch *after = &trails[k].after;
        arriving = fmaxf(arriving, trails[k].arriving);
        if (after->goes_here)
            left = fmaxf(left, after->flux * rgb_max(rgb_mul(after->tint,
                                                             medium_transmittance(medium_of(face),
                                                                                  after->start))));
    }
    return arriving > 0.0f ? left / arriving : 0.0f;
}

static void tally_stretch(const Face *face, const Stretch *stretch, float watts) {
    const Rgb color = rgb_mul(face->color, stretch->tint);
    const Rgb here = medium_transmittance(medium_of(face), stretch->start);
    const Rgb left = medium_transmittance(medium_of(face), stretch->end.reach);
    tube_tally_add(face->chunk->tally.tally.interacting,
                   rgb_mul(rgb_mul(color, here), rgb(1.0f - left.r, 1.0f - left.g, 1.0f - left.b)),
                   (double)watts);
}

static AmbStatus emit(const Face *face, const Stretch corners[3], const float values[3]) {
    const Cutter *cutter = face->cutter;
    CutTube cut = {.material = TUBE_REFLECTED, .color = rgb_mul(face->color, corners[0].tint)};
    tube_limits((const LineEnd *[3]){&corners[0].end, &corners[1].end, &corners[2].end},
                cut.tube.limit);
    for (int k = 0; k < 3; ++k) {
        cut.tube.x[k] = vec3_sub(corners[k].x, cutter->scene->objects[cutter->object].center);
        cut.tube.w[k] = corners[k].w;
        cut.tube.value[k] = values[k];
        cut.tube.start[k] = corners[k].start;
        cut.tube.far = fmaxf(cut.tube.far, corners[k].end.reach);
    }
    /* Between the corners the light may go farther before it leaves. */
    cut.tube.far = 1.1f * cut.tube.far + tube_largest_difference(cut.tube.x);
    const uint64_t count = 1 + atomic_fetch_add(cutter->reflected_count, 1);
    if (count > cutter->reflected_max && cutter->coarseness < TUBE_COARSENESS_MAX)
        return status_fail(AMB_OUT_OF_MEMORY, "too many reflected light tubes");
    return tube_chunk_append(face->chunk, &cut);
}

static Vec3 shorten(Vec3 v, float length_max) {
    const float length = vec3_length(v);
    return length > length_max ? vec3_scale(v, length_max / length) : v;
}

/* A stretch beside another one that is reflected, reflected where it meets the plane that touches
 * the wall where the other one ends, at the normal as it changes along it. */
static Stretch reflect_beside(const Face *face, const Stretch *beside, const Stretch *before,
                              const Stretch *after) {
    const AmbScene *scene = face->cutter->scene;
    const float reach = before->end.reach;
    const Vec3 p = vec3_madd(beside->x, reach, beside->w);
    const float cosine = fminf(vec3_dot(before->w, after->ng), -PLANE_COS_MIN);
    const float along = vec3_dot(vec3_sub(after->x, p), after->ng) / cosine;
    const Vec3 place = vec3_sub(vec3_madd(p, along, before->w), after->x);
    const float widest = TUBE_SIZE_SHARE_MAX * scene->objects[face->cutter->object].radius;
    const Vec3 offset = shorten(place, widest);
    Vec3 dn = scene_normal_derivative(scene, &before->end.exit, offset);
    if (vec3_dot(after->n, scene_surface(scene, &before->end.exit).ns) < 0.0f)
        dn = vec3_negate(dn);
    const Vec3 n = vec3_normalize(vec3_add(after->n, shorten(dn, TURN_MAX)));
    Stretch next = *after;
    next.x = vec3_add(after->x, offset);
    next.w = vec3_madd(beside->w, -2.0f * vec3_dot(beside->w, n), n);
    next.w = vec3_normalize(vec3_add(after->w, shorten(vec3_sub(next.w, after->w), TURN_MAX)));
    next.start = fmaxf(beside->start + reach + along, 0.0f);
    return next;
}

/* As far on the other side of a stretch as another one is on this. */
static Stretch opposite(const Stretch *stretch, const Stretch *beside) {
    Stretch out = *stretch;
    out.x = vec3_madd(stretch->x, -1.0f, vec3_sub(beside->x, stretch->x));
    out.w = vec3_normalize(vec3_madd(stretch->w, -1.0f, vec3_sub(beside->w, stretch->w)));
    return out;
}

/* A piece that a jump of the wall cuts through, at the level where it is not divided any more: each
 * corner's light goes on by itself through all reflections that are left, with the other two
 * corners beside it and its value falling to 0 towards them. The three together carry the flux of
 * the piece. */
static AmbStatus reflect_alone(const Face *face, const Trail trails[3], int k, uint32_t bounce,
                               float area) {
    Trail trail = trails[k];
    Stretch sides[2] = {trails[(k + 1) % 3].before, trails[(k + 2) % 3].before};
    if (!sides[0].goes_here && !sides[1].goes_here)
        return AMB_OK; /* nothing says how wide it is */
    for (int i = 0; i < 2; ++i)
        if (!sides[i].goes_here)
            sides[i] = opposite(&trail.before, &sides[1 - i]);
    for (;; ++bounce) {
        const Trail same[3] = {trail, trail, trail};
        if (!(share_left(face, same) > FLUX_MIN))
            return AMB_OK;
        Stretch corners[3] = {trail.after};
        for (int i = 0; i < 2; ++i)
            corners[1 + i] = sides[i] =
                reflect_beside(face, &sides[i], &trail.before, &trail.after);
        const float watts = trail.after.flux * area;
        tally_stretch(face, &trail.after, watts / 3.0f);
        AMB_TRY(emit(face, corners, (float[3]){watts, 0.0f, 0.0f}));
        if (bounce >= face->cutter->params->bounces || bounce >= BOUNCE_MAX)
            return AMB_OK;
        go_on(face, &trail);
    }
}

static AmbStatus emit_whole(const Face *face, const Trail trails[3], float area) {
    Stretch corners[3];
    float values[3];
    for (int k = 0; k < 3; ++k) {
        corners[k] = trails[k].after;
        values[k] = corners[k].flux * area;
        tally_stretch(face, &corners[k], values[k] / 3.0f);
    }
    return emit(face, corners, values);
}

static float angle_between(const Trail trails[3]) {
    const Vec3 w[3] = {trails[0].after.w, trails[1].after.w, trails[2].after.w};
    return tube_largest_difference(w);
}

static float size_between(const Trail trails[3]) {
    const Vec3 x[3] = {trails[0].after.x, trails[1].after.x, trails[2].after.x};
    return tube_largest_difference(x);
}

static bool is_same_tint(Rgb a, Rgb b) {
    return a.r == b.r && a.g == b.g && a.b == b.b;
}

/* Whether corners lie on parts of the wall that do not belong together. */
static bool is_step(const Trail trails[3]) {
    for (int k = 0; k < 3; ++k) {
        const Stretch *a = &trails[k].after, *b = &trails[(k + 1) % 3].after;
        if (a->goes_here != b->goes_here || !is_same_tint(a->tint, b->tint))
            return true;
        const Vec3 apart = vec3_sub(b->x, a->x);
        const float most = STEP_COS_MAX * vec3_length(apart);
        if (fabsf(vec3_dot(apart, a->ng)) > most || fabsf(vec3_dot(apart, b->ng)) > most)
            return true;
    }
    return false;
}

static Reflection plan_reflection(const Face *face, const Trail trails[3], uint32_t bounce) {
    const Cutter *cutter = face->cutter;
    const float share = share_left(face, trails);
    const float ease = fminf(1.0f / sqrtf(share), EASE_MAX);
    const uint32_t spared = (uint32_t)log2f(fmaxf(ease, 1.0f)) + cutter->coarseness + bounce - 1;
    const float scale =
        ease * ldexpf(1.0f, (int)(cutter->coarseness + bounce - 1) - cutter->params->refinement);
    return (Reflection){.face = face,
                        .bounce = bounce,
                        .angle = angle_between(trails),
                        .size = size_between(trails),
                        .angle_max = scale * TUBE_ANGLE_MAX,
                        .length = scale * TUBE_SIZE_SHARE_MAX *
                                  cutter->scene->objects[cutter->object].radius,
                        .depth_max = spared < DEPTH_MAX ? DEPTH_MAX - spared : 0};
}

static AmbStatus follow(const Face *face, const Trail trails[3], float area, uint32_t bounce);

/* `area` of the face. */
static AmbStatus divide(const Reflection *reflection, const Trail trails[3], float area,
                        uint32_t depth) {
    const Face *face = reflection->face;
    if (!(share_left(face, trails) > FLUX_MIN))
        return AMB_OK;
    if (job_is_cancelled(face->cutter->job))
        return AMB_CANCELLED;
    const float angle = angle_between(trails), size = size_between(trails);
    const bool is_stepped = is_step(trails);
    const bool is_apart = is_stepped || angle > reflection->angle_max || size > reflection->length;
    if (is_apart && depth < reflection->depth_max) {
        Trail middle[3]; /* of the edges 01, 12, 20 */
        for (int k = 0; k < 3; ++k) {
            const Trail *a = &trails[k], *b = &trails[(k + 1) % 3];
            middle[k] = trail_at(reflection, 0.5f * (a->u + b->u), 0.5f * (a->v + b->v));
        }
        for (int k = 0; k < 3; ++k) {
            const Trail part[3] = {trails[k], middle[k], middle[(k + 2) % 3]};
            AMB_TRY(divide(reflection, part, 0.25f * area, depth + 1));
        }
        return divide(reflection, middle, 0.25f * area, depth + 1);
    }
    const float expected = SMOOTH_FACTOR * ldexpf(1.0f, -(int)depth);
    const bool jumps = is_stepped ||
                       (angle > reflection->angle_max && angle > expected * reflection->angle) ||
                       (size > reflection->length && size > expected * reflection->size);
    if (jumps) {
        for (int k = 0; k < 3; ++k)
            AMB_TRY(reflect_alone(face, trails, k, reflection->bounce, area));
        return AMB_OK;
    }
    AMB_TRY(emit_whole(face, trails, area));
    if (reflection->bounce >= face->cutter->params->bounces || reflection->bounce >= BOUNCE_MAX)
        return AMB_OK;
    Trail next[3] = {trails[0], trails[1], trails[2]};
    for (int k = 0; k < 3; ++k)
        go_on(face, &next[k]);
    return follow(face, next, area, reflection->bounce + 1);
}

/* Reflects a piece whose light lines came through all reflections before this one together. */
static AmbStatus follow(const Face *face, const Trail trails[3], float area, uint32_t bounce) {
    if (!(share_left(face, trails) > FLUX_MIN))
        return AMB_OK;
    const Reflection reflection = plan_reflection(face, trails, bounce);
    return divide(&reflection, trails, area, 0);
}

AmbStatus tubes_reflect(const Face *face, const Corner corners[3], float area) {
    Trail trails[3];
    for (int k = 0; k < 3; ++k)
        trails[k] = begin_trail(face, &corners[k]);
    return follow(face, trails, area, 1);
}
