/* SPDX-License-Identifier: GPL-3.0-or-later
 * Films as OpenEXR files: the only file that includes OpenEXR. */
#include "film/film.h"

#include <OpenEXR/openexr.h>
#include <errno.h>
#include <stdio.h>
#include <string.h>

#include "base/memory.h"

enum { PART = 0, NAME_MAX_LENGTH = 255, CHANNELS_PER_PASS_MAX = 4 };

/* Where the encoder finds the values of one channel. */
typedef struct Plane {
    char name[NAME_MAX_LENGTH + 1];
    uint32_t pass, channel;
} Plane;

enum { PLANE_MAX = FILM_PASS_COUNT * CHANNELS_PER_PASS_MAX };

static uint32_t list_planes(const char *layer, Plane out_planes[PLANE_MAX]) {
    uint32_t count = 0;
    for (uint32_t p = 0; p < FILM_PASS_COUNT; ++p)
        for (uint32_t c = 0; c < FILM_PASSES[p].channels; ++c) {
            Plane *plane = &out_planes[count++];
            snprintf(plane->name, sizeof plane->name, "%.200s.%s.%s", layer, FILM_PASSES[p].name,
                     FILM_PASSES[p].channel_names[c]);
            plane->pass = p;
            plane->channel = c;
        }
    return count;
}

static exr_result_t write_header(exr_context_t file, const Film *film, const Plane *planes,
                                 uint32_t plane_count, const char *attribute_name,
                                 const char *attribute_text) {
    int part = 0;
    exr_result_t result = exr_add_part(file, "amberlight", EXR_STORAGE_SCANLINE, &part);
    if (result == EXR_ERR_SUCCESS)
        result = exr_initialize_required_attr_simple(file, part, (int32_t)film->width,
                                                     (int32_t)film->height, EXR_COMPRESSION_ZIP);
    for (uint32_t i = 0; i < plane_count && result == EXR_ERR_SUCCESS; ++i)
        result = exr_add_channel(file, part, planes[i].name, EXR_PIXEL_FLOAT,
                                 EXR_PERCEPTUALLY_LOGARITHMIC, 1, 1);
    if (result == EXR_ERR_SUCCESS)
        result = exr_attr_set_string(file, part, attribute_name, attribute_text);
    if (result == EXR_ERR_SUCCESS)
        result = exr_write_header(file);
    return result;
}

static const Plane *find_plane(const Plane *planes, uint32_t count, const char *name) {
    for (uint32_t i = 0; i < count; ++i)
        if (strcmp(planes[i].name, name) == 0)
            return &planes[i];
    return NULL;
}

/* Fills rows for the chunk that starts at file line `line` (0 = top): plane after plane, each
 * (lines, width). */
static void fill_rows(Film *film, const Plane *planes, uint32_t plane_count, int32_t line,
                      int32_t lines, float *row, float *out_rows) {
    for (int32_t k = 0; k < lines; ++k) {
        const uint32_t y = film->height - 1 - (uint32_t)(line + k);
        uint32_t loaded = UINT32_MAX;
        for (uint32_t i = 0; i < plane_count; ++i) {
            if (planes[i].pass != loaded) {
                loaded = planes[i].pass;
                film_read_row(film, loaded, y, row);
            }
            const uint32_t channels = FILM_PASSES[loaded].channels;
            float *out = out_rows + ((uint64_t)i * (uint32_t)lines + (uint32_t)k) * film->width;
            for (uint32_t x = 0; x < film->width; ++x)
                out[x] = row[(uint64_t)x * channels + planes[i].channel];
        }
    }
}

/* OpenEXR's initializer names as many members as its version wants and leaves out the others. */
static exr_encode_pipeline_t new_encoder(void) {
#pragma GCC diagnostic push
#pragma GCC diagnostic ignored "-Wmissing-field-initializers"
    const exr_encode_pipeline_t encoder = EXR_ENCODE_PIPELINE_INITIALIZER;
#pragma GCC diagnostic pop
    return encoder;
}

static exr_result_t write_chunks(exr_context_t file, Film *film, const Plane *planes,
                                 uint32_t plane_count, float *row, float *rows) {
    int32_t step = 0;
    exr_result_t result = exr_get_scanlines_per_chunk(file, PART, &step);
    exr_encode_pipeline_t encoder = new_encoder();
    for (int32_t line = 0; line < (int32_t)film->height && result == EXR_ERR_SUCCESS;
         line += step) {
        exr_chunk_info_t chunk;
        result = exr_write_scanline_chunk_info(file, PART, line, &chunk);
        if (result == EXR_ERR_SUCCESS)
            result = line == 0 ? exr_encoding_initialize(file, PART, &chunk, &encoder)
                               : exr_encoding_update(file, PART, &chunk, &encoder);
        if (result != EXR_ERR_SUCCESS)
            break;
        fill_rows(film, planes, plane_count, line, chunk.height, row, rows);
        for (int16_t c = 0; c < encoder.channel_count; ++c) {
            exr_coding_channel_info_t *channel = &encoder.channels[c];
            const Plane *plane = find_plane(planes, plane_count, channel->channel_name);
            const uint64_t i = (uint64_t)(plane - planes);
            channel->encode_from_ptr =
                (const uint8_t *)(rows + i * (uint32_t)chunk.height * film->width);
            channel->user_pixel_stride = (int32_t)sizeof(float);
            channel->user_line_stride = (int32_t)(film->width * sizeof(float));
        }
        if (line == 0)
            result = exr_encoding_choose_default_routines(file, PART, &encoder);
        if (result == EXR_ERR_SUCCESS)
            result = exr_encoding_run(file, PART, &encoder);
    }
    exr_encoding_destroy(file, &encoder);
    return result;
}

/* Silent: the status carries what went wrong, and Blender's console is not ours. */
static void on_error(exr_const_context_t file, exr_result_t code, const char *message) {
    (void)file;
    (void)code;
    (void)message;
}

static exr_result_t write_file(Film *film, const char *path, const char *layer,
                               const char *attribute_name, const char *attribute_text) {
    Plane planes[PLANE_MAX];
    const uint32_t plane_count = list_planes(layer, planes);
    enum { LINES_MAX = 256 }; /* of a chunk, over all compressions of OpenEXR */
    float *row = memory_alloc_array((uint64_t)film->width * CHANNELS_PER_PASS_MAX, sizeof(float));
    float *rows =
        memory_alloc_array((uint64_t)film->width * LINES_MAX * plane_count, sizeof(float));
    exr_result_t result = EXR_ERR_OUT_OF_MEMORY;
    if (row != NULL && rows != NULL) {
        exr_context_initializer_t setup = EXR_DEFAULT_CONTEXT_INITIALIZER;
        setup.error_handler_fn = on_error;
        exr_context_t file = NULL;
        result = exr_start_write(&file, path, EXR_WRITE_FILE_DIRECTLY, &setup);
        if (result == EXR_ERR_SUCCESS) {
            exr_set_longname_support(file, 1);
            result = write_header(file, film, planes, plane_count, attribute_name, attribute_text);
            if (result == EXR_ERR_SUCCESS)
                result = write_chunks(file, film, planes, plane_count, row, rows);
            const exr_result_t closed = exr_finish(&file);
            if (result == EXR_ERR_SUCCESS)
                result = closed;
        }
    }
    memory_free(row);
    memory_free(rows);
    return result;
}

AmbStatus film_write_exr(Film *film, const char *path, const char *layer,
                         const char *attribute_name, const char *attribute_text) {
    static const char SUFFIX[] = ".part";
    const size_t length = strlen(path);
    char *part_path = memory_alloc_array(length + sizeof SUFFIX, 1);
    if (part_path == NULL)
        return status_fail(AMB_OUT_OF_MEMORY, "no memory to write \"%s\"", path);
    memcpy(part_path, path, length);
    memcpy(part_path + length, SUFFIX, sizeof SUFFIX);
    const exr_result_t result = write_file(film, part_path, layer, attribute_name, attribute_text);
    AmbStatus status = AMB_OK;
    if (result == EXR_ERR_OUT_OF_MEMORY)
        status = status_fail(AMB_OUT_OF_MEMORY, "no memory to write \"%s\"", path);
    else if (result != EXR_ERR_SUCCESS)
        status = status_fail(AMB_IO, "cannot write \"%s\": %s", path,
                             exr_get_default_error_message(result));
    else if (rename(part_path, path) != 0)
        status = status_fail(AMB_IO, "cannot write \"%s\": %s", path, strerror(errno));
    if (status != AMB_OK)
        remove(part_path);
    memory_free(part_path);
    return status;
}
