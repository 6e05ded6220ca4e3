/* SPDX-License-Identifier: MIT */
/* Finds and opens libprt_oiio.so and decodes through it. In a child process only, because the
 * library loads 262 others, and before that child is confined, because it opens files. */
#include "light_private.h"
#include "oiio_abi.h"

#include <dlfcn.h>
#include <errno.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>
#include <unistd.h>

struct job {
    const struct prt_context *ctx;
    const char *name;
    int err;
    bool is_logged; /* the error has its log line */
};

/* Searches beside the program, in ../lib/relight, in ../bin, then in $PRT_LIBDIR. */
static void *find_library(void)
{
    char exe[3072], path[4096];
    static const char *const places[] = {".", "../lib/relight", "../bin"};
    const ssize_t n = readlink("/proc/self/exe", exe, sizeof exe - 1);
    exe[n > 0 ? n : 0] = 0;
    char *slash = strrchr(exe, '/');
    if (slash) *slash = 0;
    for (size_t i = 0; slash && i < sizeof places / sizeof *places; i++) {
        snprintf(path, sizeof path, "%s/%s/libprt_oiio.so", exe, places[i]);
        if (!access(path, R_OK)) return dlopen(path, RTLD_NOW | RTLD_LOCAL);
    }
    const char *dir = getenv("PRT_LIBDIR");
    if (dir && snprintf(path, sizeof path, "%s/libprt_oiio.so", dir) < (int)sizeof path)
        return dlopen(path, RTLD_NOW | RTLD_LOCAL);
    return NULL;
}

static void *library;

void prt_oiio_open(void)
{
    if (!library) library = find_library();
}

static int allow(void *user, uint64_t width, uint64_t height)
{
    struct job *job = user;
    const uint64_t limit =
        job->ctx && job->ctx->memory_limit ? job->ctx->memory_limit : UINT64_C(8) << 30;
    int err = prt_image_check(job->ctx, job->name, width, height);
    if (!err && width * height * 24 > limit) /* the pixels exist twice for a while */
        err = prt_fail(job->ctx, PRT_LIMIT,
                       "%s: decoding %llu x %llu pixels needs more than %llu MB", job->name,
                       (unsigned long long)width, (unsigned long long)height,
                       (unsigned long long)(limit >> 20));
    job->err = err ? err : PRT_FORMAT;
    job->is_logged = err;
    return err != 0;
}

/* OpenImageIO selects its reader by the extension first: a name with the extension of the
 * format that the bytes begin with. */
static const char *name_for_sniffing(const char *name, const uint8_t *bytes, size_t n)
{
    if (prt_is_exr(bytes, n)) return "image.exr";
    if (prt_is_dds(bytes, n)) return "image.dds";
    if (n > 8 && !memcmp(bytes, "\x89PNG", 4)) return "image.png";
    if (n > 3 && bytes[0] == 0xff && bytes[1] == 0xd8) return "image.jpg";
    if (n > 4 && (!memcmp(bytes, "II*", 4) || !memcmp(bytes, "MM\0*", 4))) return "image.tif";
    if (n > 2 && (!memcmp(bytes, "PF", 2) || !memcmp(bytes, "Pf", 2))) return "image.pfm";
    const char *slash = strrchr(name, '/');
    return slash ? slash + 1 : name;
}

int prt_decode_oiio(const struct prt_context *ctx, const char *name, const uint8_t *bytes,
                    size_t n, bool is_chroma, struct prt_image *out)
{
    struct job job = {ctx, name, PRT_FORMAT, false};
    struct prt_oiio_image image;
    prt_oiio_decode_fn decode = NULL;
    prt_oiio_open();
    if (library) *(void **)&decode = dlsym(library, "prt_oiio_decode");
    if (!decode)
        return prt_fail(ctx, PRT_UNSUPPORTED,
                        "%s: this format needs libprt_oiio.so, which was "
                        "not found beside the program (set PRT_LIBDIR); .hdr and .exr do not",
                        name);
    if (decode(name_for_sniffing(name, bytes, n), bytes, n, is_chroma, allow, &job, &image)) {
        if (job.is_logged) return job.err;
        /* OpenImageIO tries to open a file of this name when no reader accepts the bytes; the
         * sandbox refuses that. */
        if (strstr(image.error, "does not exist") || strstr(image.error, strerror(EPERM)) ||
            strstr(image.error, "find a format reader"))
            return prt_fail(ctx, PRT_FORMAT, "%s: not an image of a known format", name);
        for (char *p = image.error; *p; p++) *p = *p == '\n' || *p == '\r' ? ' ' : *p;
        return prt_fail(ctx, job.err, "%s: %s", name, image.error);
    }
    int err = prt_image_reserve(ctx, name, image.width, image.height, out);
    const size_t count = err ? 0 : (size_t)image.width * image.height * 3;
    for (size_t i = 0; i < count; i++)
        out->rgb[i] = image.is_srgb ? prt_srgb_to_linear(image.rgb[i]) : image.rgb[i];
    free(image.rgb);
    return err;
}
