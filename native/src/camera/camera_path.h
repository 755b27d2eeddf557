/* SPDX-License-Identifier: GPL-3.0-or-later
 * The camera pass: one sample of a pixel, from the lens through boundaries and media. */
#ifndef AMB_CAMERA_CAMERA_PATH_H
#define AMB_CAMERA_CAMERA_PATH_H

#include "camera/ledger.h"
#include "field/caustics/caustics.h"
#include "field/scatter/scatter.h"

enum { CAMERA_ORDER_COUNT = 3 };

/* Effects of the camera's side whose part of the radiance is kept. */
enum {
    CAMERA_PART_REFLECTION,
    CAMERA_PART_BACKGROUND,
    CAMERA_PART_BOUNCES,
    CAMERA_PART_WORLD_LIGHT,   /* scattered light of the surroundings, as walks find it */
    CAMERA_PART_CAUSTICS,      /* on opaque surfaces, seen directly or by way of objects */
    CAMERA_PART_LIGHT_BOUNCES, /* see FieldRadiance, of gathers from the light field; */
    CAMERA_PART_TRANSMITTED,   /* where photons bring later orders these are not in them */
    CAMERA_PART_INTERREFLECTION,
    CAMERA_PART_RETURN, /* see CameraWay, as walks find it */
    CAMERA_PART_COUNT
};

typedef struct CameraParams {
    const CausticMap *caustics; /* on opaque surfaces; NULL: none */
    uint32_t
        glow; /* AMB_EFFECT_*_SCATTERING: orders of light that scattered on its way to opaque
               * surfaces which the map has, and AMB_EFFECT_WORLD_LIGHT where it has them of the
               * surroundings, too. 0: all is gathered in media, along rays from the surface */
    uint32_t width, height; /* of the full image, pixels */
    uint32_t effects;       /* AMB_EFFECT_* to simulate */
    uint32_t bounces;       /* internal reflections to follow */
    uint32_t seed;
    uint32_t part_count; /* of the light field and of caustics: a sample sees the light of one part,
                          * a pixel of all in turn; 0: all of it at once */
    bool gathers_by_chance; /* along branches of little throughput */
    float reflected_chance; /* of each gather to look at light that was reflected inside, for as
                             * much more of it; 0: always, see FieldSegment */
    float late_throughput;  /* below which branches behind many boundaries go on by chance; 0: below
                             * WALKER_ROULETTE_THROUGHPUT, as all others */
    uint32_t order_max;     /* scatterings after which light is left out; 0: no limit */
    bool film_transparent;
    bool may_start_inside; /* a translucent object is near where camera rays begin */
    bool shines_through;   /* light reaches opaque surfaces through translucent objects; else
                            * these cast black shadows */
    uint32_t replicas;     /* independent sequences that cover a pixel in turn, >= 1: one is more
                            * even, and between two the difference tells the error of their mean */
    bool has_returns;      /* media see what opaque surfaces have from one another and from media */
    const Scatter *scatter; /* later orders and what scatters of the surroundings; NULL: by walks */
    Ledger *ledger;         /* of the samples' time; NULL: none is timed */
    const Job *job;         /* a long walk ends where it is cancelled; NULL: never */
} CameraParams;

typedef struct CameraSample {
    SceneLeaks leaks;
    Rgb orders[CAMERA_ORDER_COUNT]; /* scattered once, twice, more often in media, W m^-2 sr^-1 */
    Rgb surface;                    /* not scattered in a medium */
    Rgb lamps;                      /* images of lamps, in none of the above */
    float parts[CAMERA_PART_COUNT]; /* of all this, mean of channels; they overlap */
    Rgb albedo;  /* of what is seen, by way of all objects: see amb_render_pass_channels */
    Vec3 normal; /* of the first surface, world, towards the eye; 0 where nothing is seen */
    float alpha;
    float depth;        /* along the view axis, m; CAMERA_DEPTH_NONE where nothing is seen */
    float frequency;    /* sum of contribution * frequency factor, where that is wanted */
    float contribution; /* sum of contributions (mean of channels), likewise */
    bool is_object;     /* the primary ray hits a translucent object */
} CameraSample;

/* All radiance but images of lamps: orders and surface. */
static inline Rgb camera_sample_sum(const CameraSample *sample) {
    Rgb sum = sample->surface;
    for (int k = 0; k < CAMERA_ORDER_COUNT; ++k)
        sum = rgb_add(sum, sample->orders[k]);
    return sum;
}

#define CAMERA_DEPTH_NONE 1e10f

/* Sample `index` of pixel (x, y), y = 0 at the bottom. */
typedef struct CameraRequest {
    uint32_t x, y, index;
    bool wants_frequency;
} CameraRequest;

enum { CAMERA_BATCH = FIELD_GATHER_MAX };

/* Radiance of up to CAMERA_BATCH samples, best of neighbouring pixels, box filter. field may be
 * NULL: nothing scatters. At each dielectric boundary both the reflected and the refracted branch
 * are followed; radiance is divided by the square of the index entered, so that L / n^2 is kept. Of
 * requests for one pixel that want frequencies and follow one another the first that sees a medium
 * tells its own, which takes time. What a sample sees is deterministic in (seed, x, y, index),
 * whatever else is asked for. Any thread. AMB_CANCELLED where params->job is. */
AmbStatus camera_samples(const AmbScene *scene, const Field *field, const CameraParams *params,
                         const CameraRequest requests[], uint32_t count, CameraSample out[]);

/* What light needs so that it is seen along a branch of a camera path. */
typedef struct CameraWay {
    uint32_t effects; /* AMB_EFFECT_SURFACE_REFLECTION, _BACKGROUND, _INTERREFLECTION */
    uint32_t bounces; /* internal reflections */
    uint32_t object;  /* whose boundary the branch met last, or whose medium the lens is in;
                       * UINT32_MAX: none */
    bool returns;     /* into a medium, from an opaque surface that has it from another one or from
                       * a medium */
} CameraWay;

/* Looks at a camera path and its walks instead of summing up what they see. */
typedef struct CameraObserver {
    void *user;
    /* A stretch inside a medium that scatters, after so many scatterings; throughput from its
     * start to the lens. */
    void (*see_medium)(void *user, const CameraWay *way, const FieldSegment *segment,
                       uint32_t order, Rgb throughput);
    /* Light of the world or of an opaque surface as it arrives at the lens, after so many
     * scatterings. */
    void (*see_light)(void *user, const CameraWay *way, uint32_t order, Rgb radiance);
} CameraObserver;

/* The path of camera_sample with everything that params->effects has. The sample has no
 * radiance. */
CameraSample camera_observe(const AmbScene *scene, const CameraObserver *observer,
                            const CameraParams *params, uint32_t x, uint32_t y, uint32_t index);

#endif
