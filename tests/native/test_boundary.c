/* SPDX-License-Identifier: GPL-3.0-or-later
 * Objects that overlap, lie in one another and touch: which medium holds along a path. */
#include "scene/boundary.h"
#include "shapes.h"
#include "test.h"

enum { SLAB_MAX = 4 };

/* A slab between two values of x, wide enough across for every ray of these tests. */
typedef struct Slab {
    float begin, end;
    int32_t priority;
} Slab;

static AmbScene *slab_scene(const Slab slabs[], uint32_t count) {
    AmbScene *scene = NULL;
    ENSURE_STATUS(amb_scene_create(&scene), AMB_OK);
    AmbCamera camera;
    amb_camera_init(&camera, AMB_CAMERA_PERSPECTIVE);
    ENSURE_STATUS(amb_scene_set_camera(scene, &camera), AMB_OK);
    Shape box = shape_box();
    for (uint64_t v = 0; v < box.vertex_count; ++v)
        for (int axis = 1; axis < 3; ++axis)
            box.positions[3 * v + (uint64_t)axis] *= 30.0f;
    for (uint32_t i = 0; i < count; ++i) {
        Shape slab = box;
        float positions[3 * 64];
        for (uint64_t k = 0; k < 3 * box.vertex_count; ++k)
            positions[k] = box.positions[k];
        for (uint64_t v = 0; v < box.vertex_count; ++v)
            positions[3 * v] = box.positions[3 * v] < 0.0f ? slabs[i].begin : slabs[i].end;
        slab.positions = positions;
        const AmbMesh mesh = shape_mesh(&slab, "slab", false);
        const AmbMaterial material = shape_resin(1.1f + 0.1f * (float)i, 1.0f, 0.0f, 0.0f);
        uint32_t id = 0;
        ENSURE_STATUS(amb_scene_add_material(scene, &material, &id), AMB_OK);
        scene->materials[id].priority = slabs[i].priority;
        shape_add(scene, &mesh, id, 1.0f, 0, 0, 0);
    }
    shape_free(&box);
    ENSURE_STATUS(amb_scene_commit(scene), AMB_OK);
    Job job;
    job_init(&job, 1);
    ENSURE_STATUS(scene_build(scene, &job), AMB_OK);
    return scene;
}

/* Slab whose medium holds at x for a path along +x (towards = 1) or -x, or SLAB_MAX: the highest
 * priority, then the latest entered, then the last of the list. */
static uint32_t holding(const Slab slabs[], uint32_t count, float x, float towards) {
    uint32_t best = SLAB_MAX;
    for (uint32_t i = 0; i < count; ++i) {
        if (x <= slabs[i].begin || x >= slabs[i].end)
            continue;
        if (best == SLAB_MAX) {
            best = i;
            continue;
        }
        const Slab *a = &slabs[best], *b = &slabs[i];
        const float entered_a = towards > 0.0f ? a->begin : -a->end;
        const float entered_b = towards > 0.0f ? b->begin : -b->end;
        if (b->priority > a->priority || (b->priority == a->priority && entered_b >= entered_a))
            best = i;
    }
    return best;
}

static uint32_t top_or_none(const MediumStack *stack) {
    return stack->count > 0 ? medium_stack_top(stack) : SLAB_MAX;
}

/* Follows a path straight through all slabs, and compares with the intervals. Returns what is
 * wrong. */
static int follow_through(const AmbScene *scene, const Slab slabs[], uint32_t count,
                          float towards) {
    const Vec3 d = vec3_normalize(vec3(towards, 0.02f, 0.015f));
    Vec3 o = vec3(-9.0f * towards, 0.1f, 0.2f);
    MediumStack stack = {.count = 0};
    int wrong = 0;
    BoundaryArrival arrival;
    for (int i = 0; i < 2 * SLAB_MAX; ++i) {
        const uint32_t here = top_or_none(&stack);
        const bool is_hit = boundary_find(scene, &stack, o, d, INFINITY, &arrival);
        /* All the way up to there the medium holds. */
        const float end = is_hit ? o.x + arrival.t * d.x : 9.0f * towards;
        for (int k = 0; k < 32; ++k) {
            const float x = o.x + (end - o.x) * ((float)k + 0.5f) / 32.0f;
            if (fabsf(2.0f * x - roundf(2.0f * x)) > 1e-3f)
                wrong += holding(slabs, count, x, towards) != here;
        }
        wrong += arrival.irregular_count != 0;
        if (!is_hit)
            return wrong + (stack.count != 0);
        const BoundaryCrossing *crossing = &arrival.crossing;
        const uint32_t beyond = top_or_none(&crossing->beyond);
        wrong += arrival.is_opaque || crossing->is_ignored || beyond == here;
        /* The face belongs to the medium that begins or ends. */
        const uint32_t face = crossing->surface.object;
        wrong += face != here && face != beyond;
        const float n_here = here < SLAB_MAX ? 1.1f + 0.1f * (float)here : 1.0f;
        const float n_beyond = beyond < SLAB_MAX ? 1.1f + 0.1f * (float)beyond : 1.0f;
        wrong += fabsf(crossing->eta - n_here / n_beyond) > 1e-6f;
        wrong += !(vec3_dot(crossing->n, d) < 0.0f);
        /* Reflected, a path meets the boundary before, not this one again. */
        MediumStack back = stack;
        const Vec3 mirrored = vec3(-d.x, d.y, d.z);
        BoundaryArrival before;
        if (boundary_find(scene, &back, scene_leave(&crossing->surface, mirrored), mirrored,
                          INFINITY, &before))
            wrong += before.t < 0.4f;
        else
            wrong += back.count != 0;
        o = scene_leave(&crossing->surface, d);
        stack = crossing->beyond;
    }
    return wrong + 1;
}

/* Slabs with ends on a grid of halves, so that many coincide, in every order and both ways. */
static void the_highest_priority_holds(void) {
    uint64_t state = 11;
    int wrong = 0, coincident = 0;
    for (int trial = 0; trial < 600; ++trial) {
        Slab slabs[SLAB_MAX];
        const uint32_t count = 2 + (uint32_t)test_uniform(&state, 0.0, SLAB_MAX - 1);
        for (uint32_t i = 0; i < count; ++i) {
            const int begin = (int)test_uniform(&state, -4.0, 4.0);
            const int length = 1 + (int)test_uniform(&state, 0.0, 5.0);
            slabs[i] = (Slab){0.5f * (float)begin, 0.5f * (float)(begin + length),
                              (int32_t)test_uniform(&state, -1.5, 2.0)};
            for (uint32_t k = 0; k < i; ++k)
                coincident += slabs[k].end == slabs[i].begin || slabs[k].begin == slabs[i].begin;
        }
        AmbScene *scene = slab_scene(slabs, count);
        wrong += follow_through(scene, slabs, count, 1.0f) != 0;
        wrong += follow_through(scene, slabs, count, -1.0f) != 0;
        for (float x = -2.75f; x < 5.0f; x += 0.5f) {
            const MediumStack stack = scene_media_at(scene, vec3(x, 0.3f, -0.2f));
            uint32_t inside = 0;
            for (uint32_t i = 0; i < count; ++i)
                inside += x > slabs[i].begin && x < slabs[i].end;
            wrong += stack.count != inside;
            const uint32_t expected = holding(slabs, count, x, 1.0f);
            if (inside > 0 && stack.count == inside)
                wrong += slabs[medium_stack_top(&stack)].priority != slabs[expected].priority;
        }
        amb_scene_destroy(scene);
    }
    ENSURE(coincident > 300);
    ENSURE(wrong == 0);
}

/* The same boundary whichever of two objects that touch there is met, added in either order. */
static void touching_faces_are_one_boundary(void) {
    for (int32_t priority = -1; priority <= 1; ++priority)
        for (int order = 0; order < 2; ++order) {
            Slab slabs[2];
            slabs[order] = (Slab){0.0f, 1.0f, 0};
            slabs[1 - order] = (Slab){1.0f, 2.0f, priority};
            AmbScene *scene = slab_scene(slabs, 2);
            const float left = 1.1f + 0.1f * (float)order, right = 1.2f - 0.1f * (float)order;
            const Vec3 d = vec3_normalize(vec3(1, 0.3f, 0.2f));
            for (uint32_t object = 0; object < 2; ++object) {
                /* Whichever the ray met. */
                const uint32_t inside = (uint32_t)order;
                const MediumStack stack = {.count = 1, .objects = {inside}};
                Hit hits[4];
                const uint32_t count =
                    scene_intersect_all(scene, vec3(0.9f, 0, 0), d, 0.3f, hits, 4);
                ENSURE(count == 2);
                const SurfacePoint surface = scene_surface(scene, &hits[object]);
                ENSURE(surface.object == object);
                ENSURE(boundary_is_touched(scene, &surface));
                const BoundaryCrossing crossing = boundary_cross(scene, &stack, &surface, d);
                ENSURE(!crossing.is_ignored && !crossing.is_stray && !crossing.is_again);
                ENSURE(crossing.beyond.count == 1 && crossing.beyond.objects[0] == 1 - inside);
                ENSURE_NEAR(crossing.eta, left / right, 1e-6);
                /* The face of the higher priority, or of the first object. */
                const uint32_t expected = priority == 0 ? 0 : priority > 0 ? 1 - inside : inside;
                ENSURE(crossing.surface.object == expected);
            }
            amb_scene_destroy(scene);
        }
}

/* A boundary that stands on an opaque face ends there, from inside; beside it nothing changes. */
static void an_opaque_face_on_a_boundary_ends_the_path(void) {
    for (int order = 0; order < 2; ++order) {
        AmbScene *scene = NULL;
        ENSURE_STATUS(amb_scene_create(&scene), AMB_OK);
        AmbCamera camera;
        amb_camera_init(&camera, AMB_CAMERA_PERSPECTIVE);
        ENSURE_STATUS(amb_scene_set_camera(scene, &camera), AMB_OK);
        AmbMaterial table;
        amb_material_init(&table);
        const AmbMaterial resin = shape_resin(1.5f, 1.0f, 0.0f, 0.0f);
        uint32_t ids[2];
        ENSURE_STATUS(amb_scene_add_material(scene, &table, &ids[0]), AMB_OK);
        ENSURE_STATUS(amb_scene_add_material(scene, &resin, &ids[1]), AMB_OK);
        Shape plane = shape_plane(), box = shape_box();
        const AmbMesh plane_mesh = shape_mesh(&plane, "table", false);
        const AmbMesh box_mesh = shape_mesh(&box, "box", false);
        for (int i = 0; i < 2; ++i)
            if (i == order)
                shape_add(scene, &plane_mesh, ids[0], 5.0f, 0, 0, 0);
            else
                shape_add(scene, &box_mesh, ids[1], 1.0f, 0, 0, 1.0f);
        shape_free(&plane);
        shape_free(&box);
        ENSURE_STATUS(amb_scene_commit(scene), AMB_OK);
        Job job;
        job_init(&job, 1);
        ENSURE_STATUS(scene_build(scene, &job), AMB_OK);
        const uint32_t resin_object = (uint32_t)(1 - order);
        uint64_t state = 5;
        int wrong = 0;
        for (int trial = 0; trial < 500; ++trial) {
            MediumStack stack = {.count = 1, .objects = {resin_object}};
            const Vec3 d = vec3_normalize(vec3((float)test_uniform(&state, -0.4, 0.4),
                                               (float)test_uniform(&state, -0.4, 0.4), -1));
            BoundaryArrival arrival;
            const Vec3 o = vec3((float)test_uniform(&state, -0.1, 0.1), 0.05f, 1.5f);
            wrong += !boundary_find(scene, &stack, o, d, INFINITY, &arrival);
            wrong += !arrival.is_opaque || arrival.crossing.surface.object == resin_object;
            wrong += fabsf(arrival.crossing.surface.p.z) > 1e-6f;
            /* The sides of the box are boundaries. */
            const Vec3 aside = vec3_normalize(vec3(1, d.x, d.y));
            stack = (MediumStack){.count = 1, .objects = {resin_object}};
            wrong += !boundary_find(scene, &stack, vec3(0, 0, 1), aside, INFINITY, &arrival);
            wrong += arrival.is_opaque || arrival.crossing.beyond.count != 0;
        }
        ENSURE(wrong == 0);
        amb_scene_destroy(scene);
    }
}

/* A basin: resin in a box of which only the top is a boundary. Its opaque walls are its ends. */
static void a_basin_has_an_inside(void) {
    AmbScene *scene = NULL;
    ENSURE_STATUS(amb_scene_create(&scene), AMB_OK);
    AmbMaterial stone;
    amb_material_init(&stone);
    const AmbMaterial resin = shape_resin(1.5f, 1.0f, 0.0f, 0.0f);
    uint32_t materials[2], id = 0;
    ENSURE_STATUS(amb_scene_add_material(scene, &resin, &materials[0]), AMB_OK);
    ENSURE_STATUS(amb_scene_add_material(scene, &stone, &materials[1]), AMB_OK);
    Shape box = shape_box();
    uint32_t slots[12];
    for (uint32_t t = 0; t < 12; ++t) {
        slots[t] = 0;
        for (int k = 0; k < 3; ++k)
            slots[t] |= box.positions[3 * box.triangles[3 * t + (uint32_t)k] + 2] < 0.0f;
    }
    AmbMesh mesh = shape_mesh(&box, "basin", false);
    mesh.slots = slots;
    AmbObject object;
    amb_object_init(&object);
    object.materials = materials;
    object.material_count = 2;
    ENSURE_STATUS(amb_scene_add_mesh(scene, &mesh, &object.mesh), AMB_OK);
    ENSURE_STATUS(amb_scene_add_object(scene, &object, &id), AMB_OK);
    shape_free(&box);
    shape_commit(scene);
    Job job;
    job_init(&job, 1);
    ENSURE_STATUS(scene_build(scene, &job), AMB_OK);
    uint64_t state = 7;
    int wrong = 0;
    for (int trial = 0; trial < 2000; ++trial) {
        const Vec3 p = vec3((float)test_uniform(&state, -2, 2), (float)test_uniform(&state, -2, 2),
                            (float)test_uniform(&state, -2, 2));
        const bool is_inside = fabsf(p.x) < 1.0f && fabsf(p.y) < 1.0f && fabsf(p.z) < 1.0f;
        wrong += scene_media_at(scene, p).count != (is_inside ? 1u : 0u);
    }
    ENSURE(wrong == 0);
    amb_scene_destroy(scene);
}

/* Outside of the resin a bubble that reaches through its surface is not there. */
static void a_bubble_cuts_a_hole(void) {
    static const Slab slabs[2] = {{0.0f, 2.0f, 0}, {1.0f, 3.0f, 1}};
    AmbScene *scene = slab_scene(slabs, 2);
    Hit hit;
    ENSURE(scene_intersect(scene, vec3(-1, 0.1f, 0.2f), vec3(1, 0, 0), INFINITY, &hit));
    const SurfacePoint alone = scene_surface(scene, &hit);
    ENSURE(!boundary_is_touched(scene, &alone));
    scene->materials[1].ior = 1.0f;
    scene->materials[1].medium = (Medium){.lobe_count = 0};
    MediumStack stack = {.count = 0};
    const Vec3 d = vec3(1, 0, 0);
    Vec3 o = vec3(-1, 0.1f, 0.2f);
    static const float at[3] = {0.0f, 1.0f, 3.0f};
    static const float etas[3] = {1.0f / 1.1f, 1.1f, 1.0f};
    for (int i = 0; i < 3; ++i) {
        BoundaryArrival arrival;
        ENSURE(boundary_find(scene, &stack, o, d, INFINITY, &arrival));
        ENSURE_NEAR(o.x + arrival.t, at[i], 1e-5);
        ENSURE_NEAR(arrival.crossing.eta, etas[i], 1e-6);
        ENSURE(arrival.crossing.can_reflect == (i < 2));
        ENSURE(arrival.nested_count == (i > 0 ? 1u : 0u));
        o = scene_leave(&arrival.crossing.surface, d);
        stack = arrival.crossing.beyond;
    }
    ENSURE(stack.count == 0);
    amb_scene_destroy(scene);
}

void test_boundary(void);
void test_boundary(void) {
    RUN(the_highest_priority_holds);
    RUN(touching_faces_are_one_boundary);
    RUN(an_opaque_face_on_a_boundary_ends_the_path);
    RUN(a_basin_has_an_inside);
    RUN(a_bubble_cuts_a_hole);
}
