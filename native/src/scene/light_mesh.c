/* SPDX-License-Identifier: GPL-3.0-or-later
 * The places from which meshes shine. */
#include "scene/light_mesh.h"

#include "base/memory.h"
#include "math/vec3d.h"

static uint32_t part_of(const LightMesh *mesh, uint64_t triangle) {
    return (uint32_t)(triangle * LIGHT_MESH_PARTS / mesh->count);
}

static uint64_t find_triangle(const LightMesh *mesh, double at) {
    uint64_t low = 0, high = mesh->count - 1; /* the first whose sum is above `at` */
    while (low < high) {
        const uint64_t middle = (low + high) / 2;
        if (mesh->sums[middle] > at)
            high = middle;
        else
            low = middle + 1;
    }
    return low;
}

LightPlace light_mesh_place(const LightMesh *mesh, Sample2 u) {
    const double power = light_mesh_power(mesh), at = (double)u.u * power;
    const uint64_t i = find_triangle(mesh, at);
    const LightTriangle *triangle = &mesh->triangles[i];
    const double before = i > 0 ? mesh->sums[i - 1] : 0.0;
    /* What is left of u.u is even in the triangle. */
    const float s = (float)((at - before) / (mesh->sums[i] - before));
    const float root = sqrtf(fminf(fmaxf(s, 0.0f), 1.0f));
    LightPlace place = {.n = triangle->n, .part = part_of(mesh, i)};
    place.p = vec3_madd(vec3_madd(triangle->p, root * (1.0f - u.v), triangle->e1), root * u.v,
                        triangle->e2);
    const Rgb share = rgb_scale(triangle->radiance, 1.0f / rgb_mean(triangle->radiance));
    place.weight = rgb_scale(share, (float)power);
    place.density = (float)((double)rgb_mean(triangle->radiance) / power);
    return place;
}

static float largest_coordinate(Vec3 p) {
    return fmaxf(fmaxf(fabsf(p.x), fabsf(p.y)), fabsf(p.z));
}

Vec3 light_place_towards(const LightPlace *place, Vec3 other) {
    /* As scene_leave, and room for its step off the other surface. */
    const float scale = largest_coordinate(place->p) + 2.0f * largest_coordinate(other);
    const float side = vec3_dot(vec3_sub(other, place->p), place->n);
    return vec3_madd(place->p, copysignf(2e-6f * scale + 1e-12f, side), place->n);
}

Vec3 light_place_leave(const LightPlace *place, Vec3 d) {
    const float offset = 2e-6f * largest_coordinate(place->p) + 1e-12f;
    return vec3_madd(place->p, copysignf(offset, vec3_dot(d, place->n)), place->n);
}

static double weight_of(const LightMesh *mesh, uint64_t i) {
    return mesh->sums[i] - (i > 0 ? mesh->sums[i - 1] : 0.0);
}

static Vec3d middle_of(const LightTriangle *triangle) {
    const Vec3d edges = vec3d_add(vec3d_from(triangle->e1), vec3d_from(triangle->e2));
    return vec3d_madd(vec3d_from(triangle->p), 1.0 / 3.0, edges);
}

static void add_square(double sum[6], double weight, Vec3d v) {
    sum[0] += weight * v.x * v.x;
    sum[1] += weight * v.y * v.y;
    sum[2] += weight * v.z * v.z;
    sum[3] += weight * v.x * v.y;
    sum[4] += weight * v.y * v.z;
    sum[5] += weight * v.z * v.x;
}

static void sum_up(LightMesh *mesh, Vec3 *out_middle) {
    double sum = 0.0;
    Vec3d middle = {0.0, 0.0, 0.0};
    for (uint64_t i = 0; i < mesh->count; ++i) {
        const LightTriangle *triangle = &mesh->triangles[i];
        const double area =
            0.5 * vec3d_length(vec3d_cross(vec3d_from(triangle->e1), vec3d_from(triangle->e2)));
        const double weight = area * (double)rgb_mean(triangle->radiance);
        sum += weight;
        mesh->sums[i] = sum;
        middle = vec3d_madd(middle, weight, middle_of(triangle));
    }
    *out_middle = vec3d_round(vec3d_scale(middle, 1.0 / sum));
}

static void find_spread(const LightMesh *mesh, uint64_t begin, uint64_t end, float out[6]) {
    const double sum = mesh->sums[end - 1] - (begin > 0 ? mesh->sums[begin - 1] : 0.0);
    Vec3d middle = {0.0, 0.0, 0.0};
    for (uint64_t i = begin; i < end; ++i)
        middle = vec3d_madd(middle, weight_of(mesh, i) / sum, middle_of(&mesh->triangles[i]));
    double spread[6] = {0.0};
    for (uint64_t i = begin; i < end; ++i) {
        const LightTriangle *triangle = &mesh->triangles[i];
        const double weight = weight_of(mesh, i) / sum;
        const Vec3d own = middle_of(triangle);
        add_square(spread, weight, vec3d_sub(own, middle));
        /* Of an even triangle: a twelfth of the sum of squares of its corners from its middle. */
        const Vec3d a = vec3d_sub(vec3d_from(triangle->p), own);
        add_square(spread, weight / 12.0, a);
        add_square(spread, weight / 12.0, vec3d_add(a, vec3d_from(triangle->e1)));
        add_square(spread, weight / 12.0, vec3d_add(a, vec3d_from(triangle->e2)));
    }
    for (int k = 0; k < 6; ++k)
        out[k] = (float)spread[k];
}

void light_mesh_prepare(LightMesh *mesh, Vec3 *out_middle) {
    sum_up(mesh, out_middle);
    for (uint64_t begin = 0, end = 0; begin < mesh->count; begin = end) {
        const uint32_t part = part_of(mesh, begin);
        while (end < mesh->count && part_of(mesh, end) == part)
            ++end;
        find_spread(mesh, begin, end, mesh->spread[part]);
    }
}

void light_mesh_destroy(LightMesh *mesh) {
    if (mesh == NULL)
        return;
    memory_free(mesh->triangles);
    memory_free(mesh->sums);
    memory_free(mesh);
}
