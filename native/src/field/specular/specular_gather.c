/* SPDX-License-Identifier: GPL-3.0-or-later
 * The radiance along a segment: quadrature over the curves of solutions. */
#include "field/specular/specular.h"
#include "field/specular/specular_curve.h"

enum {
    DEPTH_MAX = 10, /* halvings of a piece of the curve; in a dense medium, where it must be halved
                     * to where the light is, so many more as it takes */
    OPTICAL_DEPTH_MAX = 30, /* halvings for density at most: float coordinates have 24 */
    END_STEPS = 60          /* to where a piece enters or leaves the segment */
};

/* Simpson's rule is taken where it differs from the rule of the middle by less than this part. The
 * difference is of second order and Simpson's own error of fourth: 1e-4 or so of the piece. */
static const double SIMPSON_DIFFERENCE_MAX = 0.02;
/* Pieces longer than this part of the object's radius, measured along the segment, are halved
 * before visibility, which is asked for in their middles, is trusted. */
static const double LENGTH_SHARE_MAX = 0.25;
/* Where the light is as near as this to the end of its way, a surface may be between. */
static const double REACH_SHARE_MAX = 0.95;
/* Where uneven visibility is asked for beside the ends of a piece. */
static const double END_SHRINK = 1e-3;
/* Ends of the segment are found to this part of its length, or, where the light fades, of
 * END_DEPTHS mean free paths. */
static const double END_TOLERANCE = 1e-7;
static const double END_DEPTHS = 1e3;
/* The shortest piece: where view and light are nearly parallel, the whole segment is seen through
 * a small part of a cell. */
static const double WIDTH_MIN = 1e-13;
/* For a few places where light and view turn over: each is found in log2(1 / WIDTH_MIN) = 43. */
enum { TURN_HALVINGS_MAX = 512 };
/* Six times what a piece takes in tests of closed forms: where it takes more, rounding decides, and
 * halving each half as deep as density asks for would never end. */
enum { HALVINGS_MAX = 1 << 10 };
/* Sine between light and view below which the digits of a double do not tell where they meet, and
 * the angle by which the view is then turned. Both bend the light by less than a pixel. */
static const double PARALLEL_SINE = 1e-5;
static const double NUDGE = 4e-5;
/* What is nearer to the point in the medium than this part of the light's way does not hide it. */
static const float TOUCH_SHARE = 1e-5f;

typedef struct Gather {
    const SpecularField *field;
    const Medium *medium;
    SpecularSegment segment;
    SpecularFace face;
    const SpecularCell *cell;
    double sum[3], frequency, contribution;
    double straight[3]; /* 1/m, and light that goes straight on: see FieldRadiance */
    double straight_once[3], straight_more[3];
    double extinction; /* sigma_t of the densest channel, 1/m */
    int depth_max;     /* halvings of a piece */
    int turns_left;    /* halvings of this piece that cost no depth */
    int halvings_left; /* of this piece */
    bool is_parallel;  /* some light is parallel to the view */
    bool is_turned;    /* and the view was turned */
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
    const Rgb transmittance = medium_transmittance(medium, (float)(point->s + point->t));
    const double left[3] = {(double)transmittance.r, (double)transmittance.g,
                            (double)transmittance.b};
    double scattered[3] = {0, 0, 0};
    for (uint32_t l = 0; l < medium->lobe_count; ++l) {
        const MediumLobe *lobe = &medium->lobes[l];
        const double p = (double)phase_hg(cosine, lobe->g);
        scattered[0] += (double)lobe->sigma_s.r * p;
        scattered[1] += (double)lobe->sigma_s.g * p;
        scattered[2] += (double)lobe->sigma_s.b * p;
    }
    for (int k = 0; k < 3; ++k) {
        sample.value[k] = flux * color[k] * scattered[k] * left[k];
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
    /* Between its ends the curve of a cell at the triangle's edge may leave it by a little. */
    const double u = fmin(fmax(point->u, 0.0), 1.0), v = fmin(fmax(point->v, 0.0), 1.0 - u);
    const SurfacePoint surface = {.p = vec3d_round(specular_point(&gather->face, u, v)),
                                  .ng = vec3d_round(gather->face.ng)};
    const Vec3 wi = vec3d_round(point->line.wi), w = vec3d_round(point->line.w);
    const float distance = (float)specular_light_distance(&gather->face, point->line.p);
    return !scene_is_occluded(scene, scene_leave(&surface, wi), wi, distance) &&
           !scene_is_occluded(scene, scene_leave(&surface, w), w,
                              (float)point->s * (1.0f - TOUCH_SHARE));
}

static bool is_visible_at(const Gather *gather, const CurvePiece *piece, double x) {
    CurvePoint point;
    return specular_curve_at(piece, x, &point) && is_visible(gather, &point);
}

/* exp(x) - 1 - x. */
static double straight_several(double x) {
    return x < 1e-3 ? x * x * (0.5 + x / 6.0) : expm1(x) - x;
}

/* Simpson's rule. */
static double integral(double a, double middle, double b, double width) {
    return width / 6.0 * (a + 4.0 * middle + b);
}

static void add_straight(Gather *gather, const Sample *a, const Sample *middle, const Sample *b,
                         double width) {
    const Sample *samples[3] = {a, middle, b};
    for (int k = 0; k < 3; ++k) {
        double once[3], more[3];
        for (int i = 0; i < 3; ++i) {
            const double x = gather->straight[k] * fmax(samples[i]->point.t, 0.0);
            const double value = samples[i]->value[k];
            once[i] = value * x;
            more[i] = value > 0.0 ? value * straight_several(x) : 0.0;
        }
        gather->straight_once[k] += integral(once[0], once[1], once[2], width);
        gather->straight_more[k] += integral(more[0], more[1], more[2], width);
    }
}

static void add(Gather *gather, const Sample *a, const Sample *middle, const Sample *b,
                double width) {
    double mean = 0.0;
    for (int k = 0; k < 3; ++k) {
        const double value = integral(a->value[k], middle->value[k], b->value[k], width);
        gather->sum[k] += value;
        mean += value / 3.0;
    }
    if (gather->straight[0] + gather->straight[1] + gather->straight[2] > 0.0)
        add_straight(gather, a, middle, b, width);
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

/* How far inside of that end of the segment the meeting is at which a point outside is. */
static double depth_at_end(const Gather *gather, const CurvePoint *point, bool is_far_end) {
    if (!(point->s > 0.0) || !isfinite(point->t))
        return -gather->segment.length;
    return is_far_end ? gather->segment.length - point->t : point->t;
}

/* The sample between an inner and an outer one where the light meets an end of the segment. An
 * inner one may be at the other end within rounding: that one does not count. */
static Sample find_end(const Gather *gather, const CurvePiece *piece, Sample inner, Sample outer) {
    const double reach = fmin(gather->segment.length, END_DEPTHS / gather->extinction);
    const double close = END_TOLERANCE * reach;
    const bool is_far_end = outer.point.t > 0.5 * gather->segment.length;
    for (int i = 0; i < END_STEPS; ++i) {
        const double in = depth_at_end(gather, &inner.point, is_far_end);
        const double out = depth_at_end(gather, &outer.point, is_far_end);
        if (in < close || fabs(outer.x - inner.x) < WIDTH_MIN)
            break;
        /* The secant and the middle in turn: neither sticks, one is fast. */
        const double share = i % 2 == 0 && out < 0.0 ? in / (in - out) : 0.5;
        Sample next;
        if (!sample_at(gather, piece, inner.x + share * (outer.x - inner.x), &next))
            break;
        if (depth_at_end(gather, &next.point, is_far_end) >= 0.0)
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
    return fabs(b->x - a->x) > WIDTH_MIN &&
           sample_at(gather, piece, 0.5 * (a->x + b->x), out_middle);
}

/* False, and nothing is done, where it cannot be. */
static bool halve(Gather *gather, const CurvePiece *piece, const Sample *a, const Sample *middle,
                  const Sample *b, int depth) {
    Sample first, second;
    if (gather->halvings_left == 0 || !middle_of(gather, piece, a, middle, &first) ||
        !middle_of(gather, piece, middle, b, &second))
        return false;
    --gather->halvings_left;
    integrate(gather, piece, a, &first, middle, depth);
    integrate(gather, piece, middle, &second, b, depth);
    return true;
}

/* A piece whose three samples are within the segment. */
static void integrate_inside(Gather *gather, const CurvePiece *piece, const Sample *a,
                             const Sample *middle, const Sample *b, int depth) {
    /* Each channel: one may be gone where another is not. */
    bool is_rough = false, is_dark = true;
    for (int k = 0; k < 3; ++k) {
        const double simpson = (a->value[k] + 4.0 * middle->value[k] + b->value[k]) / 6.0;
        is_rough |= fabs(simpson - middle->value[k]) > SIMPSON_DIFFERENCE_MAX * simpson;
        is_dark &= simpson == 0.0;
    }
    if (is_dark && depth > 0)
        return;
    const double radius = (double)gather->field->scene->objects[gather->field->object].radius;
    const double length = fabs(b->point.t - a->point.t);
    if ((is_rough || length > LENGTH_SHARE_MAX * radius) && depth < gather->depth_max &&
        halve(gather, piece, a, middle, b, depth + 1))
        return;
    const bool is_lit = is_visible(gather, &middle->point);
    const double reach = (double)gather->cell->reach * REACH_SHARE_MAX;
    const bool may_be_cut = depth > 0 || gather->cell->lit_corners != (is_lit ? 3 : 0) ||
                            fmax(fmax(a->point.s, b->point.s), middle->point.s) > reach;
    const double shrink = END_SHRINK * (b->x - a->x);
    if (may_be_cut && depth < gather->depth_max &&
        (is_visible_at(gather, piece, a->x + shrink) != is_lit ||
         is_visible_at(gather, piece, b->x - shrink) != is_lit) &&
        halve(gather, piece, a, middle, b, depth + 1))
        return;
    if (is_lit)
        add(gather, a, middle, b, fabs(b->x - a->x));
}

/* Whether light becomes parallel to the view between two points, where t and s are infinite and
 * change sign, or starts on the camera's line, where s changes sign. */
static bool turns_over(const CurvePoint *a, const CurvePoint *b) {
    if (a->line.is_total || b->line.is_total)
        return false;
    return vec3d_dot(a->normal, b->normal) < 0.0 || vec3d_dot(a->turn, b->turn) < 0.0;
}

/* Whether a piece may be within the segment somewhere though its three samples are not. */
static bool may_reach_in(const Gather *gather, const CurvePoint *a, const CurvePoint *middle,
                         const CurvePoint *b) {
    const double length = gather->segment.length;
    const double t[3] = {a->t, middle->t, b->t};
    const double s[3] = {a->s, middle->s, b->s};
    double least = INFINITY, low = t[0], high = t[0], s_low = s[0], s_high = s[0];
    for (int k = 0; k < 3; ++k) {
        least = fmin(least, fmax(-t[k], t[k] - length));
        low = fmin(low, t[k]);
        high = fmax(high, t[k]);
        s_low = fmin(s_low, s[k]);
        s_high = fmax(s_high, s[k]);
    }
    /* A curve that turns back in t goes beyond its samples by less than they differ. So in s: where
     * all of it is before the face, that t is within the segment means nothing. */
    if (s_high < s_low - s_high)
        return false;
    return (low < 0.0 && high > length) || least < high - low;
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
        if (depth < gather->depth_max && middle_of(gather, piece, from, to, &between))
            integrate(gather, piece, from, &between, to, depth + 1);
    } else if (in_middle || in_a) {
        /* In and out again, or out and in: each half has one end. */
        if (depth < gather->depth_max)
            halve(gather, piece, a, middle, b, depth + 1);
    } else if (turns_over(&a->point, &middle->point) || turns_over(&middle->point, &b->point)) {
        /* The way between is found at any width, and costs no depth, as long as it is one: where
         * view and light are the same line, rounding turns them over everywhere. */
        const bool is_free = gather->turns_left > 0;
        gather->turns_left -= is_free;
        if (is_free || depth < gather->depth_max)
            halve(gather, piece, a, middle, b, is_free ? depth : depth + 1);
    } else if (depth < gather->depth_max &&
               may_reach_in(gather, &a->point, &middle->point, &b->point)) {
        halve(gather, piece, a, middle, b, depth + 1);
    }
}

static void integrate_piece(void *user, const CurvePiece *piece) {
    Gather *gather = user;
    gather->turns_left = TURN_HALVINGS_MAX;
    gather->halvings_left = HALVINGS_MAX;
    const Sample a = sample_of(gather, piece, 0.0, &piece->a);
    const Sample middle = sample_of(gather, piece, 0.5, &piece->middle);
    const Sample b = sample_of(gather, piece, 1.0, &piece->b);
    integrate(gather, piece, &a, &middle, &b, 0);
}

/* f at the six points whose light the cell keeps. */
static void nodes_of(const Gather *gather, const SpecularCell *cell, CurveNode corners[3],
                     CurveNode middles[3]) {
    for (int k = 0; k < 3; ++k) {
        const double u = (double)cell->corners[k][0], v = (double)cell->corners[k][1];
        const Vec3d p = specular_point(&gather->face, u, v);
        corners[k] = (CurveNode){u, v, specular_side(&gather->segment, p, cell->w[k])};
    }
    for (int k = 0; k < 3; ++k) {
        const int next = (k + 1) % 3;
        const double u = 0.5 * (corners[k].u + corners[next].u);
        const double v = 0.5 * (corners[k].v + corners[next].v);
        const Vec3d p = specular_point(&gather->face, u, v);
        const Vec3d mean = vec3d_scale(vec3d_add(cell->w[k], cell->w[next]), 0.5);
        const Vec3d w = vec3d_add(mean, vec3d_from(cell->bend[k]));
        middles[k] = (CurveNode){u, v, specular_side(&gather->segment, p, w)};
    }
}

static void gather_cell(Gather *gather, const SpecularCell *cell) {
    const SpecularField *field = gather->field;
    gather->cell = cell;
    gather->face = specular_face_places(field->scene, field->object, cell->triangle);
    CurveNode corners[3], middles[3];
    nodes_of(gather, cell, corners, middles);
    const Vec3d normal = vec3d_cross(cell->w[0], gather->segment.d);
    if (vec3d_dot(normal, normal) < PARALLEL_SINE * PARALLEL_SINE && !gather->is_turned)
        gather->is_parallel = true;
    if (gather->is_parallel)
        return;
    if (!specular_may_cross(corners, middles))
        return;
    specular_face_light(field->scene, field->object, cell->triangle, cell->material,
                        &field->scene->lights[cell->light], field->adjoint_normals, &gather->face);
    specular_curve(&gather->face, &gather->segment, corners, middles, integrate_piece, gather);
}

static void search_tree(Gather *gather, const BoundQuery *query) {
    const SpecularTree *tree = &gather->field->tree;
    struct {
        uint32_t level, index;
    } stack[SPECULAR_CHILDREN * SPECULAR_LEVEL_MAX];
    uint32_t depth = 0;
    stack[depth].level = tree->level_count - 1;
    stack[depth++].index = 0;
    while (depth > 0) {
        --depth;
        const uint32_t level = stack[depth].level;
        const uint64_t child = (uint64_t)stack[depth].index * SPECULAR_CHILDREN;
        const SpecularNode *node = &tree->nodes[tree->first[level] + stack[depth].index];
        uint32_t bits = specular_children_met(node, query);
        const uint64_t count = tree->child_count[level] - child;
        if (count < SPECULAR_CHILDREN)
            bits &= (1u << count) - 1u;
        for (; bits != 0; bits &= bits - 1) {
            const uint64_t i = child + (uint64_t)__builtin_ctz(bits);
            if (level == 0) {
                gather_cell(gather, &tree->cells[i]);
            } else {
                stack[depth].level = level - 1;
                stack[depth++].index = (uint32_t)i;
            }
        }
    }
}

static Rgb rgb_of_sums(const double v[3]) {
    return rgb((float)v[0], (float)v[1], (float)v[2]);
}

FieldRadiance specular_gather(const SpecularField *field, const FieldSegment *asked) {
    const Vec3 o = asked->o, d = asked->d;
    const float length = asked->length;
    const AmbScene *scene = field->scene;
    const SceneObject *object = &scene->objects[field->object];
    const Medium *medium = &scene->materials[object->inside].medium;
    Gather gather = {.field = field,
                     .medium = medium,
                     .extinction = (double)rgb_max(medium->sigma_t),
                     .straight = {(double)asked->straight.r, (double)asked->straight.g,
                                  (double)asked->straight.b},
                     .depth_max = DEPTH_MAX,
                     .segment = {vec3d_from(o), vec3d_from(d), (double)length}};
    const double optical_radius = gather.extinction * (double)object->radius;
    if (optical_radius > 1.0)
        gather.depth_max += (int)ceil(fmin(log2(optical_radius), OPTICAL_DEPTH_MAX));
    SpecularSegment *segment = &gather.segment;
    segment->d = vec3d_scale(segment->d, 1.0 / vec3d_length(segment->d));
    const BoundQuery query = {o, d, length};
    search_tree(&gather, &query);
    if (gather.is_parallel) {
        Vec3 x, y;
        vec3_frame(d, &x, &y);
        const Vec3d turned = vec3d_madd(segment->d, NUDGE, vec3d_from(x));
        gather = (Gather){.field = field,
                          .medium = medium,
                          .straight = {gather.straight[0], gather.straight[1], gather.straight[2]},
                          .extinction = gather.extinction,
                          .depth_max = gather.depth_max,
                          .segment = gather.segment};
        segment->d = vec3d_scale(turned, 1.0 / vec3d_length(turned));
        gather.is_turned = true;
        search_tree(&gather, &(BoundQuery){o, vec3d_round(segment->d), length});
    }
    FieldRadiance out = {.frequency = 0.0f};
    out.radiance = rgb_of_sums(gather.sum);
    out.straight_once = rgb_of_sums(gather.straight_once);
    out.straight_more = rgb_of_sums(gather.straight_more);
    out.frequency = (float)gather.frequency;
    out.contribution = (float)gather.contribution;
    return out;
}
