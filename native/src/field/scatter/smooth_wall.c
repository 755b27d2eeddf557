/* SPDX-License-Identifier: GPL-3.0-or-later
 * Light that has scattered, at boundaries whose normals are interpolated.
 *
 * A camera path that leaves along wo, seen from the face, looks along its mirror image by the
 * interpolated normal, wi. Mirroring keeps solid angles, and flux counts cosines to the face: light
 * from wi carries |wo.Ng| / |wi.Ng| of its flux on to wo ([Veach97] 5.3), which has no bound where
 * light grazes the face, and hardly a variance. But little light does, and what has scattered is
 * much the same in all such directions: light that grazes the face stands for all of that, is
 * turned about the face's normal, and has a weight with a bound. */
#include "field/scatter/smooth_wall.h"

#include "math/sampling.h"

/* Cosine to the face up to which light is taken to be alike, in units of the cosine with which
 * light in the face's plane is mirrored: weights are below 8 where the normals are less than 60
 * degrees apart. */
static const float GRAZING_PART = 0.75f;

/* What of the light goes one way. */
typedef struct Way {
    Vec3 d;
    float weight;
} Way;

bool smooth_wall_is_bent(const BoundaryCrossing *crossing) {
    return fabsf(vec3_dot(crossing->surface.ns, crossing->surface.ng)) < 1.0f - 1e-6f;
}

/* In [low, high], in proportion to a function that is linear there, from a >= 0 to b >= 0. */
static float sample_linear(float a, float b, float low, float high, float u) {
    const float value = sqrtf(a * a + u * (b * b - a * a)); /* there */
    return low + (high - low) * fminf(u * (a + b) / fmaxf(a + value, 1e-20f), 1.0f);
}

/* Light from v, mirrored. Where it grazes the face: from all directions that have its azimuth
 * around the face's normal; also from below the face, for camera paths that would look there look
 * along the face (keep_side of boundary.c). */
static Way mirror(const BoundaryCrossing *crossing, Vec3 v, Vec3 ng, Vec3 ns, float u) {
    const DielectricSplit *split = &crossing->split;
    const float c = vec3_dot(v, ng);
    const Vec3 along = vec3_normalize(vec3_madd(v, -c, ng));
    /* Light with the cosine x is mirrored to one of base sqrt(1 - x^2) + slope x. */
    const Vec3 axis = vec3_madd(vec3_negate(ng), 2.0f * vec3_dot(ns, ng), ns);
    const float base = vec3_dot(axis, along), slope = vec3_dot(axis, ng);
    const float grazing = GRAZING_PART * base;
    Way way = {split->reflected, 0.0f};
    if (!(c < grazing)) {
        if (crossing->can_reflect)
            way.weight = split->reflectance * crossing->adjoint_reflect;
        return way;
    }
    const float low = fmaxf(-1.0f, slope > base ? -base / slope : -1.0f);
    const float high = slope < 0.0f ? fminf(grazing, -base / slope) : grazing;
    const float first = fmaxf(base + slope * low, 0.0f), last = fmaxf(base + slope * high, 0.0f);
    const float x = sample_linear(first, last, low, high, u);
    const Vec3 from =
        vec3_normalize(vec3_madd(vec3_scale(ng, x), sqrtf(fmaxf(1.0f - x * x, 0.0f)), along));
    const DielectricSplit turned = dielectric_split(vec3_negate(from), ns, crossing->eta);
    const float off_face = vec3_dot(turned.reflected, ng), value = base + slope * x;
    if (!(vec3_dot(from, ns) > 0.0f) || !(off_face > 0.0f) || !(value > 0.0f))
        return way;
    const float all = 0.5f * (first + last) * (high - low);
    const float arriving = 0.5f * grazing * grazing;
    return (Way){turned.reflected, turned.reflectance * off_face / value * all / arriving};
}

WallTurn smooth_wall_turn(const BoundaryCrossing *crossing, Vec3 d, Sample2 u) {
    const float side = crossing->is_entering ? 1.0f : -1.0f;
    const Vec3 ng = vec3_scale(crossing->surface.ng, side);
    const Vec3 ns = vec3_scale(crossing->surface.ns, side);
    const Vec3 v = vec3_negate(d);
    Way ways[4] = {{d, 0.0f}, {d, 0.0f}, {d, 0.0f}, {d, 0.0f}};
    if (vec3_dot(v, ns) > 0.0f) {
        const DielectricSplit *split = &crossing->split;
        ways[0] = mirror(crossing, v, ng, ns, u.v);
        if (crossing->can_refract)
            ways[2] =
                (Way){split->refracted, (1.0f - split->reflectance) * crossing->adjoint_refract};
    }
    /* Camera paths that the interpolated normal is turned away from meet the face's own. */
    const DielectricSplit flat = dielectric_split(d, ng, crossing->eta);
    if (vec3_dot(flat.reflected, ns) <= 0.0f)
        ways[1] = (Way){flat.reflected, flat.reflectance};
    if (flat.reflectance < 1.0f && vec3_dot(flat.refracted, ns) >= 0.0f)
        ways[3] = (Way){flat.refracted, 1.0f - flat.reflectance};
    const float kept = ways[0].weight + ways[1].weight, left = ways[2].weight + ways[3].weight;
    /* Light that leaves seldom comes back: its weight may be large where it grazes the face. */
    const float leaving = fminf(left, 1.0f), sum = kept + leaving;
    if (!(sum > 0.0f))
        return (WallTurn){.d = d, .weight = 0.0f};
    float pick = u.u * sum;
    const bool is_refracted = pick >= kept;
    if (is_refracted)
        pick = (pick - kept) / leaving * left;
    const Way *way = &ways[is_refracted ? 2 : 0];
    if (pick >= way->weight && way[1].weight > 0.0f)
        ++way;
    return (WallTurn){.is_refracted = is_refracted,
                      .d = way->d,
                      .weight = is_refracted ? sum * left / leaving : sum};
}
