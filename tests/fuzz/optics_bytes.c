/* SPDX-License-Identifier: GPL-3.0-or-later
 * The operators of optics/ and of boundaries on inputs decoded from bytes: not only that they
 * return, but what must be true of what they return. */
#include <stdlib.h>
#include <string.h>

#include "fuzz.h"
#include "optics/covariance.h"
#include "optics/dielectric.h"
#include "optics/kernel.h"
#include "optics/medium.h"
#include "optics/tangent.h"
#include "scene/boundary.h"
#include "shapes.h"
#include "test.h"

/* What shapes.c checks. */
void test_check(bool is_true, const char *file, int line, const char *format, ...) {
    if (!is_true)
        fuzz_fail(file, line, "%s", format);
}

static Vec3 any_direction(Bytes *bytes) {
    const float z = (float)bytes_uniform(bytes, -1.0, 1.0);
    const float phi = (float)bytes_uniform(bytes, 0.0, 6.283185307);
    const float r = sqrtf((1.0f - z) * (1.0f + z));
    return vec3_normalize(vec3(r * cosf(phi), r * sinf(phi), z));
}

/* A direction that arrives at n, from straight on to grazing within 1e-9. */
static Vec3 any_arrival(Bytes *bytes, Vec3 n, double *out_cosine) {
    Vec3 x, y;
    vec3_frame(n, &x, &y);
    const bool is_grazing = bytes_below(bytes, 2) == 0;
    const double c = is_grazing ? bytes_log(bytes, -9.0, 0.0) : bytes_uniform(bytes, 1e-3, 1.0);
    const double s = sqrt((1.0 - c) * (1.0 + c));
    const double phi = bytes_uniform(bytes, 0.0, 6.283185307);
    const Vec3 d =
        vec3_add(vec3_scale(n, (float)-c), vec3_add(vec3_scale(x, (float)(s * cos(phi))),
                                                    vec3_scale(y, (float)(s * sin(phi)))));
    const Vec3 unit = vec3_normalize(d);
    *out_cosine = -(double)vec3_dot(unit, n);
    return unit;
}

static float any_eta(Bytes *bytes) {
    switch (bytes_below(bytes, 4)) {
    case 0:
        return 1.0f;
    case 1:
        return 1.0f + (float)(bytes_log(bytes, -7.0, -1.0) * (bytes_below(bytes, 2) ? 1.0 : -1.0));
    default:
        return (float)bytes_log(bytes, -2.0, 2.0); /* two media of ior 0.1 .. 10 */
    }
}

static bool is_unit(Vec3 v, float tolerance) {
    return fabsf(vec3_dot(v, v) - 1.0f) <= tolerance;
}

void fuzz_dielectric(const uint8_t *data, size_t size) {
    Bytes bytes = {data, size, 0};
    const Vec3 n = any_direction(&bytes);
    double cosine;
    const Vec3 d = any_arrival(&bytes, n, &cosine);
    const float eta = any_eta(&bytes);
    if (!(cosine > 0.0))
        return;
    const DielectricSplit s = dielectric_split(d, n, eta);
    FUZZ_HOLDS(s.reflectance >= 0.0f && s.reflectance <= 1.0f, "F = %.9g, cos %g, eta %g",
               (double)s.reflectance, cosine, (double)eta);
    FUZZ_HOLDS(s.cos_i >= 0.0f && s.cos_i <= 1.0f && s.cos_t >= 0.0f && s.cos_t <= 1.0f,
               "cosines %g, %g", (double)s.cos_i, (double)s.cos_t);
    FUZZ_HOLDS(is_unit(s.reflected, 2e-6f) && vec3_dot(s.reflected, n) > -1e-6f, "reflected");
    if (eta == 1.0f) {
        FUZZ_HOLDS(s.reflectance == 0.0f && memcmp(&s.refracted, &d, sizeof d) == 0, "at eta 1");
        return;
    }
    /* Against Fresnel's equations in double, with the cosine that they see. */
    const double c = (double)s.cos_i, e = (double)eta, sin2_t = e * e * (1.0 - c * c);
    if (s.reflectance == 1.0f && s.cos_t == 0.0f) {
        FUZZ_HOLDS(sin2_t >= 1.0 - 1e-6, "total reflection at sin2 %.9g", sin2_t);
        return;
    }
    FUZZ_HOLDS(is_unit(s.refracted, 2e-6f), "refracted is not unit");
    const Vec3 along_d = vec3_madd(d, -vec3_dot(d, n), n);
    const Vec3 along_t = vec3_madd(s.refracted, -vec3_dot(s.refracted, n), n);
    const Vec3 snell = vec3_sub(along_t, vec3_scale(along_d, eta));
    FUZZ_HOLDS(vec3_length(snell) < 2e-6f * fmaxf(1.0f, eta * eta),
               "Snell's law is off by %g, eta %g", (double)vec3_length(snell), (double)eta);
    if (sin2_t >= 1.0)
        return;
    const double ct = sqrt(1.0 - sin2_t);
    const double a = (c - e * ct) / (c + e * ct), b = (e * c - ct) / (e * c + ct);
    const double f = 0.5 * (a * a + b * b);
    /* Beside the critical angle the rounding of 1 - sin^2 is the rounding of F's argument. */
    const double tolerance =
        4e-6 + 4.0 * 6e-8 / (ct > 1e-4 ? ct : 1e-4) + 4e-6 / (c > 1e-3 ? c : 1e-3);
    FUZZ_HOLDS(fabs((double)s.reflectance - f) <= tolerance * fmax(1.0, e * e),
               "F = %.9g, is %.9g; cos %g, eta %g", (double)s.reflectance, f, c, e);
}

static TangentPair any_pair(Bytes *bytes) {
    const Vec3 dp = vec3_scale(any_direction(bytes), (float)bytes_log(bytes, -6.0, 3.0));
    const Vec3 dd = vec3_scale(any_direction(bytes), (float)bytes_log(bytes, -6.0, 1.0));
    return (TangentPair){bytes_below(bytes, 8) == 0 ? vec3(0, 0, 0) : dp,
                         bytes_below(bytes, 8) == 0 ? vec3(0, 0, 0) : dd};
}

void fuzz_tangent(const uint8_t *data, size_t size) {
    Bytes bytes = {data, size, 0};
    const Vec3 n = any_direction(&bytes);
    double cosine;
    const Vec3 d = any_arrival(&bytes, n, &cosine);
    const float eta = any_eta(&bytes);
    if (!(cosine >= 1e-4)) /* the light pass drops what grazes more */
        return;
    const DielectricSplit s = dielectric_split(d, n, eta);
    const Vec3 across = vec3_scale(any_direction(&bytes), (float)bytes_log(&bytes, -6.0, 6.0));
    const Vec3 dn = vec3_madd(across, -vec3_dot(across, n), n);
    TangentPair pairs[TANGENT_COUNT];
    for (int k = 0; k < TANGENT_COUNT; ++k) {
        const TangentPair start = any_pair(&bytes);
        const float way = (float)bytes_log(&bytes, -6.0, 4.0);
        pairs[k] = tangent_travel_to_surface(start, way, d, n);
        /* dp on the way there, over the cosine, is what cancels. */
        const float scale = (vec3_length(start.dp) + way * vec3_length(start.dd)) / (float)cosine;
        FUZZ_HOLDS(fabsf(vec3_dot(pairs[k].dp, n)) <= 1e-6f * scale, "off the plane by %g of %g",
                   (double)vec3_dot(pairs[k].dp, n), (double)scale);
        const TangentPair mirrored = tangent_reflect(pairs[k], d, n, dn, s.cos_i);
        FUZZ_HOLDS(vec3_is_finite(mirrored.dp) && vec3_is_finite(mirrored.dd), "reflect");
        /* At a plane mirror an angle stays as large as it was. */
        const TangentPair plane = tangent_reflect(pairs[k], d, n, vec3(0, 0, 0), s.cos_i);
        const float before = vec3_length(pairs[k].dd);
        FUZZ_HOLDS(fabsf(vec3_length(plane.dd) - before) <= 1e-5f * before, "a plane mirror bends");
        if (s.reflectance < 1.0f)
            pairs[k] = tangent_refract(pairs[k], d, n, dn, eta, s.cos_i, s.cos_t);
        FUZZ_HOLDS(vec3_is_finite(pairs[k].dp) && vec3_is_finite(pairs[k].dd), "refract");
    }
    const Vec3 w = s.reflectance < 1.0f ? s.refracted : s.reflected;
    const TangentSpread spread = tangent_spread(pairs, w);
    for (int i = 0; i < 8; ++i) {
        const float at = (float)bytes_log(&bytes, -6.0, 3.0);
        const float all = tangent_cross_section(&spread, at);
        const float cell = tangent_cell_area(pairs, w, at);
        FUZZ_HOLDS(all >= 0.0f && isfinite(all) && cell >= 0.0f && isfinite(cell),
                   "areas %g, %g at %g", (double)all, (double)cell, (double)at);
    }
}

/* Ranges of operators in decades: where the module promises its digits (see its header), and all
 * that it takes. */
typedef struct Range {
    double cosine, length, curvature, index; /* 10^-cosine .. 1, 10^-length .. 10^length, ... */
} Range;

static const Range MODEST = {0.7, 1.0, 1.0, 0.3}, WILD = {3.9, 4.0, 3.0, 1.0};

static SurfaceCurvature any_curvature(Bytes *bytes, double range) {
    const double sign = bytes_below(bytes, 2) ? 1.0 : -1.0;
    const double x = sign * bytes_log(bytes, -range, range);
    const double y = sign * bytes_log(bytes, -range, range);
    const double mixed = bytes_uniform(bytes, -0.9, 0.9) * sqrt(fabs(x * y));
    return bytes_below(bytes, 4) == 0 ? (SurfaceCurvature){0, 0, 0}
                                      : (SurfaceCurvature){x, mixed, y};
}

static void change_covariance(Bytes *bytes, const Range *range, Covariance *sigma, double *flux) {
    const double cosine = bytes_log(bytes, -range->cosine, 0.0);
    switch (bytes_below(bytes, 9)) {
    case 0:
        covariance_travel(sigma, bytes_log(bytes, -range->length, range->length) *
                                     (bytes_below(bytes, 2) ? 1.0 : -1.0));
        break;
    case 1:
        covariance_rotate(sigma, bytes_uniform(bytes, -7.0, 7.0));
        break;
    case 2:
        covariance_refract(sigma, bytes_log(bytes, -range->index, range->index),
                           bytes_log(bytes, -range->index, range->index), cosine,
                           any_curvature(bytes, range->curvature));
        break;
    case 3:
        covariance_reflect(sigma, cosine, any_curvature(bytes, range->curvature));
        break;
    case 4:
        covariance_convolve_angle(sigma, bytes_log(bytes, -9.0, 3.0), bytes_log(bytes, -9.0, 3.0));
        break;
    case 5:
        covariance_scatter_hg(sigma, bytes_uniform(bytes, -0.999, 0.999),
                              bytes_uniform(bytes, -1.0, 1.0));
        break;
    case 6: {
        double h[4];
        for (int i = 0; i < 4; ++i)
            h[i] = bytes_uniform(bytes, -1.0, 1.0);
        covariance_window(sigma, h, bytes_log(bytes, -4.0, 2.0));
        break;
    }
    case 7:
        covariance_attenuate(sigma, bytes_log(bytes, -3.0, 3.0), bytes_uniform(bytes, -20.0, 20.0));
        break;
    default: {
        const Covariance other = covariance_point(bytes_log(bytes, -9.0, 0.0), 1.0);
        covariance_add(sigma, flux, &other, bytes_log(bytes, -3.0, 3.0));
        break;
    }
    }
}

void fuzz_covariance(const uint8_t *data, size_t size) {
    Bytes bytes = {data, size, 0};
    Covariance sigma;
    switch (bytes_below(&bytes, 5)) {
    case 0:
        sigma = covariance_point(bytes_log(&bytes, -9.0, 1.0), bytes_log(&bytes, -2.0, 2.0));
        break;
    case 1:
        sigma =
            covariance_directional(bytes_log(&bytes, -9.0, 1.0), bytes_uniform(&bytes, 0.0, 1.5),
                                   bytes_log(&bytes, -2.0, 2.0));
        break;
    case 2:
        sigma = covariance_spot(bytes_log(&bytes, -9.0, 0.0), bytes_log(&bytes, -4.0, 0.0),
                                bytes_log(&bytes, -2.0, 2.0));
        break;
    case 3:
        sigma = covariance_area(bytes_log(&bytes, -9.0, 0.0), bytes_log(&bytes, -6.0, 1.0),
                                bytes_log(&bytes, -2.0, 2.0));
        break;
    default:
        sigma = covariance_gaussian(bytes_log(&bytes, -4.0, 2.0), bytes_log(&bytes, -4.0, 2.0),
                                    bytes_log(&bytes, -4.0, 1.0), bytes_log(&bytes, -4.0, 1.0));
    }
    double flux = 1.0;
    FUZZ_HOLDS(covariance_is_valid(&sigma), "the source");
    const bool is_modest = bytes_below(&bytes, 2) == 0;
    const uint32_t steps = 1 + bytes_below(&bytes, 6);
    for (uint32_t i = 0; i < steps; ++i) {
        change_covariance(&bytes, is_modest ? &MODEST : &WILD, &sigma, &flux);
        /* Later ones may have lost the digits that tell the sign of the smallest eigenvalue. */
        if (is_modest && i == 0)
            FUZZ_HOLDS(covariance_is_valid(&sigma), "after one operator");
        for (int k = 0; k < 10; ++k)
            FUZZ_HOLDS(isfinite(sigma.c[k]), "step %u: entry %d is %g", i, k, sigma.c[k]);
        FUZZ_HOLDS(flux > 0.0 && isfinite(flux), "flux %g", flux);
        const double det = spatial_covariance_sqrt_det(covariance_spatial(&sigma));
        FUZZ_HOLDS(det >= 0.0, "sqrt|S| = %g", det);
        const double factor = covariance_frequency_factor(&sigma, bytes_log(&bytes, -9.0, 2.0));
        FUZZ_HOLDS(factor >= 0.0 && factor <= 1.0, "factor %g", factor);
    }
}

void fuzz_kernel(const uint8_t *data, size_t size) {
    Bytes bytes = {data, size, 0};
    const float entry = (float)bytes_log(&bytes, -12.0, 6.0);
    const float area = bytes_below(&bytes, 8) == 0 ? 0.0f : (float)bytes_log(&bytes, -20.0, 12.0);
    const float size_k = (float)bytes_log(&bytes, -6.0, 6.0);
    const float frequency = kernel_frequency(entry, area);
    FUZZ_HOLDS(frequency >= 0.0f && frequency <= 1.0f, "frequency %g", (double)frequency);
    const float multiplier = kernel_multiplier(size_k, frequency);
    FUZZ_HOLDS(multiplier >= 0.1999f * size_k && multiplier <= 1.0001f * size_k, "multiplier %g",
               (double)multiplier);
    /* The more light is concentrated, the smaller the kernel. */
    FUZZ_HOLDS(multiplier <= kernel_multiplier(size_k, 0.5f * frequency) * 1.000001f, "order");
    const float radius = kernel_radius(area * multiplier);
    FUZZ_HOLDS(radius >= 0.0f && isfinite(radius), "radius %g", (double)radius);
}

void fuzz_phase(const uint8_t *data, size_t size) {
    Bytes bytes = {data, size, 0};
    const float g = (float)(bytes_below(&bytes, 2) ? bytes_uniform(&bytes, -0.9999, 0.9999)
                                                   : (1.0 - bytes_log(&bytes, -4.0, 0.0)) *
                                                         (bytes_below(&bytes, 2) ? 1.0 : -1.0));
    const float cosine =
        bytes_below(&bytes, 4) == 0 ? 1.0000001f : (float)bytes_uniform(&bytes, -1.0, 1.0);
    const float p = phase_hg(cosine, g), back = phase_hg(-cosine, -g);
    const double a = fabs((double)g);
    const double peak = (1.0 + a) / (12.566370614 * (1.0 - a) * (1.0 - a));
    FUZZ_HOLDS(p >= 0.0f && (double)p <= peak * 1.0001, "p(%g, %g) = %g", (double)cosine, (double)g,
               (double)p);
    FUZZ_HOLDS(p == back, "not the mirror image");
    const double c = fmin((double)cosine, 1.0), e = (double)g;
    const double base = g > 0.0f ? (1.0 - e) * (1.0 - e) + 2.0 * e * (1.0 - c)
                                 : (1.0 + e) * (1.0 + e) - 2.0 * e * (1.0 + c);
    const double exact = (1.0 - e) * (1.0 + e) / (12.566370614359172 * base * sqrt(base));
    if (fabs((double)cosine) <= 1.0)
        FUZZ_HOLDS(fabs((double)p / exact - 1.0) < 1e-4, "p = %g, is %g (cos %.9g, g %.9g)",
                   (double)p, exact, c, e);
    Medium medium = {.sigma_t = {(float)bytes_log(&bytes, -6.0, 9.0),
                                 (float)bytes_log(&bytes, -6.0, 9.0), 0.0f}};
    const float s = (float)bytes_log(&bytes, -9.0, 9.0), t = (float)bytes_log(&bytes, -9.0, 9.0);
    const Rgb one = medium_transmittance(&medium, s), two = medium_transmittance(&medium, t);
    const Rgb both = medium_transmittance(&medium, s + t);
    FUZZ_HOLDS(one.r >= 0.0f && one.r <= 1.0f && one.b == 1.0f, "transmittance %g", (double)one.r);
    /* exp of a rounded product: relative error of the depth times the depth. */
    const float tolerance = 1e-6f * (1.0f + medium.sigma_t.r * (s + t));
    FUZZ_HOLDS(fabsf(both.r - one.r * two.r) <= tolerance * both.r + 1e-37f,
               "T(s + t) = %g, T(s) T(t) = %g", (double)both.r, (double)(one.r * two.r));
}

/* Spheres that overlap, touch, and are inside of one another. */
static AmbScene *boundary_scene(void) {
    static AmbScene *scene;
    if (scene != NULL)
        return scene;
    Shape sphere = shape_sphere(12, 20);
    const AmbMesh mesh = shape_mesh(&sphere, "sphere", true);
    AmbCamera camera;
    amb_camera_init(&camera, AMB_CAMERA_PERSPECTIVE);
    static const float iors[4] = {1.5f, 1.0f, 2.4f, 0.7f};
    if (amb_scene_create(&scene) != AMB_OK || amb_scene_set_camera(scene, &camera) != AMB_OK)
        abort();
    for (uint32_t i = 0; i < 4; ++i) {
        AmbMaterial material = shape_resin(iors[i], 1.0f, 0.1f, 0.0f);
        uint32_t id;
        if (amb_scene_add_material(scene, &material, &id) != AMB_OK)
            abort();
        shape_add(scene, &mesh, id, i == 1 ? 0.5f : 1.0f, i == 2 ? 1.0f : 0.0f, 0.0f,
                  i == 3 ? 2.0f : 0.0f);
    }
    Job job;
    job_init(&job, 1);
    if (amb_scene_commit(scene) != AMB_OK || scene_build(scene, &job) != AMB_OK)
        abort();
    shape_free(&sphere);
    return scene;
}

void fuzz_boundary(const uint8_t *data, size_t size) {
    const AmbScene *scene = boundary_scene();
    Bytes bytes = {data, size, 0};
    Vec3 o = vec3((float)bytes_uniform(&bytes, -2.0, 2.5), (float)bytes_uniform(&bytes, -2.0, 2.0),
                  (float)bytes_uniform(&bytes, -2.0, 4.0));
    Vec3 d = any_direction(&bytes);
    MediumStack stack = scene_media_at(scene, o);
    const uint32_t steps = 1 + bytes_below(&bytes, 8);
    for (uint32_t i = 0; i < steps; ++i) {
        BoundaryArrival arrival;
        FUZZ_HOLDS(stack.count <= MEDIUM_STACK_MAX, "%u media", stack.count);
        if (!boundary_find(scene, &stack, o, d, INFINITY, &arrival))
            break;
        const BoundaryCrossing *crossing = &arrival.crossing;
        FUZZ_HOLDS(arrival.t >= 0.0f && isfinite(arrival.t) && !arrival.is_opaque, "t = %g",
                   (double)arrival.t);
        FUZZ_HOLDS(crossing->eta > 0.06f && crossing->eta < 16.0f, "eta %g", (double)crossing->eta);
        const DielectricSplit *split = &crossing->split;
        FUZZ_HOLDS(split->reflectance >= 0.0f && split->reflectance <= 1.0f, "F %g",
                   (double)split->reflectance);
        FUZZ_HOLDS(vec3_dot(d, crossing->n) <= 0.0f, "the normal is behind");
        FUZZ_HOLDS(isfinite(crossing->adjoint_refract) && isfinite(crossing->adjoint_reflect) &&
                       crossing->adjoint_refract >= 0.0f && crossing->adjoint_reflect >= 0.0f,
                   "adjoint factors %g, %g", (double)crossing->adjoint_refract,
                   (double)crossing->adjoint_reflect);
        const bool refracts = crossing->can_refract && bytes_below(&bytes, 4) > 0;
        if (!refracts && !crossing->can_reflect)
            break;
        d = refracts ? split->refracted : split->reflected;
        FUZZ_HOLDS(is_unit(d, 1e-5f), "direction");
        if (refracts)
            stack = crossing->beyond;
        o = scene_leave(&crossing->surface, d);
    }
}
