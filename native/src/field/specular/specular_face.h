/* SPDX-License-Identifier: GPL-3.0-or-later
 * One triangle of a boundary under one light: the refracted light line at each of its points, with
 * derivatives. All in double: the estimator is a reference for the others.
 *
 * The condition on a point P of the triangle is that of [Walter09] and [Holzschuch15], light that
 * refracts at P with the interpolated normal N passes through x:
 *   H / |H| + N = 0,   H = n w_V + w_L.
 * They solve it as it stands. Here it is solved for the refracted direction w(P), which must point
 * to x: the same points P where the index n is larger than 1, and n = 1, where H vanishes, and
 * n < 1 are no exceptions. */
#ifndef AMB_FIELD_SPECULAR_SPECULAR_FACE_H
#define AMB_FIELD_SPECULAR_SPECULAR_FACE_H

#include "math/vec3d.h"
#include "scene/scene.h"

typedef struct SpecularFace {
    const SceneLight *light;
    Vec3d p, p_u, p_v; /* p + u p_u + v p_v, m */
    Vec3d n, n_u, n_v; /* the interpolated normal before it is normalised */
    Vec3d ng;          /* unit, outward */
    Vec3d to_light;    /* SUN: unit; else the light's place */
    double eta;        /* n outside / n inside */
    double area;       /* m^2 */
    Rgb color;         /* of the light and of the surface's tint */
    bool adjoint_normals;
} SpecularFace;

/* The light line x + s w that a point of the face sends on. */
typedef struct SpecularLine {
    Vec3d p, w;     /* w unit */
    Vec3d w_u, w_v; /* derivatives of w; those of p are the face's */
    Vec3d wi, n;    /* unit: to the light; normal that refracts */
    double cos_i, cos_t;
    bool is_total; /* total reflection: w is the nearest direction along the face */
} SpecularLine;

/* Places of the triangle that the index names, alone: p, p_u, p_v. */
SpecularFace specular_face_places(const AmbScene *scene, uint32_t object, uint32_t triangle);

/* Adds the rest; the area is larger than 0. */
void specular_face_light(const AmbScene *scene, uint32_t object, uint32_t triangle,
                         const SceneMaterial *material, const SceneLight *light,
                         bool adjoint_normals, SpecularFace *face);

static inline Vec3d specular_point(const SpecularFace *face, double u, double v) {
    return vec3d_madd(vec3d_madd(face->p, u, face->p_u), v, face->p_v);
}

/* Light line at barycentric weights u, v of the second and third vertex. */
SpecularLine specular_line(const SpecularFace *face, double u, double v);

/* Distance to the light, m; infinite for a sun. */
static inline double specular_light_distance(const SpecularFace *face, Vec3d p) {
    return face->light->kind == AMB_LIGHT_SUN ? (double)INFINITY
                                              : vec3d_length(vec3d_sub(face->to_light, p));
}

/* Flux that arrives there and goes on with the line, per area of the triangle and unit colour of
 * the light, 1/m^2; 0 where none enters. */
double specular_arriving(const SpecularFace *face, const SpecularLine *line);
double specular_entering(const SpecularFace *face, const SpecularLine *line);

#endif
