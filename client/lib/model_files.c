// SPDX-License-Identifier: MIT
// A model's file and the files that it names, uploaded under the names that it uses: buffers
// and images of a .gltf.
#include "internal.h"

#include <cjson/cJSON.h>
#include <limits.h>
#include <stdio.h>
#include <strings.h>
#include <sys/mman.h>
#include <sys/stat.h>

enum { MAX_FILE = 64, MAX_NAME = 200 }; // as the daemon has them

struct bundle {
    size_t n;
    struct relight_file file[MAX_FILE];
    char *name[MAX_FILE];
    char hash[MAX_FILE][65];
};

static int bundle_add(struct relight_client *client, struct bundle *bundle, const char *path,
                      const char *name, relight_progress_fn fn, void *user,
                      struct relight_error *error)
{
    if (bundle->n == MAX_FILE)
        return relight_fail(error, RELIGHT_E_LIMIT, "pack it as .glb",
                            "%s: names more than %d files", path, MAX_FILE);
    size_t i = bundle->n;
    int status = relight_upload_file(client, path, fn, user, bundle->hash[i], NULL, error);
    if (status) return status;
    if (!(bundle->name[i] = strdup(name)))
        return relight_fail(error, RELIGHT_E_NO_MEMORY, "", "not enough memory");
    bundle->file[i] = (struct relight_file){bundle->name[i], bundle->hash[i]};
    bundle->n++;
    return 0;
}

static bool bundle_has(const struct bundle *bundle, const char *name)
{
    for (size_t i = 0; i < bundle->n; i++)
        if (!strcmp(bundle->name[i], name)) return true;
    return false;
}

// ---- names in a .gltf

static int hex_digit(char c)
{
    return c >= '0' && c <= '9'   ? c - '0'
           : c >= 'a' && c <= 'f' ? c - 'a' + 10
           : c >= 'A' && c <= 'F' ? c - 'A' + 10
                                  : -1;
}

static void unescape_uri(char *text)
{
    char *to = text;
    for (const char *at = text; *at; to++) {
        if (*at == '%' && hex_digit(at[1]) >= 0 && hex_digit(at[2]) >= 0) {
            *to = (char)(hex_digit(at[1]) * 16 + hex_digit(at[2]));
            at += 3;
        } else {
            *to = *at++;
        }
    }
    *to = 0;
}

// The file name of a URI, without "./" at its beginning; NULL without memory.
static char *name_of_uri(const char *uri)
{
    char *name = strdup(uri);
    if (!name) return NULL;
    unescape_uri(name);
    while (!strncmp(name, "./", 2)) memmove(name, name + 2, strlen(name + 2) + 1);
    return name;
}

static bool leads_up(const char *name)
{
    for (const char *p = name; p; p = strchr(p, '/')) {
        p += *p == '/';
        if (!strncmp(p, "..", 2) && (p[2] == '/' || !p[2])) return true;
    }
    return false;
}

// A downloaded model must not make us send files from elsewhere: neither by its name nor by a
// link. full: the file `name` beside the model.
static bool is_inside(const char *folder, const char *full, const char *name)
{
    char base[PATH_MAX], real[PATH_MAX];
    if (!*name || *name == '/' || leads_up(name)) return false;
    if (!realpath(folder, base) || !realpath(full, real)) return true; // there is no such file
    size_t n = strlen(base);
    return !strncmp(real, base, n) && (real[n] == '/' || !strcmp(base, "/"));
}

// Whether the daemon takes a file of this name.
static bool is_plain(const char *name)
{
    for (const char *p = name; *p; p++)
        if ((unsigned char)*p < 32 || *p == 127 || *p == '\\' ||
            (*p == '/' && (p[1] == '.' || p[1] == '/')))
            return false;
    return *name != '.' && strlen(name) <= MAX_NAME;
}

// ---- the files that a .gltf names

struct sender {
    struct relight_client *client;
    struct bundle *bundle;
    const char *path; // of the .gltf
    char *folder;     // its own
    relight_progress_fn fn;
    void *user;
};

// A file that the model needs to be read.
static int add_buffer(const struct sender *s, const char *name, const char *full,
                      struct relight_error *error)
{
    if (is_inside(s->folder, full, name))
        return bundle_add(s->client, s->bundle, full, name, s->fn, s->user, error);
    return relight_fail(error, RELIGHT_E_FILE, "move the buffer beside the model",
                        "%s: buffer '%s' lies outside the model's folder", s->path, name);
}

// An image that is not there, or not in the folder, is left out: the daemon draws the model
// without it and warns, as prt does.
static int add_image(const struct sender *s, const char *name, const char *full,
                     struct relight_error *error)
{
    struct stat st;
    if (!is_inside(s->folder, full, name) || !is_plain(name) || stat(full, &st) ||
        !S_ISREG(st.st_mode) || !st.st_size)
        return 0;
    return bundle_add(s->client, s->bundle, full, name, s->fn, s->user, error);
}

static int add_named(const struct sender *s, const cJSON *item, bool image,
                     struct relight_error *error)
{
    const char *uri = cJSON_GetStringValue(cJSON_GetObjectItemCaseSensitive(item, "uri"));
    if (!uri || !strncasecmp(uri, "data:", 5)) return 0;
    char *name = name_of_uri(uri), *full = NULL;
    int status = 0;
    if (!name || asprintf(&full, "%s%s", s->folder, name) < 0) {
        full = NULL;
        status = relight_fail(error, RELIGHT_E_NO_MEMORY, "", "not enough memory");
    } else if (!bundle_has(s->bundle, name)) {
        status = (image ? add_image : add_buffer)(s, name, full, error);
    }
    free(name);
    free(full);
    return status;
}

static int add_list(const struct sender *s, const cJSON *gltf, const char *list,
                    struct relight_error *error)
{
    const cJSON *item;
    int status = 0;
    cJSON_ArrayForEach(item, cJSON_GetObjectItemCaseSensitive(gltf, list))
    {
        status = add_named(s, item, !strcmp(list, "images"), error);
        if (status) break;
    }
    return status;
}

static int add_files(struct sender *s, bool images, struct relight_error *error)
{
    struct relight_mapping map;
    int status = relight_map_file(s->path, &map, error);
    if (status) return status;
    cJSON *json = cJSON_ParseWithLength(map.bytes, map.size);
    munmap(map.bytes, map.size);
    if (!json) return relight_fail(error, RELIGHT_E_FILE, "", "%s: is not JSON", s->path);
    bool slash = relight_base_name(s->path) > s->path;
    if (asprintf(&s->folder, "%.*s", slash ? (int)(relight_base_name(s->path) - s->path) : 2,
                 slash ? s->path : "./") < 0) {
        s->folder = NULL;
        status = relight_fail(error, RELIGHT_E_NO_MEMORY, "", "not enough memory");
    }
    if (!status) status = add_list(s, json, "buffers", error);
    if (!status && images) status = add_list(s, json, "images", error);
    free(s->folder);
    cJSON_Delete(json);
    return status;
}

// Uploads a model's file and what it refers to, its images where they are wanted; the caller
// frees *out.
static int upload_bundle(struct relight_client *client, const char *path, bool images,
                         relight_progress_fn fn, void *user, struct bundle **out,
                         struct relight_error *error)
{
    struct bundle *bundle = calloc(1, sizeof *bundle);
    if (!bundle) return relight_fail(error, RELIGHT_E_NO_MEMORY, "", "not enough memory");
    struct sender sender = {client, bundle, path, NULL, fn, user};
    size_t n = strlen(path);
    bool gltf = n > 5 && !strcasecmp(path + n - 5, ".gltf");
    int status = bundle_add(client, bundle, path, relight_base_name(path), fn, user, error);
    if (!status && gltf) status = add_files(&sender, images, error);
    *out = bundle;
    return status;
}

static void free_bundle(struct bundle *bundle)
{
    for (size_t i = 0; bundle && i < bundle->n; i++) free(bundle->name[i]);
    free(bundle);
}

int relight_load_file(struct relight_client *client, const char *path,
                      const struct relight_load *load, relight_progress_fn fn, void *user,
                      struct relight_loaded *out, struct relight_error *error)
{
    struct bundle *bundle = NULL;
    int status = upload_bundle(client, path, true, fn, user, &bundle, error);
    if (!status) {
        struct relight_load whole = *load;
        whole.n_file = bundle->n;
        whole.files = bundle->file;
        whole.path = NULL;
        status = relight_load(client, &whole, out, error);
    }
    free_bundle(bundle);
    return status;
}

int relight_put_animation(struct relight_client *client, const char *model, const char *path,
                          const char *animation, double time_s, bool up_z, char pose[65],
                          struct relight_error *error)
{
    Relight__PutPoseRequest m = RELIGHT__PUT_POSE_REQUEST__INIT;
    struct answer *answer;
    struct bundle *bundle = NULL;
    int status = upload_bundle(client, path, false, NULL, NULL, &bundle, error);
    const size_t n = status ? 0 : bundle->n;
    Relight__FileRef *ref = calloc(n + 1, sizeof *ref), **refs = calloc(n + 1, sizeof *refs);
    if (!status && (!ref || !refs))
        status = relight_fail(error, RELIGHT_E_NO_MEMORY, "", "not enough memory");
    for (size_t i = 0; !status && i < n; i++) {
        relight__file_ref__init(refs[i] = ref + i);
        ref[i].name = relight_text(bundle->file[i].name);
        ref[i].blob = relight_text(bundle->file[i].hash);
    }
    m.model = relight_text(model);
    m.animation = relight_text(animation);
    m.time_s = (float)time_s;
    m.up_z = up_z;
    m.n_files = n;
    m.files = refs;
    if (!status) status = relight_call(client, RELIGHT_TYPE_PUT_POSE, &m.base, &answer, error);
    if (!status) {
        snprintf(pose, 65, "%s", ((Relight__PutPoseAnswer *)answer->message)->pose);
        relight_answer_free(answer);
    }
    free_bundle(bundle);
    free(ref);
    free(refs);
    return status;
}
