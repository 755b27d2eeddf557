/* SPDX-License-Identifier: GPL-3.0-or-later
 * Lights, from both ends. */
#include "scene/light.h"

#include "amberlight/amberlight.h"
#include "math/vec3d.h"

/* Full extent of the uniform interval whose variance is that of one coordinate of a disc of
 * radius 1: sqrt(12 * 1/4). Tangent pairs are measured in full extents. */
static const float DISC_EXTENT = 1.7320508f;

/* Relative intensity of a spot in unit direction d of travel. */
static float spot_factor(const SceneLight *light, Vec3 d) {
    /* 1 - cos from the difference of unit vectors: cones of a milliradian keep their edge. */
    const Vec3 aside = vec3_sub(d, light->direction);
    const float cap = 0.5f * vec3_dot(aside, aside);
    if (cap >= light->spot_cap)
        return 0.0f;
    const float cos_axis = 1.0f - cap;
    const float width = light->spot_cap * light->spot_blend;
    const float x = width > 0.0f ? fminf((light->spot_cap - cap) / width, 1.0f) : 1.0f;
    const float edge = x * x * (3.0f - 2.0f * x);
    return light->spot_cosine > 0.0f ? edge * cos_axis : edge;
}

/* 1 - cos of a sun's angular radius, with its digits. */
static float sun_cap(const SceneLight *light) {
    const float sine = sinf(0.5f * light->angle);
    return 2.0f * sine * sine;
}

/* Irradiance that each direction of a sun's disc stands for, on a plane perpendicular to that
 * direction. color is what the disc gives on a plane perpendicular to its axis, where directions
 * count with their cosine, on average (1 + cos)/2. */
static Rgb sun_irradiance(const SceneLight *light) {
    return rgb_scale(light->color, 1.0f / (1.0f - 0.5f * sun_cap(light)));
}

void light_set_sun(SceneLight *light, Rgb irradiance) {
    light->color = rgb_scale(irradiance, 1.0f - 0.5f * sun_cap(light));
}

static float area_measure(const SceneLight *light) {
    const float box = 4.0f * light->size[0] * light->size[1];
    return light->area_shape == AMB_AREA_ELLIPSE ? box * AMB_PI / 4.0f : box;
}

static Vec3 area_point(const SceneLight *light, Sample2 u) {
    Sample2 s = {2.0f * u.u - 1.0f, 2.0f * u.v - 1.0f};
    if (light->area_shape == AMB_AREA_ELLIPSE)
        s = sample_disc(u);
    return vec3_madd(vec3_madd(light->position, s.u * light->size[0], light->x),
                     s.v * light->size[1], light->y);
}

/* Point of the disc of the light's radius that faces along unit n. */
static Vec3 disc_point(const SceneLight *light, Vec3 n, Sample2 u) {
    Vec3 x, y;
    vec3_frame(n, &x, &y);
    const Sample2 s = sample_disc(u);
    return vec3_madd(vec3_madd(light->position, light->radius * s.u, x), light->radius * s.v, y);
}

static LightArrival mesh_arrival(const LightMesh *mesh, Vec3 p, Sample2 u) {
    LightArrival arrival = {.irradiance = {0, 0, 0}};
    const LightPlace place = light_mesh_place(mesh, u);
    const Vec3 y = light_place_towards(&place, p);
    const Vec3 to_light = vec3_sub(y, p);
    const float distance = vec3_length(to_light);
    if (!(distance > 0.0f))
        return arrival;
    arrival.wi = vec3_scale(to_light, 1.0f / distance);
    arrival.distance = distance;
    const float cosine = fabsf(vec3_dot(arrival.wi, place.n));
    arrival.irradiance = rgb_scale(place.weight, cosine / (distance * distance));
    arrival.pdf = cosine > 0.0f ? place.density * distance * distance / cosine : 0.0f;
    return arrival;
}

LightArrival light_arrival(const SceneLight *light, Vec3 p, Sample2 u) {
    if (light->kind == LIGHT_MESH)
        return mesh_arrival(light->mesh, p, u);
    LightArrival arrival = {.irradiance = {0, 0, 0}};
    if (light->kind == AMB_LIGHT_SUN) {
        const Vec3 cone = sample_cap(u, sun_cap(light));
        arrival.wi = vec3_negate(frame_to_world(light->x, light->y, light->direction, cone));
        arrival.distance = INFINITY;
        arrival.irradiance = sun_irradiance(light);
        return arrival;
    }
    Vec3 y = light->position;
    Vec3 normal = light->direction;
    if (light->kind == AMB_LIGHT_AREA) {
        y = area_point(light, u);
    } else if (light->radius > 0.0f) {
        normal = vec3_normalize(vec3_sub(p, light->position));
        y = disc_point(light, normal, u);
    }
    const Vec3 to_light = vec3_sub(y, p);
    const float distance = vec3_length(to_light);
    if (!(distance > 0.0f))
        return arrival;
    arrival.wi = vec3_scale(to_light, 1.0f / distance);
    arrival.distance = distance;
    const Vec3 d = vec3_negate(arrival.wi);
    float scale = 1.0f / (distance * distance);
    if (light->kind == AMB_LIGHT_AREA)
        scale *= area_measure(light) * fmaxf(vec3_dot(d, normal), 0.0f);
    else if (light->radius > 0.0f)
        scale *= fmaxf(vec3_dot(d, normal), 0.0f);
    if (light->kind == AMB_LIGHT_SPOT)
        scale *= spot_factor(light, d);
    arrival.irradiance = rgb_scale(light->color, scale);
    return arrival;
}

bool light_has_extent(const SceneLight *light) {
    return light->kind == LIGHT_MESH       ? false
           : light->kind == AMB_LIGHT_AREA ? light->size[0] > 0.0f && light->size[1] > 0.0f
           : light->kind == AMB_LIGHT_SUN  ? light->angle > 0.0f
                                           : light->radius > 0.0f;
}

static Rgb sun_seen(const SceneLight *light, Vec3 d, float t_max, float *out_t) {
    const Vec3 aside = vec3_add(d, light->direction);
    const float cap = sun_cap(light);
    *out_t = INFINITY;
    if (isfinite(t_max) || 0.5f * vec3_dot(aside, aside) >= cap)
        return rgb(0, 0, 0);
    return rgb_scale(sun_irradiance(light), 1.0f / (2.0f * AMB_PI * cap));
}

Rgb light_seen(const SceneLight *light, Vec3 o, Vec3 d, float t_max, float *out_t) {
    if (light->kind == AMB_LIGHT_SUN)
        return sun_seen(light, d, t_max, out_t);
    const Rgb black = rgb(0, 0, 0);
    const Vec3 from_light = vec3_sub(o, light->position);
    const bool is_area = light->kind == AMB_LIGHT_AREA;
    *out_t = INFINITY;
    if (!is_area && !(vec3_length(from_light) > 0.0f))
        return black;
    const Vec3 normal = is_area ? light->direction : vec3_normalize(from_light);
    const float cosine = -vec3_dot(d, normal);
    if (!(cosine > 0.0f))
        return black;
    const float t = vec3_dot(from_light, normal) / cosine;
    *out_t = t;
    if (!(t > 0.0f) || !(t <= t_max))
        return black;
    const Vec3 at = vec3_madd(from_light, t, d);
    if (!is_area) {
        if (!(vec3_dot(at, at) < light->radius * light->radius))
            return black;
        const float factor =
            light->kind == AMB_LIGHT_SPOT ? spot_factor(light, vec3_negate(d)) : 1.0f;
        return rgb_scale(light->color, factor / (AMB_PI * light->radius * light->radius));
    }
    const float x = vec3_dot(at, light->x) / light->size[0];
    const float y = vec3_dot(at, light->y) / light->size[1];
    const bool is_inside = light->area_shape == AMB_AREA_ELLIPSE
                               ? x * x + y * y < 1.0f
                               : fabsf(x) < 1.0f && fabsf(y) < 1.0f;
    return is_inside ? light->color : black;
}

typedef struct Cap {
    Vec3 axis;
    float one_minus_cos;
    bool is_aimed; /* at the target */
} Cap;

/* Smallest cap of directions from y that covers what the light can send at the target. */
static Cap emission_cap(const LightEmission *emission, Vec3 y) {
    const SceneLight *light = emission->light;
    const Vec3 to_target = vec3_sub(emission->target, y);
    const float distance = vec3_length(to_target);
    const float reach = emission->target_radius + light->radius;
    Cap cap = {vec3(0, 0, 1), 2.0f, false};
    if (distance > reach) {
        const float sine = reach / distance;
        cap.axis = vec3_scale(to_target, 1.0f / distance);
        cap.is_aimed = true;
        /* 1 - cos by sin^2 / (1 + cos): no cancellation for a small, far target. */
        cap.one_minus_cos = sine * sine / (1.0f + safe_sqrtf(1.0f - sine * sine));
    }
    if (light->kind == AMB_LIGHT_SPOT && light->spot_cap < cap.one_minus_cos)
        cap = (Cap){light->direction, light->spot_cap, false};
    return cap;
}

/* A light this many times as far away as the rays of a sun start is far: where its rays meet the
 * target, single precision counted from the light has few digits left. */
static const float FAR_SHARE = 8.0f;

/* Starts a ray of the cap's direction `local` from y near the target instead, in double. */
static void start_near_target(const LightEmission *emission, const Cap *cap, Vec3 x, Vec3 y,
                              Vec3 local, LightRay *ray) {
    const Vec3d to_target = vec3d_sub(vec3d_from(emission->target), vec3d_from(ray->o));
    const double distance = vec3d_length(to_target);
    const double near = (double)emission->distance;
    if (!(near > 0.0) || !(distance > (double)FAR_SHARE * near) || !(local.z > 0.0f))
        return;
    Vec3d axis = cap->is_aimed ? to_target : vec3d_from(cap->axis);
    axis = vec3d_scale(axis, 1.0 / vec3d_length(axis));
    Vec3d d = vec3d_scale(axis, (double)local.z);
    d = vec3d_madd(d, (double)local.x, vec3d_from(x));
    d = vec3d_madd(d, (double)local.y, vec3d_from(y));
    d = vec3d_scale(d, 1.0 / vec3d_length(d));
    const double way = vec3d_dot(to_target, d) - near;
    if (!(way > 0.0))
        return;
    ray->o = vec3d_round(vec3d_madd(vec3d_from(ray->o), way, d));
    ray->d = vec3d_round(d);
    ray->way = (float)way;
    for (int k = 0; k < TANGENT_COUNT; ++k)
        ray->pairs[k].dp = vec3_madd(ray->pairs[k].dp, ray->way, ray->pairs[k].dd);
}

static Sample2 source_sample(const LightEmission *emission, uint64_t i) {
    return sample_r2(i, emission->shift_u, emission->shift_v);
}

static LightRay emit_sun(const LightEmission *emission, uint64_t i, Sample2 lattice) {
    const SceneLight *light = emission->light;
    LightRay ray = {.d = light->direction};
    Vec3 x = light->x, y = light->y;
    if (light->angle > 0.0f) {
        const Vec3 cone = sample_cap(source_sample(emission, i), sun_cap(light));
        ray.d = vec3_normalize(frame_to_world(light->x, light->y, light->direction, cone));
        vec3_frame(ray.d, &x, &y);
        ray.pairs[2].dd = vec3_scale(x, DISC_EXTENT * light->angle);
        ray.pairs[3].dd = vec3_scale(y, DISC_EXTENT * light->angle);
        /* Where on the sun a ray comes from turns it about its point on the target's disc. */
        ray.pairs[2].dp = vec3_scale(ray.pairs[2].dd, -emission->distance);
        ray.pairs[3].dp = vec3_scale(ray.pairs[3].dd, -emission->distance);
    }
    const float radius = emission->target_radius;
    const Sample2 disc = sample_disc(lattice);
    ray.o = vec3_madd(emission->target, -emission->distance, ray.d);
    ray.o = vec3_madd(vec3_madd(ray.o, radius * disc.u, x), radius * disc.v, y);
    const float cell = AMB_PI * radius * radius / (float)emission->count;
    ray.flux = rgb_scale(sun_irradiance(light), cell);
    ray.pairs[0].dp = vec3_scale(x, sqrtf(cell));
    ray.pairs[1].dp = vec3_scale(y, sqrtf(cell));
    return ray;
}

/* Full extents across a direction that have the covariance c of a mesh's places, by Cholesky's
 * decomposition; x and y are unit and across. */
static void spread_across(const float c[6], Vec3 x, Vec3 y, TangentPair pairs[]) {
    static const float EXTENT = 3.4641016f; /* sqrt(12): of the interval of variance 1 */
    const Vec3 cx = vec3(c[0] * x.x + c[3] * x.y + c[5] * x.z, c[3] * x.x + c[1] * x.y + c[4] * x.z,
                         c[5] * x.x + c[4] * x.y + c[2] * x.z);
    const Vec3 cy = vec3(c[0] * y.x + c[3] * y.y + c[5] * y.z, c[3] * y.x + c[1] * y.y + c[4] * y.z,
                         c[5] * y.x + c[4] * y.y + c[2] * y.z);
    const float first = safe_sqrtf(vec3_dot(x, cx));
    const float both = first > 0.0f ? vec3_dot(y, cx) / first : 0.0f;
    const float second = safe_sqrtf(vec3_dot(y, cy) - both * both);
    pairs[TANGENT_LATTICE].dp = vec3_madd(vec3_scale(x, EXTENT * first), EXTENT * both, y);
    pairs[TANGENT_LATTICE + 1].dp = vec3_scale(y, EXTENT * second);
}

/* Seen from another point of the light, the cap turns about the target. */
static void turn_about_target(const LightEmission *emission, LightRay *ray) {
    const float distance = vec3_length(vec3_sub(emission->target, ray->o));
    for (int k = TANGENT_LATTICE; k < TANGENT_COUNT && distance > emission->target_radius; ++k) {
        const Vec3 dp = ray->pairs[k].dp;
        const Vec3 across = vec3_madd(dp, -vec3_dot(dp, ray->d), ray->d);
        ray->pairs[k].dd = vec3_scale(across, -1.0f / distance);
    }
}

LightRay light_emit(const LightEmission *emission, uint64_t i) {
    const SceneLight *light = emission->light;
    const Sample2 lattice = sample_fibonacci(i, emission->count, emission->shift_v);
    if (light->kind == AMB_LIGHT_SUN)
        return emit_sun(emission, i, lattice);

    LightRay ray = {.o = light->position};
    float scale = 1.0f;
    LightPlace place = {.weight = light->color};
    if (light->kind == LIGHT_MESH) {
        place = light_mesh_place(light->mesh, source_sample(emission, i));
        ray.o = place.p;
    } else if (light->kind == AMB_LIGHT_AREA) {
        ray.o = area_point(light, source_sample(emission, i));
        scale = area_measure(light);
        const float extent = light->area_shape == AMB_AREA_ELLIPSE ? DISC_EXTENT : 2.0f;
        ray.pairs[2].dp = vec3_scale(light->x, extent * light->size[0]);
        ray.pairs[3].dp = vec3_scale(light->y, extent * light->size[1]);
    }
    const Cap cap = emission_cap(emission, ray.o);
    Vec3 x, y;
    vec3_frame(cap.axis, &x, &y);
    const Vec3 local = sample_cap(lattice, cap.one_minus_cos);
    ray.d = vec3_normalize(frame_to_world(x, y, cap.axis, local));
    const Vec3 cap_x = x, cap_y = y;
    vec3_frame(ray.d, &x, &y);
    if (light->kind == LIGHT_MESH) {
        spread_across(light->mesh->spread[place.part], x, y, ray.pairs);
        turn_about_target(emission, &ray);
        scale = fabsf(vec3_dot(ray.d, place.n));
        ray.o = light_place_leave(&place, ray.d);
    } else if (light->kind == AMB_LIGHT_AREA) {
        turn_about_target(emission, &ray);
        scale *= fmaxf(vec3_dot(ray.d, light->direction), 0.0f);
    } else if (light->radius > 0.0f) {
        /* The disc faces where the ray goes: the same intensity in every direction. The light
         * pass adds the falloff of Cycles' discs, 1/(d^2 + r^2), where the ray arrives. */
        ray.o = disc_point(light, ray.d, source_sample(emission, i));
        ray.pairs[2].dp = vec3_scale(x, DISC_EXTENT * light->radius);
        ray.pairs[3].dp = vec3_scale(y, DISC_EXTENT * light->radius);
    }
    if (light->kind == AMB_LIGHT_SPOT)
        scale *= spot_factor(light, ray.d);
    const float cell = 2.0f * AMB_PI * cap.one_minus_cos / (float)emission->count;
    ray.flux = rgb_scale(place.weight, scale * cell);
    ray.pairs[0].dd = vec3_scale(x, sqrtf(cell));
    ray.pairs[1].dd = vec3_scale(y, sqrtf(cell));
    start_near_target(emission, &cap, cap_x, cap_y, local, &ray);
    return ray;
}

/* The mean over places spread over it, each of which sends half of what faces the target would. */
static float mesh_power_towards(const LightEmission *emission) {
    enum { PLACES = 16 };
    const LightMesh *mesh = emission->light->mesh;
    float sum = 0.0f;
    for (uint64_t i = 0; i < PLACES; ++i) {
        const LightPlace place = light_mesh_place(mesh, sample_r2(i, 0.5f, 0.5f));
        sum += 0.5f * emission_cap(emission, place.p).one_minus_cos;
    }
    return (float)light_mesh_power(mesh) * 2.0f * AMB_PI * sum / (float)PLACES;
}

float light_power_towards(const LightEmission *emission) {
    const SceneLight *light = emission->light;
    if (light->kind == LIGHT_MESH)
        return mesh_power_towards(emission);
    const float color = rgb_mean(light->color);
    if (light->kind == AMB_LIGHT_SUN)
        return color * AMB_PI * emission->target_radius * emission->target_radius;
    const Cap cap = emission_cap(emission, light->position);
    const float area = light->kind == AMB_LIGHT_AREA ? area_measure(light) : 1.0f;
    return color * area * 2.0f * AMB_PI * cap.one_minus_cos;
}
