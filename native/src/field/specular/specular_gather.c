/* SPDX-License-Identifier: GPL-3.0-or-later
 * The radiance along a segment: quadrature over the curves of solutions. */
#include "field/specular/specular.h"
#include "field/specular/specular_curve.h"

enum {
    DEPTH_MAX = 10, /* halvings of a piece of the curve */
    END_STEPS = 40  /* to where a piece enters or leaves the segment */
};

/* Simpson's rule is taken where it differs from the rule of the middle by less than this part. The
 * difference is of second order and Simpson's own error of fourth: 1e-4 or so of the piece. */
static const double SIMPSON_DIFFERENCE_MAX = 0.02;
/* Pieces longer than this part of the object's radius, measured along the segment, are halved
 * before visibility, which is asked for in their middles, is trusted. */
static const double LENGTH_SHARE_MAX = 0.25;
/* Where the light is as near as this to the end of its way, a surface may be between. */
static const double REACH_SHARE_MAX = 0.8;
/* Where uneven visibility is asked for beside the ends of a piece. */
static const double END_SHRINK = 1e-3;
/* Ends of the segment are found to this part of its length. */
static const double END_TOLERANCE = 1e-7;
/* The point in the medium is on a surface if it is nearer than this part of the light's way. */
static const float TOUCH_SHARE = 1e-5f;

typedef struct Gather {
    const SpecularField *field;
    const Medium *medium;
    SpecularSegment segment;
    SpecularFace face;
    const SpecularCell *cell;
    double sum[3], frequency, contribution;
} Gather;

/* A point of a piece and its light. */
typedef struct Sample {
    double x; /* along the piece */
    CurvePoint point;
    double value[3], mean; /* per unit of x, without visibility */
} Sample;

/* How far inside of the segment the meeting is; negative outside. */
static double depth_in(const Gather *gather, const CurvePoint *point) {
    /* Not finite where the lines are parallel: outside. */
    if (!(point->s > 0.0) || !isfinite(point->t))
        return -gather->segment.length;
    return fmin(point->t, gather->segment.length - point->t);
}

static Sample sample_of(const Gather *gather, const CurvePiece *piece, double x,
                        const CurvePoint *point) {
    Sample sample = {.x = x, .point = *point};
    if (depth_in(gather, point) < 0.0)
        return sample;
    const double flux =
        specular_entering(&gather->face, &point->line) * specular_density(piece, point);
    const float cosine = (float)-vec3d_dot(point->line.w, gather->segment.d);
    const Medium *medium = gather->medium;
    const double color[3] = {(double)gather->face.color.r, (double)gather->face.color.g,
                             (double)gather->face.color.b};
    const double sigma_t[3] = {(double)medium->sigma_t.r, (double)medium->sigma_t.g,
                               (double)medium->sigma_t.b};
    double scattered[3] = {0, 0, 0};
    for (uint32_t l = 0; l < medium->lobe_count; ++l) {
        const MediumLobe *lobe = &medium->lobes[l];
        const double p = (double)phase_hg(cosine, lobe->g);
        scattered[0] += (double)lobe->sigma_s.r * p;
        scattered[1] += (double)lobe->sigma_s.g * p;
        scattered[2] += (double)lobe->sigma_s.b * p;
    }
    for (int k = 0; k < 3; ++k) {
        sample.value[k] = flux * color[k] * scattered[k] * exp(-sigma_t[k] * (point->s + point->t));
        sample.mean += sample.value[k] / 3.0;
    }
    return sample;
}

static bool sample_at(const Gather *gather, const CurvePiece *piece, double x, Sample *out_sample) {
    CurvePoint point;
    if (!specular_curve_at(piece, x, &point))
        return false;
    *out_sample = sample_of(gather, piece, x, &point);
    return true;
}

/* Whether nothing stands between the light and the face, nor between the face and the point in the
 * medium. The published code asks for the first alone, which is enough for convex shapes. */
static bool is_visible(const Gather *gather, const CurvePoint *point) {
    const AmbScene *scene = gather->field->scene;
    const float u = clampf((float)point->u, 0.0f, 1.0f);
    const float v = clampf((float)point->v, 0.0f, 1.0f - u);
    const SurfacePoint surface =
        scene_surface(scene, &(Hit){0.0f, u, v, gather->field->object, gather->cell->triangle});
    const LightArrival light = light_arrival(gather->face.light, surface.p, (Sample2){0.5f, 0.5f});
    const Vec3 w = vec3d_round(point->line.w);
    return !scene_is_occluded(scene, scene_leave(&surface, light.wi), light.wi, light.distance) &&
           !scene_is_occluded(scene, scene_leave(&surface, w), w,
                              (float)point->s * (1.0f - TOUCH_SHARE));
}

static bool is_visible_at(const Gather *gather, const CurvePiece *piece, double x) {
    CurvePoint point;
    return specular_curve_at(piece, x, &point) && is_visible(gather, &point);
}

static void add(Gather *gather, const Sample *a, const Sample *middle, const Sample *b,
                double width) {
    double mean = 0.0;
    for (int k = 0; k < 3; ++k) {
        const double value = width / 6.0 * (a->value[k] + 4.0 * middle->value[k] + b->value[k]);
        gather->sum[k] += value;
        mean += value / 3.0;
    }
    /* a_0 / (a_0 + a(s)) of the light's cross-section. */
    const SpecularFace *face = &gather->face;
    const SpecularLine *line = &middle->point.line;
    const double s = middle->point.s;
    const Vec3d p_u = vec3d_madd(face->p_u, s, line->w_u);
    const Vec3d p_v = vec3d_madd(face->p_v, s, line->w_v);
    const double start = fabs(vec3d_dot(line->w, vec3d_cross(face->p_u, face->p_v)));
    const double spread = fabs(vec3d_dot(line->w, vec3d_cross(p_u, p_v)));
    if (start > 0.0)
        gather->frequency += mean * start / (start + spread);
    gather->contribution += mean;
}

/* The sample between an inner and an outer one where the light meets an end of the segment. */
static Sample find_end(const Gather *gather, const CurvePiece *piece, Sample inner, Sample outer) {
    const double close = END_TOLERANCE * gather->segment.length;
    for (int i = 0; i < END_STEPS; ++i) {
        const double in = depth_in(gather, &inner.point), out = depth_in(gather, &outer.point);
        if (in < close || fabs(outer.x - inner.x) < END_TOLERANCE)
            break;
        /* The secant and the middle in turn: neither sticks, one is fast. */
        const double share = i % 2 == 0 ? in / (in - out) : 0.5;
        Sample next;
        if (!sample_at(gather, piece, inner.x + share * (outer.x - inner.x), &next))
            break;
        if (depth_in(gather, &next.point) >= 0.0)
            inner = next;
        else
            outer = next;
    }
    return inner;
}

static void integrate(Gather *gather, const CurvePiece *piece, const Sample *a,
                      const Sample *middle, const Sample *b, int depth);

static bool middle_of(const Gather *gather, const CurvePiece *piece, const Sample *a,
                      const Sample *b, Sample *out_middle) {
    return fabs(b->x - a->x) > END_TOLERANCE &&
           sample_at(gather, piece, 0.5 * (a->x + b->x), out_middle);
}

/* False, and nothing is done, where it cannot be. */
static bool halve(Gather *gather, const CurvePiece *piece, const Sample *a, const Sample *middle,
                  const Sample *b, int depth) {
    Sample first, second;
    if (depth >= DEPTH_MAX || !middle_of(gather, piece, a, middle, &first) ||
        !middle_of(gather, piece, middle, b, &second))
        return false;
    integrate(gather, piece, a, &first, middle, depth + 1);
    integrate(gather, piece, middle, &second, b, depth + 1);
    return true;
}

/* A piece whose three samples are within the segment. */
static void integrate_inside(Gather *gather, const CurvePiece *piece, const Sample *a,
                             const Sample *middle, const Sample *b, int depth) {
    const double simpson = (a->mean + 4.0 * middle->mean + b->mean) / 6.0;
    if (simpson == 0.0 && depth > 0)
        return;
    const double radius = (double)gather->field->scene->objects[gather->field->object].radius;
    const double length = fabs(b->point.t - a->point.t);
    if ((fabs(simpson - middle->mean) > SIMPSON_DIFFERENCE_MAX * simpson ||
         length > LENGTH_SHARE_MAX * radius) &&
        halve(gather, piece, a, middle, b, depth))
        return;
    const bool is_lit = is_visible(gather, &middle->point);
    const double reach = (double)gather->cell->reach * REACH_SHARE_MAX;
    const bool may_be_cut = depth > 0 || gather->cell->lit_corners != (is_lit ? 3 : 0) ||
                            fmax(fmax(a->point.s, b->point.s), middle->point.s) > reach;
    const double shrink = END_SHRINK * (b->x - a->x);
    if (may_be_cut && depth < DEPTH_MAX &&
        (is_visible_at(gather, piece, a->x + shrink) != is_lit ||
         is_visible_at(gather, piece, b->x - shrink) != is_lit) &&
        halve(gather, piece, a, middle, b, depth))
        return;
    if (is_lit)
        add(gather, a, middle, b, fabs(b->x - a->x));
}

static void integrate(Gather *gather, const CurvePiece *piece, const Sample *a,
                      const Sample *middle, const Sample *b, int depth) {
    const bool in_a = depth_in(gather, &a->point) >= 0.0;
    const bool in_middle = depth_in(gather, &middle->point) >= 0.0;
    const bool in_b = depth_in(gather, &b->point) >= 0.0;
    if (in_a && in_middle && in_b) {
        integrate_inside(gather, piece, a, middle, b, depth);
    } else if (in_a != in_b) {
        const Sample end = in_a ? find_end(gather, piece, *a, *b) : find_end(gather, piece, *b, *a);
        const Sample *from = in_a ? a : &end, *to = in_a ? &end : b;
        Sample between;
        if (middle_of(gather, piece, from, to, &between))
            integrate(gather, piece, from, &between, to, depth + 1);
    } else if (in_middle || in_a) {
        /* In and out again, or out and in: each half has one end. */
        halve(gather, piece, a, middle, b, depth);
    } else {
        /* All three outside: the whole segment may lie between two of them, and where a piece
         * turns back, its turn may reach in. */
        const double reach = fabs(b->point.t - a->point.t) + fabs(middle->point.t - a->point.t);
        const double outside = -fmax(fmax(depth_in(gather, &a->point), depth_in(gather, &b->point)),
                                     depth_in(gather, &middle->point));
        if (outside < reach)
            halve(gather, piece, a, middle, b, depth);
    }
}

static void integrate_piece(void *user, const CurvePiece *piece) {
    Gather *gather = user;
    const Sample a = sample_of(gather, piece, 0.0, &piece->a);
    const Sample middle = sample_of(gather, piece, 0.5, &piece->middle);
    const Sample b = sample_of(gather, piece, 1.0, &piece->b);
    integrate(gather, piece, &a, &middle, &b, 0);
}

static void gather_cell(Gather *gather, const SpecularCell *cell) {
    const SpecularField *field = gather->field;
    gather->cell = cell;
    if (specular_face(field->scene, field->object, cell->triangle,
                      &field->scene->lights[cell->light], field->adjoint_normals, &gather->face))
        specular_curve(&gather->face, &gather->segment, cell->corners, integrate_piece, gather);
}

FieldRadiance specular_gather(const SpecularField *field, Vec3 o, Vec3 d, float length) {
    const AmbScene *scene = field->scene;
    Gather gather = {.field = field,
                     .medium = &scene->materials[scene->objects[field->object].inside].medium,
                     .segment = {vec3d_from(o), vec3d_from(d), (double)length}};
    gather.segment.d = vec3d_scale(gather.segment.d, 1.0 / vec3d_length(gather.segment.d));
    const BoundQuery query = {o, d, length};
    const SpecularTree *tree = &field->tree;
    uint32_t stack[SPECULAR_DEPTH_MAX], depth = 0;
    stack[depth++] = 0;
    while (depth > 0) {
        const uint32_t index = stack[--depth];
        const SpecularNode *node = &tree->nodes[index];
        if (!specular_bound_meets(&node->bound, &query))
            continue;
        if (node->count == 0) {
            stack[depth++] = node->second;
            stack[depth++] = index + 1;
        }
        for (uint32_t i = 0; i < node->count; ++i) {
            const SpecularCell *cell = &tree->cells[node->first + i];
            if (specular_bound_meets(&cell->bound, &query))
                gather_cell(&gather, cell);
        }
    }
    FieldRadiance out;
    out.radiance = rgb((float)gather.sum[0], (float)gather.sum[1], (float)gather.sum[2]);
    out.frequency = (float)gather.frequency;
    out.contribution = (float)gather.contribution;
    return out;
}
