/* SPDX-License-Identifier: GPL-3.0-or-later
 * Refraction of one light at one triangle. */
#include "field/specular/specular_face.h"

/* Cosine of incidence to which normals are turned back that interpolation turned away from the
 * light, near silhouettes: what enters there carries nothing to speak of, and the refracted map
 * has no jump. */
static const double GRAZING_COS = 1e-3;
/* Where the refracted light grazes the face, Snell's law has an infinite derivative; only the
 * search for solutions uses it there. */
static const double COS_T_MIN = 1e-6;

SpecularFace specular_face_places(const AmbScene *scene, uint32_t object, uint32_t triangle) {
    const SceneObject *body = &scene->objects[object];
    const uint32_t *index = scene->meshes[body->mesh].triangles + 3 * (uint64_t)triangle;
    SpecularFace face = {.p = vec3d_from(body->positions[index[0]])};
    face.p_u = vec3d_sub(vec3d_from(body->positions[index[1]]), face.p);
    face.p_v = vec3d_sub(vec3d_from(body->positions[index[2]]), face.p);
    return face;
}

void specular_face_light(const AmbScene *scene, uint32_t object, uint32_t triangle,
                         const SceneMaterial *material, const SceneLight *light,
                         bool adjoint_normals, SpecularFace *face) {
    const SceneObject *body = &scene->objects[object];
    const SceneMesh *mesh = &scene->meshes[body->mesh];
    const Vec3d cross = vec3d_cross(face->p_u, face->p_v);
    const double twice_area = vec3d_length(cross);
    face->light = light;
    face->eta = 1.0 / (double)material->ior;
    face->color = rgb_mul(light->color, material->transmit_color);
    face->adjoint_normals = adjoint_normals;
    face->area = 0.5 * twice_area;
    face->ng = vec3d_scale(cross, (body->is_flipped ? -1.0 : 1.0) / twice_area);
    face->n = face->ng;
    face->n_u = face->n_v = (Vec3d){0, 0, 0};
    if (body->normals != NULL) {
        const uint32_t *index = mesh->triangles + 3 * (uint64_t)triangle;
        Vec3d n[3];
        for (uint32_t k = 0; k < 3; ++k)
            n[k] = vec3d_from(body->normals[mesh->normal_domain == AMB_NORMALS_VERTEX
                                                ? index[k]
                                                : 3 * (uint64_t)triangle + k]);
        face->n = n[0];
        face->n_u = vec3d_sub(n[1], n[0]);
        face->n_v = vec3d_sub(n[2], n[0]);
    }
    if (light->kind == AMB_LIGHT_SUN) {
        const Vec3d to_light = vec3d_negate(vec3d_from(light->direction));
        face->to_light = vec3d_scale(to_light, 1.0 / vec3d_length(to_light));
    } else {
        face->to_light = vec3d_from(light->position);
    }
}

/* A unit vector and its derivatives. */
typedef struct Unit {
    Vec3d v, v_u, v_v;
} Unit;

static Vec3d without(Vec3d a, Vec3d unit, double scale) {
    return vec3d_scale(vec3d_madd(a, -vec3d_dot(a, unit), unit), scale);
}

/* Normalised; the derivatives too. */
static Unit normalize(Vec3d v, Vec3d v_u, Vec3d v_v, double length) {
    const double scale = 1.0 / length;
    const Vec3d unit = vec3d_scale(v, scale);
    return (Unit){unit, without(v_u, unit, scale), without(v_v, unit, scale)};
}

static Unit light_direction(const SpecularFace *face, Vec3d p) {
    if (face->light->kind == AMB_LIGHT_SUN)
        return (Unit){face->to_light, {0, 0, 0}, {0, 0, 0}};
    const Vec3d to = vec3d_sub(face->to_light, p);
    return normalize(to, vec3d_negate(face->p_u), vec3d_negate(face->p_v), vec3d_length(to));
}

/* The shading normal on the side of the face. */
static Unit shading_normal(const SpecularFace *face, double u, double v) {
    const Vec3d raw = vec3d_madd(vec3d_madd(face->n, u, face->n_u), v, face->n_v);
    const double side = vec3d_dot(raw, face->ng), length = vec3d_length(raw);
    if (!(length > 0.0) || side == 0.0)
        return (Unit){face->ng, {0, 0, 0}, {0, 0, 0}};
    return normalize(raw, face->n_u, face->n_v, copysign(length, side));
}

/* Turned back to the light until it grazes. */
static Unit turned_back(Unit n, Unit wi, double cos_s) {
    const double k = GRAZING_COS - cos_s;
    const double k_u = -vec3d_dot(wi.v_u, n.v) - vec3d_dot(wi.v, n.v_u);
    const double k_v = -vec3d_dot(wi.v_v, n.v) - vec3d_dot(wi.v, n.v_v);
    const Vec3d v = vec3d_madd(n.v, k, wi.v);
    const Vec3d v_u = vec3d_madd(vec3d_madd(n.v_u, k, wi.v_u), k_u, wi.v);
    const Vec3d v_v = vec3d_madd(vec3d_madd(n.v_v, k, wi.v_v), k_v, wi.v);
    return normalize(v, v_u, v_v, vec3d_length(v));
}

SpecularLine specular_line(const SpecularFace *face, double u, double v) {
    SpecularLine line = {.p = specular_point(face, u, v)};
    const Unit wi = light_direction(face, line.p);
    Unit n = shading_normal(face, u, v);
    double c = vec3d_dot(wi.v, n.v);
    if (c < GRAZING_COS) {
        n = turned_back(n, wi, c);
        c = vec3d_dot(wi.v, n.v);
    }
    const double eta = face->eta;
    const double cos2_t = 1.0 - eta * eta * (1.0 - c * c);
    line.is_total = cos2_t <= 0.0;
    line.wi = wi.v;
    line.n = n.v;
    line.cos_i = c;
    line.cos_t = eta == 1.0 ? c : sqrt(fmax(cos2_t, 0.0));
    /* w = -eta wi + m n and its derivatives; at total reflection cos_t stays 0. */
    const double m = eta * c - line.cos_t;
    const double slope = line.is_total ? eta : eta - eta * eta * c / fmax(line.cos_t, COS_T_MIN);
    const double m_u = slope * (vec3d_dot(wi.v_u, n.v) + vec3d_dot(wi.v, n.v_u));
    const double m_v = slope * (vec3d_dot(wi.v_v, n.v) + vec3d_dot(wi.v, n.v_v));
    line.w = vec3d_madd(vec3d_scale(wi.v, -eta), m, n.v);
    line.w_u = vec3d_madd(vec3d_madd(vec3d_scale(wi.v_u, -eta), m, n.v_u), m_u, n.v);
    line.w_v = vec3d_madd(vec3d_madd(vec3d_scale(wi.v_v, -eta), m, n.v_v), m_v, n.v);
    if (line.is_total) {
        const Unit w = normalize(line.w, line.w_u, line.w_v, vec3d_length(line.w));
        line.w = w.v;
        line.w_u = w.v_u;
        line.w_v = w.v_v;
    }
    return line;
}

double specular_arriving(const SpecularFace *face, const SpecularLine *line) {
    const LightArrival light =
        light_arrival(face->light, vec3d_round(line->p), (Sample2){0.5f, 0.5f});
    const float color = rgb_max(face->light->color);
    const double cos_g = vec3d_dot(line->wi, face->ng);
    if (!(color > 0.0f) || !(cos_g > 0.0))
        return 0.0;
    return (double)(rgb_max(light.irradiance) / color) * cos_g;
}

double specular_entering(const SpecularFace *face, const SpecularLine *line) {
    const double cos_g = vec3d_dot(line->wi, face->ng);
    const double below = -vec3d_dot(line->w, face->ng);
    const double c = line->cos_i, cos_t = line->cos_t, eta = face->eta;
    if (line->is_total || !(cos_t > 0.0) || !(below > 0.0) || !(cos_g > 0.0))
        return 0.0;
    /* 1 - F with the two amplitudes of Fresnel's formulae; exactly 1 at eta = 1. */
    const double parallel = (c - eta * cos_t) / (c + eta * cos_t);
    const double perpendicular = (eta * c - cos_t) / (eta * c + cos_t);
    double flux = specular_arriving(face, line) *
                  (1.0 - 0.5 * (parallel * parallel + perpendicular * perpendicular));
    /* Veach's factor for shading normals, see BoundaryCrossing. */
    if (face->adjoint_normals)
        flux *= c * below / (cos_g * cos_t);
    return flux;
}
