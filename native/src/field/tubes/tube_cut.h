/* SPDX-License-Identifier: GPL-3.0-or-later
 * What the two steps of cutting tubes share: light that enters a triangle of the boundary
 * (tube_cut.c) and light that the walls reflect back inside (tube_reflect.c). */
#ifndef AMB_FIELD_TUBES_TUBE_CUT_H
#define AMB_FIELD_TUBES_TUBE_CUT_H

#include <stdatomic.h>

#include "field/tubes/tube_source.h"
#include "field/tubes/tubes.h"

/* A tube's corners lie apart by at most this part of its object's radius, and its directions
 * within this angle (rad), each halved by every refinement: inside, the refracted map is taken to
 * be linear. Meshes with rounded shapes are finer anyway; this is for cubes and slabs. */
#define TUBE_SIZE_SHARE_MAX 0.25f
#define TUBE_ANGLE_MAX 0.1f

/* Where a light line inside the object ends. */
typedef struct LineEnd {
    bool is_there; /* false: it leaves through a hole of the mesh */
    Hit exit;
    float reach;  /* m, to the next surface */
    float limit;  /* m, to where the light ends for the gather */
    bool is_free; /* it leaves and does not come back: any limit beyond reach will do */
} LineEnd;

/* Limits of a piece's corners: those that are free follow the others, for what lies between a gap
 * and none would else be lit beyond the gap nearly everywhere. */
void tube_limits(const LineEnd *const ends[3], float out[3]);

/* A point of a triangle and the light there. */
typedef struct Corner {
    float u, v;           /* barycentric weights of the triangle's second and third vertex */
    Vec3 x, w;            /* world; w unit */
    float arriving, flux; /* per area of the flat triangle and unit colour, before and after
                           * refraction, 1/m^2 */
    float value;          /* see TUBE_VALUE_* */
    float blur;           /* how far w moves over half of the source, both axes together */
    LineEnd end;
    bool is_lit;
} Corner;

/* A tube and what decides which tree it belongs to. */
typedef struct CutTube {
    Tube tube;
    uint32_t material; /* that it enters through; TUBE_REFLECTED: it was reflected inside */
    Rgb color; /* of a reflected one: the lamp's, with the tints of all surfaces on its way */
} CutTube;

#define TUBE_REFLECTED UINT32_MAX

/* Of the triangles of one unit of work under one source. */
enum { TUBE_CHUNK_TRIANGLES = 256 };

typedef struct TubeChunk {
    CutTube *tubes;
    uint64_t count, room;
    TubeCount tally;
} TubeChunk;

typedef struct Cutter {
    const AmbScene *scene;
    const TubeParams *params;
    Job *job;
    const TubeSource *sources;
    uint32_t source_count;
    TubeChunk *chunks;
    uint64_t triangle_chunks; /* chunks of one source */
    uint32_t object;
    /* Reflected tubes so far. Above the most of them a try is given up, and the next one divides
     * less: the total decides, which threads do not change. */
    atomic_uint_least64_t *reflected_count;
    uint64_t reflected_max;
    uint32_t coarseness; /* tries given up so far; TUBE_COARSENESS_MAX: nothing is divided */
} Cutter;

enum { TUBE_COARSENESS_MAX = 4 };

/* One triangle under one light. */
typedef struct Face {
    const Cutter *cutter;
    const TubeSource *source;
    const SceneLight *light; /* the source's */
    TubeChunk *chunk;
    uint32_t triangle, material;
    Rgb color;
    float area; /* of the whole triangle, m^2 */
} Face;

/* Cuts the chunks begin .. end - 1 of the Cutter `user`: see parallel_for. */
AmbStatus tube_cut_chunks(void *user, uint64_t begin, uint64_t end, uint32_t thread);

AmbStatus tube_chunk_append(TubeChunk *chunk, const CutTube *tube);
void tube_tally_add(double sum[3], Rgb color, double flux);
float tube_largest_difference(const Vec3 v[3]);

/* Light and its refraction at a point of the face's triangle. */
Corner tube_corner(const Face *face, float u, float v);
/* Follows a light line from a point just inside the wall. */
LineEnd tube_line_end(const Face *face, Vec3 from, Vec3 w);

/* Adds what the walls reflect, up to params->bounces times, of a piece of the face's triangle, m^2.
 */
AmbStatus tubes_reflect(const Face *face, const Corner corners[3], float area);

#endif
