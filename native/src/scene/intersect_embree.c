/* SPDX-License-Identifier: GPL-3.0-or-later
 * Ray queries by Embree 3 or 4: the only file that includes it. */
#include "scene/intersect.h"

#if __has_include(<embree4/rtcore.h>)
#include <embree4/rtcore.h>
#else
#include <embree3/rtcore.h>
#endif

#include <stdatomic.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>

#include "base/memory.h"
#include "math/vec3d.h"

/* Embree's own bound of coordinates. */
static const float COORDINATE_MAX = 1.844e18f;

struct Intersector {
    RTCDevice device;
    RTCScene scene;
    Job *job;            /* during the commit */
    MemoryLimit *memory; /* of the render that builds; Embree allocates on threads of its own */
    atomic_int_least64_t bytes;
    atomic_uint_least64_t nonfinite_count;
};

/* Embree asks before (or, with post, right after) it takes bytes, and says when it gives them
 * back; false makes it give up with RTC_ERROR_OUT_OF_MEMORY. */
static bool on_memory(void *user, ssize_t bytes, bool post) {
    (void)post;
    Intersector *self = user;
    if ((bytes > 0 && memory_must_fail()) || !memory_reserve(self->memory, (int64_t)bytes))
        return false;
    atomic_fetch_add(&self->bytes, (int64_t)bytes);
    return true;
}

static bool on_build_progress(void *user, double fraction) {
    (void)fraction;
    const Intersector *self = user;
    return !job_is_cancelled(self->job);
}

/* Embree keeps the first error of each thread until it is read. */
static AmbStatus check(RTCDevice device, const char *doing) {
    switch (rtcGetDeviceError(device)) {
    case RTC_ERROR_NONE:
        return AMB_OK;
    case RTC_ERROR_OUT_OF_MEMORY:
        return status_fail(AMB_OUT_OF_MEMORY, "Embree is out of memory while %s", doing);
    case RTC_ERROR_CANCELLED:
        return AMB_CANCELLED;
    case RTC_ERROR_UNSUPPORTED_CPU:
        return status_fail(AMB_UNSUPPORTED, "this processor is not supported by Embree");
    default:
        return status_fail(AMB_INTERNAL, "Embree failed while %s", doing);
    }
}

AmbStatus intersector_create(uint32_t thread_count, Intersector **out_intersector) {
    Intersector *self = memory_zero_array(1, sizeof *self);
    if (self == NULL)
        return status_fail(AMB_OUT_OF_MEMORY, "no memory for the ray accelerator");
    char config[32];
    snprintf(config, sizeof config, "threads=%u", thread_count);
    self->device = rtcNewDevice(config);
    if (self->device == NULL) {
        memory_free(self);
        AMB_TRY(check(NULL, "creating a device"));
        return status_fail(AMB_INTERNAL, "Embree gives no device");
    }
    atomic_init(&self->bytes, 0);
    atomic_init(&self->nonfinite_count, 0);
    self->memory = memory_get_limit();
    rtcSetDeviceMemoryMonitorFunction(self->device, on_memory, self);
    self->scene = rtcNewScene(self->device);
    /* Watertight at shared edges: a path that slips between two triangles of a closed boundary
     * would lose track of the medium that it is in. */
    if (self->scene != NULL)
        rtcSetSceneFlags(self->scene, RTC_SCENE_FLAG_ROBUST);
    const AmbStatus status = check(self->device, "creating a scene");
    if (status != AMB_OK) {
        intersector_destroy(self);
        return status;
    }
    *out_intersector = self;
    return AMB_OK;
}

void intersector_destroy(Intersector *self) {
    if (self == NULL)
        return;
    if (self->scene != NULL)
        rtcReleaseScene(self->scene);
    rtcReleaseDevice(self->device);
    /* What Embree took and did not give back, its own devices' small change. */
    memory_reserve(NULL, -atomic_load(&self->bytes));
    memory_free(self);
}

static bool has_area(const Vec3 *positions, const uint32_t i[3]) {
    const Vec3d area = vec3d_area(positions[i[0]], positions[i[1]], positions[i[2]]);
    return vec3d_dot(area, area) > 0.0;
}

/* Faces without area are met by rounding, and have no normal: a point takes their place. */
static void set_triangles(RTCGeometry geometry, const Vec3 *positions, const uint32_t *triangles,
                          uint64_t count) {
    uint64_t with_area = 0;
    while (with_area < count && has_area(positions, triangles + 3 * with_area))
        ++with_area;
    if (with_area == count) {
        rtcSetSharedGeometryBuffer(geometry, RTC_BUFFER_TYPE_INDEX, 0, RTC_FORMAT_UINT3, triangles,
                                   0, 3 * sizeof(uint32_t), count);
        return;
    }
    uint32_t *own = rtcSetNewGeometryBuffer(geometry, RTC_BUFFER_TYPE_INDEX, 0, RTC_FORMAT_UINT3,
                                            3 * sizeof(uint32_t), count);
    for (uint64_t t = 0; own != NULL && t < count; ++t) {
        const uint32_t *i = triangles + 3 * t;
        const bool is_face = has_area(positions, i);
        for (uint32_t k = 0; k < 3; ++k)
            own[3 * t + k] = is_face ? i[k] : i[0];
    }
}

AmbStatus intersector_add(Intersector *self, const Vec3 *positions, uint64_t vertex_count,
                          const uint32_t *triangles, uint64_t triangle_count) {
    RTCGeometry geometry = rtcNewGeometry(self->device, RTC_GEOMETRY_TYPE_TRIANGLE);
    if (geometry == NULL)
        return check(self->device, "adding a mesh");
    rtcSetSharedGeometryBuffer(geometry, RTC_BUFFER_TYPE_VERTEX, 0, RTC_FORMAT_FLOAT3, positions, 0,
                               sizeof(Vec3), vertex_count);
    set_triangles(geometry, positions, triangles, triangle_count);
    rtcCommitGeometry(geometry);
    rtcAttachGeometry(self->scene, geometry);
    rtcReleaseGeometry(geometry);
    return check(self->device, "adding a mesh");
}

void intersector_enable_all(Intersector *self) {
#if RTC_VERSION_MAJOR >= 4
    const enum RTCSceneFlags filter = RTC_SCENE_FLAG_FILTER_FUNCTION_IN_ARGUMENTS;
#else
    const enum RTCSceneFlags filter = RTC_SCENE_FLAG_CONTEXT_FILTER_FUNCTION;
#endif
    rtcSetSceneFlags(self->scene, RTC_SCENE_FLAG_ROBUST | filter);
}

AmbStatus intersector_commit(Intersector *self, Job *job) {
    self->job = job;
    rtcSetSceneProgressMonitorFunction(self->scene, on_build_progress, self);
    rtcCommitScene(self->scene);
    rtcSetSceneProgressMonitorFunction(self->scene, NULL, NULL);
    self->job = NULL;
    self->memory = NULL;
    AMB_TRY(check(self->device, "building the ray accelerator"));
    return job_is_cancelled(job) ? AMB_CANCELLED : AMB_OK;
}

static bool is_within(Vec3 v) {
    return fabsf(v.x) <= COORDINATE_MAX && fabsf(v.y) <= COORDINATE_MAX &&
           fabsf(v.z) <= COORDINATE_MAX;
}

/* Embree built with assertions ends the process over any other ray. From that far away nothing is
 * met; a ray that is no ray is a defect of whoever made it, and is counted. */
static bool is_traceable(Intersector *self, Vec3 o, Vec3 d, float t_max) {
    if (is_within(o) && is_within(d) && !isnan(t_max))
        return true;
    if (!vec3_is_finite(o) || !vec3_is_finite(d) || isnan(t_max))
        atomic_fetch_add(&self->nonfinite_count, 1);
    return false;
}

static struct RTCRay make_ray(Vec3 o, Vec3 d, float t_max) {
    struct RTCRay ray;
    memset(&ray, 0, sizeof ray);
    ray.org_x = o.x;
    ray.org_y = o.y;
    ray.org_z = o.z;
    ray.dir_x = d.x;
    ray.dir_y = d.y;
    ray.dir_z = d.z;
    ray.tnear = 0.0f;
    ray.tfar = t_max;
    ray.mask = ~0u;
    return ray;
}

bool intersector_nearest(Intersector *self, Vec3 o, Vec3 d, float t_max, Hit *out_hit) {
    if (!is_traceable(self, o, d, t_max))
        return false;
    struct RTCRayHit query;
    memset(&query, 0, sizeof query);
    query.ray = make_ray(o, d, t_max);
    query.hit.geomID = RTC_INVALID_GEOMETRY_ID;
#if RTC_VERSION_MAJOR >= 4
    rtcIntersect1(self->scene, &query, NULL);
#else
    struct RTCIntersectContext context;
    rtcInitIntersectContext(&context);
    rtcIntersect1(self->scene, &context, &query);
#endif
    if (query.hit.geomID == RTC_INVALID_GEOMETRY_ID)
        return false;
    *out_hit = (Hit){query.ray.tfar, query.hit.u, query.hit.v, query.hit.geomID, query.hit.primID};
    return true;
}

bool intersector_any(Intersector *self, Vec3 o, Vec3 d, float t_max) {
    if (!is_traceable(self, o, d, t_max))
        return false;
    struct RTCRay ray = make_ray(o, d, t_max);
#if RTC_VERSION_MAJOR >= 4
    rtcOccluded1(self->scene, &ray, NULL);
#else
    struct RTCIntersectContext context;
    rtcInitIntersectContext(&context);
    rtcOccluded1(self->scene, &context, &ray);
#endif
    return ray.tfar < 0.0f; /* Embree's sign for "something is there" */
}

/* The point of a triangle nearest to p: the foot on its plane where that lies inside, else on the
 * nearest edge. */
static Vec3 closest_on_triangle(Vec3 p, Vec3 a, Vec3 b, Vec3 c) {
    const Vec3 corners[3] = {a, b, c};
    const Vec3 n = vec3_cross(vec3_sub(b, a), vec3_sub(c, a));
    const float n2 = vec3_dot(n, n);
    bool is_inside = n2 > 0.0f;
    float nearest = INFINITY;
    Vec3 closest = a;
    for (int k = 0; k < 3; ++k) {
        const Vec3 from = corners[k];
        const Vec3 edge = vec3_sub(corners[(k + 1) % 3], from);
        const Vec3 to_p = vec3_sub(p, from);
        is_inside = is_inside && vec3_dot(vec3_cross(n, edge), to_p) >= 0.0f;
        const float length2 = vec3_dot(edge, edge);
        const float s = length2 > 0.0f ? clampf(vec3_dot(to_p, edge) / length2, 0.0f, 1.0f) : 0.0f;
        const Vec3 across = vec3_madd(to_p, -s, edge);
        if (vec3_dot(across, across) < nearest) {
            nearest = vec3_dot(across, across);
            closest = vec3_madd(from, s, edge);
        }
    }
    return is_inside ? vec3_madd(p, -vec3_dot(n, vec3_sub(p, a)) / n2, n) : closest;
}

typedef struct ClosestQuery {
    RTCScene scene;
    Vec3 point;
    bool is_found;
} ClosestQuery;

/* Embree offers a triangle within the radius: a smaller radius is an answer. */
static bool on_near_triangle(struct RTCPointQueryFunctionArguments *args) {
    ClosestQuery *found = args->userPtr;
    RTCGeometry geometry = rtcGetGeometry(found->scene, args->geomID);
    const Vec3 *positions = rtcGetGeometryBufferData(geometry, RTC_BUFFER_TYPE_VERTEX, 0);
    const uint32_t *triangles = rtcGetGeometryBufferData(geometry, RTC_BUFFER_TYPE_INDEX, 0);
    const uint32_t *i = triangles + 3 * (uint64_t)args->primID;
    struct RTCPointQuery *query = args->query;
    const Vec3 p = vec3(query->x, query->y, query->z);
    const Vec3 point = closest_on_triangle(p, positions[i[0]], positions[i[1]], positions[i[2]]);
    const float distance = vec3_length(vec3_sub(point, p));
    if (!(distance < query->radius))
        return false;
    query->radius = distance;
    found->point = point;
    found->is_found = true;
    return true;
}

bool intersector_closest(const Intersector *self, Vec3 p, float reach, Vec3 *out_point) {
    struct RTCPointQuery query;
    memset(&query, 0, sizeof query);
    query.x = p.x;
    query.y = p.y;
    query.z = p.z;
    query.radius = reach;
    struct RTCPointQueryContext context;
    rtcInitPointQueryContext(&context);
    ClosestQuery found = {.scene = self->scene};
    rtcPointQuery(self->scene, &query, &context, on_near_triangle, &found);
    if (found.is_found)
        *out_point = found.point;
    return found.is_found;
}

/* The context of a query for all hits: Embree hands it to the filter. */
typedef struct Collection {
#if RTC_VERSION_MAJOR >= 4
    struct RTCRayQueryContext context; /* first: the filter casts it back */
#else
    struct RTCIntersectContext context;
#endif
    Hit *hits;
    uint32_t count, room;
} Collection;

/* Takes note of a hit and refuses it, so that Embree goes on. */
static void collect(const struct RTCFilterFunctionNArguments *arguments) {
    Collection *collection = (Collection *)(void *)arguments->context;
    arguments->valid[0] = 0;
    if (collection->count == collection->room)
        return;
    /* Packets of one have the layout of a single ray and hit. */
    const struct RTCRay *ray = (const struct RTCRay *)(const void *)arguments->ray;
    const struct RTCHit *hit = (const struct RTCHit *)(const void *)arguments->hit;
    collection->hits[collection->count++] =
        (Hit){ray->tfar, hit->u, hit->v, hit->geomID, hit->primID};
}

static int compare_hits(const void *left, const void *right) {
    const Hit *a = left, *b = right;
    if (a->geometry != b->geometry)
        return a->geometry < b->geometry ? -1 : 1;
    return (a->triangle > b->triangle) - (a->triangle < b->triangle);
}

uint32_t intersector_all(Intersector *self, Vec3 o, Vec3 d, float t_max, Hit *out_hits,
                         uint32_t room) {
    if (!is_traceable(self, o, d, t_max))
        return 0;
    Collection collection = {.hits = out_hits, .count = 0, .room = room};
    struct RTCRayHit query;
    memset(&query, 0, sizeof query);
    query.ray = make_ray(o, d, t_max);
    query.hit.geomID = RTC_INVALID_GEOMETRY_ID;
#if RTC_VERSION_MAJOR >= 4
    rtcInitRayQueryContext(&collection.context);
    struct RTCIntersectArguments arguments;
    rtcInitIntersectArguments(&arguments);
    arguments.context = &collection.context;
    arguments.filter = collect;
    arguments.flags |= RTC_RAY_QUERY_FLAG_INVOKE_ARGUMENT_FILTER;
    rtcIntersect1(self->scene, &query, &arguments);
#else
    rtcInitIntersectContext(&collection.context);
    collection.context.filter = collect;
    rtcIntersect1(self->scene, &collection.context, &query);
#endif
    qsort(out_hits, collection.count, sizeof *out_hits, compare_hits);
    return collection.count;
}

uint64_t intersector_bytes(const Intersector *self) {
    const int64_t bytes = atomic_load(&self->bytes);
    return bytes > 0 ? (uint64_t)bytes : 0;
}

uint64_t intersector_nonfinite(const Intersector *self) {
    return atomic_load(&self->nonfinite_count);
}

AmbStatus intersector_self_test(void) {
    static const Vec3 positions[4] = {{-1, -1, 0}, {1, -1, 0}, {0, 1, 0}, {0, 0, 0}};
    static const uint32_t triangles[3] = {0, 1, 2};
    Intersector *self = NULL;
    Job job;
    job_init(&job, 1);
    AMB_TRY(intersector_create(1, &self));
    const ssize_t found = rtcGetDeviceProperty(self->device, RTC_DEVICE_PROPERTY_VERSION);
    AmbStatus status = intersector_add(self, positions, 3, triangles, 1);
    if (status == AMB_OK)
        status = intersector_commit(self, &job);
    Hit hit;
    bool is_hit = false;
    if (status == AMB_OK)
        is_hit = intersector_nearest(self, vec3(0, 0, 2), vec3(0, 0, -1), 10.0f, &hit);
    intersector_destroy(self);
    AMB_TRY(status);
    if (found / 10000 != RTC_VERSION_MAJOR || !is_hit || fabsf(hit.t - 2.0f) > 1e-5f)
        return status_fail(AMB_INTERNAL,
                           "Embree %d.%d was built in but Embree %d.%d answers, and rays %s: "
                           "another copy of Embree in this process took its place",
                           RTC_VERSION_MAJOR, RTC_VERSION_MINOR, (int)(found / 10000),
                           (int)(found / 100 % 100), is_hit ? "go astray" : "miss");
    return AMB_OK;
}
