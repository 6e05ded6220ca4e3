// SPDX-License-Identifier: MIT
// The bytes of a glTF's images: a bufferView, a data URI or a file beside the model. An image
// that cannot be read ends in one warning that names it.
#include "gltf.h"

#include <cjson/cJSON.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>
#include <strings.h>

enum { FAILED = 0xfffffffe }; // in image_index: an image that was left out

static int hex(char c)
{
    return c >= '0' && c <= '9'   ? c - '0'
           : c >= 'a' && c <= 'f' ? c - 'a' + 10
           : c >= 'A' && c <= 'F' ? c - 'A' + 10
                                  : -1;
}

// Undoes %XX in place.
static void decode_percent(char *text)
{
    char *to = text;
    for (const char *p = text; *p; p++) {
        if (*p == '%' && hex(p[1]) >= 0 && hex(p[2]) >= 0) {
            *to++ = (char)(hex(p[1]) * 16 + hex(p[2]));
            p += 2;
        } else {
            *to++ = *p;
        }
    }
    *to = 0;
}

static int base64_digit(char c)
{
    return c >= 'A' && c <= 'Z'   ? c - 'A'
           : c >= 'a' && c <= 'z' ? c - 'a' + 26
           : c >= '0' && c <= '9' ? c - '0' + 52
           : c == '+'             ? 62
           : c == '/'             ? 63
                                  : -1;
}

// Bytes of base64 text, malloc-ed; NULL without memory. Ends at the first other character.
static uint8_t *decode_base64(const char *text, size_t *n)
{
    uint8_t *out = malloc(strlen(text) / 4 * 3 + 4);
    uint32_t bits = 0;
    int held = 0;
    *n = 0;
    for (; out && base64_digit(*text) >= 0; text++) {
        bits = bits << 6 | (uint32_t)base64_digit(*text);
        held += 6;
        if (held < 8) continue;
        held -= 8;
        out[(*n)++] = (uint8_t)(bits >> held);
    }
    return out;
}

struct image_bytes {
    const uint8_t *at;
    size_t n;
    uint8_t *made;        // free()
    struct prt_blob file; // prt_free(file.bytes)
};

static int from_uri(struct gltf *g, const struct prt_context *lenient, const char *uri,
                    struct image_bytes *out)
{
    const char *comma = strchr(uri, ',');
    if (!strncasecmp(uri, "data:", 5)) {
        if (!comma || comma - uri < 12 || strncasecmp(comma - 7, ";base64", 7))
            return prt_fail(lenient, PRT_FORMAT, "%s: an image's data URI is not base64",
                            g->d->name);
        out->made = decode_base64(comma + 1, &out->n);
        out->at = out->made;
        return out->made ? PRT_OK : PRT_NOMEM;
    }
    char *path = strdup(uri);
    if (!path) return PRT_NOMEM;
    decode_percent(path);
    int status = prt_draft_file(g->d, lenient, "image", path, g->d->max_bytes - g->loaded_bytes,
                                &out->file);
    free(path);
    if (status) return status;
    g->loaded_bytes += out->file.size;
    out->at = (const uint8_t *)out->file.bytes;
    out->n = out->file.size;
    return PRT_OK;
}

static int from_view(struct gltf *g, const cJSON *view, struct image_bytes *out)
{
    struct gltf_bytes bytes;
    double at = cJSON_IsNumber(view) ? view->valuedouble : -1;
    if (!(at >= 0 && at < (double)g->file.n_view) || (double)(size_t)at != at)
        return prt_gltf_bad(g, "an image names neither a bufferView nor a URI of the file");
    int status = prt_gltf_view(g, (size_t)at, &bytes);
    if (status) return status;
    *out = (struct image_bytes){.at = bytes.at, .n = bytes.n};
    return PRT_OK;
}

// Name of image i for messages.
static void image_name(const struct gltf *g, const cJSON *image, size_t i, char out[200])
{
    const char *name = cJSON_GetStringValue(cJSON_GetObjectItem(image, "name"));
    const char *uri = cJSON_GetStringValue(cJSON_GetObjectItem(image, "uri"));
    if (!name && uri && strncasecmp(uri, "data:", 5)) name = uri;
    snprintf(out, 200, "%.90s: image %zu%s%.60s%s", g->d->name, i, name ? " (" : "",
             name ? name : "", name ? ")" : "");
    for (char *p = out; *p; p++)
        if ((unsigned char)*p < 32) *p = '?';
}

// Reads and decodes; messages are warnings meanwhile.
static int load(struct gltf *g, const cJSON *image, const char *name,
                enum prt_texture_kind kind, uint32_t *out)
{
    const struct prt_context *own = g->d->ctx, *user;
    const struct prt_context lenient = prt_draft_lenient(g->d, &user);
    const char *uri = cJSON_GetStringValue(cJSON_GetObjectItem(image, "uri"));
    struct image_bytes bytes = {0};
    g->d->ctx = &lenient;
    int status = uri ? from_uri(g, &lenient, uri, &bytes)
                     : from_view(g, cJSON_GetObjectItem(image, "bufferView"), &bytes);
    g->d->ctx = own;
    if (!status) status = prt_draft_image(g->d, name, bytes.at, bytes.n, kind, out);
    else status = PRT_OK; // warned
    free(bytes.made);
    prt_free(bytes.file.bytes);
    return status;
}

int prt_gltf_image(struct gltf *g, size_t i, enum prt_texture_kind kind, uint32_t *out)
{
    uint32_t *known = &g->image_index[i * PRT_TEXTURE_N_KIND + (size_t)kind];
    const cJSON *image =
        cJSON_GetArrayItem(cJSON_GetObjectItemCaseSensitive(g->json, "images"), (int)i);
    char name[200];
    int status = PRT_OK;
    *out = UINT32_MAX;
    if (*known == UINT32_MAX) {
        image_name(g, image, i, name);
        status = load(g, image, name, kind, out);
        *known = *out == UINT32_MAX ? (uint32_t)FAILED : *out;
    }
    if (!status && *known != (uint32_t)FAILED) *out = *known;
    return status;
}
