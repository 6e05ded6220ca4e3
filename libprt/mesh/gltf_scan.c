// SPDX-License-Identifier: MIT
// One pass over a glTF's JSON before tinygltf parses it. The parser recurses, so the depth is
// bounded here. It reads -4 and 2^32 as 0, so indices, offsets and counts are checked here.
// Parts that tinygltf is not to read (images, animations, extras) are blanked, so that they
// cost no time and cannot fail; gltf_camera.c reads the cameras before. Invalid JSON may pass:
// the parser refuses it.
#include "gltf.h"

#include <ctype.h>
#include <string.h>

enum { MAX_DEPTH = 200 }; // chosen, not measured

struct span {
    const char *at; // NULL: none
    size_t n;
};

struct scan {
    struct gltf *g;
    char *json;
    size_t n, i, depth;
    struct span last, key;      // the last string; the key of the value that follows
    size_t blank_at, blank;     // start and depth of the part to blank; 0: none
    size_t list;                // depth of an array of node indices; 0: none
    bool in_cameras;            // the part to blank is the file's cameras
    bool in_buffers, has_bytes; // inside "buffers"; the current object has an external file
    uint64_t length;            // its byteLength
};

static bool is(struct span s, const char *text)
{
    return s.at && s.n == strlen(text) && !memcmp(s.at, text, s.n);
}

static bool one_of(struct span s, const char *const *list)
{
    for (; *list; list++)
        if (is(s, *list)) return true;
    return false;
}

static const char *const sizes[] = {"byteOffset", "byteLength", "count", NULL};
static const char *const numbers[] = {
    "byteStride", "bufferView", "buffer",     "componentType", "POSITION",   "NORMAL",
    "COLOR_0",    "TEXCOORD_0", "TEXCOORD_1", "TEXCOORD_2",    "TEXCOORD_3", "TEXCOORD_4",
    "TEXCOORD_5", "TEXCOORD_6", "TEXCOORD_7", "indices",       "material",   "mesh",
    "mode",       "scene",      NULL};
static const char *const unread[] = {"images",  "textures", "samplers", "animations",
                                     "cameras", "skins",    NULL};

static int not_whole(const struct scan *s, struct span key)
{
    return prt_gltf_bad(s->g, "near byte %zu of its JSON: %.*s is not a whole number in range",
                        s->i, (int)(key.n > 40 ? 40 : key.n), key.at);
}

// A number's first character: sizes are at most 2^53, the others fit an int.
static int number(struct scan *s)
{
    bool size = one_of(s->key, sizes), other = one_of(s->key, numbers) || s->list == s->depth;
    struct span key = s->key.at ? s->key : (struct span){"a node", 6};
    uint64_t x = 0;
    if (!size && !other) return PRT_OK;
    size_t i = s->i;
    for (; i < s->n && isdigit((unsigned char)s->json[i]) && x <= 1ull << 53; i++)
        x = x * 10 + (uint64_t)(s->json[i] - '0');
    if (i == s->i || x > (size ? 1ull << 53 : INT32_MAX) ||
        (i < s->n && strchr(".eE+-", s->json[i])))
        return not_whole(s, key);
    if (s->in_buffers && s->depth == 3 && is(s->key, "byteLength")) s->length = x;
    s->i = i - 1;
    return PRT_OK;
}

static int string(struct scan *s)
{
    size_t begin = s->i + 1;
    for (s->i++; s->i < s->n && s->json[s->i] != '"'; s->i++)
        if (s->json[s->i] == '\\' && ++s->i >= s->n) break;
    size_t end = s->i < s->n ? s->i : s->n;
    if (memchr(s->json + begin, 0, end - begin))
        return prt_gltf_bad(s->g, "a zero byte inside the glTF JSON");
    s->last = (struct span){s->json + begin, end - begin};
    if (s->key.at && !s->blank && one_of(s->key, sizes)) return not_whole(s, s->key);
    if (s->in_buffers && s->depth == 3 && is(s->key, "uri"))
        s->has_bytes = s->last.n && (s->last.n < 5 || memcmp(s->last.at, "data:", 5));
    s->key.at = NULL;
    return PRT_OK;
}

static int open_value(struct scan *s)
{
    if (++s->depth > MAX_DEPTH)
        return prt_gltf_bad(s->g, "the glTF JSON nests deeper than %d levels", MAX_DEPTH);
    bool array = s->json[s->i] == '[';
    if (!s->blank &&
        (is(s->key, "extras") || (array && s->depth == 2 && one_of(s->key, unread)))) {
        s->blank = s->depth;
        s->blank_at = s->i + 1;
        s->in_cameras = s->depth == 2 && is(s->key, "cameras");
    }
    if (array && (is(s->key, "children") || (s->depth > 2 && is(s->key, "nodes"))))
        s->list = s->depth;
    if (s->depth == 2) s->in_buffers = array && is(s->key, "buffers");
    if (s->depth == 3) s->has_bytes = false, s->length = UINT64_MAX;
    s->key.at = NULL;
    return PRT_OK;
}

static int close_value(struct scan *s)
{
    if (s->blank && s->blank == s->depth) {
        int status = s->in_cameras ? prt_gltf_cameras(s->g, s->json + s->blank_at - 1,
                                                      s->i + 2 - s->blank_at)
                                   : PRT_OK;
        if (status) return status;
        memset(s->json + s->blank_at, ' ', s->i - s->blank_at);
        s->blank = 0;
    }
    if (s->list == s->depth) s->list = 0;
    if (s->in_buffers && s->depth == 3 && s->has_bytes) {
        struct gltf *g = s->g;
        if (g->n_external % 64 == 0) {
            uint64_t *more = prt_gltf_own(g, (g->n_external + 64) * sizeof *more);
            if (!more) return prt_gltf_no_memory(g);
            if (g->n_external) memcpy(more, g->external, g->n_external * sizeof *more);
            g->external = more;
        }
        g->external[g->n_external++] = s->length;
    }
    if (s->depth) s->depth--;
    s->key.at = NULL;
    return PRT_OK;
}

static int step(struct scan *s)
{
    char c = s->json[s->i];
    switch (c) {
    case 0:
        return prt_gltf_bad(s->g, "a zero byte inside the glTF JSON");
    case '"':
        return string(s);
    case '[':
    case '{':
        return open_value(s);
    case ']':
    case '}':
        return close_value(s);
    case ':':
        s->key = s->last;
        return PRT_OK;
    case ',':
        s->key.at = NULL;
        return PRT_OK;
    }
    if ((isdigit((unsigned char)c) || c == '-') && !s->blank && (s->key.at || s->list)) {
        int status = number(s);
        s->key.at = NULL;
        return status;
    }
    return PRT_OK;
}

int prt_gltf_scan(struct gltf *g, char *json, size_t n)
{
    struct scan s = {.g = g, .json = json, .n = n};
    int status = PRT_OK;
    for (; !status && s.i < n; s.i++) status = step(&s);
    return status;
}
