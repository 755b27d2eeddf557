/* SPDX-License-Identifier: GPL-3.0-or-later
 * The surroundings. */
#include "scene/world.h"

#include <string.h>

#include "base/memory.h"

/* Colatitude from the bottom of the image's row boundary y. */
static double row_angle(const WorldImage *image, double y) {
    return (double)AMB_PI * y / (double)image->height;
}

static Vec3 rotate(const float m[9], Vec3 v) {
    return vec3(m[0] * v.x + m[1] * v.y + m[2] * v.z, m[3] * v.x + m[4] * v.y + m[5] * v.z,
                m[6] * v.x + m[7] * v.y + m[8] * v.z);
}

static Vec3 rotate_back(const float m[9], Vec3 v) {
    return vec3(m[0] * v.x + m[3] * v.y + m[6] * v.z, m[1] * v.x + m[4] * v.y + m[7] * v.z,
                m[2] * v.x + m[5] * v.y + m[8] * v.z);
}

/* Place in the image, in pixels, of a direction; Cycles' convention: the middle of the image is
 * +x, and to its right comes -y. */
static Sample2 place_of(const WorldImage *image, Vec3 d) {
    const Vec3 v = rotate_back(image->to_world, d);
    float u = 0.5f - atan2f(v.y, v.x) / (2.0f * AMB_PI);
    /* From below: the angle of a vertical direction keeps its digits next to the pole. */
    const float across = sqrtf(v.x * v.x + v.y * v.y);
    const float t = atan2f(across, -v.z) / AMB_PI;
    u -= floorf(u);
    return (Sample2){u * (float)image->width, t * (float)image->height};
}

Vec3 world_direction(const WorldImage *image, float x, float y) {
    const float phi = 2.0f * AMB_PI * (0.5f - x / (float)image->width);
    const float theta = AMB_PI * y / (float)image->height;
    const float across = sinf(theta);
    return rotate(image->to_world, vec3(across * cosf(phi), across * sinf(phi), -cosf(theta)));
}

static uint32_t wrap(int64_t x, uint32_t width) {
    const int64_t rest = x % (int64_t)width;
    return (uint32_t)(rest < 0 ? rest + (int64_t)width : rest);
}

/* The four pixels around a place, and their weights. */
typedef struct Corners {
    uint32_t x[2], y[2];
    float weight[2][2]; /* by row, column */
} Corners;

static Corners corners_at(const WorldImage *image, Sample2 place) {
    const float x = place.u - 0.5f;
    const float y = fminf(fmaxf(place.v - 0.5f, 0.0f), (float)(image->height - 1));
    const float x0 = floorf(x), y0 = floorf(y);
    const float fx = x - x0, fy = y - y0;
    const uint32_t row = (uint32_t)y0;
    return (Corners){
        .x = {wrap((int64_t)x0, image->width), wrap((int64_t)x0 + 1, image->width)},
        .y = {row, row + 1 < image->height ? row + 1 : row},
        .weight = {{(1.0f - fx) * (1.0f - fy), fx * (1.0f - fy)}, {(1.0f - fx) * fy, fx * fy}}};
}

static Rgb excess_at(const WorldPatch *patch, uint32_t image_width, uint32_t x, uint32_t y) {
    const uint32_t column = x >= patch->x ? x - patch->x : x + image_width - patch->x;
    if (column >= patch->width || y < patch->y || y - patch->y >= patch->height)
        return (Rgb){0, 0, 0};
    return patch->excess[(uint64_t)(y - patch->y) * patch->width + column];
}

static Rgb image_radiance(const WorldImage *image, Vec3 d, bool has_lamps) {
    const Corners corners = corners_at(image, place_of(image, d));
    Rgb sum = {0, 0, 0};
    for (int j = 0; j < 2; ++j)
        for (int i = 0; i < 2; ++i) {
            const uint32_t x = corners.x[i], y = corners.y[j];
            Rgb value = image->pixels[(uint64_t)y * image->width + x];
            for (uint32_t k = 0; has_lamps && k < image->patch_count; ++k)
                value = rgb_add(value, excess_at(&image->patches[k], image->width, x, y));
            sum = rgb_add(sum, rgb_scale(value, corners.weight[j][i]));
        }
    return sum;
}

Rgb world_radiance(const World *world, Vec3 d) {
    return world->image.width > 0 ? image_radiance(&world->image, d, true) : world->constant;
}

Rgb world_radiance_but_lamps(const World *world, Vec3 d) {
    return world->image.width > 0 ? image_radiance(&world->image, d, false) : world->constant;
}

double world_pixel_weight(const WorldImage *image, uint32_t row) {
    const double h = row_angle(image, 1.0), middle = row_angle(image, row + 0.5);
    /* int_0^h (1 - t/h) sin(middle +- t) dt, the two sides of the interpolation's tent; at a pole
     * its value stays 1 instead. */
    const double up = cos(middle) - (sin(middle + h) - sin(middle)) / h;
    const double down = -cos(middle) - (sin(middle - h) - sin(middle)) / h;
    double sum = 0.0;
    sum += row + 1 < image->height ? up : 1.0 - cos(0.5 * h);
    sum += row > 0 ? down : 1.0 - cos(0.5 * h);
    return sum * 2.0 * (double)AMB_PI / (double)image->width;
}

/* Mean over pixel (x, y) of the interpolated radiance, mean of the channels. */
static float pixel_mean(const WorldImage *image, uint32_t x, uint32_t y) {
    static const float SHARE[3] = {0.125f, 0.75f, 0.125f};
    float sum = 0.0f;
    for (int j = 0; j < 3; ++j)
        for (int i = 0; i < 3; ++i) {
            int64_t row = (int64_t)y + j - 1;
            row = row < 0 ? 0 : row >= (int64_t)image->height ? (int64_t)image->height - 1 : row;
            const uint32_t column = wrap((int64_t)x + i - 1, image->width);
            sum += SHARE[i] * SHARE[j] *
                   rgb_mean(image->pixels[(uint64_t)row * image->width + column]);
        }
    return sum;
}

/* Turns running sums of `count` chances into shares of the last; all alike where all are 0. */
static void normalise(float *sums, const double *running, uint32_t count) {
    for (uint32_t i = 0; i <= count; ++i)
        sums[i] = running[count] > 0.0 ? (float)(running[i] / running[count])
                                       : (float)((double)i / (double)count);
    sums[count] = 1.0f;
}

static double row_solid_angle(const WorldImage *image, uint32_t row) {
    return 2.0 * (double)AMB_PI *
           (cos(row_angle(image, row)) - cos(row_angle(image, (double)row + 1.0)));
}

AmbStatus world_prepare(World *world) {
    WorldImage *image = &world->image;
    world->mean = world->constant;
    world->is_black = !(rgb_max(world->constant) > 0.0f);
    if (image->width == 0)
        return AMB_OK;
    const uint32_t most = image->width > image->height ? image->width : image->height;
    double *running = memory_alloc_array((uint64_t)most + 1, sizeof *running);
    double *rows = memory_alloc_array((uint64_t)image->height + 1, sizeof *rows);
    if (running == NULL || rows == NULL) {
        memory_free(running);
        memory_free(rows);
        return status_fail(AMB_OUT_OF_MEMORY, "no memory for the world's image");
    }
    rows[0] = 0.0;
    double mean[3] = {0, 0, 0};
    for (uint32_t y = 0; y < image->height; ++y) {
        running[0] = 0.0;
        const double weight = world_pixel_weight(image, y) / (4.0 * (double)AMB_PI);
        for (uint32_t x = 0; x < image->width; ++x) {
            const Rgb pixel = image->pixels[(uint64_t)y * image->width + x];
            mean[0] += weight * (double)pixel.r;
            mean[1] += weight * (double)pixel.g;
            mean[2] += weight * (double)pixel.b;
            running[x + 1] = running[x] + (double)pixel_mean(image, x, y);
        }
        normalise(image->column_sums + (uint64_t)y * (image->width + 1), running, image->width);
        rows[y + 1] =
            rows[y] + running[image->width] / (double)image->width * row_solid_angle(image, y);
    }
    normalise(image->row_sums, rows, image->height);
    world->mean = rgb((float)mean[0], (float)mean[1], (float)mean[2]);
    world->is_black = !(rows[image->height] > 0.0);
    memory_free(running);
    memory_free(rows);
    return AMB_OK;
}

static void image_clear(WorldImage *image) {
    memory_free(image->pixels);
    memory_free(image->row_sums);
    memory_free(image->column_sums);
    for (uint32_t i = 0; i < image->patch_count; ++i)
        memory_free(image->patches[i].excess);
    memory_free(image->patches);
    memset(image, 0, sizeof *image);
}

AmbStatus world_set_image(World *world, Rgb *pixels, uint32_t width, uint32_t height,
                          const float to_world[9]) {
    WorldImage image = {.width = width, .height = height};
    image.row_sums = memory_alloc_array((uint64_t)height + 1, sizeof(float));
    image.column_sums = memory_alloc_array((uint64_t)height * (width + 1), sizeof(float));
    if (image.row_sums == NULL || image.column_sums == NULL) {
        image_clear(&image);
        return status_fail(AMB_OUT_OF_MEMORY, "no memory for the world's image");
    }
    memcpy(image.to_world, to_world, sizeof image.to_world);
    image.pixels = pixels;
    image_clear(&world->image);
    world->image = image;
    return AMB_OK;
}

void world_clear(World *world) {
    image_clear(&world->image);
}

uint64_t world_bytes(const World *world) {
    const WorldImage *image = &world->image;
    const uint64_t pixels = (uint64_t)image->width * image->height;
    uint64_t bytes = pixels * (sizeof(Rgb) + sizeof(float));
    for (uint32_t i = 0; i < image->patch_count; ++i)
        bytes += (uint64_t)image->patches[i].width * image->patches[i].height * sizeof(Rgb);
    return bytes;
}

/* Largest i < count with sums[i] <= u and a chance of its own. */
static uint32_t find_cell(const float *sums, uint32_t count, float u) {
    uint32_t low = 0, high = count;
    while (high - low > 1) {
        const uint32_t middle = low + (high - low) / 2;
        if (sums[middle] <= u)
            low = middle;
        else
            high = middle;
    }
    return low;
}

/* Where u falls in cell i, [0,1). */
static float cell_offset(const float *sums, uint32_t i, float u) {
    return fminf((u - sums[i]) / (sums[i + 1] - sums[i]), 0x1.fffffep-1f);
}

Vec3 world_sample(const World *world, Sample2 u) {
    const WorldImage *image = &world->image;
    const uint32_t row = find_cell(image->row_sums, image->height, u.v);
    const float *columns = image->column_sums + (uint64_t)row * (image->width + 1);
    const uint32_t column = find_cell(columns, image->width, u.u);
    /* Even in solid angle: uniform in the cosine. */
    const double v = (double)cell_offset(image->row_sums, row, u.v);
    const double below = cos(row_angle(image, row)), above = cos(row_angle(image, row + 1.0));
    const double theta = acos(fmin(fmax(below + v * (above - below), -1.0), 1.0));
    const float y = (float)(theta / (double)AMB_PI * (double)image->height);
    return world_direction(image, (float)column + cell_offset(columns, column, u.u), y);
}

float world_pdf(const World *world, Vec3 d) {
    const WorldImage *image = &world->image;
    if (image->width == 0)
        return 0.0f;
    const Sample2 place = place_of(image, d);
    const uint32_t x = wrap((int64_t)place.u, image->width);
    const uint32_t y = place.v < (float)image->height ? (uint32_t)place.v : image->height - 1;
    const float *columns = image->column_sums + (uint64_t)y * (image->width + 1);
    const float chance =
        (image->row_sums[y + 1] - image->row_sums[y]) * (columns[x + 1] - columns[x]);
    return chance * (float)((double)image->width / row_solid_angle(image, y));
}
