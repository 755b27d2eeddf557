/* SPDX-License-Identifier: GPL-3.0-or-later
 *
 * Amberlight: light in homogeneous participating media behind refractive boundaries.
 *
 * The only public header. How it is used:
 *
 *     amb_scene_create -> amb_scene_add_* / amb_scene_set_* -> amb_scene_commit
 *     amb_render_start -> amb_render_wait (poll) -> amb_render_read_pass -> amb_render_destroy
 *     amb_scene_destroy
 *
 * Units: metres, radians, watts; radiance W m^-2 sr^-1, radiant intensity W sr^-1, irradiance
 * W m^-2, coefficients of media 1/m. Colours are scene-linear RGB. A "metre" is one unit of the
 * scene: nothing depends on its true length. World space is right-handed.
 *
 * Memory: arrays and strings passed in are copied during the call; buffers passed out belong to
 * the caller. Every destroy accepts NULL.
 *
 * Threads: a scene is set up by one thread at a time. A committed scene is constant, but for
 * its camera between renders, and may be rendered by several renders at once. amb_render_progress,
 * amb_render_cancel and amb_render_wait may be called from any thread; no callback ever enters the
 * caller's code.
 *
 * Errors: a function that can fail returns an AmbStatus; on failure outputs are zeroed, the
 * object is unchanged and amb_last_error has the details for the calling thread.
 *
 * Versions: every struct begins with struct_size, set by the matching amb_*_init. A smaller size
 * than the library's comes from an older caller and the missing fields keep their defaults; a
 * larger one is AMB_INVALID_ARGUMENT.
 */
#ifndef AMBERLIGHT_AMBERLIGHT_H
#define AMBERLIGHT_AMBERLIGHT_H

#include <stdint.h>

#ifdef __cplusplus
extern "C" {
#endif

#if defined(__GNUC__)
#define AMB_API __attribute__((visibility("default")))
#else
#define AMB_API
#endif

/* Bumped when the layout of a struct or the meaning of a function changes. */
#define AMB_ABI_VERSION 6
#define AMB_VERSION_STRING "0.1.0"

/* ---- Status ---------------------------------------------------------------------------------- */

/* X(name, value, default message). Values are never reused. */
#define AMB_STATUS_LIST(X)                                                                         \
    X(OK, 0, "success")                                                                            \
    X(INVALID_ARGUMENT, 1, "invalid argument")                                                     \
    X(INVALID_STATE, 2, "call not allowed in this state")                                          \
    X(OUT_OF_MEMORY, 3, "out of memory")                                                           \
    X(UNSUPPORTED, 4, "not supported")                                                             \
    X(IO, 5, "input or output failed")                                                             \
    X(CANCELLED, 6, "cancelled")                                                                   \
    X(INTERNAL, 7, "internal error")

#define AMB_STATUS_ENUM(name, value, message) AMB_##name = (value),
enum { AMB_STATUS_LIST(AMB_STATUS_ENUM) AMB_STATUS_ENUM_END };
#undef AMB_STATUS_ENUM

/* A fixed width, not the enum type, so that the ABI does not depend on the compiler. */
typedef int32_t AmbStatus;

typedef struct AmbErrorInfo {
    int32_t status;    /* AmbStatus of the last failed call on this thread; 0 if none failed */
    char function[64]; /* name of the public function, zero-terminated */
    char message[256]; /* one sentence, with the object's name where there is one */
} AmbErrorInfo;

/* Copies the calling thread's record of its last failed call. Never allocates. */
AMB_API void amb_last_error(AmbErrorInfo *out_info);

/* Name ("INVALID_ARGUMENT") of a status, or "UNKNOWN". Static storage. */
AMB_API const char *amb_status_name(AmbStatus status);

/* ---- Version --------------------------------------------------------------------------------- */

AMB_API uint32_t amb_abi_version(void);       /* AMB_ABI_VERSION of the library */
AMB_API const char *amb_version_string(void); /* "major.minor.patch", static storage */

/* Identifiers for amb_struct_size, so that a binding can check its mirrored structs. */
enum {
    AMB_STRUCT_ERROR_INFO = 0,
    AMB_STRUCT_PHASE_LOBE = 1,
    AMB_STRUCT_MATERIAL = 2,
    AMB_STRUCT_MESH = 3,
    AMB_STRUCT_OBJECT = 4,
    AMB_STRUCT_LIGHT = 5,
    AMB_STRUCT_CAMERA = 6,
    AMB_STRUCT_RENDER_PARAMS = 7,
    AMB_STRUCT_PROGRESS = 8,
    AMB_STRUCT_WORLD_IMAGE = 9,
    AMB_STRUCT_TEXTURE = 10,
    AMB_STRUCT_COUNT = 11
};
AMB_API uint64_t amb_struct_size(uint32_t struct_id); /* bytes; 0 for an unknown id */

/* Shoots one ray at one triangle and compares Embree's version at run time with the one compiled
 * against: a host process may interpose its own copy of Embree. Fails with AMB_INTERNAL and a
 * message that names both versions. Any thread. */
AMB_API AmbStatus amb_self_test(void);

/* ---- Scene ----------------------------------------------------------------------------------- */

typedef struct AmbScene AmbScene;

AMB_API AmbStatus amb_scene_create(AmbScene **out_scene);
AMB_API void amb_scene_destroy(AmbScene *scene); /* after every render of it is destroyed */

/* What an image shows beyond its edges. */
enum {
    AMB_EXTENSION_REPEAT = 0,
    AMB_EXTENSION_EDGE = 1, /* the nearest pixel */
    AMB_EXTENSION_CLIP = 2, /* black */
    AMB_EXTENSION_MIRROR = 3,
};
enum { AMB_INTERPOLATION_LINEAR = 0, AMB_INTERPOLATION_CLOSEST = 1 };

/* An image for opaque surfaces. It covers (0, 0) .. (1, 1); values are those in the pixels'
 * middles. */
typedef struct AmbTexture {
    uint32_t struct_size;
    uint32_t width, height; /* pixels, >= 1; together < 2^32 */
    uint32_t extension;     /* AMB_EXTENSION_* */
    uint32_t interpolation; /* AMB_INTERPOLATION_* */
    uint32_t reserved;
    const char *name;
    const float *color; /* (height, width, 3), scene-linear, in [0,1]; row 0 is the bottom */
} AmbTexture;

AMB_API void amb_texture_init(AmbTexture *texture);
/* *out_id counts from 1: 0 in a material is no texture. */
AMB_API AmbStatus amb_scene_add_texture(AmbScene *scene, const AmbTexture *texture,
                                        uint32_t *out_id);

/* Henyey-Greenstein lobe: p(cos) = (1-g^2) / (4 pi (1+g^2-2 g cos)^1.5) in 1/sr, cos between the
 * directions of travel before and after. */
typedef struct AmbPhaseLobe {
    float sigma_s[3]; /* scattering coefficient of this lobe, 1/m, >= 0 */
    float g;          /* mean cosine, in (-1, 1) */
} AmbPhaseLobe;

#define AMB_PHASE_LOBE_MAX 4

enum {
    AMB_SURFACE_DIFFUSE = 0,    /* opaque, Lambertian */
    AMB_SURFACE_DIELECTRIC = 1, /* smooth refractive boundary of a medium (which may be clear) */
};

/* sigma_t = sigma_a + the sum of the lobes' sigma_s. The medium fills the side that the
 * triangles' geometric normals point away from; a mesh that encloses negative volume is inside
 * out and taken the right way round, which the report says. */
typedef struct AmbMaterial {
    uint32_t struct_size;
    uint32_t surface; /* AMB_SURFACE_* */
    const char *name;
    float albedo[3];         /* DIFFUSE: reflectance in [0,1] */
    float emission[3];       /* DIFFUSE: radiance of both sides, W m^-2 sr^-1, in [0,1e30] */
    float transmit_color[3]; /* DIELECTRIC: factor on each refraction, in [0,1] */
    float reflect_color[3];  /* DIELECTRIC: factor on each reflection, in [0,1] */
    float ior;               /* DIELECTRIC: index of the inside, vacuum = 1; > 0 */
    float sigma_a[3];        /* DIELECTRIC: absorption coefficient, 1/m, >= 0 */
    uint32_t lobe_count;     /* DIELECTRIC: 0 .. AMB_PHASE_LOBE_MAX */
    AmbPhaseLobe lobes[AMB_PHASE_LOBE_MAX];
    int32_t priority; /* DIELECTRIC: where objects overlap the medium of the highest one holds, of
                       * equal ones that of the object entered last */
    uint32_t texture; /* DIFFUSE: id from amb_scene_add_texture, whose colour multiplies albedo; 0:
                       * none. Without uvs of the mesh it is seen at (0, 0) */
    float uv_to_texture[6]; /* row-major 2x3: from uvs to places of the texture */
} AmbMaterial;

/* Defaults: grey diffuse albedo 0.8, ior 1, white tints, no medium, priority 0, no texture. */
AMB_API void amb_material_init(AmbMaterial *material);
/* *out_id counts from 0. */
AMB_API AmbStatus amb_scene_add_material(AmbScene *scene, const AmbMaterial *material,
                                         uint32_t *out_id);

enum {
    AMB_NORMALS_NONE = 0,   /* flat */
    AMB_NORMALS_VERTEX = 1, /* normals: (vertex_count, 3) */
    AMB_NORMALS_CORNER = 2, /* normals: (triangle_count, 3, 3) */
};

typedef struct AmbMesh {
    uint32_t struct_size;
    uint32_t normal_domain; /* AMB_NORMALS_* */
    const char *name;
    const float *positions;    /* (vertex_count, 3), metres, object space, finite */
    const uint32_t *triangles; /* (triangle_count, 3), indices < vertex_count; counter-clockwise
                                * seen from outside */
    const float *normals;      /* unit shading normals, object space; NULL for AMB_NORMALS_NONE;
                                * a zero or non-finite normal is replaced by the face's own */
    const uint32_t *slots;     /* (triangle_count), material slot of each triangle; NULL: all 0 */
    uint64_t vertex_count;
    uint64_t triangle_count; /* < 2^32 / 3 */
    const float *uvs;        /* (triangle_count, 3, 2), of textures, for each corner; NULL: none */
} AmbMesh;

AMB_API void amb_mesh_init(AmbMesh *mesh);
AMB_API AmbStatus amb_scene_add_mesh(AmbScene *scene, const AmbMesh *mesh, uint32_t *out_id);

/* One placement of a mesh. A slot beyond material_count uses the last material. */
typedef struct AmbObject {
    uint32_t struct_size;
    uint32_t mesh; /* id from amb_scene_add_mesh */
    const char *name;
    float to_world[16]; /* row-major 4x4, affine, invertible; may mirror, outside stays outside */
    const uint32_t *materials; /* (material_count) ids from amb_scene_add_material */
    uint32_t material_count;   /* >= 1 */
    uint32_t reserved;
} AmbObject;

AMB_API void amb_object_init(AmbObject *object); /* identity transform */
AMB_API AmbStatus amb_scene_add_object(AmbScene *scene, const AmbObject *object, uint32_t *out_id);

enum {
    AMB_LIGHT_POINT = 0,
    AMB_LIGHT_SPOT = 1,
    AMB_LIGHT_SUN = 2,
    AMB_LIGHT_AREA = 3,
};

enum { AMB_AREA_RECTANGLE = 0, AMB_AREA_ELLIPSE = 1 };

/* Lights are not seen by camera paths.
 *   POINT, SPOT: color = radiant intensity on the axis, W/sr. The emitter is a disc of the given
 *       radius that faces the receiver (Cycles' convention); radius 0 is a point. A spot's cone
 *       edge follows x = (cos - cos(size/2)) / ((1 - cos(size/2)) blend), smoothstep(clamp(x)).
 *   SUN: color = irradiance on a plane perpendicular to it, W/m^2; angle = angular diameter.
 *   AREA: color = radiance, W m^-2 sr^-1, one-sided, along direction. */
typedef struct AmbLight {
    uint32_t struct_size;
    uint32_t kind; /* AMB_LIGHT_* */
    const char *name;
    float color[3];      /* see above, >= 0 */
    float position[3];   /* metres, world; not SUN */
    float direction[3];  /* of travel, need not be unit; SPOT, SUN, AREA */
    float tangent[3];    /* AREA: its x axis, need not be unit */
    float radius;        /* POINT, SPOT: metres, >= 0 */
    float angle;         /* SUN: radians, in [0, pi] */
    float spot_size;     /* SPOT: full angle of the cone, radians, (0, pi] */
    float spot_blend;    /* SPOT: [0, 1] */
    float spot_cosine;   /* SPOT: 1 multiplies by the cosine from the axis (Blender 3.4), else 0 */
    float size[2];       /* AREA: full extents along x and y, metres, > 0 */
    uint32_t area_shape; /* AMB_AREA_* */
    uint32_t reserved;
} AmbLight;

AMB_API void amb_light_init(AmbLight *light, uint32_t kind);
AMB_API AmbStatus amb_scene_add_light(AmbScene *scene, const AmbLight *light, uint32_t *out_id);

/* Radiance of the surroundings in [0,1e30], constant; takes the place of an image. */
AMB_API AmbStatus amb_scene_set_world(AmbScene *scene, const float radiance[3]);

/* Radiance of the surroundings by direction, equirectangular. Row 0 is the bottom; the middle of
 * the image is the image's +x, a quarter to its left +y, the top +z. Values are those in the
 * pixels' middles, bilinear between them. What is small and far brighter than its surroundings
 * lights the scene as sun lamps, which the report counts; camera paths see it in the image. */
typedef struct AmbWorldImage {
    uint32_t struct_size;
    uint32_t width, height; /* pixels, >= 1; together < 2^32 */
    float to_world[9];      /* row-major 3x3 of the image's axes; orthogonal */
    const float *radiance;  /* (height, width, 3), W m^-2 sr^-1, in [0,1e30] */
} AmbWorldImage;

AMB_API void amb_world_image_init(AmbWorldImage *image); /* identity rotation */
/* Takes the place of the constant. */
AMB_API AmbStatus amb_scene_set_world_image(AmbScene *scene, const AmbWorldImage *image);

enum { AMB_CAMERA_PERSPECTIVE = 0, AMB_CAMERA_ORTHOGRAPHIC = 1 };

/* Camera space: x right, y up, looks along -z. window is the image's rectangle (left, right,
 * bottom, top): at distance 1 for a perspective camera, in metres for an orthographic one. */
typedef struct AmbCamera {
    uint32_t struct_size;
    uint32_t kind;      /* AMB_CAMERA_* */
    float to_world[16]; /* row-major; rotation and translation, scale is removed */
    float window[4];
    float clip_start, clip_end; /* metres along the view axis; 0 < start < end; an orthographic
                                 * camera may start at a negative distance */
    float lens_radius;          /* metres; 0 = pinhole */
    float focus_distance;       /* metres along the view axis; > 0 where lens_radius > 0 */
} AmbCamera;

AMB_API void amb_camera_init(AmbCamera *camera, uint32_t kind);
/* The camera alone may change after the commit: while the scene has no render (AMB_INVALID_STATE
 * until the last is destroyed). What was built for the rays stays. */
AMB_API AmbStatus amb_scene_set_camera(AmbScene *scene, const AmbCamera *camera);

/* Checks the whole and freezes it: later amb_scene_add_* and _set_* return AMB_INVALID_STATE. A
 * scene without camera is AMB_INVALID_ARGUMENT; one without objects or lights is allowed. */
AMB_API AmbStatus amb_scene_commit(AmbScene *scene);

/* ---- Render ---------------------------------------------------------------------------------- */

typedef struct AmbRender AmbRender;

enum {
    AMB_ESTIMATOR_AUTO = 0,
    AMB_ESTIMATOR_POINTS_FIXED = 1,
    AMB_ESTIMATOR_POINTS_COVARIANCE = 2,
    AMB_ESTIMATOR_TUBES = 3,    /* lamps outside of every object, no object inside another; else
                                 * AMB_UNSUPPORTED. A lamp with an extent costs as much as 1 to 36
                                 * without, the larger it is seen. Volume samples join it for what
                                 * it does not follow: later internal reflections of light, and
                                 * light that has passed an object */
    AMB_ESTIMATOR_SPECULAR = 4, /* exact and slow, the reference of the others; for the same scenes
                                 * as TUBES but lamps of no extent and no light_bounces, never
                                 * chosen by AUTO */
};

enum {
    AMB_EFFECT_SINGLE_SCATTERING = 1 << 0,
    AMB_EFFECT_DOUBLE_SCATTERING = 1 << 1,
    AMB_EFFECT_MULTIPLE_SCATTERING = 1 << 2, /* three times and more */
    AMB_EFFECT_SURFACE_REFLECTION = 1 << 3,
    AMB_EFFECT_BACKGROUND = 1 << 4,        /* what is seen through a refractive object */
    AMB_EFFECT_TRANSMITTED_LIGHT = 1 << 5, /* light that passes one refractive object and then
                                            * enters another, or the same again */
    AMB_EFFECT_CAUSTICS = 1 << 6,          /* light that passes translucent objects or is
                                            * reflected by them onto opaque surfaces; without,
                                            * they cast black shadows */
    AMB_EFFECT_WORLD_LIGHT = 1 << 7,       /* light of the world and of lit opaque surfaces that
                                            * scatters in media */
    AMB_EFFECT_INTERREFLECTION = 1 << 8,   /* light that opaque surfaces have from one another, as
                                            * the camera sees it and, with WORLD_LIGHT, media */
    AMB_EFFECT_LAMP_IMAGES = 1 << 9,       /* lamps of some extent that the camera sees mirrored in
                                            * objects, or through them */
};

/* How light that scattered twice and more is found. */
enum {
    AMB_SCATTER_AUTO = 0,
    AMB_SCATTER_WALK = 1,     /* random walks from the camera, the last scattering gathered from
                               * the light field: noise, no other bias than the field's */
    AMB_SCATTER_PHOTONS = 2,  /* photons from lamps and surroundings, kept in cells by depth: for
                               * thick media; a fourth of light_samples are emitted */
    AMB_SCATTER_TREE_CUT = 3, /* [Wang16]: straight connections to volume samples, an infinite
                               * medium's table beyond two scatterings; for comparison: light that
                               * walls reflect between scatterings is missing, the surroundings'
                               * too. A fourth of light_samples are placed */
};

typedef struct AmbRenderParams {
    uint32_t struct_size;
    uint32_t width, height;                           /* of the full image, pixels, >= 1 */
    uint32_t crop_x, crop_y, crop_width, crop_height; /* rectangle to render; y = 0 is the
                                                       * bottom row; width 0 = full image */
    uint32_t samples;                                 /* camera samples per pixel, >= 1 */
    uint32_t estimator;                               /* AMB_ESTIMATOR_* */
    uint32_t effects;                                 /* AMB_EFFECT_* bits that may be simulated */
    uint64_t light_samples;   /* volume samples of the point estimators, >= 1; those that join TUBES
                               * are a fourth of them */
    float kernel_size;        /* C_k of eq. 8: kernel cross-section in units of the cross-section
                               * of one refracted sample, i.e. samples that overlap a point; > 0 */
    uint32_t light_bounces;   /* internal reflections followed on the light side */
    uint32_t camera_bounces;  /* internal reflections followed on the camera side */
    uint32_t adjoint_normals; /* 1: Veach's adjoint factor c_adj on light-side crossings */
    uint32_t seed;
    uint32_t threads;           /* 0 = one for each processor */
    uint32_t film_transparent;  /* 1: the world seen directly has alpha 0 and no radiance */
    int32_t tube_refinement;    /* TUBES: each triangle is halved so many times along its edges,
                                 * 0, 1, 2 .. 4 = 1, 4, 16 .. 256 tubes and more where it must;
                                 * -1, -2: more only where it must twice, four times as much */
    float accuracy;             /* > 0: target of the relative error of the picture (rel_rmse of
                                 * docs/accuracy.md). samples has then no effect; tube_refinement,
                                 * at least 0, is where the search for fine enough tubes begins;
                                 * that for volume samples goes from a 64th of light_samples to 16
                                 * times as many. 0: fixed budgets */
    uint32_t scatter_estimator; /* AMB_SCATTER_* */
    uint32_t scatter_order_max; /* scatterings after which light is left out; 0: no limit */
    uint32_t effects_are_auto;  /* 1: of the effects named those that would not show are left out;
                                 * 0: all that the scene has are simulated */
    uint64_t memory_limit;      /* bytes that all scenes and renders of the process may hold while
                                 * this one runs; beyond it the light field gets coarser, which the
                                 * report says, or the render ends with AMB_OUT_OF_MEMORY. 0: half
                                 * of the machine's memory */
    uint32_t coarse_first;      /* 1: the first samples go to every eighth pixel of a row and of a
                                 * column, then every fourth, every second: a view that is looked
                                 * at while it renders has a picture soon. The final pixels are the
                                 * same. No effect with accuracy */
    uint32_t reserved;
} AmbRenderParams;

AMB_API void amb_render_params_init(AmbRenderParams *params);

/* Starts rendering a committed scene on threads of the library's own and returns at once.
 * The scene must outlive the render. */
AMB_API AmbStatus amb_render_start(AmbScene *scene, const AmbRenderParams *params,
                                   AmbRender **out_render);

/* Plans a render without starting it: which effects would be simulated and which left out, for the
 * picture and for each object, with the share that is predicted of each, and why. Writes JSON
 * (UTF-8, zero-terminated) into the buffer if it fits; *out_size is always the size needed in
 * bytes, including the zero. buffer may be NULL. Returns when it is done, after a small part of a
 * render's time. */
AMB_API AmbStatus amb_plan_explain(AmbScene *scene, const AmbRenderParams *params, char *buffer,
                                   uint64_t size, uint64_t *out_size);

enum {
    AMB_STATE_RUNNING = 0,
    AMB_STATE_DONE = 1,
    AMB_STATE_CANCELLED = 2,
    AMB_STATE_FAILED = 3,
};

typedef struct AmbProgress {
    uint32_t struct_size;
    uint32_t state;        /* AMB_STATE_* */
    float fraction;        /* of the whole render, [0,1], never falls */
    float elapsed;         /* seconds since start */
    uint32_t samples_done; /* camera samples per pixel that every pixel has */
    uint32_t pixel_step;   /* every pixel_step-th pixel of a row and of a column, from the first,
                            * has a sample; 0: none has */
    char stage[32];        /* "scene", "light", "field", "camera", "done" */
    char detail[96];       /* one line for a status bar */
    float error;           /* relative, as the render states it so far; 0: not estimated */
    float remaining;       /* seconds, about; < 0: unknown */
} AmbProgress;

AMB_API void amb_progress_init(AmbProgress *progress);
AMB_API AmbStatus amb_render_progress(AmbRender *render, AmbProgress *out_progress);

/* Asks the render to stop; returns at once. The render stops within 0.2 s. */
AMB_API void amb_render_cancel(AmbRender *render);

/* Waits until the render has ended or timeout seconds (< 0: no limit) have passed. *out_ended is
 * 1 once it has ended; the return value is then the render's own status (AMB_CANCELLED after a
 * cancel) and its error is put into the calling thread's record. Returns AMB_OK and *out_ended 0
 * after a timeout. */
AMB_API AmbStatus amb_render_wait(AmbRender *render, double timeout, int32_t *out_ended);

/* Passes: "Combined" (RGBA, alpha premultiplied), "Depth" (1: distance along the view axis, m;
 * 1e10 where nothing is seen), "Single Scattering", "Double Scattering", "Multiple
 * Scattering" (RGB; light that scattered once, twice, more often in media), "Surface" (RGB;
 * everything that did not scatter in a medium), "Frequency" (1: mean frequency factor of the
 * gathered samples, [0,1]), "Error" (1: standard error of Combined RGB as the render states it,
 * mean of channels, W m^-2 sr^-1; under a target accuracy of noise and light field, after each
 * round; else of the noise, at the end, and 0 with one sample). Combined RGB = the sum of the three
 * of scattering and Surface. For denoisers: "Denoising Albedo" (RGB; of the opaque surfaces, media
 * and surroundings that are seen, of what shines its radiance up to 1, each by the part of the
 * light that comes from there by way of all refractions and reflections; in [0, 1] but for noise)
 * and "Denoising Normal" (3: mean shading normal of the first surface, world, towards the eye). */
AMB_API AmbStatus amb_render_pass_channels(AmbRender *render, const char *name,
                                           uint32_t *out_channels);

/* Copies a pass of the crop rectangle: (crop_height, crop_width, channels) floats, row 0 =
 * bottom. count = number of floats of the buffer, must be exact. While the render runs, the
 * values are those of the samples done so far (AMB_INVALID_STATE while pixel_step is 0), and 0 in
 * pixels that have none. */
AMB_API AmbStatus amb_render_read_pass(AmbRender *render, const char *name, float *out_pixels,
                                       uint64_t count);

/* Writes the report (JSON, UTF-8, zero-terminated) of an ended render into the buffer if it fits;
 * *out_size is always the size needed in bytes, including the zero. buffer may be NULL. */
AMB_API AmbStatus amb_render_report(AmbRender *render, char *buffer, uint64_t size,
                                    uint64_t *out_size);

/* Writes all passes of an ended render into one multi-layer OpenEXR file (32-bit float, channels
 * "LAYER.Pass.R"), with the report as attribute "amberlight:report". Written beside the final
 * name and renamed: there is never half a file under `path`. */
AMB_API AmbStatus amb_render_write_exr(AmbRender *render, const char *path, const char *layer);

/* Cancels if needed, waits and frees. */
AMB_API void amb_render_destroy(AmbRender *render);

#ifdef __cplusplus
}
#endif
#endif
