/* SPDX-License-Identifier: GPL-3.0-or-later
 * Boundaries between media. */
#include "scene/boundary.h"

enum {
    PASSED_MAX = 256, /* surfaces that a path may pass before it gives up */
    TOUCHING_MAX = 16 /* triangles that lie on one another */
};

static int32_t priority_of(const AmbScene *scene, uint32_t object) {
    return scene->materials[scene->objects[object].inside].priority;
}

/* The highest priority holds; among equals the object entered last. */
static void stack_choose(const AmbScene *scene, MediumStack *stack) {
    stack->top = 0;
    for (uint32_t i = 1; i < stack->count; ++i)
        if (priority_of(scene, stack->objects[i]) >= priority_of(scene, stack->objects[stack->top]))
            stack->top = i;
}

static bool stack_holds(const MediumStack *stack, uint32_t object) {
    for (uint32_t i = 0; i < stack->count; ++i)
        if (stack->objects[i] == object)
            return true;
    return false;
}

static bool stack_remove(MediumStack *stack, uint32_t object) {
    for (uint32_t i = stack->count; i-- > 0;)
        if (stack->objects[i] == object) {
            for (uint32_t k = i + 1; k < stack->count; ++k)
                stack->objects[k - 1] = stack->objects[k];
            --stack->count;
            return true;
        }
    return false;
}

static bool stack_push(MediumStack *stack, uint32_t object) {
    if (stack->count == MEDIUM_STACK_MAX)
        return false;
    stack->objects[stack->count++] = object;
    return true;
}

static bool is_same_medium(const MediumStack *a, const MediumStack *b) {
    if (a->count == 0 || b->count == 0)
        return a->count == b->count;
    return medium_stack_top(a) == medium_stack_top(b);
}

static bool is_boundary_surface(const SurfacePoint *surface) {
    return surface->material->surface == AMB_SURFACE_DIELECTRIC;
}

/* One object's part of what is crossed at once. */
typedef struct Face {
    SurfacePoint surface;
    bool is_entered, is_left; /* both: an edge of it is; that changes nothing */
} Face;

typedef struct FaceSet {
    uint32_t count;
    Face faces[TOUCHING_MAX + 1]; /* one for each object, in the order of objects */
    bool has_opaque;
    SurfacePoint opaque;
} FaceSet;

static void add_face(FaceSet *set, const SurfacePoint *surface, bool is_entering) {
    uint32_t i = 0;
    while (i < set->count && set->faces[i].surface.object < surface->object)
        ++i;
    if (i == set->count || set->faces[i].surface.object != surface->object) {
        for (uint32_t k = set->count++; k > i; --k)
            set->faces[k] = set->faces[k - 1];
        set->faces[i] = (Face){.surface = *surface};
    }
    set->faces[i].is_entered = set->faces[i].is_entered || is_entering;
    set->faces[i].is_left = set->faces[i].is_left || !is_entering;
}

/* The face that a path met, and those of other objects that lie on it: what a path that goes on by
 * scene_leave skips. They are looked for straight across the face, from where a path leaves it on
 * one side to where it does on the other, so that the two agree. */
static void find_faces(const AmbScene *scene, const SurfacePoint *surface, Vec3 d,
                       FaceSet *out_set) {
    const bool is_entering = vec3_dot(d, surface->ng) < 0.0f;
    out_set->count = 0;
    out_set->has_opaque = false;
    add_face(out_set, surface, is_entering);
    if (!scene->objects[surface->object].may_touch)
        return;
    const Vec3 across = vec3_scale(surface->ng, is_entering ? -1.0f : 1.0f);
    const Vec3 from = scene_leave(surface, vec3_negate(across));
    const Vec3 to = scene_leave(surface, across);
    Hit hits[TOUCHING_MAX];
    const uint32_t count = scene_intersect_all(scene, from, across, vec3_length(vec3_sub(to, from)),
                                               hits, TOUCHING_MAX);
    for (uint32_t i = 0; i < count; ++i) {
        if (hits[i].geometry == surface->object)
            continue;
        SurfacePoint other = scene_surface(scene, &hits[i]);
        other.p = surface->p;
        if (is_boundary_surface(&other)) {
            add_face(out_set, &other, vec3_dot(across, other.ng) < 0.0f);
        } else if (!out_set->has_opaque) {
            out_set->has_opaque = true;
            out_set->opaque = other;
        }
    }
}

bool boundary_is_touched(const AmbScene *scene, const SurfacePoint *surface) {
    FaceSet set;
    find_faces(scene, surface, vec3_negate(surface->ng), &set);
    return set.count > 1;
}

MediumStack scene_media_at(const AmbScene *scene, Vec3 p) {
    MediumStack entered = {.count = 0}; /* by the probe, after p */
    MediumStack inner_first = {.count = 0};
    /* No direction of special meaning to modelled shapes. */
    const Vec3 d = vec3_normalize(vec3(0.41f, 0.27f, 0.87f));
    Vec3 o = p;
    for (int i = 0; i < PASSED_MAX; ++i) {
        Hit hit;
        if (!scene_intersect(scene, o, d, INFINITY, &hit))
            break;
        const SurfacePoint surface = scene_surface(scene, &hit);
        o = scene_leave(&surface, d);
        /* A medium has an inside behind its opaque faces, too. */
        if (!scene->objects[surface.object].is_boundary)
            continue;
        FaceSet set;
        find_faces(scene, &surface, d, &set);
        for (uint32_t k = 0; k < set.count; ++k) {
            const Face *face = &set.faces[k];
            const uint32_t object = face->surface.object;
            if (face->is_entered && !face->is_left)
                stack_push(&entered, object);
            else if (face->is_left && !face->is_entered && !stack_remove(&entered, object))
                stack_push(&inner_first, object);
        }
    }
    MediumStack stack = {.count = inner_first.count};
    for (uint32_t i = 0; i < stack.count; ++i)
        stack.objects[i] = inner_first.objects[stack.count - 1 - i];
    stack_choose(scene, &stack);
    return stack;
}

static float adjoint_factor(Vec3 d, Vec3 wt, Vec3 ns, Vec3 ng) {
    const float above = fabsf(vec3_dot(d, ns) * vec3_dot(wt, ng));
    const float below = fabsf(vec3_dot(d, ng) * vec3_dot(wt, ns));
    return below > 0.0f ? above / below : 0.0f;
}

/* How far a direction that is laid into a face points off it, so that it keeps to its side. */
static const float LAID_COSINE = 1e-3f;

/* The direction nearest to d on the side of the unit normal. */
static Vec3 keep_side(Vec3 d, Vec3 normal) {
    const float cosine = vec3_dot(d, normal);
    return cosine > 0.0f ? d : vec3_normalize(vec3_madd(d, LAID_COSINE - cosine, normal));
}

/* Media behind all faces of the set: what is left goes first, so that the order among them does
 * not matter. */
static void stack_cross(const AmbScene *scene, const FaceSet *set, BoundaryCrossing *crossing) {
    MediumStack *beyond = &crossing->beyond;
    for (uint32_t i = 0; i < set->count; ++i)
        if (set->faces[i].is_left && !set->faces[i].is_entered)
            crossing->is_stray =
                !stack_remove(beyond, set->faces[i].surface.object) || crossing->is_stray;
    for (uint32_t i = 0; i < set->count; ++i)
        if (set->faces[i].is_entered && !set->faces[i].is_left) {
            const uint32_t object = set->faces[i].surface.object;
            crossing->is_again = crossing->is_again || stack_holds(beyond, object);
            stack_push(beyond, object);
        }
    stack_choose(scene, beyond);
}

/* The face of the object whose medium begins or ends, of the higher priority if there are two. */
static const SurfacePoint *choose_face(const AmbScene *scene, const FaceSet *set,
                                       const MediumStack *here, const MediumStack *beyond) {
    const SurfacePoint *chosen = NULL;
    for (uint32_t i = 0; i < set->count; ++i) {
        const SurfacePoint *surface = &set->faces[i].surface;
        const bool begins = beyond->count > 0 && medium_stack_top(beyond) == surface->object;
        const bool ends = here->count > 0 && medium_stack_top(here) == surface->object;
        if ((begins || ends) && (chosen == NULL || priority_of(scene, surface->object) >
                                                       priority_of(scene, chosen->object)))
            chosen = surface;
    }
    return chosen;
}

BoundaryCrossing boundary_cross(const AmbScene *scene, const MediumStack *stack,
                                const SurfacePoint *surface, Vec3 d) {
    BoundaryCrossing crossing = {.beyond = *stack, .surface = *surface};
    FaceSet set;
    find_faces(scene, surface, d, &set);
    stack_cross(scene, &set, &crossing);
    if (set.has_opaque) {
        crossing.is_opaque = true;
        crossing.surface = set.opaque;
        return crossing;
    }
    crossing.is_ignored = is_same_medium(stack, &crossing.beyond);
    if (crossing.is_ignored)
        return crossing;
    crossing.surface = *choose_face(scene, &set, stack, &crossing.beyond);
    crossing.is_entering = vec3_dot(d, crossing.surface.ng) < 0.0f;
    crossing.eta = medium_stack_ior(scene, stack) / medium_stack_ior(scene, &crossing.beyond);

    const float side = crossing.is_entering ? 1.0f : -1.0f;
    const Vec3 ng = vec3_scale(crossing.surface.ng, side);
    crossing.n = vec3_scale(crossing.surface.ns, side);
    /* Interpolation can turn the normal away from the ray near a silhouette. */
    const Vec3 ns = crossing.n;
    const bool is_away = vec3_dot(d, ns) >= 0.0f;
    if (is_away)
        crossing.n = ng;
    crossing.split = dielectric_split(d, crossing.n, crossing.eta);
    crossing.can_refract =
        crossing.split.reflectance < 1.0f && vec3_dot(crossing.split.refracted, ng) < 0.0f;
    crossing.can_reflect =
        crossing.split.reflectance > 0.0f && vec3_dot(crossing.split.reflected, ng) > 0.0f;
    crossing.refracted = keep_side(crossing.split.refracted, vec3_scale(ng, -1.0f));
    crossing.reflected = keep_side(crossing.split.reflected, ng);
    crossing.adjoint_refract = adjoint_factor(d, crossing.split.refracted, crossing.n, ng);
    crossing.adjoint_reflect = adjoint_factor(d, crossing.split.reflected, crossing.n, ng);
    /* Of camera paths only those meet the face's own normal from which the other is turned away. */
    if (is_away) {
        crossing.adjoint_refract = vec3_dot(crossing.split.refracted, ns) >= 0.0f ? 1.0f : 0.0f;
        crossing.adjoint_reflect = 0.0f;
    }
    return crossing;
}

bool boundary_find(const AmbScene *scene, MediumStack *stack, Vec3 o, Vec3 d, float t_max,
                   BoundaryArrival *out_arrival) {
    *out_arrival = (BoundaryArrival){.t = 0.0f};
    for (int i = 0; i < PASSED_MAX; ++i) {
        Hit hit;
        if (!scene_intersect(scene, o, d, t_max - out_arrival->t, &hit))
            return false;
        out_arrival->t += hit.t;
        const SurfacePoint surface = scene_surface(scene, &hit);
        BoundaryCrossing *crossing = &out_arrival->crossing;
        if (!is_boundary_surface(&surface)) {
            crossing->surface = surface;
            out_arrival->is_opaque = true;
            return true;
        }
        *crossing = boundary_cross(scene, stack, &surface, d);
        out_arrival->is_opaque = crossing->is_opaque;
        if (crossing->is_opaque)
            return true;
        out_arrival->irregular_count += crossing->is_stray || crossing->is_again;
        out_arrival->nested_count += stack->count > 0 && crossing->beyond.count > 0;
        if (!crossing->is_ignored)
            return true;
        *stack = crossing->beyond;
        ++out_arrival->passed_count;
        o = scene_leave(&surface, d);
    }
    return false;
}
