/* SPDX-License-Identifier: GPL-3.0-or-later
 * An order-tagged path tracer of one body in vacuum, against which the library's orders of
 * scattering are held.
 *
 * It shares no code, no estimator and no random number with the library, so that agreement means
 * something; Embree finds where rays meet the mesh, and that is all they have in common. Paths
 * start at the camera and are analog: free flights from the exponential distribution, directions
 * from the phase function, reflection or refraction at a wall by lot with Fresnel's odds. Nothing
 * is connected, gathered or split: light is found where a path happens to run into an emitter, and
 * is booked under the number of scatterings so far. Emitters therefore need an extent; lamps are
 * not seen as bodies: paths go on through them.
 *
 * Radiance outside is that inside over n^2, so that weights take 1/n^2 going in and n^2 coming out.
 * A path ends where the normal that it is bent at sends it to the wrong side of the triangle.
 *
 *     order_tracer SCENE > RESULT.json
 *
 * SCENE has a line for each setting, in any order (see read_scene). Every batch of paths has its
 * own random numbers and sums, so that the result does not depend on the number of threads. */
#include <inttypes.h>
#include <math.h>
#include <pthread.h>
#include <stdarg.h>
#include <stdatomic.h>
#include <stdbool.h>
#include <stdint.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>
#include <time.h>

#if __has_include(<embree4/rtcore.h>)
#include <embree4/rtcore.h>
#else
#include <embree3/rtcore.h>
#endif

enum {
    ORDERS = 5, /* 0, 1, 2, 3, and the rest */
    LAMPS_MAX = 8,
    REGIONS_MAX = 1 << 16,
    BATCHES = 64,      /* of each region */
    EVENTS_MAX = 20000 /* of one path; those that are cut off are counted */
};

static const double PI = 3.14159265358979323846;
/* Of a new ray's origin above the triangle that it leaves, in units of the mesh's extent. */
static const double LIFT = 2e-6;
/* Lighter paths survive by lot. */
static const double ROULETTE_WEIGHT = 0.02;

static _Noreturn void fail(const char *format, ...) {
    va_list arguments;
    va_start(arguments, format);
    fputs("order_tracer: ", stderr);
    vfprintf(stderr, format, arguments);
    fputc('\n', stderr);
    va_end(arguments);
    exit(1);
}

static void *allocate(size_t count, size_t size) {
    void *memory = calloc(count > 0 ? count : 1, size);
    if (memory == NULL)
        fail("out of memory");
    return memory;
}

/* ---- Vectors --------------------------------------------------------------------------------- */

typedef struct V {
    double x, y, z;
} V;

static V add(V a, V b) {
    return (V){a.x + b.x, a.y + b.y, a.z + b.z};
}

static V sub(V a, V b) {
    return (V){a.x - b.x, a.y - b.y, a.z - b.z};
}

static V mul(double k, V a) {
    return (V){k * a.x, k * a.y, k * a.z};
}

static double dot(V a, V b) {
    return a.x * b.x + a.y * b.y + a.z * b.z;
}

static V cross(V a, V b) {
    return (V){a.y * b.z - a.z * b.y, a.z * b.x - a.x * b.z, a.x * b.y - a.y * b.x};
}

static V unit(V a) {
    return mul(1.0 / sqrt(dot(a, a)), a);
}

/* The direction at polar angle acos(c) from the axis a, turned by phi around it. */
static V turned(V a, double c, double phi) {
    const V helper = fabs(a.z) < 0.9 ? (V){0, 0, 1} : (V){1, 0, 0};
    const V p = unit(cross(helper, a));
    const V q = cross(a, p);
    const double s = sqrt(fmax(0.0, 1.0 - c * c));
    return unit(add(mul(c, a), add(mul(s * cos(phi), p), mul(s * sin(phi), q))));
}

/* ---- Random numbers: xoshiro256++ by Blackman and Vigna ---------------------------------------
 */

typedef struct Dice {
    uint64_t s[4];
} Dice;

static uint64_t rotate(uint64_t x, int k) {
    return x << k | x >> (64 - k);
}

static uint64_t roll(Dice *dice) {
    uint64_t *s = dice->s;
    const uint64_t result = rotate(s[0] + s[3], 23) + s[0];
    const uint64_t t = s[1] << 17;
    s[2] ^= s[0];
    s[3] ^= s[1];
    s[1] ^= s[2];
    s[0] ^= s[3];
    s[2] ^= t;
    s[3] = rotate(s[3], 45);
    return result;
}

/* In (0, 1]. */
static double uniform(Dice *dice) {
    return ((double)(roll(dice) >> 11) + 1.0) * 0x1p-53;
}

static Dice dice_of(uint64_t seed, uint64_t batch) {
    /* splitmix64 fills the state, as its authors advise. */
    Dice dice;
    uint64_t x = seed * UINT64_C(0xd1342543de82ef95) + batch * UINT64_C(0x2545f4914f6cdd1d);
    for (int i = 0; i < 4; ++i) {
        x += UINT64_C(0x9e3779b97f4a7c15);
        uint64_t z = x;
        z = (z ^ z >> 30) * UINT64_C(0xbf58476d1ce4e5b9);
        z = (z ^ z >> 27) * UINT64_C(0x94d049bb133111eb);
        dice.s[i] = z ^ z >> 31;
    }
    return dice;
}

/* ---- Scene ----------------------------------------------------------------------------------- */

typedef enum LampKind { LAMP_RECTANGLE, LAMP_SPHERE, LAMP_SUN } LampKind;

typedef struct Lamp {
    LampKind kind;
    V position, axis; /* axis: unit, of travel (RECTANGLE: the side that shines) */
    V x, y;           /* RECTANGLE: half extents along its sides */
    double size;      /* SPHERE: radius; SUN: cosine of its angular radius */
    double radiance;
} Lamp;

typedef struct Scene {
    double ior, sigma_s, sigma_a, g;
    double world; /* radiance from everywhere */
    Lamp lamps[LAMPS_MAX];
    int lamp_count;
    bool is_perspective;
    V eye, forward, right, up; /* right, up: half extents of the window */
    int columns, rows;         /* regions of the window */
    bool starts_inside;        /* camera rays begin in the medium */
    bool reenters;  /* paths that leave the body may come back to it, and the camera's may be
                     * reflected first; else the body only casts a shadow on its lamps */
    uint64_t paths; /* of each region */
    int last_order; /* paths end after so many scatterings; 0: never */
    uint64_t seed;
    int threads;
    uint32_t vertex_count, triangle_count;
    V *positions, *normals; /* normals NULL: flat */
    uint32_t (*triangles)[3];
    double extent, lift; /* the largest coordinate; LIFT of it */
    RTCDevice device;
    RTCScene embree;
} Scene;

static double number(FILE *file, const char *what) {
    double value = 0;
    if (fscanf(file, "%lf", &value) != 1)
        fail("a number is missing after '%s'", what);
    return value;
}

static V vector(FILE *file, const char *what) {
    const double x = number(file, what);
    const double y = number(file, what);
    const double z = number(file, what);
    return (V){x, y, z};
}

static Lamp *new_lamp(Scene *scene, LampKind kind) {
    if (scene->lamp_count == LAMPS_MAX)
        fail("too many lamps");
    Lamp *lamp = &scene->lamps[scene->lamp_count++];
    lamp->kind = kind;
    return lamp;
}

static void read_camera(Scene *scene, FILE *file, const char *key) {
    scene->eye = vector(file, key);
    scene->forward = unit(vector(file, key));
    const V up = vector(file, key);
    const V right = unit(cross(scene->forward, up));
    const double width = number(file, key);
    const double height = number(file, key);
    scene->right = mul(0.5 * width, right);
    scene->up = mul(0.5 * height, cross(right, scene->forward));
}

static void read_mesh(Scene *scene, FILE *file, const char *key, bool has_normals) {
    scene->vertex_count = (uint32_t)number(file, key);
    scene->triangle_count = (uint32_t)number(file, key);
    scene->positions = allocate(scene->vertex_count, sizeof *scene->positions);
    scene->normals = has_normals ? allocate(scene->vertex_count, sizeof *scene->normals) : NULL;
    scene->triangles = allocate(scene->triangle_count, sizeof *scene->triangles);
    for (uint32_t i = 0; i < scene->vertex_count; ++i) {
        scene->positions[i] = vector(file, key);
        if (scene->normals != NULL)
            scene->normals[i] = vector(file, key);
    }
    for (uint32_t i = 0; i < scene->triangle_count; ++i)
        for (int k = 0; k < 3; ++k) {
            scene->triangles[i][k] = (uint32_t)number(file, key);
            if (scene->triangles[i][k] >= scene->vertex_count)
                fail("triangle %" PRIu32 " has no such vertex", i);
        }
}

/* One setting: its name has been read. False: no such name. */
static bool read_setting(Scene *scene, FILE *file, const char *key) {
    if (strcmp(key, "ior") == 0)
        scene->ior = number(file, key);
    else if (strcmp(key, "sigma_s") == 0)
        scene->sigma_s = number(file, key);
    else if (strcmp(key, "sigma_a") == 0)
        scene->sigma_a = number(file, key);
    else if (strcmp(key, "g") == 0)
        scene->g = number(file, key);
    else if (strcmp(key, "world") == 0)
        scene->world = number(file, key);
    else if (strcmp(key, "paths") == 0)
        scene->paths = (uint64_t)number(file, key);
    else if (strcmp(key, "last_order") == 0)
        scene->last_order = (int)number(file, key);
    else if (strcmp(key, "seed") == 0)
        scene->seed = (uint64_t)number(file, key);
    else if (strcmp(key, "threads") == 0)
        scene->threads = (int)number(file, key);
    else if (strcmp(key, "starts_inside") == 0)
        scene->starts_inside = number(file, key) != 0.0;
    else if (strcmp(key, "reenters") == 0)
        scene->reenters = number(file, key) != 0.0;
    else if (strcmp(key, "regions") == 0) { /* columns, rows */
        scene->columns = (int)number(file, key);
        scene->rows = (int)number(file, key);
    } else if (strcmp(key, "perspective") == 0) { /* eye, forward, up, window at distance 1 */
        scene->is_perspective = true;
        read_camera(scene, file, key);
    } else if (strcmp(key, "orthographic") == 0) { /* eye, forward, up, window */
        scene->is_perspective = false;
        read_camera(scene, file, key);
    } else if (strcmp(key, "rectangle") == 0) { /* centre, direction, x axis, extents, radiance */
        Lamp *lamp = new_lamp(scene, LAMP_RECTANGLE);
        lamp->position = vector(file, key);
        lamp->axis = unit(vector(file, key));
        const V tangent = vector(file, key);
        const V y = unit(cross(lamp->axis, tangent));
        const double width = number(file, key);
        const double height = number(file, key);
        lamp->x = mul(0.5 * width, cross(y, lamp->axis));
        lamp->y = mul(0.5 * height, y);
        lamp->radiance = number(file, key);
    } else if (strcmp(key, "sphere") == 0) { /* centre, radius, radiance */
        Lamp *lamp = new_lamp(scene, LAMP_SPHERE);
        lamp->position = vector(file, key);
        lamp->size = number(file, key);
        lamp->radiance = number(file, key);
    } else if (strcmp(key, "sun") == 0) { /* direction of travel, angular radius, radiance */
        Lamp *lamp = new_lamp(scene, LAMP_SUN);
        lamp->axis = unit(vector(file, key));
        lamp->size = cos(number(file, key));
        lamp->radiance = number(file, key);
    } else if (strcmp(key, "smooth_mesh") == 0) { /* counts; positions and normals; triangles */
        read_mesh(scene, file, key, true);
    } else if (strcmp(key, "flat_mesh") == 0) { /* counts; positions; triangles */
        read_mesh(scene, file, key, false);
    } else
        return false;
    return true;
}

static Scene read_scene(const char *path) {
    FILE *file = fopen(path, "r");
    if (file == NULL)
        fail("cannot read %s", path);
    Scene scene = {.ior = 1, .columns = 1, .rows = 1, .paths = 1000, .threads = 1};
    char key[32];
    while (fscanf(file, "%31s", key) == 1)
        if (!read_setting(&scene, file, key))
            fail("unknown setting '%s'", key);
    fclose(file);
    if (scene.triangle_count == 0)
        fail("no mesh");
    if (scene.columns < 1 || scene.rows < 1 || scene.columns > REGIONS_MAX / scene.rows)
        fail("bad number of regions");
    if (dot(scene.forward, scene.forward) == 0.0)
        fail("no camera");
    return scene;
}

static void build(Scene *scene) {
    scene->device = rtcNewDevice("threads=1");
    if (scene->device == NULL)
        fail("no Embree device");
    scene->embree = rtcNewScene(scene->device);
    rtcSetSceneFlags(scene->embree, RTC_SCENE_FLAG_ROBUST);
    RTCGeometry geometry = rtcNewGeometry(scene->device, RTC_GEOMETRY_TYPE_TRIANGLE);
    float *vertices = rtcSetNewGeometryBuffer(geometry, RTC_BUFFER_TYPE_VERTEX, 0,
                                              RTC_FORMAT_FLOAT3, 12, scene->vertex_count);
    uint32_t *indices = rtcSetNewGeometryBuffer(geometry, RTC_BUFFER_TYPE_INDEX, 0,
                                                RTC_FORMAT_UINT3, 12, scene->triangle_count);
    if (vertices == NULL || indices == NULL)
        fail("out of memory");
    scene->extent = 0;
    for (uint32_t i = 0; i < scene->vertex_count; ++i) {
        V *p = &scene->positions[i];
        vertices[3 * i] = (float)p->x;
        vertices[3 * i + 1] = (float)p->y;
        vertices[3 * i + 2] = (float)p->z;
        /* What Embree sees is what is computed with. */
        *p = (V){(double)vertices[3 * i], (double)vertices[3 * i + 1], (double)vertices[3 * i + 2]};
        scene->extent = fmax(scene->extent, fmax(fabs(p->x), fmax(fabs(p->y), fabs(p->z))));
    }
    memcpy(indices, scene->triangles, 12 * (size_t)scene->triangle_count);
    scene->lift = LIFT * scene->extent;
    rtcCommitGeometry(geometry);
    rtcAttachGeometry(scene->embree, geometry);
    rtcReleaseGeometry(geometry);
    rtcCommitScene(scene->embree);
    if (rtcGetDeviceError(scene->device) != RTC_ERROR_NONE)
        fail("Embree cannot take the mesh");
}

/* ---- Walls ------------------------------------------------------------------------------------
 */

typedef struct Wall {
    double distance;
    V p;
    V flat, smooth; /* outward unit normals */
} Wall;

/* The nearest wall within `reach`, or false. */
static bool find_wall(const Scene *scene, V o, V d, double reach, Wall *wall) {
    struct RTCRayHit query;
    memset(&query, 0, sizeof query);
    query.ray.org_x = (float)o.x;
    query.ray.org_y = (float)o.y;
    query.ray.org_z = (float)o.z;
    query.ray.dir_x = (float)d.x;
    query.ray.dir_y = (float)d.y;
    query.ray.dir_z = (float)d.z;
    query.ray.tfar = (float)reach;
    query.ray.mask = UINT32_MAX;
    query.hit.geomID = RTC_INVALID_GEOMETRY_ID;
#if RTC_VERSION_MAJOR >= 4
    rtcIntersect1(scene->embree, &query, NULL);
#else
    struct RTCIntersectContext context;
    rtcInitIntersectContext(&context);
    rtcIntersect1(scene->embree, &context, &query);
#endif
    if (query.hit.geomID == RTC_INVALID_GEOMETRY_ID)
        return false;
    const uint32_t *i = scene->triangles[query.hit.primID];
    const double b = (double)query.hit.u;
    const double c = (double)query.hit.v;
    const double a = 1.0 - b - c;
    const V *p = scene->positions;
    wall->distance = (double)query.ray.tfar;
    wall->p = add(mul(a, p[i[0]]), add(mul(b, p[i[1]]), mul(c, p[i[2]])));
    wall->flat = unit(cross(sub(p[i[1]], p[i[0]]), sub(p[i[2]], p[i[0]])));
    wall->smooth = wall->flat;
    if (scene->normals != NULL) {
        const V *n = scene->normals;
        wall->smooth = unit(add(mul(a, n[i[0]]), add(mul(b, n[i[1]]), mul(c, n[i[2]]))));
    }
    return true;
}

/* Power reflected at incidence cosine ci, relative index m = n beyond / n here; *ct is the cosine
 * beyond. */
static double reflected_share(double ci, double m, double *ct) {
    const double sin2 = (1.0 - ci * ci) / (m * m);
    if (sin2 >= 1.0)
        return 1.0;
    *ct = sqrt(1.0 - sin2);
    const double s = (ci - m * *ct) / (ci + m * *ct);
    const double p = (m * ci - *ct) / (m * ci + *ct);
    return 0.5 * (s * s + p * p);
}

/* ---- Lamps ------------------------------------------------------------------------------------
 */

/* Radiance of the lamps that the ray passes within `reach`. */
static double lamps_passed(const Scene *scene, V o, V d, double reach) {
    double radiance = 0;
    for (int i = 0; i < scene->lamp_count; ++i) {
        const Lamp *lamp = &scene->lamps[i];
        if (lamp->kind == LAMP_SUN) {
            if (isinf(reach) && -dot(d, lamp->axis) > lamp->size)
                radiance += lamp->radiance;
            continue;
        }
        const V to = sub(lamp->position, o);
        const double along = dot(to, d);
        if (lamp->kind == LAMP_SPHERE) {
            /* Where the ray goes into the sphere: only the outside shines. */
            const double square = lamp->size * lamp->size - (dot(to, to) - along * along);
            const double t = square > 0.0 ? along - sqrt(square) : -1.0;
            if (t > 0.0 && t < reach)
                radiance += lamp->radiance;
            continue;
        }
        const double facing = dot(d, lamp->axis);
        if (facing >= 0.0)
            continue;
        const double t = dot(to, lamp->axis) / facing;
        if (t <= 0.0 || t >= reach)
            continue;
        const V at = sub(add(o, mul(t, d)), lamp->position);
        if (fabs(dot(at, lamp->x)) < dot(lamp->x, lamp->x) &&
            fabs(dot(at, lamp->y)) < dot(lamp->y, lamp->y))
            radiance += lamp->radiance;
    }
    return radiance;
}

/* ---- Paths ------------------------------------------------------------------------------------
 */

typedef struct Sums {
    double value[ORDERS + 1], square[ORDERS + 1]; /* the last: orders 1 and up together */
    uint64_t lost;                                /* paths that slipped through the mesh */
    uint64_t wrong_way; /* paths ended by normals that disagree about the side */
    uint64_t cut;       /* paths with EVENTS_MAX events */
    uint64_t events;
} Sums;

static V scatter(const Scene *scene, V d, Dice *dice) {
    const double u = uniform(dice);
    const double g = scene->g;
    double c = 1.0 - 2.0 * u;
    if (fabs(g) > 1e-6) {
        const double q = (1.0 - g * g) / (1.0 + g - 2.0 * g * u);
        c = (1.0 + g * g - q * q) / (2.0 * g);
    }
    return turned(d, fmin(1.0, fmax(-1.0, c)), 2.0 * PI * uniform(dice));
}

/* A ray through a random place of a region. */
static void camera_ray(const Scene *scene, int region, Dice *dice, V *o, V *d) {
    const double u = (region % scene->columns + uniform(dice)) / scene->columns * 2.0 - 1.0;
    const double v = (region / scene->columns + uniform(dice)) / scene->rows * 2.0 - 1.0;
    /* Rows count from the top. */
    const V shift = add(mul(u, scene->right), mul(-v, scene->up));
    *o = scene->is_perspective ? scene->eye : add(scene->eye, shift);
    *d = scene->is_perspective ? unit(add(scene->forward, shift)) : scene->forward;
}

/* Adds what one path finds to found[order]. */
static void trace(const Scene *scene, int region, Dice *dice, double *found, Sums *sums) {
    V o, d;
    camera_ray(scene, region, dice, &o, &d);
    const double sigma_t = scene->sigma_s + scene->sigma_a;
    const double albedo = sigma_t > 0.0 ? scene->sigma_s / sigma_t : 0.0;
    double weight = 1.0;
    bool inside = scene->starts_inside;
    bool has_entered = inside;
    int order = 0;
    for (int event = 0;; ++event) {
        if (event == EVENTS_MAX) {
            ++sums->cut;
            return;
        }
        ++sums->events;
        const double flight =
            inside && sigma_t > 0.0 ? -log(uniform(dice)) / sigma_t : (double)INFINITY;
        Wall wall;
        const bool is_wall = find_wall(scene, o, d, flight, &wall);
        const double reach = is_wall ? wall.distance : flight;
        /* Lamps that the camera sees itself are no part of the picture. */
        if (has_entered)
            found[order < ORDERS - 1 ? order : ORDERS - 1] +=
                weight * lamps_passed(scene, o, d, reach);
        if (!is_wall && isinf(reach)) {
            sums->lost += inside;
            if (!inside)
                found[order < ORDERS - 1 ? order : ORDERS - 1] += weight * scene->world;
            return;
        }
        if (!is_wall) { /* a scattering */
            if (scene->last_order > 0 && order == scene->last_order)
                return;
            weight *= albedo;
            ++order;
            if (weight < ROULETTE_WEIGHT) {
                if (uniform(dice) * ROULETTE_WEIGHT > weight)
                    return;
                weight = ROULETTE_WEIGHT;
            }
            o = add(o, mul(flight, d));
            if (fmax(fabs(o.x), fmax(fabs(o.y), fabs(o.z))) > 1.001 * scene->extent) {
                ++sums->lost;
                return;
            }
            d = scatter(scene, d, dice);
            continue;
        }
        if ((dot(d, wall.flat) > 0.0) != inside) {
            ++sums->lost;
            return;
        }
        if (!inside && has_entered && !scene->reenters)
            return; /* in its own shadow */
        const double side = inside ? -1.0 : 1.0;
        const V flat = mul(side, wall.flat);
        V n = mul(side, wall.smooth);
        if (dot(d, n) >= 0.0)
            n = flat;
        const double m = inside ? 1.0 / scene->ior : scene->ior;
        const double ci = fmin(1.0, -dot(d, n));
        double ct = 0;
        const double share = reflected_share(ci, m, &ct);
        bool reflects = false;
        if (has_entered || scene->reenters)
            reflects = uniform(dice) <= share;
        else
            weight *= 1.0 - share;
        if (reflects) {
            d = unit(add(d, mul(2.0 * ci, n)));
        } else {
            d = unit(add(mul(1.0 / m, d), mul(ci / m - ct, n)));
            weight /= m * m;
            inside = !inside;
            has_entered = true;
        }
        if ((dot(d, flat) > 0.0) != reflects) {
            ++sums->wrong_way;
            return;
        }
        o = add(wall.p, mul(reflects ? scene->lift : -scene->lift, flat));
    }
}

typedef struct Work {
    const Scene *scene;
    Sums *batches; /* (regions, BATCHES) */
    atomic_uint_least64_t next;
} Work;

static void *run(void *user) {
    Work *work = user;
    const Scene *scene = work->scene;
    const uint64_t count = (uint64_t)(scene->columns * scene->rows) * BATCHES;
    for (;;) {
        const uint64_t b = atomic_fetch_add(&work->next, 1);
        if (b >= count)
            return NULL;
        Dice dice = dice_of(scene->seed, b);
        Sums sums = {.lost = 0};
        for (uint64_t i = 0; i < scene->paths / BATCHES; ++i) {
            double found[ORDERS + 1] = {0};
            trace(scene, (int)(b / BATCHES), &dice, found, &sums);
            for (int k = 1; k < ORDERS; ++k)
                found[ORDERS] += found[k];
            for (int k = 0; k <= ORDERS; ++k) {
                sums.value[k] += found[k];
                sums.square[k] += found[k] * found[k];
            }
        }
        work->batches[b] = sums;
    }
}

static void print_row(const char *name, const double *values, const char *end) {
    printf("\"%s\": [", name);
    for (int k = 0; k <= ORDERS; ++k)
        printf("%s%.9g", k > 0 ? ", " : "", values[k]);
    printf("]%s", end);
}

static void report(const Scene *scene, const Sums *batches) {
    const int regions = scene->columns * scene->rows;
    const double n = (double)(scene->paths / BATCHES * BATCHES);
    Sums all = {.lost = 0};
    printf("{\"orders\": [\"0\", \"1\", \"2\", \"3\", \"4+\", \"1+\"],\n\"regions\": [\n");
    for (int r = 0; r < regions; ++r) {
        double mean[ORDERS + 1], error[ORDERS + 1];
        for (int k = 0; k <= ORDERS; ++k) {
            double value = 0, square = 0;
            for (int b = 0; b < BATCHES; ++b) {
                value += batches[r * BATCHES + b].value[k];
                square += batches[r * BATCHES + b].square[k];
            }
            mean[k] = value / n;
            error[k] = sqrt(fmax(0.0, square / n - mean[k] * mean[k]) / n);
        }
        for (int b = 0; b < BATCHES; ++b) {
            const Sums *sums = &batches[r * BATCHES + b];
            all.lost += sums->lost;
            all.wrong_way += sums->wrong_way;
            all.cut += sums->cut;
            all.events += sums->events;
        }
        printf("{");
        print_row("mean", mean, ", ");
        print_row("error", error, r + 1 < regions ? "},\n" : "}],\n");
    }
    struct timespec spent = {0};
    clock_gettime(CLOCK_PROCESS_CPUTIME_ID, &spent);
    const double total = n * regions;
    printf("\"paths\": %.0f, \"lost\": %.9g, \"wrong_way\": %.9g, \"cut\": %.9g,\n", n,
           (double)all.lost / total, (double)all.wrong_way / total, (double)all.cut / total);
    printf("\"events_per_path\": %.4g, \"cpu_seconds\": %.3f}\n", (double)all.events / total,
           (double)spent.tv_sec + 1e-9 * (double)spent.tv_nsec);
}

int main(int argc, char **argv) {
    if (argc != 2)
        fail("usage: order_tracer SCENE");
    Scene scene = read_scene(argv[1]);
    build(&scene);
    const size_t count = (size_t)(scene.columns * scene.rows) * BATCHES;
    Work work = {.scene = &scene, .batches = allocate(count, sizeof(Sums))};
    pthread_t threads[64];
    const int helpers = scene.threads > 64 ? 63 : scene.threads - 1;
    for (int i = 0; i < helpers; ++i)
        if (pthread_create(&threads[i], NULL, run, &work) != 0)
            fail("cannot start a thread");
    run(&work);
    for (int i = 0; i < helpers; ++i)
        pthread_join(threads[i], NULL);
    report(&scene, work.batches);
    rtcReleaseScene(scene.embree);
    rtcReleaseDevice(scene.device);
    free(work.batches);
    free(scene.positions);
    free(scene.normals);
    free(scene.triangles);
    return 0;
}
