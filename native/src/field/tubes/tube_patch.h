/* SPDX-License-Identifier: GPL-3.0-or-later
 * Light tubes, and patches of neighbouring tubes that share their corners. */
#ifndef AMB_FIELD_TUBES_TUBE_PATCH_H
#define AMB_FIELD_TUBES_TUBE_PATCH_H

#include <string.h>

#include "base/parallel.h"
#include "math/vec3.h"

/* How values at corners become flux: dPhi of a whole piece is the value at a point of it times
 * what follows. With the adjoint factor it is as the square of the cosine where light grazes, which
 * linear interpolation makes half too large between 0 and the next corner: corners have its root,
 * which is linear there, and where one is dark and light falls off to it, values are linear. */
enum {
    TUBE_VALUE_IS_FLUX = 0, /* 1: values are W, of the piece if all of it were like the corner */
    TUBE_VALUE_ARRIVES = 1, /* wi . A for a sun, (light - x) . A for a light with a position */
    TUBE_VALUE_LEAVES = 2   /* - w . A: the light after refraction, with Veach's adjoint factor */
};                          /* A: area vector of the piece, m^2, on the light's side */

/* Cosine of incidence that counts as grazing. Interpolation can turn the normal away from the light
 * near a silhouette; it is turned back until the light grazes it, which leaves the refracted map
 * without a jump. What enters there carries nothing to speak of. */
#define TUBE_GRAZING_COS 1e-3f

/* What the light of all tubes in one tree has in common. */
typedef struct TubeLight {
    Rgb color;
    uint32_t value; /* TUBE_VALUE_* */
    bool is_directional;
    Vec3 origin;    /* position, m, from the centre of the tree; of a sun the direction of travel */
    Vec3 extent[2]; /* half of the source along two axes, m, of a sun rad; 0: a point */
    float eta;      /* n before / n after the refraction at the corners */
} TubeLight;

/* A lit piece of the boundary and the light that goes on from it: inside, the light lines are
 * x + s w, start + s its way so far, 0 < s < limit. */
typedef struct Tube {
    Vec3 x[3];      /* corners on the boundary, m, from the centre of the tree */
    Vec3 w[3];      /* unit, direction of travel */
    float value[3]; /* see TUBE_VALUE_*; 0 where there is no light */
    float limit[3]; /* m, where the light ends */
    float start[3]; /* m, travelled inside the medium before */
    float far;      /* m, beyond which none of the light is inside the object: for boxes */
    float bulge;    /* how far w between the corners may be from linear; 0: not at all, or w cannot
                     * be found again from the light */
    float blur;     /* how far w moves over half of the source, both axes together, at most */
} Tube;

/* Numbers of a corner, side by side. */
enum { CORNER_X = 0, CORNER_W = 3, CORNER_VALUE = 6, CORNER_LIMIT = 7, CORNER_SIZE = 8 };

enum { PATCH_CORNERS = 16, PATCH_TUBES = 16, LINE_AXES = 6 };

/* Neighbouring tubes: a corner is stored once, and its f is computed once, for all of them. */
typedef struct TubePatch {
    _Alignas(64) float lines[LINE_AXES][PATCH_CORNERS]; /* x cross w and w of each corner */
    float corners[PATCH_CORNERS][CORNER_SIZE];          /* the same corners, for what is crossed */
    float starts[PATCH_CORNERS];
    uint16_t masks[PATCH_TUBES]; /* which corners a tube has; 0: no tube */
    float bulge;                 /* the largest of the tubes, as their codes have it */
    float radius;                /* of a ball around all corners, m */
    Vec3 center;
    uint32_t codes[PATCH_TUBES]; /* of each tube its corners and bulge: see tube_code */
} TubePatch;

/* Numbers of three corners, four bits each, and the bulge: a float's exponent and three bits of its
 * mantissa, not smaller than it is, from 1e-9 to 4; 0: none. */
enum { CODE_BULGE = 12, CODE_BULGE_MAX = 255, CODE_BULGE_BASE = 8 * (127 + 2) - CODE_BULGE_MAX };

static inline uint32_t tube_code(const uint32_t corners[3], float bulge) {
    uint32_t bits;
    memcpy(&bits, &bulge, sizeof bits);
    const uint32_t step = 1u << 20, level = (bits + step - 1) / step;
    const uint32_t least = CODE_BULGE_BASE + 1, most = CODE_BULGE_BASE + CODE_BULGE_MAX;
    const uint32_t number = !(bulge > 0.0f) ? 0
                            : level < least ? 1
                            : level > most  ? CODE_BULGE_MAX
                                            : level - CODE_BULGE_BASE;
    return corners[0] | corners[1] << 4 | corners[2] << 8 | number << CODE_BULGE;
}

static inline float tube_code_bulge(uint32_t code) {
    const uint32_t number = code >> CODE_BULGE;
    const uint32_t bits = number == 0 ? 0 : (number + CODE_BULGE_BASE) << 20;
    float bulge;
    memcpy(&bulge, &bits, sizeof bulge);
    return bulge;
}

/* Patch p has the tubes order[first[p]] .. order[first[p + 1] - 1]. */
typedef struct TubePatches {
    TubePatch *patches;
    uint64_t *first;
    uint32_t *order;
    uint64_t count;
} TubePatches;

/* Divides tubes into patches; the result depends on the tubes alone, never on threads. radius
 * scales places against directions, m. tube_count in 1 .. 2^31. */
AmbStatus tube_patches_build(const Tube *tubes, uint64_t tube_count, float radius, Job *job,
                             TubePatches *out);
void tube_patches_clear(TubePatches *patches);

/* Sorting by place among lines, for patches and for the tree above them. */
/* x cross w in units of the radius, and w. */
typedef struct LineItem {
    float place[LINE_AXES];
    uint32_t index;
} LineItem;

void line_of(Vec3 x, Vec3 w, float out[LINE_AXES]);
/* Moves the `rank` first items along the longest axis of all to the front. */
void line_items_divide(LineItem *items, uint64_t count, uint64_t rank);
/* Halves along the longest axis until `unit` items or fewer are left; every run of unit * 8^k
 * items from a multiple of that size is one node of a tree. */
AmbStatus line_items_sort(LineItem *items, uint64_t count, uint64_t unit, const Job *job);

#endif
