/* SPDX-License-Identifier: GPL-3.0-or-later
 * Ray queries against triangles; Embree stays behind this header. */
#ifndef AMB_SCENE_INTERSECT_H
#define AMB_SCENE_INTERSECT_H

#include "base/parallel.h"
#include "math/vec3.h"

typedef struct Intersector Intersector;

typedef struct Hit {
    float t;           /* m */
    float u, v;        /* barycentric weights of the triangle's second and third vertex */
    uint32_t geometry; /* order of intersector_add */
    uint32_t triangle;
} Hit;

AmbStatus intersector_create(uint32_t thread_count, Intersector **out_intersector);
void intersector_destroy(Intersector *intersector);

/* Adds triangles; the arrays are shared and must outlive the intersector. positions must be
 * readable for 4 bytes past its end. */
AmbStatus intersector_add(Intersector *intersector, const Vec3 *positions, uint64_t vertex_count,
                          const uint32_t *triangles, uint64_t triangle_count);

/* Before the commit: intersector_all will be asked. Other queries may become a little slower. */
void intersector_enable_all(Intersector *intersector);

/* Builds the tree; AMB_CANCELLED when the job is cancelled meanwhile. */
AmbStatus intersector_commit(Intersector *intersector, Job *job);

/* After the commit, from any thread. d need not be unit; t is in units of its length. */
bool intersector_nearest(Intersector *intersector, Vec3 o, Vec3 d, float t_max, Hit *out_hit);
bool intersector_any(Intersector *intersector, Vec3 o, Vec3 d, float t_max);

/* The point of the surfaces that is nearest to p; false: none is nearer than reach. */
bool intersector_closest(const Intersector *intersector, Vec3 p, float reach, Vec3 *out_point);

/* Every triangle along the way, in the order of geometry and triangle; returns their number, `room`
 * at most. */
uint32_t intersector_all(Intersector *intersector, Vec3 o, Vec3 d, float t_max, Hit *out_hits,
                         uint32_t room);

/* Rays so far that held a value that is no number: they meet nothing. Above zero it is a defect. */
uint64_t intersector_nonfinite(const Intersector *intersector);

uint64_t intersector_bytes(const Intersector *intersector);

/* See amb_self_test. */
AmbStatus intersector_self_test(void);

#endif
