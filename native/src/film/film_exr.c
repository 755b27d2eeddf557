/* SPDX-License-Identifier: GPL-3.0-or-later
 * Films as OpenEXR files: the only file that includes OpenEXR. */
#define _GNU_SOURCE /* NOLINT(bugprone-reserved-identifier): O_TMPFILE is Linux's */
#include "film/film.h"

#include <OpenEXR/openexr.h>
#include <errno.h>
#include <fcntl.h>
#include <stdatomic.h>
#include <stdio.h>
#include <string.h>
#include <unistd.h>

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
                                 uint32_t plane_count, int32_t step, float *row, float *rows) {
    exr_result_t result = EXR_ERR_SUCCESS;
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

static void *exr_memory(size_t bytes) {
    return memory_alloc_array(bytes, 1);
}

/* Silent: the status carries what went wrong, and Blender's console is not ours. */
static void on_error(exr_const_context_t file, exr_result_t code, const char *message) {
    (void)file;
    (void)code;
    (void)message;
}

static exr_result_t write_pixels(exr_context_t file, Film *film, const Plane *planes,
                                 uint32_t plane_count) {
    int32_t step = 0;
    exr_result_t result = exr_get_scanlines_per_chunk(file, PART, &step);
    if (result != EXR_ERR_SUCCESS)
        return result;
    float *row = memory_alloc_array((uint64_t)film->width * CHANNELS_PER_PASS_MAX, sizeof(float));
    float *rows =
        memory_alloc_array((uint64_t)film->width * (uint32_t)step * plane_count, sizeof(float));
    result = EXR_ERR_OUT_OF_MEMORY;
    if (row != NULL && rows != NULL)
        result = write_chunks(file, film, planes, plane_count, step, row, rows);
    memory_free(row);
    memory_free(rows);
    return result;
}

/* ---- Files that have no name until they are whole -------------------------------------------- */

/* Where the file system can do it, the file itself has no name before: a process that is killed
 * leaves nothing at all. Elsewhere (NFS, FAT) it has a hidden one beside the final name. */
typedef struct Draft {
    int descriptor;
    int error;        /* errno of the first write that failed, or 0 */
    bool is_nameless; /* so far */
    char *name;       /* beside the final one; no other writer's */
} Draft;

static atomic_bool is_nameless_avoided;

void film_exr_avoid_nameless(bool is_avoided) {
    atomic_store(&is_nameless_avoided, is_avoided);
}

static AmbStatus draft_open(const char *path, Draft *out) {
    static atomic_uint count;
    enum { NAME_ROOM = 64 };
    const char *slash = strrchr(path, '/');
    const size_t folder = slash != NULL ? (size_t)(slash - path) + 1 : 0;
    *out = (Draft){.descriptor = -1, .name = memory_alloc_array(folder + NAME_ROOM, 1)};
    if (out->name == NULL)
        return status_fail(AMB_OUT_OF_MEMORY, "no memory to write \"%.200s\"", path);
    memcpy(out->name, path, folder);
    /* Linking needs /proc, which some chroots lack. */
    if (!atomic_load(&is_nameless_avoided) && access("/proc/self/fd", X_OK) == 0) {
        memcpy(out->name + folder, ".", 2);
        out->descriptor = open(out->name, O_TMPFILE | O_WRONLY | O_CLOEXEC, 0666);
    }
    out->is_nameless = out->descriptor >= 0;
    snprintf(out->name + folder, NAME_ROOM, ".amberlight-%ld-%u.part", (long)getpid(),
             atomic_fetch_add(&count, 1));
    if (out->descriptor < 0)
        out->descriptor = open(out->name, O_CREAT | O_EXCL | O_WRONLY | O_CLOEXEC, 0666);
    if (out->descriptor >= 0)
        return AMB_OK;
    memory_free(out->name);
    return status_fail(AMB_IO, "cannot write \"%.180s\": %s", path, strerror(errno));
}

static int64_t draft_write(exr_const_context_t file, void *user, const void *buffer, uint64_t size,
                           uint64_t offset, exr_stream_error_func_ptr_t fail) {
    Draft *draft = user;
    uint64_t done = 0;
    while (done < size) {
        const ssize_t count = pwrite(draft->descriptor, (const char *)buffer + done, size - done,
                                     (off_t)(offset + done));
        if (count > 0)
            done += (uint64_t)count;
        else if (count == 0 || errno != EINTR) {
            draft->error = count == 0 ? ENOSPC : errno;
            fail(file, EXR_ERR_WRITE_IO, "%s", strerror(draft->error));
            return -1;
        }
    }
    return (int64_t)size;
}

/* Gives the file its name; 0, or what went wrong. */
static int draft_name(Draft *draft, const char *path) {
    /* What the disk has to say, it says now and not when everyone believes in the file. */
    if (fsync(draft->descriptor) != 0)
        return errno;
    if (draft->is_nameless) {
        char link[64];
        snprintf(link, sizeof link, "/proc/self/fd/%d", draft->descriptor);
        if (linkat(AT_FDCWD, link, AT_FDCWD, draft->name, AT_SYMLINK_FOLLOW) != 0)
            return errno;
        draft->is_nameless = false;
    }
    return rename(draft->name, path) == 0 ? 0 : errno;
}

static void draft_close(Draft *draft, bool is_named) {
    close(draft->descriptor);
    if (!is_named && !draft->is_nameless)
        remove(draft->name);
    memory_free(draft->name);
}

static exr_result_t write_draft(Film *film, Draft *draft, const char *layer,
                                const char *attribute_name, const char *attribute_text) {
    Plane planes[PLANE_MAX];
    const uint32_t plane_count = list_planes(layer, planes);
    exr_context_initializer_t setup = EXR_DEFAULT_CONTEXT_INITIALIZER;
    setup.error_handler_fn = on_error;
    setup.alloc_fn = exr_memory;
    setup.free_fn = memory_free;
    setup.write_fn = draft_write;
    setup.user_data = draft;
    exr_context_t file = NULL;
    exr_result_t result = exr_start_write(&file, draft->name, EXR_WRITE_FILE_DIRECTLY, &setup);
    if (result != EXR_ERR_SUCCESS)
        return result;
    exr_set_longname_support(file, 1);
    result = write_header(file, film, planes, plane_count, attribute_name, attribute_text);
    if (result == EXR_ERR_SUCCESS)
        result = write_pixels(file, film, planes, plane_count);
    const exr_result_t closed = exr_finish(&file);
    return result == EXR_ERR_SUCCESS ? closed : result;
}

AmbStatus film_write_exr(Film *film, const char *path, const char *layer,
                         const char *attribute_name, const char *attribute_text) {
    Draft draft;
    AMB_TRY(draft_open(path, &draft));
    const exr_result_t result = write_draft(film, &draft, layer, attribute_name, attribute_text);
    int error = draft.error;
    if (result == EXR_ERR_SUCCESS && error == 0)
        error = draft_name(&draft, path);
    const bool is_named = result == EXR_ERR_SUCCESS && error == 0;
    draft_close(&draft, is_named);
    if (is_named)
        return AMB_OK;
    if (result == EXR_ERR_OUT_OF_MEMORY)
        return status_fail(AMB_OUT_OF_MEMORY, "no memory to write \"%.200s\"", path);
    return status_fail(AMB_IO, "cannot write \"%.180s\": %s", path,
                       error != 0 ? strerror(error) : exr_get_default_error_message(result));
}
