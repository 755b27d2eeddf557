/* SPDX-License-Identifier: GPL-3.0-or-later
 * Exact connections against the equations as they are printed: the half-vector condition, the
 * spread of the light by traced rays, integrals over t; and against tubes. */
#include "base/memory.h"
#include "field/specular/specular.h"
#include "field/specular/specular_curve.h"
#include "shapes.h"
#include "test.h"

/* ---- Faces ----------------------------------------------------------------------------------- */

static Vec3d random_vector(uint64_t *state, double size) {
    const double x = test_uniform(state, -size, size), y = test_uniform(state, -size, size);
    return (Vec3d){x, y, test_uniform(state, -size, size)};
}

static Vec3d unit(Vec3d v) {
    return vec3d_scale(v, 1.0 / vec3d_length(v));
}

/* A triangle around the origin that faces +z, with normals bent by about `bend`, and a light above
 * it: far away for odd numbers. */
static SpecularFace random_face(uint64_t *state, double eta, double bend, SceneLight *light) {
    static const double corner[3][2] = {{-0.5, -0.4}, {0.5, -0.4}, {0.0, 0.6}};
    Vec3d p[3], n[3];
    for (int k = 0; k < 3; ++k) {
        p[k] = vec3d_add((Vec3d){corner[k][0], corner[k][1], 0}, random_vector(state, 0.1));
        n[k] = unit(vec3d_add((Vec3d){0, 0, 1}, random_vector(state, bend)));
    }
    const Vec3d p_u = vec3d_sub(p[1], p[0]), p_v = vec3d_sub(p[2], p[0]);
    const Vec3d normal = vec3d_cross(p_u, p_v);
    const Vec3d place = vec3d_add((Vec3d){0, 0, 2.0}, random_vector(state, 0.8));
    const bool is_sun = test_uniform(state, 0, 1) < 0.5;
    *light = (SceneLight){.kind = is_sun ? AMB_LIGHT_SUN : AMB_LIGHT_POINT,
                          .color = {1, 1, 1},
                          .position = vec3d_round(place),
                          .direction = vec3d_round(vec3d_negate(unit(place)))};
    vec3_frame(light->direction, &light->x, &light->y);
    return (SpecularFace){.light = light,
                          .p = p[0],
                          .p_u = p_u,
                          .p_v = p_v,
                          .n = n[0],
                          .n_u = vec3d_sub(n[1], n[0]),
                          .n_v = vec3d_sub(n[2], n[0]),
                          .ng = unit(normal),
                          .to_light = is_sun ? unit(vec3d_negate(vec3d_from(light->direction)))
                                             : vec3d_from(light->position),
                          .eta = eta,
                          .area = 0.5 * vec3d_length(normal),
                          .color = {1, 1, 1}};
}

/* A segment below the face that its light meets. */
static SpecularSegment random_segment(uint64_t *state, const SpecularFace *face) {
    const double u = test_uniform(state, 0.1, 0.5), v = test_uniform(state, 0.1, 0.4);
    const SpecularLine line = specular_line(face, u, v);
    const Vec3d x = vec3d_madd(line.p, test_uniform(state, 0.2, 1.5), line.w);
    SpecularSegment segment = {.d = unit(random_vector(state, 1.0)), .length = 2.0};
    segment.o = vec3d_madd(x, -1.0, segment.d);
    return segment;
}

static double distance(Vec3d a, Vec3d b) {
    return vec3d_length(vec3d_sub(a, b));
}

static void derivatives_match_differences(void) {
    static const double etas[] = {1.0 / 1.5, 1.0, 1.0 / 0.9};
    uint64_t state = 1;
    double worst = 0.0;
    for (int trial = 0; trial < 300; ++trial) {
        SceneLight light;
        const SpecularFace face =
            random_face(&state, etas[trial % 3], trial % 2 == 0 ? 0.3 : 1.2, &light);
        const double u = test_uniform(&state, 0.1, 0.4), v = test_uniform(&state, 0.1, 0.4);
        const SpecularLine line = specular_line(&face, u, v);
        if (line.is_total || line.cos_t < 0.1)
            continue;
        const double h = 1e-6;
        const Vec3d u_1 = specular_line(&face, u + h, v).w, u_0 = specular_line(&face, u - h, v).w;
        const Vec3d v_1 = specular_line(&face, u, v + h).w, v_0 = specular_line(&face, u, v - h).w;
        const double error_u = distance(vec3d_scale(vec3d_sub(u_1, u_0), 0.5 / h), line.w_u);
        const double error_v = distance(vec3d_scale(vec3d_sub(v_1, v_0), 0.5 / h), line.w_v);
        worst = test_worse(worst, error_u / (1.0 + vec3d_length(line.w_u)));
        worst = test_worse(worst, error_v / (1.0 + vec3d_length(line.w_v)));
        ENSURE_NEAR(vec3d_length(line.w), 1.0, 1e-12);
    }
    ENSURE(worst < 1e-6);
}

/* ---- The curve ------------------------------------------------------------------------------- */

static CurveNode node_at(const SpecularFace *face, const SpecularSegment *segment, double u,
                         double v) {
    const SpecularLine line = specular_line(face, u, v);
    return (CurveNode){u, v, specular_side(segment, line.p, line.w)};
}

static void search_whole(const SpecularFace *face, const SpecularSegment *segment,
                         CurveVisitor visit, void *user) {
    const CurveNode corners[3] = {node_at(face, segment, 0, 0), node_at(face, segment, 1, 0),
                                  node_at(face, segment, 0, 1)};
    const CurveNode middles[3] = {node_at(face, segment, 0.5, 0), node_at(face, segment, 0.5, 0.5),
                                  node_at(face, segment, 0, 0.5)};
    specular_curve(face, segment, corners, middles, visit, user);
}

/* H / |H| + N as in the papers, w_V from p to x; for n < 1 H points to the other side. */
static Vec3d half_vector(const SpecularFace *face, double u, double v, Vec3d x) {
    const SpecularLine line = specular_line(face, u, v);
    const Vec3d w_v = unit(vec3d_sub(x, line.p));
    const Vec3d h = unit(vec3d_madd(line.wi, 1.0 / face->eta, w_v));
    return vec3d_add(face->eta < 1.0 ? h : vec3d_negate(h), line.n);
}

/* Newton's method on |H / |H| + N|, by differences: [Walter09] for one x. False: none. */
static bool walter_solve(const SpecularFace *face, Vec3d x, double *u, double *v) {
    const double h = 1e-6;
    for (int i = 0; i < 40; ++i) {
        const Vec3d f = half_vector(face, *u, *v, x);
        const Vec3d a = vec3d_scale(
            vec3d_sub(half_vector(face, *u + h, *v, x), half_vector(face, *u - h, *v, x)), 0.5 / h);
        const Vec3d b = vec3d_scale(
            vec3d_sub(half_vector(face, *u, *v + h, x), half_vector(face, *u, *v - h, x)), 0.5 / h);
        /* Least squares: three equations, two of them independent. */
        const double aa = vec3d_dot(a, a), ab = vec3d_dot(a, b), bb = vec3d_dot(b, b);
        const double fa = vec3d_dot(f, a), fb = vec3d_dot(f, b), det = aa * bb - ab * ab;
        const double du = -(fa * bb - fb * ab) / det, dv = -(fb * aa - fa * ab) / det;
        const double length = hypot(du, dv), scale = length > 0.1 ? 0.1 / length : 1.0;
        *u += scale * du;
        *v += scale * dv;
        if (length < 1e-10)
            return vec3d_length(half_vector(face, *u, *v, x)) < 1e-8;
    }
    return false;
}

/* Irradiance at distance s along the line from (u, v), by the lines beside it. */
static double traced_irradiance(const SpecularFace *face, double u, double v, double s) {
    const double h = 1e-6;
    const SpecularLine line = specular_line(face, u, v);
    Vec3d moved[2];
    for (int k = 0; k < 2; ++k) {
        const double du = k == 0 ? h : 0.0, dv = k == 0 ? 0.0 : h;
        const SpecularLine a = specular_line(face, u + du, v + dv);
        const SpecularLine b = specular_line(face, u - du, v - dv);
        const Vec3d end_a = vec3d_madd(a.p, s, a.w), end_b = vec3d_madd(b.p, s, b.w);
        moved[k] = vec3d_scale(vec3d_sub(end_a, end_b), 0.5 / h);
    }
    const double spread = fabs(vec3d_dot(line.w, vec3d_cross(moved[0], moved[1])));
    return specular_entering(face, &line) * 2.0 * face->area / spread;
}

typedef struct Found {
    int pieces, folds, compared;
    double worst_end, worst_condition, curve, along_t;
} Found;

static double outside_of_edges(const CurvePoint *point) {
    return fmin(fmin(fabs(point->u), fabs(point->v)), fabs(1.0 - point->u - point->v));
}

static Vec3d meeting(const CurvePiece *piece, const CurvePoint *point) {
    return vec3d_madd(piece->segment->o, point->t, piece->segment->d);
}

static void check_piece(void *user, const CurvePiece *piece) {
    enum { STEPS = 64 };
    Found *found = user;
    ++found->pieces;
    const SpecularFace *face = piece->face;
    double last = piece->a.t, sum = 0.0;
    bool is_monotone = true, is_near = !piece->is_straight;
    for (int i = 0; i <= STEPS; ++i) {
        CurvePoint point;
        if (!specular_curve_at(piece, (double)i / STEPS, &point) || point.line.cos_t < 0.05)
            return;
        const Vec3d x = meeting(piece, &point);
        is_near = is_near && point.s > 0.05 && point.s < 5.0 && fabs(point.t) < 10.0;
        if (is_near && face->eta != 1.0)
            found->worst_condition = test_worse(
                found->worst_condition, vec3d_length(half_vector(face, point.u, point.v, x)));
        is_monotone = is_monotone && (i == 0 || (point.t > last) == (piece->b.t > piece->a.t));
        last = point.t;
        const double weight = i == 0 || i == STEPS ? 1.0 : i % 2 == 1 ? 4.0 : 2.0;
        /* E dt = flux dx / (sine of the angle): f has the sine in it. */
        sum += weight / (3.0 * STEPS) * specular_entering(face, &point.line) *
               specular_density(piece, &point);
    }
    if (!is_monotone) {
        ++found->folds;
        return;
    }
    if (!is_near || face->eta == 1.0)
        return;
    /* The same in t, midpoint by midpoint, with the points of [Walter09]. */
    double integral = 0.0, u = piece->a.u, v = piece->a.v;
    for (int i = 0; i < STEPS; ++i) {
        const double width = (piece->b.t - piece->a.t) / STEPS;
        const double t = piece->a.t + (i + 0.5) * width;
        const Vec3d x = vec3d_madd(piece->segment->o, t, piece->segment->d);
        const double u_before = u, v_before = v;
        /* Several points may send light to x: stay on this curve. */
        if (!walter_solve(face, x, &u, &v) ||
            hypot(u - u_before, v - v_before) > 0.2 * hypot(piece->chord[0], piece->chord[1]))
            return;
        const double s = distance(x, specular_line(face, u, v).p);
        integral += traced_irradiance(face, u, v, s) * fabs(width);
    }
    if (hypot(u - piece->b.u, v - piece->b.v) > 0.1 * hypot(piece->chord[0], piece->chord[1]))
        return;
    ++found->compared;
    found->curve += sum;
    found->along_t += integral;
    ENSURE_NEAR(sum / integral, 1.0, 0.1);
}

/* Half vectors, ends on the triangle's edges, and the measure against E by traced rays. */
static void curve_is_that_of_the_half_vector(void) {
    static const double etas[] = {1.0 / 1.5, 1.0, 1.0 / 0.9, 1.0 / 1.33};
    Found found = {0};
    uint64_t state = 2;
    for (int trial = 0; trial < 600; ++trial) {
        SceneLight light;
        const SpecularFace face =
            random_face(&state, etas[trial % 4], trial % 3 == 0 ? 1.5 : 0.1, &light);
        const SpecularSegment segment = random_segment(&state, &face);
        search_whole(&face, &segment, check_piece, &found);
    }
    ENSURE(found.pieces > 1000 && found.folds > 50 && found.compared > 300);
    ENSURE(found.worst_condition < 2e-3);
    ENSURE_NEAR(found.curve / found.along_t, 1.0, 1e-3);
}

typedef struct Ends {
    int count;
    double worst;
} Ends;

static void check_ends(void *user, const CurvePiece *piece) {
    Ends *ends = user;
    ++ends->count;
    ends->worst = test_worse(ends->worst, outside_of_edges(&piece->a));
    ends->worst = test_worse(ends->worst, outside_of_edges(&piece->b));
}

/* With weakly bent normals no cell is cut: each piece runs from edge to edge. */
static void pieces_end_on_edges(void) {
    Ends ends = {0, 0.0};
    uint64_t state = 3;
    for (int trial = 0; trial < 100; ++trial) {
        SceneLight light;
        const SpecularFace face = random_face(&state, 1.0 / 1.5, 0.02, &light);
        const SpecularSegment segment = random_segment(&state, &face);
        const int before = ends.count;
        search_whole(&face, &segment, check_ends, &ends);
        ENSURE(ends.count > before);
    }
    ENSURE(ends.worst < 1e-9);
}

/* Flat water under a point light: the refracted path by halving on Snell's law. */
static double slab_offset(double n, double height, double depth, double range) {
    double low = 0.0, high = range;
    for (int i = 0; i < 60; ++i) {
        const double x = 0.5 * (low + high);
        const double above = x / hypot(x, height), below = (range - x) / hypot(range - x, depth);
        if (above < n * below)
            low = x;
        else
            high = x;
    }
    return 0.5 * (low + high);
}

typedef struct SlabCheck {
    double n, height, worst;
    int count;
} SlabCheck;

static void check_slab(void *user, const CurvePiece *piece) {
    SlabCheck *slab = user;
    for (int i = 0; i <= 4; ++i) {
        CurvePoint point;
        /* Light that nearly grazes is of no account. */
        if (!specular_curve_at(piece, i / 4.0, &point) || point.line.cos_t < 0.05)
            continue;
        const Vec3d x = meeting(piece, &point);
        if (!(point.s > 0.0) || !(x.z < -0.01))
            continue;
        const double range = hypot(x.x, x.y);
        const double expected = slab_offset(slab->n, slab->height, -x.z, range);
        const double offset = hypot(point.line.p.x, point.line.p.y);
        slab->worst = test_worse(slab->worst, fabs(offset - expected) / (1.0 + range));
        ++slab->count;
        /* Irradiance as of docs: I T exp(..) / |B_sag B_mer|, the widths of the beam. */
        const double c = point.line.cos_i, ct = point.line.cos_t, h = slab->height, s = point.s;
        const double sagittal = h / c + s / slab->n;
        const double meridional = h / c * ct / c + s / slab->n * c / ct;
        const double e = traced_irradiance(piece->face, point.u, point.v, s);
        const double enters = specular_entering(piece->face, &point.line) /
                              specular_arriving(piece->face, &point.line);
        slab->worst = test_worse(slab->worst, fabs(e * sagittal * meridional / enters - 1.0));
    }
}

static void slab_matches_snell(void) {
    static const double indices[] = {1.5, 1.33, 1.0, 0.8};
    uint64_t state = 4;
    for (int trial = 0; trial < 40; ++trial) {
        SceneLight light;
        SlabCheck slab = {.n = indices[trial % 4], .height = 1.5};
        SpecularFace face = random_face(&state, 1.0 / slab.n, 0.0, &light);
        face.p = (Vec3d){-3, -3, 0};
        face.p_u = (Vec3d){8, 0, 0};
        face.p_v = (Vec3d){0, 8, 0};
        face.n = face.ng = (Vec3d){0, 0, 1};
        face.n_u = face.n_v = (Vec3d){0, 0, 0};
        face.area = 32.0;
        light.kind = AMB_LIGHT_POINT;
        light.position = vec3(0, 0, (float)slab.height);
        face.to_light = vec3d_from(light.position);
        SpecularSegment segment = {.d = unit(random_vector(&state, 1.0)), .length = 2.0};
        segment.o = vec3d_sub(random_vector(&state, 0.5), (Vec3d){0, 0, 0.8});
        search_whole(&face, &segment, check_slab, &slab);
        ENSURE(slab.count > 0);
        ENSURE(slab.worst < 3e-4);
    }
}

/* ---- The field ------------------------------------------------------------------------------- */

typedef struct Body {
    AmbScene *scene;
    Shape shape;
    Job job;
} Body;

static Body make_body(bool is_box, bool is_smooth, float ior, uint32_t kind) {
    Body body;
    body.shape = is_box ? shape_box() : shape_sphere(10, 14);
    ENSURE_STATUS(amb_scene_create(&body.scene), AMB_OK);
    const AmbMaterial resin = shape_resin(ior, 0.6f, 0.1f, 0.5f);
    uint32_t material;
    ENSURE_STATUS(amb_scene_add_material(body.scene, &resin, &material), AMB_OK);
    const AmbMesh mesh = shape_mesh(&body.shape, "body", is_smooth);
    shape_add(body.scene, &mesh, material, 1.0f, 0, 0, 0);
    AmbLight light;
    amb_light_init(&light, kind);
    light.color[0] = light.color[1] = light.color[2] = 10.0f;
    light.position[0] = 0.7f;
    light.position[1] = 0.4f;
    light.position[2] = 3.0f;
    light.direction[0] = -0.3f;
    light.direction[1] = -0.2f;
    light.direction[2] = -1.0f;
    light.angle = 0.0f;
    light.radius = 0.0f;
    light.spot_size = 0.4f;
    uint32_t id;
    ENSURE_STATUS(amb_scene_add_light(body.scene, &light, &id), AMB_OK);
    AmbCamera camera;
    amb_camera_init(&camera, AMB_CAMERA_ORTHOGRAPHIC);
    ENSURE_STATUS(amb_scene_set_camera(body.scene, &camera), AMB_OK);
    ENSURE_STATUS(amb_scene_commit(body.scene), AMB_OK);
    job_init(&body.job, 2);
    ENSURE_STATUS(scene_build(body.scene, &body.job), AMB_OK);
    return body;
}

static void free_body(Body *body) {
    amb_scene_destroy(body->scene);
    shape_free(&body->shape);
}

static FieldRadiance gather_frequency(const Field *field, const FieldSegment *segment) {
    FieldRadiance out;
    field_gather_many(field, segment, 1, 1, &out);
    return out;
}

/* A chord of the body. */
static FieldSegment random_chord(uint64_t *state, const AmbScene *scene) {
    for (;;) {
        const Vec3 p = vec3d_round(random_vector(state, 0.6));
        const Vec3 d = vec3d_round(unit(random_vector(state, 1.0)));
        Hit back, front;
        if (scene_intersect(scene, p, vec3_negate(d), INFINITY, &back) &&
            scene_intersect(scene, p, d, INFINITY, &front))
            return (FieldSegment){
                .o = vec3_madd(p, -back.t, d), .d = d, .length = back.t + front.t, .object = 0};
    }
}

static Field *make_field(Body *body, uint32_t estimator, bool adjoint_normals) {
    const FieldParams params = {
        .estimator = estimator, .tube_refinement = 4, .adjoint_normals = adjoint_normals};
    Field *field = NULL;
    ENSURE_STATUS(field_create(body->scene, NULL, &params, &body->job, &field), AMB_OK);
    return field;
}

/* Coarse meshes with normals that vary much: a cube with the normals of a ball, a ball of few
 * triangles. */
static void coarse_meshes_agree_with_fine_tubes(void) {
    static const float iors[] = {1.5f, 1.0f, 0.8f};
    static const uint32_t kinds[] = {AMB_LIGHT_POINT, AMB_LIGHT_SUN, AMB_LIGHT_SPOT};
    for (int i = 0; i < 12; ++i) {
        Body body = make_body(i % 2 == 0, true, iors[i / 2 % 3], kinds[i / 4]);
        Field *exact = make_field(&body, AMB_ESTIMATOR_SPECULAR, i % 4 < 2);
        Field *tubes = make_field(&body, AMB_ESTIMATOR_TUBES, i % 4 < 2);
        LightTally exact_tally = {.incident = {0}}, tubes_tally = {.incident = {0}};
        SceneLeaks leaks = {0, 0};
        field_tally(exact, &exact_tally, &leaks);
        field_tally(tubes, &tubes_tally, &leaks);
        ENSURE_NEAR(exact_tally.entered[1] / tubes_tally.entered[1], 1.0, 0.02);
        uint64_t state = 5;
        double sum = 0.0, expected = 0.0, frequency = 0.0, difference = 0.0;
        double straight[4] = {0, 0, 0, 0};
        for (int trial = 0; trial < 300; ++trial) {
            FieldSegment segment = random_chord(&state, body.scene);
            segment.straight = rgb(0.5f, 0.2f, 0.0f);
            const FieldRadiance a = gather_frequency(exact, &segment);
            const FieldRadiance b = gather_frequency(tubes, &segment);
            sum += (double)a.radiance.g;
            expected += (double)b.radiance.g;
            difference += fabs((double)a.radiance.g - (double)b.radiance.g);
            frequency += (double)(a.frequency - b.frequency);
            straight[0] += (double)a.straight_once.r;
            straight[1] += (double)b.straight_once.r;
            straight[2] += (double)a.straight_more.r;
            straight[3] += (double)b.straight_more.r;
            ENSURE(a.straight_more.b == 0.0f && b.straight_more.b == 0.0f);
            ENSURE(a.frequency >= 0.0f && a.frequency <= a.contribution * 1.00001f);
        }
        ENSURE(expected > 0.1);
        ENSURE_NEAR(sum / expected, 1.0, 4e-3);
        ENSURE(difference < 0.02 * expected);
        ENSURE(fabs(frequency) < 0.01 * expected);
        ENSURE_NEAR(straight[0] / straight[1], 1.0, 4e-3);
        ENSURE_NEAR(straight[2] / straight[3], 1.0, 4e-3);
        field_destroy(exact);
        field_destroy(tubes);
        free_body(&body);
    }
}

/* A cube of flat faces under a sun: light lines are parallel inside. Seen along them, and more and
 * more nearly so, the whole segment is lit through a smaller and smaller part of one triangle. */
static void views_along_the_light_are_exact(void) {
    static const double tilts[] = {0.0, 1e-15, 1e-9, 1e-7, 1e-5, 1e-3, 0.1};
    static const float iors[] = {1.5f, 1.0f};
    for (int i = 0; i < 4; ++i) {
        Body body = make_body(true, false, iors[i % 2], AMB_LIGHT_SUN);
        /* From above, so that side faces take up next to nothing. */
        SceneLight *sun = &body.scene->lights[0];
        sun->direction = vec3_normalize(vec3(-0.003f, -0.002f, -1.0f));
        vec3_frame(sun->direction, &sun->x, &sun->y);
        const double ior = (double)iors[i % 2];
        const Vec3d light = unit(vec3d_from(sun->direction));
        const Vec3d wide = vec3d_scale((Vec3d){light.x, light.y, 0}, 1.0 / ior);
        const double cos_t = sqrt(1.0 - wide.x * wide.x - wide.y * wide.y);
        const Vec3d w = {wide.x, wide.y, -cos_t};
        const double c = -light.z;
        const double parallel = (ior * c - cos_t) / (ior * c + cos_t);
        const double perpendicular = (c - ior * cos_t) / (c + ior * cos_t);
        const double enters = 1.0 - 0.5 * (parallel * parallel + perpendicular * perpendicular);
        Field *field = make_field(&body, AMB_ESTIMATOR_SPECULAR, false);
        for (size_t k = 0; k < sizeof tilts / sizeof tilts[0]; ++k) {
            const double side = i < 2 ? 1.0 : -1.0;
            const Vec3d d = unit(vec3d_madd(vec3d_scale(w, side), tilts[k], (Vec3d){0.6, 0.8, 0}));
            /* Half a metre around a point 0.6 below the top, where all light is from the top. */
            const Vec3d x = {0.11, 0.07, 0.4};
            const FieldSegment segment = {.o = vec3d_round(vec3d_madd(x, -0.25, d)),
                                          .d = vec3d_round(d),
                                          .length = 0.5f,
                                          .object = 0};
            double expected = 0.0;
            enum { STEPS = 200 };
            for (int n = 0; n < STEPS; ++n) {
                const double t = 0.5 * (n + 0.5) / STEPS;
                const Vec3d at = vec3d_madd(vec3d_from(segment.o), t, d);
                expected += exp(-0.7 * (t + (1.0 - at.z) / cos_t)) * 0.5 / STEPS;
            }
            const double p = (double)phase_hg((float)-vec3d_dot(w, d), 0.5f);
            expected *= 10.0 * c / cos_t * enters * 0.6 * p;
            const FieldRadiance found = field_gather(field, &segment);
            ENSURE_NEAR((double)found.radiance.r / expected, 1.0, 2e-4);
        }
        field_destroy(field);
        free_body(&body);
    }
}

static void tree_loses_no_cell(void) {
    for (int i = 0; i < 2; ++i) {
        Body body = make_body(i == 0, true, 1.5f, AMB_LIGHT_POINT);
        SpecularField field;
        SpecularCount count = {0};
        ENSURE_STATUS(specular_build(body.scene, 0, true, &body.job, &count, &field), AMB_OK);
        uint64_t state = 6;
        for (int trial = 0; trial < 20; ++trial) {
            const FieldSegment s = random_chord(&state, body.scene);
            const FieldRadiance all = specular_gather(&field, &s);
            double sum = 0.0;
            for (uint64_t c = 0; c < field.tree.cell_count; ++c) {
                /* A ball around everything, and all directions. */
                SpecularCell *cell = memory_copy_array(&field.tree.cells[c], 1, sizeof *cell);
                ENSURE(cell != NULL);
                cell->bound = (LineBound){.radius = 10.0f, .spread = 10.0f};
                SpecularField one = field;
                ENSURE_STATUS(specular_tree_build(cell, 1, 1.0f, &body.job, &one.tree), AMB_OK);
                sum += (double)specular_gather(&one, &s).radiance.r;
                specular_clear(&one);
            }
            ENSURE(sum > 0.0);
            ENSURE_NEAR(all.radiance.r, sum, 1e-5 * sum);
        }
        specular_clear(&field);
        free_body(&body);
    }
}

static void build_does_not_depend_on_threads_and_can_be_cancelled(void) {
    Body body = make_body(false, true, 1.5f, AMB_LIGHT_POINT);
    SpecularField one, many, none;
    SpecularCount count = {0};
    ENSURE_STATUS(specular_build(body.scene, 0, true, &body.job, &count, &one), AMB_OK);
    Job job;
    job_init(&job, 5);
    ENSURE_STATUS(specular_build(body.scene, 0, true, &job, &count, &many), AMB_OK);
    ENSURE(one.tree.cell_count == many.tree.cell_count && one.tree.cell_count > 50);
    for (uint64_t c = 0; c < one.tree.cell_count; ++c)
        ENSURE(one.tree.cells[c].triangle == many.tree.cells[c].triangle &&
               one.tree.cells[c].reach == many.tree.cells[c].reach);
    ENSURE(specular_bytes(&one) == specular_bytes(&many));
    job.cancelled = true;
    ENSURE_STATUS(specular_build(body.scene, 0, true, &job, &count, &none), AMB_CANCELLED);
    specular_clear(&one);
    specular_clear(&many);
    free_body(&body);
}

void test_specular(void);

void test_specular(void) {
    RUN(derivatives_match_differences);
    RUN(curve_is_that_of_the_half_vector);
    RUN(pieces_end_on_edges);
    RUN(slab_matches_snell);
    RUN(coarse_meshes_agree_with_fine_tubes);
    RUN(views_along_the_light_are_exact);
    RUN(tree_loses_no_cell);
    RUN(build_does_not_depend_on_threads_and_can_be_cancelled);
}
