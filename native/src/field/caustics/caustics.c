/* SPDX-License-Identifier: GPL-3.0-or-later
 * From landings of light to kernels. */
#include "field/caustics/caustics.h"

#include <float.h>
#include <string.h>

#include "base/memory.h"
#include "field/caustics/caustic_gather.h"

enum { GRAIN = 4096 };

/* A kernel is at most so many times longer than wide, and its half-axes between these multiples of
 * the typical kernel's. Where light folds over itself neighbouring rays land on a line, and the
 * thinner a kernel may be there the sharper is the fold; where light grazes it carries little, and
 * need not be smooth. They move no flux. By tests/bench/bench_caustics.py. */
static const float ECCENTRICITY_MAX = 128.0f;
static const float AXIS_MIN = 0.005f;
static const float AXIS_MAX = 32.0f;
/* A source with an extent is sampled by one point for each ray, so that cells of the lattice land
 * apart by chance. Its image blurs the light in any case: a kernel as wide as part of it adds this
 * share of its variance, and takes in more photons, but never so many that they take long. */
static const float SOURCE_VARIANCE = 0.1f;
static const float SOURCE_OVERLAP_MAX = 200.0f;

struct CausticMap {
    CausticTree trees[CAUSTIC_PART_MAX]; /* no photons: empty */
    CausticTree glow[GLOW_ORDER_COUNT][CAUSTIC_PART_MAX];
    uint32_t part_count;
    CausticGather gather;
    float density_scale; /* over peaks, 1/W: see CausticPoint */
    CausticAccount account;
};

/* Symmetric 2 x 2: the square of an ellipse's half-axes, m^2. */
typedef struct Quadric {
    float xx, xy, yy;
} Quadric;

typedef struct Placement {
    const LightLanding *landings;
    const uint64_t *chosen; /* their indices */
    const CausticParams *params;
    float axis; /* half-axis of the typical kernel, m */
    CausticPhoton *photons;
} Placement;

static void add_square(Quadric *sum, float weight, float x, float y) {
    sum->xx += weight * x * x;
    sum->xy += weight * x * y;
    sum->yy += weight * y * y;
}

static float footprint_area(const LightLanding *landing, int k) {
    return fabsf(
        vec3_dot(landing->n, vec3_cross(landing->footprint[k], landing->footprint[k + 1])));
}

/* The sum of the covariances of cell and source, each to its own share. The cell's ellipse has
 * `overlap` times its area. */
static Quadric landing_quadric(const LightLanding *landing, float overlap, Vec3 x, Vec3 y) {
    const float cell = footprint_area(landing, 0);
    const float source = footprint_area(landing, TANGENT_LATTICE);
    /* Variances: a^2/6 of the kernel with half-axis a, e^2/12 of the source's full extent e. */
    float share = 0.5f * SOURCE_VARIANCE;
    if (share * AMB_PI * source > SOURCE_OVERLAP_MAX * cell)
        share = SOURCE_OVERLAP_MAX * cell / (AMB_PI * source);
    Quadric sum = {0, 0, 0};
    for (int k = 0; k < TANGENT_COUNT; ++k)
        add_square(&sum, k < TANGENT_LATTICE ? overlap / AMB_PI : share,
                   vec3_dot(landing->footprint[k], x), vec3_dot(landing->footprint[k], y));
    return sum;
}

CausticPhoton caustics_kernel(const LightLanding *landing, float overlap, float axis) {
    Vec3 x, y;
    vec3_frame(landing->n, &x, &y);
    const Quadric q = landing_quadric(landing, overlap, x, y);
    /* Its axes: half the angle of (xx - yy, 2 xy). */
    const float mean = 0.5f * (q.xx + q.yy);
    const float half = 0.5f * (q.xx - q.yy);
    const float split = sqrtf(half * half + q.xy * q.xy);
    const float angle = split > 0.0f ? 0.5f * atan2f(q.xy, half) : 0.0f;
    const float most = AXIS_MAX * axis, least = AXIS_MIN * axis;
    const float a = clampf(sqrtf(mean + split), least, most);
    const float b = clampf(safe_sqrtf(mean - split), fmaxf(a / ECCENTRICITY_MAX, least), most);
    const Vec3 along = vec3_madd(vec3_scale(x, cosf(angle)), sinf(angle), y);
    const Vec3 across = vec3_cross(landing->n, along);
    return (CausticPhoton){.p = landing->p,
                           .n = landing->n,
                           .u = vec3_scale(along, 1.0f / a),
                           .v = vec3_scale(across, 1.0f / b),
                           .peak = rgb_scale(landing->flux, 2.0f / (AMB_PI * a * b))};
}

static AmbStatus place_photons(void *user, uint64_t begin, uint64_t end, uint32_t thread) {
    (void)thread;
    const Placement *placement = user;
    for (uint64_t i = begin; i < end; ++i)
        placement->photons[i] = caustics_kernel(&placement->landings[placement->chosen[i]],
                                                placement->params->overlap, placement->axis);
    return AMB_OK;
}

/* Geometric mean of the cells' areas, weighted by flux: neither a focus nor grazing light moves it
 * much. 0: no area at all. */
static double typical_area(const LightField *light) {
    double sum = 0.0, weight = 0.0;
    for (uint64_t i = 0; i < light->landing_count; ++i) {
        const double flux = (double)rgb_mean(light->landings[i].flux);
        const double area = (double)footprint_area(&light->landings[i], 0);
        if (area > 0.0) {
            sum += flux * log(area);
            weight += flux;
        }
    }
    return weight > 0.0 ? exp(sum / weight) : 0.0;
}

static void account_tree(const CausticTree *tree, CausticMap *map) {
    map->account.bytes += tree->block_count * sizeof(CausticBlock) +
                          tree->node_count * sizeof(CausticNode) +
                          (tree->block_count + 1) * sizeof *tree->flux;
}

static uint32_t part_of(const CausticMap *map, float rank) {
    return (uint32_t)(rank * (float)map->part_count);
}

static bool has_part(const CausticMap *map, uint32_t part, uint32_t k) {
    return part == 0 || map->part_count == 1 || part == k + 1;
}

static double parts_flux(const CausticMap *map, uint32_t part) {
    double sum = 0.0;
    for (uint32_t k = 0; k < map->part_count; ++k)
        sum += has_part(map, part, k) ? caustic_tree_flux(&map->trees[k]) : 0.0;
    return sum;
}

/* The map's part of the photons. */
static AmbStatus build_part(const LightField *light, Placement *placement, uint32_t part, Job *job,
                            CausticMap *map) {
    uint64_t *chosen = memory_alloc_array(light->landing_count, sizeof *chosen);
    uint64_t count = 0;
    for (uint64_t i = 0; chosen != NULL && i < light->landing_count; ++i)
        if (part_of(map, light->landings[i].rank) == part)
            chosen[count++] = i;
    AmbStatus status = AMB_OK;
    placement->chosen = chosen;
    placement->photons = NULL;
    if (chosen != NULL && count > 0)
        placement->photons = memory_alloc_array(count, sizeof *placement->photons);
    if (chosen == NULL || (count > 0 && placement->photons == NULL))
        status = status_fail(AMB_OUT_OF_MEMORY, "no memory for %llu caustic photons",
                             (unsigned long long)light->landing_count);
    if (status == AMB_OK)
        status = parallel_for(job, count, GRAIN, place_photons, placement);
    memory_free(chosen);
    if (status != AMB_OK || count == 0) {
        memory_free(placement->photons);
        return status;
    }
    CausticTree *tree = &map->trees[part];
    status = caustic_tree_build(placement->photons, count, job, tree);
    memory_free(placement->photons);
    AMB_TRY(status);
    map->account.photon_count += tree->photon_count;
    account_tree(tree, map);
    return AMB_OK;
}

static AmbStatus build(const LightField *light, const CausticParams *params, Job *job,
                       CausticMap *map) {
    map->account.ray_count = light->ray_count;
    memcpy(map->account.landed, light->tally.landed, sizeof map->account.landed);
    const double area = typical_area(light);
    if (!(area > 0.0))
        return AMB_OK;
    Placement placement = {.landings = light->landings,
                           .params = params,
                           .axis = sqrtf(params->overlap * (float)area / AMB_PI)};
    for (uint32_t k = 0; k < map->part_count; ++k)
        AMB_TRY(build_part(light, &placement, k, job, map));
    /* As many kernels as overlap, at half of their peaks, are about the irradiance around. */
    const double flux = parts_flux(map, 0);
    map->density_scale = flux > 0.0 ? (float)(0.5 * (double)params->overlap / flux) : 0.0f;
    return AMB_OK;
}

static AmbStatus create_bent(const AmbScene *scene, const CausticParams *params, Job *job,
                             CausticMap *map) {
    LightField light;
    AMB_TRY(light_trace(scene, &params->light, job, &light));
    const AmbStatus status = build(&light, params, job, map);
    light_field_clear(&light);
    return status;
}

/* The part of one order's kernels. */
static AmbStatus build_glow_part(const PhotonLandings *landings, const CausticPhoton *photons,
                                 uint32_t order, uint32_t part, Job *job, CausticMap *map) {
    CausticTree *tree = &map->glow[order][part];
    uint64_t count = 0, placed = 0;
    for (uint64_t i = 0; i < landings->count; ++i)
        count += part_of(map, landings->list[i].rank) == part ? 1 : 0;
    if (count == 0)
        return AMB_OK;
    CausticPhoton *some = memory_alloc_array(count, sizeof *some);
    if (some == NULL)
        return status_fail(AMB_OUT_OF_MEMORY, "no memory for light on opaque surfaces");
    for (uint64_t i = 0; i < landings->count; ++i)
        if (part_of(map, landings->list[i].rank) == part)
            some[placed++] = photons[i];
    const AmbStatus status = caustic_tree_build(some, count, job, tree);
    memory_free(some);
    AMB_TRY(status);
    account_tree(tree, map);
    return AMB_OK;
}

static AmbStatus build_glow_order(const AmbScene *scene, const PhotonLandings *landings,
                                  uint32_t order, Job *job, CausticMap *map) {
    CausticAccount *account = &map->account;
    account->glow_photon_count += landings->count;
    for (uint64_t i = 0; i < landings->count; ++i) {
        const Rgb flux = landings->list[i].flux;
        account->glow_landed[0] += (double)flux.r;
        account->glow_landed[1] += (double)flux.g;
        account->glow_landed[2] += (double)flux.b;
    }
    if (landings->count == 0)
        return AMB_OK;
    CausticPhoton *photons = memory_alloc_array(landings->count, sizeof *photons);
    AmbStatus status = AMB_OK;
    if (photons == NULL)
        status = status_fail(AMB_OUT_OF_MEMORY, "no memory for light on opaque surfaces");
    if (status == AMB_OK)
        status = glow_place(scene, landings, job, photons);
    for (uint32_t k = 0; k < map->part_count && status == AMB_OK; ++k)
        status = build_glow_part(landings, photons, order, k, job, map);
    memory_free(photons);
    return status;
}

static AmbStatus take_landings(const CausticParams *params, Job *job, GlowLandings *landings) {
    PhotonLandings lists[SCATTER_LIST_MAX];
    scatter_take_landings(params->traced, lists);
    const uint64_t emitted = scatter_tally(params->traced)->photon_count;
    const uint64_t wanted = params->glow.photon_count;
    landings->tally.photon_count = wanted < emitted ? wanted : emitted;
    const AmbStatus status = glow_sort(lists, SCATTER_LIST_MAX, job, landings);
    for (uint32_t i = 0; i < SCATTER_LIST_MAX; ++i)
        memory_free(lists[i].list);
    return status;
}

static AmbStatus create_glow(const AmbScene *scene, const CausticParams *params, Job *job,
                             CausticMap *map) {
    GlowLandings landings = {.tally = {.photon_count = 0}};
    AmbStatus status = params->traced != NULL ? take_landings(params, job, &landings)
                                              : glow_trace(scene, &params->glow, job, &landings);
    map->account.glow_ray_count = landings.tally.photon_count;
    for (uint32_t k = 0; k < GLOW_ORDER_COUNT && status == AMB_OK; ++k)
        status = build_glow_order(scene, &landings.orders[k], k, job, map);
    glow_clear(&landings);
    return status;
}

AmbStatus caustics_create(const AmbScene *scene, const CausticParams *params, Job *job,
                          CausticMap **out_map) {
    *out_map = NULL;
    CausticMap *map = memory_zero_array(1, sizeof *map);
    if (map == NULL)
        return status_fail(AMB_OUT_OF_MEMORY, "no memory for caustics");
    map->part_count = params->part_count > 0 ? params->part_count : 1;
    map->gather = caustic_gather_select();
    AmbStatus status = AMB_OK;
    if (params->light.ray_count > 0)
        status = create_bent(scene, params, job, map);
    if (status == AMB_OK && params->glow.photon_count > 0)
        status = create_glow(scene, params, job, map);
    if (status != AMB_OK) {
        caustics_destroy(map);
        return status;
    }
    *out_map = map;
    return AMB_OK;
}

void caustics_destroy(CausticMap *map) {
    if (map == NULL)
        return;
    for (uint32_t k = 0; k < map->part_count; ++k) {
        caustic_tree_clear(&map->trees[k]);
        for (uint32_t i = 0; i < GLOW_ORDER_COUNT; ++i)
            caustic_tree_clear(&map->glow[i][k]);
    }
    memory_free(map);
}

static Rgb sum_parts(const CausticMap *map, const CausticTree *trees, Vec3 p, Vec3 n, uint32_t part,
                     float dimmed) {
    const bool is_part = part > 0 && map->part_count > 1;
    Rgb sum = rgb(0, 0, 0);
    for (uint32_t k = 0; k < map->part_count; ++k)
        if (trees[k].photon_count > 0 && (!is_part || part == k + 1))
            sum = rgb_add(sum, map->gather(&trees[k], p, n, dimmed));
    return is_part ? rgb_scale(sum, (float)map->part_count) : sum;
}

Rgb caustics_irradiance(const CausticMap *map, Vec3 p, Vec3 n, uint32_t part) {
    return sum_parts(map, map->trees, p, n, part, 0.0f);
}

Rgb caustics_irradiance_by_rays(const CausticMap *map, Vec3 p, Vec3 n, uint32_t part,
                                float density) {
    if (!(density > 0.0f))
        return rgb(0, 0, 0);
    const float dimmed = fminf(map->density_scale / density, FLT_MAX);
    return sum_parts(map, map->trees, p, n, part, dimmed);
}

bool caustics_choose(const CausticMap *map, uint32_t part, Sample2 choice, Sample2 place,
                     CausticPoint *out_point) {
    const double all = parts_flux(map, part);
    double left = ((double)choice.u + (double)choice.v * 0x1p-24) * all;
    const CausticTree *tree = NULL;
    for (uint32_t k = 0; k < map->part_count; ++k) {
        const double flux = caustic_tree_flux(&map->trees[k]);
        if (!has_part(map, part, k) || !(flux > 0.0))
            continue;
        tree = &map->trees[k];
        if (left < flux)
            break;
        left -= flux;
    }
    if (tree == NULL)
        return false;
    *out_point = caustic_tree_choose(tree, left, place);
    const double times = part > 0 ? (double)map->part_count : 1.0;
    const float chance = (float)(caustic_tree_flux(tree) / (times * all));
    out_point->flux = rgb_scale(out_point->flux, 1.0f / chance);
    out_point->density *= map->density_scale;
    return true;
}

CausticGlow caustics_glow(const CausticMap *map, Vec3 p, Vec3 n, uint32_t part) {
    CausticGlow glow;
    for (uint32_t i = 0; i < GLOW_ORDER_COUNT; ++i)
        glow.orders[i] = sum_parts(map, map->glow[i], p, n, part, 0.0f);
    return glow;
}

CausticAccount caustics_account(const CausticMap *map) {
    return map->account;
}
