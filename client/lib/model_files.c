// SPDX-License-Identifier: MIT
// A model's file and the files that it names, uploaded under the names that it uses: buffers
// and images of a .gltf, the material library of an .obj and the images of that.
#include "internal.h"

#include <cjson/cJSON.h>
#include <limits.h>
#include <stdio.h>
#include <strings.h>
#include <sys/stat.h>

enum { MAX_FILE = 64, MAX_NAME = 200 }; // as the daemon has them

struct bundle {
    size_t n;
    struct relight_file file[MAX_FILE];
    char *name[MAX_FILE];
    char hash[MAX_FILE][65];
};

static int no_memory(struct relight_error *error)
{
    return relight_fail(error, RELIGHT_E_NO_MEMORY, "", "not enough memory");
}

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
    if (!(bundle->name[i] = strdup(name))) return no_memory(error);
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

// ---- the files that a model names

struct sender {
    struct relight_client *client;
    struct bundle *bundle;
    const char *path; // of the model
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

// Whether the file `name` beside the model, at full, can be sent.
static bool can_send(const struct sender *s, const char *name, const char *full)
{
    struct stat st;
    return is_inside(s->folder, full, name) && is_plain(name) && !stat(full, &st) &&
           S_ISREG(st.st_mode) && st.st_size;
}

// An image that is not there, or not in the folder, is left out: the daemon draws the model
// without it and warns, as prt does.
static int add_image(const struct sender *s, const char *name, const char *full,
                     struct relight_error *error)
{
    if (!can_send(s, name, full)) return 0;
    return bundle_add(s->client, s->bundle, full, name, s->fn, s->user, error);
}

// ---- in a .gltf

static int add_named(const struct sender *s, const cJSON *item, bool image,
                     struct relight_error *error)
{
    const char *uri = cJSON_GetStringValue(cJSON_GetObjectItemCaseSensitive(item, "uri"));
    if (!uri || !strncasecmp(uri, "data:", 5)) return 0;
    char *name = name_of_uri(uri), *full = NULL;
    int status = 0;
    if (!name || asprintf(&full, "%s%s", s->folder, name) < 0) {
        full = NULL;
        status = no_memory(error);
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

static int add_gltf_files(const struct sender *s, const struct relight_content *file,
                          bool images, struct relight_error *error)
{
    cJSON *json = cJSON_ParseWithLength(file->bytes, file->size);
    if (!json) return relight_fail(error, RELIGHT_E_FILE, "", "%s: is not JSON", s->path);
    int status = add_list(s, json, "buffers", error);
    if (!status && images) status = add_list(s, json, "images", error);
    cJSON_Delete(json);
    return status;
}

// ---- in an .obj and its .mtl

// The text behind the word at the beginning of a line of n bytes, in memory of its own without
// blanks at its ends; NULL: another word, or no memory.
static char *text_behind(const char *line, size_t n, const char *word)
{
    const size_t length = strlen(word);
    while (n && strchr(" \t\r", line[n - 1])) n--;
    while (n && (*line == ' ' || *line == '\t')) line++, n--;
    if (n <= length || memcmp(line, word, length) || !strchr(" \t", line[length])) return NULL;
    line += length, n -= length;
    while (n && (*line == ' ' || *line == '\t')) line++, n--;
    return strndup(line, n);
}

static int add_beside(const struct sender *s, const char *name, struct relight_error *error)
{
    char *full = NULL;
    if (asprintf(&full, "%s%s", s->folder, name) < 0) return no_memory(error);
    int status = bundle_has(s->bundle, name) ? 0 : add_image(s, name, full, error);
    free(full);
    return status;
}

static bool is_beside(const struct sender *s, const char *name)
{
    char *full = NULL;
    if (asprintf(&full, "%s%s", s->folder, name) < 0) return false;
    bool found = can_send(s, name, full);
    free(full);
    return found;
}

// The image of a line of a material library, whose name may hold blanks and has options before
// it: the first of its words from which on the line names a file.
static int add_map(const struct sender *s, char *text, struct relight_error *error)
{
    for (char *c = text; *c; c++)
        if (*c == '\\') *c = '/';
    for (char *at = text; *at; at += strspn(at, " \t")) {
        const char *last = strrchr(at, '/');
        const char *name = *at == '/' || strchr(at, ':') ? last ? last + 1 : "" : at;
        if (is_beside(s, name)) return add_beside(s, name, error);
        at += strcspn(at, " \t");
    }
    return 0;
}

// Calls add for each line that begins with one of the words.
static int for_lines(const struct sender *s, const struct relight_content *file,
                     const char *const word[],
                     int (*add)(const struct sender *, char *, struct relight_error *),
                     struct relight_error *error)
{
    const char *at = file->bytes, *stop = at + file->size;
    int status = 0;
    for (const char *end; at < stop && !status; at = end + 1) {
        end = memchr(at, '\n', (size_t)(stop - at));
        if (!end) end = stop;
        for (int i = 0; word[i] && !status; i++) {
            char *text = text_behind(at, (size_t)(end - at), word[i]);
            if (text) status = add(s, text, error);
            free(text);
        }
    }
    return status;
}

static int add_library(const struct sender *s, char *name, struct relight_error *error)
{
    static const char *const maps[] = {"map_Kd", "map_Ke",   "map_Pr", "norm",
                                       "map_Kn", "map_Bump", "bump",   NULL};
    struct relight_content file;
    char *full = NULL;
    if (!is_beside(s, name)) return 0;
    int status = add_beside(s, name, error);
    if (!status && asprintf(&full, "%s%s", s->folder, name) < 0) {
        full = NULL;
        status = no_memory(error);
    }
    if (!status) status = relight_read_file(full, 0, &file, error);
    free(full);
    if (status) return status;
    status = for_lines(s, &file, maps, add_map, error);
    free(file.bytes);
    return status;
}

// A line's libraries: one name that may hold blanks, or several names between blanks.
static int add_libraries(const struct sender *s, char *line, struct relight_error *error)
{
    int status = 0;
    if (is_beside(s, line)) return add_library(s, line, error);
    for (char *name; !status && (name = strsep(&line, " \t"));)
        if (*name) status = add_library(s, name, error);
    return status;
}

static int add_obj_files(const struct sender *s, const struct relight_content *file,
                         struct relight_error *error)
{
    static const char *const libraries[] = {"mtllib", NULL};
    return for_lines(s, file, libraries, add_libraries, error);
}

// ---- a model and its files

static bool ends_in(const char *path, const char *ending)
{
    const size_t n = strlen(path), m = strlen(ending);
    return n > m && !strcasecmp(path + n - m, ending);
}

static int add_files(struct sender *s, bool images, struct relight_error *error)
{
    const bool gltf = ends_in(s->path, ".gltf");
    if (!gltf && !(images && ends_in(s->path, ".obj"))) return 0;
    struct relight_content file;
    int status = relight_read_file(s->path, 0, &file, error);
    if (status) return status;
    bool slash = relight_base_name(s->path) > s->path;
    if (asprintf(&s->folder, "%.*s", slash ? (int)(relight_base_name(s->path) - s->path) : 2,
                 slash ? s->path : "./") < 0) {
        s->folder = NULL;
        status = no_memory(error);
    }
    if (!status)
        status =
            gltf ? add_gltf_files(s, &file, images, error) : add_obj_files(s, &file, error);
    free(s->folder);
    free(file.bytes);
    return status;
}

// Uploads a model's file and the files that it names; images only where asked for. The caller
// frees *out.
static int upload_bundle(struct relight_client *client, const char *path, bool images,
                         relight_progress_fn fn, void *user, struct bundle **out,
                         struct relight_error *error)
{
    struct bundle *bundle = calloc(1, sizeof *bundle);
    if (!bundle) return no_memory(error);
    struct sender sender = {client, bundle, path, NULL, fn, user};
    int status = bundle_add(client, bundle, path, relight_base_name(path), fn, user, error);
    if (!status) status = add_files(&sender, images, error);
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
    if (!status && (!ref || !refs)) status = no_memory(error);
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
