/* SPDX-License-Identifier: MIT */
/* Loading of environments and images: decoding in a child process, validation of its answer,
 * replacement of negative and non-finite pixels. */
#include "base/sandbox.h"
#include "light_private.h"

#include <math.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>
#include <sys/stat.h>

enum { BLOB_MAGIC = 0x474d4950, BLOB_WANTS_OIIO = 0x4f49494f };
#define FILE_MAX_BYTES ((uint64_t)2 << 30)

/* The child's answer: the pixels of all images one after the other, then a header for each. */
struct blob_header {
    uint32_t magic, hint, width, height;
};
_Static_assert(sizeof(struct blob_header) <= PRT_IMAGE_TAIL,
               "one header fits behind the pixels");

static size_t pixel_bytes(uint64_t width, uint64_t height)
{
    return (size_t)(width * height) * 3 * sizeof(float);
}

/* ---- the child's side ---- */

struct decode_job {
    const struct prt_input *input;
    unsigned count;
    bool oiio; /* in the second child, which has OpenImageIO loaded */
};

static void load_oiio(void *arg)
{
    prt_oiio_open();
}

/* A single image is the answer itself: its pixels have room for the header behind them. */
static int pack(struct prt_decoded *decoded, unsigned count, struct prt_blob *out)
{
    size_t at = 0, pixels = 0;
    for (unsigned i = 0; i < count; i++)
        pixels += pixel_bytes(decoded[i].image.width, decoded[i].image.height);
    out->size = pixels + count * sizeof(struct blob_header);
    out->bytes = count == 1 ? (void *)decoded[0].image.rgb : prt_alloc(out->size, 1);
    if (!out->bytes) return PRT_NOMEM;
    char *bytes = out->bytes;
    for (unsigned i = 0; i < count; i++) {
        struct prt_image *im = &decoded[i].image;
        const struct blob_header head = {BLOB_MAGIC, decoded[i].hint, im->width, im->height};
        const size_t size = pixel_bytes(im->width, im->height);
        memcpy(bytes + pixels + i * sizeof head, &head, sizeof head);
        if (count == 1) break;
        memcpy(bytes + at, im->rgb, size);
        at += size;
        prt_image_finish(im);
    }
    return PRT_OK;
}

static int request_oiio(struct prt_blob *out)
{
    const struct blob_header head = {.magic = BLOB_WANTS_OIIO};
    if (!(out->bytes = prt_alloc(1, sizeof head))) return PRT_NOMEM;
    memcpy(out->bytes, &head, sizeof head);
    out->size = sizeof head;
    return PRT_OK;
}

/* Drops warnings and notes: the first child has logged them. */
static void pass_errors(void *user, enum prt_log_level level, const char *line)
{
    if (level == PRT_LOG_ERROR) prt_log(user, level, "%s", line);
}

static int decode_with_oiio(const struct prt_context *ctx, const struct prt_input *in,
                            struct prt_decoded *out)
{
    struct prt_context quiet = *ctx;
    quiet.log = pass_errors;
    quiet.log_user = (void *)ctx;
    const int err = prt_decode_own(&quiet, in->name, in->bytes, in->size, out);
    if (err != PRT_UNSUPPORTED) return err;
    return prt_decode_oiio(ctx, in->name, in->bytes, in->size, out->is_chroma, &out->image);
}

static int decode_all(const struct prt_context *ctx, void *arg, struct prt_blob *out)
{
    const struct decode_job *job = arg;
    struct prt_decoded decoded[PRT_FACES_MAX];
    memset(decoded, 0, sizeof decoded);
    for (unsigned i = 0; i < job->count; i++) {
        const struct prt_input *in = &job->input[i];
        const int err = job->oiio
                            ? decode_with_oiio(ctx, in, &decoded[i])
                            : prt_decode_own(ctx, in->name, in->bytes, in->size, &decoded[i]);
        if (err == PRT_UNSUPPORTED && !job->oiio) return request_oiio(out);
        if (err) return err;
    }
    return pack(decoded, job->count, out);
}

/* ---- the parent's side ---- */

/* Checks the child's answer and makes images of it. A single image takes blob->bytes over. */
static int unpack(const struct prt_context *ctx, const struct prt_input *input, unsigned count,
                  struct prt_blob *blob, struct prt_decoded *out)
{
    const size_t tail = count * sizeof(struct blob_header);
    const char *bytes = blob->bytes, *at = bytes;
    if (blob->size < tail)
        return prt_fail(ctx, PRT_FORMAT, "%s: the decoder's answer is too short",
                        input[0].name);
    size_t left = blob->size - tail;
    for (unsigned i = 0; i < count; i++) {
        struct blob_header head;
        memcpy(&head, bytes + blob->size - tail + i * sizeof head, sizeof head);
        if (head.magic != BLOB_MAGIC || head.hint >= PRT_HINT_COUNT)
            return prt_fail(ctx, PRT_FORMAT, "%s: the decoder's answer is damaged",
                            input[i].name);
        int err = prt_image_check(ctx, input[i].name, head.width, head.height);
        if (err) return err;
        const size_t size = pixel_bytes(head.width, head.height);
        if (size > left)
            return prt_fail(ctx, PRT_FORMAT, "%s: the decoder's answer is too short",
                            input[i].name);
        if (count == 1) {
            out->image = (struct prt_image){head.width, head.height, blob->bytes};
            blob->bytes = NULL;
        } else {
            err = prt_image_reserve(ctx, input[i].name, head.width, head.height, &out[i].image);
            if (err) return err;
            memcpy(out[i].image.rgb, at, size);
        }
        out[i].hint = (enum prt_layout_hint)head.hint;
        at += size;
        left -= size;
    }
    return PRT_OK;
}

static bool wants_oiio(const struct prt_blob *blob)
{
    uint32_t magic = 0;
    if (blob->size == sizeof(struct blob_header)) memcpy(&magic, blob->bytes, sizeof magic);
    return magic == BLOB_WANTS_OIIO;
}

static int decode_isolated(const struct prt_context *ctx, const struct prt_input *input,
                           unsigned count, struct prt_decoded *out)
{
    struct decode_job job = {input, count, false};
    struct prt_isolate_limits limits = {
        .memory_bytes = ctx && ctx->memory_limit ? ctx->memory_limit : (uint64_t)8 << 30,
        .seconds = SANITIZED ? 60 : 10}; // forks of an instrumented process take seconds of it
    struct prt_blob blob = {0};
    memset(out, 0, count * sizeof *out);
    int err = prt_isolate(ctx, input[0].name, &limits, decode_all, &job, &blob);
    if (!err && wants_oiio(&blob)) {
        prt_free(blob.bytes);
        blob = (struct prt_blob){0};
        job.oiio = true;
        limits.prepare = load_oiio;
        limits.threads =
            true; /* OpenImageIO starts its thread pool before its limit on threads is set */
        err = prt_isolate(ctx, input[0].name, &limits, decode_all, &job, &blob);
    }
    if (!err) err = unpack(ctx, input, count, &blob, out);
    prt_free(blob.bytes);
    for (unsigned i = 0; err && i < count; i++) prt_image_finish(&out[i].image);
    return err;
}

int prt_image_check(const struct prt_context *ctx, const char *name, uint64_t width,
                    uint64_t height)
{
    uint64_t limit = ctx && ctx->memory_limit ? ctx->memory_limit : (uint64_t)8 << 30;
    if (ctx && ctx->image_limit && ctx->image_limit < limit) limit = ctx->image_limit;
    if (!width || !height)
        return prt_fail(ctx, PRT_FORMAT, "%s: the image is empty (%llu x %llu)", name,
                        (unsigned long long)width, (unsigned long long)height);
    if (width > PRT_IMAGE_MAX || height > PRT_IMAGE_MAX ||
        width * height > PRT_IMAGE_MAX_PIXELS)
        return prt_fail(ctx, PRT_LIMIT,
                        "%s: %llu x %llu pixels are above the limit (%d a side, "
                        "%llu in all)",
                        name, (unsigned long long)width, (unsigned long long)height,
                        PRT_IMAGE_MAX, (unsigned long long)PRT_IMAGE_MAX_PIXELS);
    if (width * height * 12 > limit)
        return prt_fail(ctx, PRT_LIMIT,
                        "%s: %llu x %llu pixels take %llu MB decoded, the limit is %llu MB; "
                        "make the image smaller",
                        name, (unsigned long long)width, (unsigned long long)height,
                        (unsigned long long)(width * height * 12 >> 20),
                        (unsigned long long)(limit >> 20));
    return PRT_OK;
}

int prt_image_reserve(const struct prt_context *ctx, const char *name, uint64_t width,
                      uint64_t height, struct prt_image *out)
{
    const int err = prt_image_check(ctx, name, width, height);
    if (err) return err;
    out->alpha = NULL;
    out->rgb = prt_alloc(pixel_bytes(width, height) + PRT_IMAGE_TAIL, 1);
    if (!out->rgb)
        return prt_fail(ctx, PRT_NOMEM, "%s: no memory for %llu x %llu pixels", name,
                        (unsigned long long)width, (unsigned long long)height);
    out->width = (uint32_t)width;
    out->height = (uint32_t)height;
    return PRT_OK;
}

/* Negative values and NaN become 0. Infinity becomes the image's largest finite value in that
 * channel: a sun that overflowed its format is next to pixels that nearly did. */
static void clear_non_finite(const struct prt_context *ctx, const char *name,
                             struct prt_image *image, uint32_t *n_negative,
                             uint32_t *n_nonfinite)
{
    const size_t count = (size_t)image->width * image->height;
    uint32_t negative = 0, nonfinite = 0;
    float top[3] = {0, 0, 0};
    bool clean = true;
    for (size_t i = 0; i < count; i++)
        for (int c = 0; c < 3; c++) {
            const float v = image->rgb[i * 3 + c];
            clean = clean && v >= 0 && v <= PRT_RADIANCE_MAX;
            top[c] = v <= PRT_RADIANCE_MAX && v > top[c] ? v : top[c];
        }
    for (size_t i = 0; !clean && i < count; i++) {
        float *p = image->rgb + i * 3;
        bool low = false, odd = false;
        for (int c = 0; c < 3; c++) {
            if (p[c] >= 0 && p[c] <= PRT_RADIANCE_MAX) continue;
            const bool is_low = isfinite(p[c]) && p[c] < 0;
            low = low || is_low;
            odd = odd || !is_low;
            p[c] = isinf(p[c]) && p[c] > 0     ? top[c]
                   : isfinite(p[c]) && !is_low ? PRT_RADIANCE_MAX
                                               : 0;
        }
        negative += low;
        nonfinite += odd;
    }
    if (negative)
        prt_log(ctx, PRT_LOG_WARNING, "%s: %u pixels had negative components, which became 0",
                name, negative);
    if (nonfinite)
        prt_log(ctx, PRT_LOG_WARNING,
                "%s: %u pixels had NaN, infinite or components above %g; "
                "NaN became 0, the others the largest allowed",
                name, nonfinite, (double)PRT_RADIANCE_MAX);
    *n_negative += negative;
    *n_nonfinite += nonfinite;
}

int prt_env_cache_create(struct prt_env *env)
{
    env->cache = prt_calloc(1, sizeof *env->cache);
    if (!env->cache) return PRT_NOMEM;
    pthread_mutex_init(&env->cache->lock, NULL);
    return PRT_OK;
}

void prt_env_cache_destroy(struct prt_env *env)
{
    if (!env->cache) return;
    prt_image_finish(&env->cache->latlong);
    for (int i = 0; i < 3; i++) prt_turned_image_finish(&env->cache->reduced[i]);
    pthread_mutex_destroy(&env->cache->lock);
    prt_free(env->cache);
    env->cache = NULL;
}

static struct prt_env *env_new(void)
{
    struct prt_env *env = prt_calloc(1, sizeof *env);
    if (env && prt_env_cache_create(env)) {
        prt_free(env);
        return NULL;
    }
    return env;
}

void prt_env_destroy(struct prt_env *env)
{
    if (!env) return;
    prt_env_cache_destroy(env);
    prt_image_finish(&env->latlong);
    prt_cube_finish(&env->cube);
    prt_free(env);
}

/* "constant" or "constant:R,G,B". */
static int load_constant(const struct prt_context *ctx, const char *word, struct prt_env **out)
{
    float rgb[3] = {1, 1, 1};
    const char *at = word + strlen("constant");
    for (int c = 0; *at && c < 3; c++) {
        char *end;
        if (*at != (c ? ',' : ':')) break;
        rgb[c] = strtof(at + 1, &end);
        if (end == at + 1 || !(rgb[c] >= 0 && rgb[c] <= PRT_RADIANCE_MAX)) break;
        at = end;
        if (c < 2 && !*at) at = "?";
    }
    if (*at)
        return prt_fail(ctx, PRT_ARG,
                        "%s: expected constant or constant:R,G,B with finite "
                        "numbers of at least 0",
                        word);
    struct prt_env *env = env_new();
    int err = env ? prt_image_reserve(ctx, word, 64, 32, &env->latlong) : PRT_NOMEM;
    if (err) {
        prt_env_destroy(env);
        return prt_fail(ctx, err, "%s: %s", word, prt_status_text(err));
    }
    for (size_t i = 0; i < (size_t)64 * 32; i++)
        memcpy(env->latlong.rgb + i * 3, rgb, sizeof rgb);
    *out = env;
    return PRT_OK;
}

static int load_inputs(const struct prt_context *ctx, const char *name,
                       const struct prt_input *input, unsigned count, enum prt_faces faces,
                       struct prt_env **out)
{
    struct prt_decoded decoded[PRT_FACES_MAX];
    struct prt_env *env = env_new();
    if (!env) return prt_fail(ctx, PRT_NOMEM, "%s: no memory", name);
    int err = decode_isolated(ctx, input, count, decoded);
    for (unsigned i = 0; !err && i < count; i++)
        clear_non_finite(ctx, input[i].name, &decoded[i].image, &env->n_negative,
                         &env->n_nonfinite);
    if (!err)
        err = count == 1 ? prt_env_from_image(ctx, name, &decoded[0], faces, env)
                         : prt_env_from_faces(ctx, name, decoded, faces,
                                              prt_face_has_axis_name(input[0].name), env);
    for (unsigned i = 0; i < count; i++) prt_image_finish(&decoded[i].image);
    if (err) {
        prt_env_destroy(env);
        return err;
    }
    *out = env;
    return PRT_OK;
}

int prt_env_load_memory_faces(const struct prt_context *ctx, const char *name,
                              const void *bytes, size_t n, enum prt_faces faces,
                              struct prt_env **out)
{
    const struct prt_input input = {name, bytes, n};
    *out = NULL;
    return load_inputs(ctx, name, &input, 1, faces, out);
}

int prt_env_load_memory(const struct prt_context *ctx, const char *name, const void *bytes,
                        size_t n, struct prt_env **out)
{
    return prt_env_load_memory_faces(ctx, name, bytes, n, PRT_FACES_GUESS, out);
}

static int load_face_set(const struct prt_context *ctx, const char *pattern,
                         enum prt_faces faces, struct prt_env **out)
{
    char *paths[PRT_FACES_MAX] = {0};
    struct prt_blob blob[PRT_FACES_MAX] = {{0}};
    struct prt_input input[PRT_FACES_MAX];
    int err = prt_find_faces(ctx, pattern, paths);
    for (unsigned i = 0; !err && i < PRT_FACES_MAX; i++) {
        err = prt_read_file(ctx, paths[i], FILE_MAX_BYTES, &blob[i]);
        input[i] = (struct prt_input){paths[i], blob[i].bytes, blob[i].size};
    }
    if (!err) err = load_inputs(ctx, pattern, input, PRT_FACES_MAX, faces, out);
    for (unsigned i = 0; i < PRT_FACES_MAX; i++) {
        prt_free(blob[i].bytes);
        free(paths[i]);
    }
    return err;
}

int prt_env_load_faces(const struct prt_context *ctx, const char *path, enum prt_faces faces,
                       struct prt_env **out)
{
    struct stat st;
    char found[4096];
    *out = NULL;
    if (!strcmp(path, "constant") || !strncmp(path, "constant:", 9))
        return load_constant(ctx, path, out);
    bool exists = !stat(path, &st);
    if (exists ? S_ISDIR(st.st_mode) : strchr(path, '*') || strstr(path, "%s"))
        return load_face_set(ctx, path, faces, out);
    if (!exists) {
        const int missing = prt_env_by_beginning(ctx, path, found, sizeof found);
        if (missing) return missing;
        path = found;
    }
    struct prt_blob blob = {0};
    int err = prt_read_file(ctx, path, FILE_MAX_BYTES, &blob);
    if (!err) err = prt_env_load_memory_faces(ctx, path, blob.bytes, blob.size, faces, out);
    prt_free(blob.bytes);
    return err;
}

int prt_env_load(const struct prt_context *ctx, const char *path, struct prt_env **out)
{
    return prt_env_load_faces(ctx, path, PRT_FACES_GUESS, out);
}

int prt_image_load_memory(const struct prt_context *ctx, const char *name, const void *bytes,
                          size_t n, struct prt_image *out)
{
    struct prt_decoded decoded = {0};
    const struct prt_input input = {name, bytes, n};
    memset(out, 0, sizeof *out);
    int err = decode_isolated(ctx, &input, 1, &decoded);
    if (!err) *out = decoded.image;
    return err;
}

int prt_image_load(const struct prt_context *ctx, const char *path, struct prt_image *out)
{
    struct prt_blob blob = {0};
    memset(out, 0, sizeof *out);
    int err = prt_read_file(ctx, path, FILE_MAX_BYTES, &blob);
    if (!err) err = prt_image_load_memory(ctx, path, blob.bytes, blob.size, out);
    prt_free(blob.bytes);
    return err;
}
