/* SPDX-License-Identifier: GPL-3.0-or-later
 * Cells: their places and volumes, and the radiance along a segment. */
#include "field/scatter/scatter_cells.h"

#include <string.h>

#include "base/memory.h"
#include "base/rng.h"
#include "field/scatter/lobe.h"
#include "field/scatter/solids.h"
#include "math/sampling.h"

enum {
    LINES_PER_CUBE = 4, /* along an edge: lines on which volumes are measured */
    NODE_MAX = 1 << 24, /* nodes times layers */
    CROSSING_MAX = 256  /* surfaces along one line */
};

/* Layers begin this thin, in mean free paths of the densest channel, then each is thicker than the
 * last. */
static const float LAYER_WIDTH = 0.125f, LAYER_GROWTH = 1.2f;
/* A layer counts fully where so much of it is around, of what a plane one would have. */
static const float LAYER_PART = 0.2f;
/* Light from below this optical depth of the clearest channel is left out: exp(-9) = 1.2e-4. */
static const float DEPTH_MAX = 9.0f;

/* ---- Layers and nodes ------------------------------------------------------------------------ */

/* Extinction of the clearest channel that scatters, 1/m, without what scatters straight on. */
static float clearest(const ScatterCells *cells) {
    const Medium *medium = cells->medium;
    const float sigma_t[3] = {medium->sigma_t.r - cells->forward.r,
                              medium->sigma_t.g - cells->forward.g,
                              medium->sigma_t.b - cells->forward.b};
    float least = INFINITY;
    for (uint32_t i = 0; i < medium->lobe_count; ++i) {
        const Rgb s = medium->lobes[i].sigma_s;
        const float sigma_s[3] = {s.r, s.g, s.b};
        for (int k = 0; k < 3; ++k)
            if (sigma_s[k] > 0.0f)
                least = fminf(least, sigma_t[k]);
    }
    return least;
}

static void place_layers(ScatterCells *cells, float radius, float size) {
    float width = LAYER_WIDTH / rgb_max(cells->medium->sigma_t);
    /* In thin media, as fine as cubes. */
    width = width < 0.5f * size ? width : 0.5f * size;
    const float visible = fminf(DEPTH_MAX / clearest(cells), radius);
    /* The first layers are alike up to where growth sets in smoothly: width / (growth - 1). */
    const float uniform = roundf(1.0f / logf(LAYER_GROWTH));
    cells->layer_width = width;
    cells->uniform_depth = uniform * width;
    cells->log_scale = 1.0f / logf(LAYER_GROWTH);
    while (cells->layer_count < LAYER_MAX && cells->layers[cells->layer_count] < visible) {
        const float n = (float)(cells->layer_count + 1);
        cells->layers[++cells->layer_count] =
            n <= uniform ? n * width : uniform * width * powf(LAYER_GROWTH, n - uniform);
    }
}

static void place_nodes(ScatterCells *cells, float size) {
    const DepthGrid *depth = &cells->depth;
    uint64_t total;
    do {
        total = cells->layer_count;
        for (int k = 0; k < 3; ++k) {
            const float extent = (float)(depth->count[k] - 1) * depth->spacing;
            cells->count[k] = (uint32_t)(extent / size) + 2;
            total *= cells->count[k];
        }
        cells->size = size;
        size *= 1.25f;
    } while (total > NODE_MAX);
    cells->origin = depth->origin;
}

static uint64_t node_count(const ScatterCells *cells) {
    return (uint64_t)cells->count[0] * cells->count[1] * cells->count[2];
}

/* The cube of p: its first node, and where in it p is. */
typedef struct Cube {
    uint64_t node;
    float at[3]; /* [0,1) */
} Cube;

/* In units of cubes, from the first node. */
static Vec3 place_in_cubes(const ScatterCells *cells, Vec3 p) {
    return vec3_scale(vec3_sub(p, cells->origin), 1.0f / cells->size);
}

static bool cube_at(const ScatterCells *cells, Vec3 q, Cube *out) {
    if (!(q.x >= 0.0f && q.y >= 0.0f && q.z >= 0.0f))
        return false;
    const uint32_t i = (uint32_t)q.x, j = (uint32_t)q.y, k = (uint32_t)q.z;
    if (i + 1 >= cells->count[0] || j + 1 >= cells->count[1] || k + 1 >= cells->count[2])
        return false;
    out->node = ((uint64_t)k * cells->count[1] + j) * cells->count[0] + i;
    out->at[0] = q.x - (float)i;
    out->at[1] = q.y - (float)j;
    out->at[2] = q.z - (float)k;
    return true;
}

static bool find_cube(const ScatterCells *cells, Vec3 p, Cube *out) {
    return cube_at(cells, place_in_cubes(cells, p), out);
}

/* Node c of the eight around a cube, and its hat function there. */
static uint64_t cube_node(const ScatterCells *cells, const Cube *cube, uint32_t c) {
    const uint64_t nx = cells->count[0];
    return cube->node + (c & 1) + ((c >> 1) & 1) * nx + (c >> 2) * nx * cells->count[1];
}

static float cube_hat(const Cube *cube, uint32_t c) {
    return ((c & 1) != 0 ? cube->at[0] : 1.0f - cube->at[0]) *
           ((c & 2) != 0 ? cube->at[1] : 1.0f - cube->at[1]) *
           ((c & 4) != 0 ? cube->at[2] : 1.0f - cube->at[2]);
}

/* The degree that the sharpest lobe asks for, and what all of them together scatter. */
static void place_lobes(ScatterCells *cells) {
    const Medium *medium = cells->medium;
    uint32_t degree = 0;
    for (uint32_t j = 0; j < medium->lobe_count; ++j) {
        const uint32_t own = lobe_degree(medium->lobes[j].g);
        degree = own > degree ? own : degree;
    }
    cells->harmonics = harmonics_create(degree);
    for (uint32_t j = 0; j < medium->lobe_count; ++j) {
        float c[HARMONIC_DEGREE_MAX + 1];
        const float forward = lobe_coefficients(medium->lobes[j].g, degree, c);
        cells->forward = rgb_add(cells->forward, rgb_scale(medium->lobes[j].sigma_s, forward));
        for (uint32_t l = 0; l <= degree; ++l)
            cells->scattering[l] =
                rgb_add(cells->scattering[l], rgb_scale(medium->lobes[j].sigma_s, c[l]));
    }
}

/* ---- Volumes --------------------------------------------------------------------------------- */

typedef struct Measure {
    const AmbScene *scene;
    const ScatterCells *cells;
    const Solids *solids;
    Job *job;
    uint32_t object;
    float *volumes; /* m^3, by node and layer */
    /* Lines along an axis, of every other row of cubes: rows of one parity share no node. */
    int axis;
    uint32_t parity;
    uint32_t row; /* of the lines of this thread, along the axis after that */
} Measure;

/* Shortest step of measure_stretch, in lengths of the stretch. */
static const float STEP_SHARE_MIN = 1e-4f;

/* Part of a line: it adds a volume to the nodes around its middle. */
static void measure_part(const Measure *measure, Vec3 middle, uint32_t layer, float volume) {
    const ScatterCells *cells = measure->cells;
    const Vec3 q = place_in_cubes(cells, middle);
    float place[3] = {q.x, q.y, q.z};
    /* Far from the origin coordinates may be coarser than lines are apart, and a line beside its
     * row: the nodes there are another thread's. */
    float *across = &place[(measure->axis + 1) % 3];
    *across = clampf(*across, (float)measure->row, (float)measure->row + 0.999f);
    Cube cube;
    if (!cube_at(cells, vec3_from(place), &cube))
        return;
    for (uint32_t c = 0; c < 8; ++c)
        measure->volumes[cube_node(cells, &cube, c) * cells->layer_count + layer] +=
            cube_hat(&cube, c) * volume;
}

/* A step of a line from p on, along which depth goes linearly from one value to another: each layer
 * gets what of the step lies in it. To give the whole step to the layer in its middle would be
 * right on average over lines that meet layers at random, but those along a flat wall's normal all
 * meet them alike. */
static void measure_step(const Measure *measure, Vec3 p, Vec3 step, float volume,
                         const float depths[2]) {
    const ScatterCells *cells = measure->cells;
    const float low = fmaxf(fminf(depths[0], depths[1]), 0.0f);
    const float high = fmaxf(fmaxf(depths[0], depths[1]), low);
    const float range = depths[1] - depths[0];
    uint32_t layer = scatter_layer_at(cells, low);
    for (; layer < cells->layer_count && cells->layers[layer] <= high; ++layer) {
        float from = 0.0f, to = 1.0f; /* of the step, lower depths first */
        const float top = cells->layers[layer] - depths[0];
        const float bottom = cells->layers[layer + 1] - depths[0];
        /* What reaches above the boundary by the grid's errors belongs to the first layer. */
        if (range > 0.0f) {
            from = layer > 0 ? fmaxf(top / range, 0.0f) : 0.0f;
            to = fminf(bottom / range, 1.0f);
        } else if (range < 0.0f) {
            from = fmaxf(bottom / range, 0.0f);
            to = layer > 0 ? fminf(top / range, 1.0f) : 1.0f;
        }
        if (to > from)
            measure_part(measure, vec3_madd(p, 0.5f * (from + to), step), layer,
                         (to - from) * volume);
        if (range == 0.0f)
            return;
    }
}

/* Adds the part of a line, of cross-section `area`, between two surfaces. Steps are as long as
 * layers are thick and shorter than cubes are wide; far below the layers they are as long as the
 * way to them. */
static void measure_stretch(const Measure *measure, Vec3 o, Vec3 d, float length, float area) {
    const ScatterCells *cells = measure->cells;
    const float deepest = cells->layers[cells->layer_count];
    const float step_max = fminf(0.5f * cells->size, cells->depth.spacing);
    /* In a medium so dense that layers are thinner than this, parts of a step may be far from where
     * a line through the grid's depths says; shorter steps would never end, or not move at all. */
    const float step_min = STEP_SHARE_MIN * length;
    float depths[2] = {depth_grid_at(&cells->depth, o), 0.0f};
    for (float t = 0.0f; t < length;) {
        const float free = depth_grid_free(&cells->depth, depths[0]) - deepest;
        float step = fmaxf(cells->layer_width, 0.2f * depths[0]);
        step = fmaxf(fmaxf(fminf(step, step_max), free), step_min);
        step = fminf(step, length - t);
        const Vec3 p = vec3_madd(o, t, d);
        t += step;
        depths[1] = depth_grid_at(&cells->depth, vec3_madd(o, t, d));
        if (!(free > 0.0f)) {
            /* Lines along a layer would meet it by luck: each counts with the square of its cosine
             * to the layer's normal, which adds up to 1 over the three axes. */
            const Vec3 normal = depth_grid_normal(&cells->depth, vec3_madd(p, 0.5f * step, d));
            const float cosine = vec3_dot(normal, d);
            if (cosine != 0.0f)
                measure_step(measure, p, vec3_scale(d, step), cosine * cosine * area * step,
                             depths);
        }
        depths[0] = depths[1];
    }
}

/* Follows a line through all boundaries: what is inside is known exactly. */
static void measure_line(const Measure *measure, Vec3 o, Vec3 d, float area) {
    const AmbScene *scene = measure->scene;
    MediumStack stack = scene_media_at(scene, o);
    SolidsAround around = solids_around(scene, measure->solids, o, d);
    for (int i = 0; i < CROSSING_MAX; ++i) {
        Hit hit;
        if (!scene_intersect(scene, o, d, INFINITY, &hit))
            return;
        if (around.hiding == 0 && around.missing == 0 && stack.count > 0 &&
            medium_stack_top(&stack) == measure->object)
            measure_stretch(measure, o, d, hit.t, area);
        const SurfacePoint surface = scene_surface(scene, &hit);
        SurfacePoint wall = surface;
        bool is_opaque = surface.material->surface != AMB_SURFACE_DIELECTRIC;
        if (scene->objects[surface.object].is_boundary) {
            const BoundaryCrossing crossing = boundary_cross(scene, &stack, &surface, d);
            stack = crossing.beyond;
            if (!is_opaque) {
                is_opaque = crossing.is_opaque;
                wall = crossing.surface;
            }
        }
        if (is_opaque)
            solids_pass(measure->solids, &wall, d, &around);
        o = scene_leave(&surface, d);
    }
}

/* One row of cubes. */
static AmbStatus measure_row(void *user, uint64_t begin, uint64_t end, uint32_t thread) {
    (void)end;
    (void)thread;
    const Measure *all = user;
    const ScatterCells *cells = all->cells;
    const int axis = all->axis, row_axis = (axis + 1) % 3, other_axis = (axis + 2) % 3;
    const uint32_t row = 2 * (uint32_t)begin + all->parity;
    Measure measure = *all;
    measure.row = row;
    const float spacing = cells->size / (float)LINES_PER_CUBE;
    const uint32_t lines = (cells->count[other_axis] - 1) * LINES_PER_CUBE;
    for (uint32_t j = 0; j < lines; ++j) {
        if (job_is_cancelled(measure.job))
            return AMB_CANCELLED;
        for (uint32_t i = 0; i < LINES_PER_CUBE; ++i) {
            float from[3] = {cells->origin.x, cells->origin.y, cells->origin.z};
            float along[3] = {0, 0, 0};
            from[row_axis] += cells->size * (float)row;
            from[row_axis] += spacing * ((float)i + 0.5f);
            from[other_axis] += spacing * ((float)j + 0.5f);
            along[axis] = 1.0f;
            measure_line(&measure, vec3_from(from), vec3_from(along), spacing * spacing);
        }
    }
    return AMB_OK;
}

static AmbStatus measure_axis(Measure *measure, int axis) {
    const uint32_t rows = measure->cells->count[(axis + 1) % 3] - 1;
    measure->axis = axis;
    for (uint32_t parity = 0; parity < 2; ++parity) {
        measure->parity = parity;
        AMB_TRY(parallel_for(measure->job, (rows + 1 - parity) / 2, 1, measure_row, measure));
    }
    return AMB_OK;
}

/* Numbers the cells: of each node those between the first and the last layer with a volume. */
static AmbStatus number_cells(const Measure *measure, ScatterCells *cells) {
    const uint64_t count = node_count(cells);
    const uint32_t layers = cells->layer_count;
    const float *volumes = measure->volumes;
    for (uint64_t n = 0; n < count; ++n) {
        CellColumn *column = &cells->columns[n];
        column->first = (uint32_t)cells->cell_count;
        for (uint32_t layer = 0; layer < layers; ++layer)
            if (volumes[n * layers + layer] > 0.0f) {
                if (column->high == 0)
                    column->low = (uint16_t)layer;
                column->high = (uint16_t)(layer + 1);
            }
        cells->cell_count += column->high - column->low;
    }
    cells->volumes = memory_alloc_array(cells->cell_count, sizeof *cells->volumes);
    if (cells->volumes == NULL)
        return status_fail(AMB_OUT_OF_MEMORY, "no memory for scattered light");
    for (uint64_t n = 0; n < count; ++n) {
        const CellColumn *column = &cells->columns[n];
        for (uint32_t layer = column->low; layer < column->high; ++layer)
            cells->volumes[column->first + layer - column->low] = volumes[n * layers + layer];
    }
    return AMB_OK;
}

static AmbStatus measure_volumes(const AmbScene *scene, uint32_t object, Job *job,
                                 ScatterCells *cells) {
    const uint64_t count = node_count(cells) * cells->layer_count;
    Solids solids = {.is_solid = NULL};
    Measure measure = {.scene = scene,
                       .cells = cells,
                       .solids = &solids,
                       .job = job,
                       .object = object,
                       .volumes = memory_zero_array(count, sizeof *measure.volumes)};
    AmbStatus status = AMB_OK;
    cells->columns = memory_zero_array(node_count(cells), sizeof *cells->columns);
    if (measure.volumes == NULL || cells->columns == NULL)
        status = status_fail(AMB_OUT_OF_MEMORY, "no memory for scattered light");
    if (status == AMB_OK)
        status = solids_find(scene, object, job, &solids);
    for (int axis = 0; status == AMB_OK && axis < 3; ++axis)
        status = measure_axis(&measure, axis);
    if (status == AMB_OK)
        status = number_cells(&measure, cells);
    solids_clear(&solids);
    memory_free(measure.volumes);
    return status;
}

AmbStatus scatter_cells_build(const AmbScene *scene, uint32_t object, float size,
                              uint32_t slot_count, Job *job, ScatterCells *out_cells) {
    memset(out_cells, 0, sizeof *out_cells);
    const SceneObject *shape = &scene->objects[object];
    out_cells->medium = &scene->materials[shape->inside].medium;
    place_lobes(out_cells);
    out_cells->slot_count = slot_count;
    out_cells->float_count = slot_count * harmonic_count(out_cells->harmonics.degree) * 4;
    AMB_TRY(depth_grid_build(scene, object, size, job, &out_cells->depth));
    place_layers(out_cells, shape->radius, size);
    place_nodes(out_cells, size);
    return measure_volumes(scene, object, job, out_cells);
}

void scatter_cells_clear(ScatterCells *cells) {
    depth_grid_clear(&cells->depth);
    memory_free(cells->columns);
    memory_free(cells->volumes);
    memory_free(cells->moments);
    memset(cells, 0, sizeof *cells);
}

uint64_t scatter_cells_bytes(const ScatterCells *cells) {
    if (cells->columns == NULL)
        return 0;
    return depth_grid_bytes(&cells->depth) + node_count(cells) * sizeof *cells->columns +
           cells->cell_count * (sizeof *cells->volumes + cells->float_count * sizeof(float));
}

/* ---- Adding ---------------------------------------------------------------------------------- */

bool scatter_cells_add(const ScatterCells *cells, float *moments, uint32_t slot, Vec3 p,
                       uint32_t layer, Rgb stretch, const float *harmonics, const float u[3]) {
    Cube cube;
    if (!find_cube(cells, p, &cube))
        return false;
    const uint32_t c = (u[0] < cube.at[0] ? 1u : 0u) | (u[1] < cube.at[1] ? 2u : 0u) |
                       (u[2] < cube.at[2] ? 4u : 0u);
    const CellColumn column = cells->columns[cube_node(cells, &cube, c)];
    if (layer < column.low || layer >= column.high)
        return false;
    const uint32_t count = harmonic_count(cells->harmonics.degree);
    const uint64_t cell = column.first + layer - column.low;
    float *out = moments + cell * cells->float_count + (uint64_t)slot * count * 4;
    for (uint32_t i = 0; i < count; ++i) {
        out[4 * i] += harmonics[i] * stretch.r;
        out[4 * i + 1] += harmonics[i] * stretch.g;
        out[4 * i + 2] += harmonics[i] * stretch.b;
    }
    return true;
}

/* ---- Gathering ------------------------------------------------------------------------------- */

/* What a moment adds to the radiance scattered into one direction, per metre:
 *   sigma_s p(w . wo) = sum over l, m of (sum over lobes of sigma_s c_l) Y_lm(wo) Y_lm(w). */
static void scatter_weights(const ScatterCells *cells, Vec3 wo, float weights[][4]) {
    float values[HARMONIC_COUNT_MAX];
    harmonics_evaluate(&cells->harmonics, wo, values);
    for (uint32_t l = 0, i = 0; l <= cells->harmonics.degree; ++l)
        for (; i < harmonic_count(l); ++i) {
            weights[i][0] = values[i] * cells->scattering[l].r;
            weights[i][1] = values[i] * cells->scattering[l].g;
            weights[i][2] = values[i] * cells->scattering[l].b;
            weights[i][3] = 0.0f;
        }
}

static float layer_middle(const ScatterCells *cells, uint32_t layer) {
    return 0.5f * (cells->layers[layer] + cells->layers[layer + 1]);
}

/* The eight nodes around a point at one depth. */
typedef struct Layer {
    uint64_t cells[8];
    float hats[8];    /* 0: no cell there */
    float volumes[8]; /* m^3, times the hat */
    float volume;     /* of all */
    float trust;      /* 0 to 1: less where little of the layer is near */
} Layer;

static void find_layer(const ScatterCells *cells, const Cube *cube, uint32_t layer, Layer *out) {
    out->volume = 0.0f;
    for (uint32_t c = 0; c < 8; ++c) {
        const CellColumn column = cells->columns[cube_node(cells, cube, c)];
        const bool is_there = layer >= column.low && layer < column.high;
        const uint64_t cell = is_there ? column.first + layer - column.low : 0;
        out->cells[c] = cell;
        out->hats[c] = is_there ? cube_hat(cube, c) : 0.0f;
        out->volumes[c] = is_there ? out->hats[c] * cells->volumes[cell] : 0.0f;
        out->volume += out->volumes[c];
    }
    const float thickness = cells->layers[layer + 1] - cells->layers[layer];
    const float whole = cells->size * cells->size * fminf(thickness, cells->size);
    out->trust = out->volume > 0.0f ? fminf(out->volume / (LAYER_PART * whole), 1.0f) : 0.0f;
}

/* Adds a cell's moments, each as much as it sends into one direction, by slot. Four sums at a time:
 * one after the other would wait for each sum. */
static void add_moments(const ScatterCells *cells, uint64_t cell, const float (*weights)[4],
                        float scale, float out[SLOT_MAX][4]) {
    enum { CHAINS = 4 };
    const uint32_t count = harmonic_count(cells->harmonics.degree);
    const float *m = cells->moments + cell * cells->float_count;
    for (uint32_t s = 0; s < cells->slot_count; ++s, m += (size_t)count * 4) {
        float sums[CHAINS][4] = {{0}};
        uint32_t i = 0;
        for (; i + CHAINS <= count; i += CHAINS)
            for (uint32_t j = 0; j < CHAINS; ++j)
                for (uint32_t k = 0; k < 4; ++k)
                    sums[j][k] += weights[i + j][k] * m[4 * (i + j) + k];
        for (; i < count; ++i)
            for (uint32_t k = 0; k < 4; ++k)
                sums[0][k] += weights[i][k] * m[4 * i + k];
        for (uint32_t k = 0; k < 4; ++k)
            out[s][k] += scale * ((sums[0][k] + sums[1][k]) + (sums[2][k] + sums[3][k]));
    }
}

/* Radiance scattered per metre at one depth, by slot: moments over volumes of the nodes around,
 * each in proportion to its volume too, so that slivers say little. */
static void sample_layer(const ScatterCells *cells, const Layer *layer, const float (*weights)[4],
                         float out[SLOT_MAX][4]) {
    memset(out, 0, SLOT_MAX * sizeof *out);
    if (!(layer->volume > 0.0f))
        return;
    for (uint32_t c = 0; c < 8; ++c)
        if (layer->hats[c] > 0.0f)
            add_moments(cells, layer->cells[c], weights, layer->hats[c] / layer->volume, out);
}

/* What cells without a volume of their own have, too, in units of that of all. */
static const float SLIVER = 0.05f;

/* The same from one of the nodes by chance: its mean over u is that. */
static void sample_layer_once(const ScatterCells *cells, const Layer *layer,
                              const float (*weights)[4], float u, float out[SLOT_MAX][4]) {
    memset(out, 0, SLOT_MAX * sizeof *out);
    if (!(layer->volume > 0.0f))
        return;
    float chances[8], sum = 0.0f;
    for (uint32_t c = 0; c < 8; ++c) {
        chances[c] = layer->volumes[c] + SLIVER * layer->volume * layer->hats[c];
        sum += chances[c];
    }
    uint32_t c = 0;
    for (u *= sum; c < 7 && u >= chances[c]; ++c)
        u -= chances[c];
    while (c > 0 && !(chances[c] > 0.0f))
        --c; /* rounding went past the last one */
    if (chances[c] > 0.0f)
        add_moments(cells, layer->cells[c], weights,
                    layer->hats[c] * sum / (chances[c] * layer->volume), out);
}

/* Between two layers, x = 0 and 1 at their middles. Below 0, towards the boundary, the line ends at
 * zero there at the least: a steeper one is the noise of a second layer more than three times as
 * bright as the first, and its mean over the first stays what it is. */
static float between(float here, float there, float x) {
    const float step = there - here;
    return here + (x < 0.0f ? fmaxf(x, -0.5f) * fminf(step, 2.0f * here) : x * step);
}

/* Where one node is looked at, all are with this chance for what is above the first layer's middle.
 */
static const float BELOW_CHANCE = 0.25f;

/* Linear in depth between the middles of layers, on to the boundary beyond the first, and even
 * beyond the last. u: one node by chance; NULL: all that are around. */
static void sample_source(const ScatterCells *cells, Vec3 p, const float (*weights)[4],
                          const Sample2 *u, float out[SLOT_MAX][4]) {
    memset(out, 0, SLOT_MAX * sizeof *out);
    Cube cube;
    const float depth = fmaxf(depth_grid_at(&cells->depth, p), 0.0f);
    uint32_t layer = scatter_layer_at(cells, depth);
    if (layer >= cells->layer_count || !find_cube(cells, p, &cube))
        return;
    if (layer > 0 && (depth < layer_middle(cells, layer) || layer + 1 == cells->layer_count))
        --layer;
    Layer here, there = {.trust = 0.0f};
    find_layer(cells, &cube, layer, &here);
    float x = 0.0f;
    if (layer + 1 < cells->layer_count)
        find_layer(cells, &cube, layer + 1, &there);
    if (there.trust > 0.0f) {
        const float from = layer_middle(cells, layer), to = layer_middle(cells, layer + 1);
        x = there.trust * fminf((depth - from) / (to - from), 1.0f);
        x = 1.0f - here.trust * (1.0f - x);
    }
    if (u != NULL) {
        sample_layer_once(cells, u->v < x ? &there : &here, weights, u->u, out);
        if (!(x < 0.0f && u->v < BELOW_CHANCE))
            return;
    }
    float first[SLOT_MAX][4], next[SLOT_MAX][4];
    sample_layer(cells, &here, weights, first);
    sample_layer(cells, &there, weights, next);
    for (uint32_t s = 0; s < cells->slot_count; ++s)
        for (int k = 0; k < 4; ++k) {
            const float all = between(first[s][k], next[s][k], x);
            /* What the line to the boundary changes needs both layers. */
            out[s][k] = u == NULL ? all : out[s][k] + (all - first[s][k]) / BELOW_CHANCE;
        }
}

/* int exp(-sigma t) dt over a step. */
static float step_weight(float sigma, float from, float step) {
    const float x = sigma * step;
    return expf(-sigma * from) * (x > 1e-4f ? -expm1f(-x) / sigma : step);
}

/* Light that scatters on straight k times on a way of depth tau: by exp(-tau) less, tau^k / k!.
 * Here of all k >= 0, k >= 1 and k >= 2. */
typedef struct ForwardSums {
    float all, some, several;
} ForwardSums;

static ForwardSums forward_sums(float tau) {
    const float some = expm1f(tau);
    /* Far below 1 the difference would be rounding. */
    const float several = tau < 0.05f ? tau * tau * (0.5f + tau / 6.0f) : some - tau;
    return (ForwardSums){1.0f + some, some, several};
}

/* A step's light in each channel by its order, which light that goes straight on raises. */
static void add_step(const ScatterCells *cells, const float w[3], const float tau[3],
                     float source[SLOT_MAX][4], float sum[SLOT_MAX][4]) {
    for (int k = 0; k < 3; ++k) {
        const float once = cells->slot_count > 2 ? w[k] * source[2][k] : 0.0f;
        const float twice = w[k] * source[0][k], more = w[k] * source[1][k];
        if (tau[k] > 0.0f) {
            const ForwardSums forward = forward_sums(tau[k]);
            sum[0][k] += twice + tau[k] * once;
            sum[1][k] += forward.all * more + forward.some * twice + forward.several * once;
        } else {
            sum[0][k] += twice;
            sum[1][k] += more;
        }
        sum[2][k] += once;
    }
}

/* Steps are as long as cubes where these are no longer than this, in mean free paths of the densest
 * channel: light comes from many, and from one node of each by chance there is little noise. */
static const float THIN_CUBE = 0.25f;

ScatterRadiance scatter_cells_gather(const ScatterCells *cells, Vec3 o, Vec3 d, float length,
                                     Rgb forward, const Sample2 *u) {
    float weights[HARMONIC_COUNT_MAX][4];
    scatter_weights(cells, vec3_negate(d), weights);
    const Rgb sigma_t = cells->medium->sigma_t;
    const float dense = rgb_max(sigma_t);
    const float end = fminf(length, DEPTH_MAX / clearest(cells));
    const bool is_by_chance = u != NULL && dense * cells->size <= THIN_CUBE;
    float sum[SLOT_MAX][4] = {{0}};
    uint32_t count = 0;
    for (float t = 0.0f; t < end; ++count) {
        const float step = fminf(fminf(fmaxf(0.25f / dense, 0.3f * t), cells->size), end - t);
        /* Where the densest channel's light of the step comes from, on average. */
        const float x = dense * step;
        const float middle =
            x > 1e-2f ? t + (1.0f - x / expm1f(x)) / dense : t + (0.5f - x / 12.0f) * step;
        float source[SLOT_MAX][4];
        Sample2 chance = {0.0f, 0.0f}; /* even over the steps */
        if (is_by_chance)
            chance = sample_r2(count, u->u, u->v);
        sample_source(cells, vec3_madd(o, middle, d), (const float(*)[4])weights,
                      is_by_chance ? &chance : NULL, source);
        const float w[3] = {step_weight(sigma_t.r, t, step), step_weight(sigma_t.g, t, step),
                            step_weight(sigma_t.b, t, step)};
        const Rgb depth = scatter_forward_depth(forward, cells->forward, middle);
        const float tau[3] = {depth.r, depth.g, depth.b};
        add_step(cells, w, tau, source, sum);
        t += step;
    }
    return (ScatterRadiance){
        .twice = rgb_from(sum[0]), .more = rgb_from(sum[1]), .once = rgb_from(sum[2])};
}
