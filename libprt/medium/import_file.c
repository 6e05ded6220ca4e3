// SPDX-License-Identifier: MIT
// Files of other programs' materials, parsed in an isolated child.
#include "import.h"

#include <stdio.h>
#include <unistd.h>

// FILE or FILE#NAME.
struct request {
    char path[4096];
    const char *name; // NULL: none given
    struct prt_blob file;
    double mm_per_unit;
    bool all;
};

// Two passes: the first finds the material, the second warns of its losses alone.
static int read_one(const struct prt_context *ctx, const struct request *r,
                    struct prt_import **out, unsigned *n_out)
{
    struct prt_context quiet = *ctx;
    struct prt_import *item;
    const struct prt_import *chosen;
    unsigned n;
    quiet.log = prt_log_none;
    int status = prt_material_import(&quiet, r->path, r->file.bytes, r->file.size,
                                     r->mm_per_unit, &item, &n);
    if (status) // again, for its message
        return prt_material_import(ctx, r->path, r->file.bytes, r->file.size, r->mm_per_unit,
                                   out, n_out);
    status = prt_import_choose(ctx, r->path, item, n, r->name, &chosen);
    struct import_list list = {.ctx = ctx, .what = r->path, .mm_per_unit = r->mm_per_unit};
    if (!status) {
        list.only = chosen->name;
        status = prt_import_text(&list, r->file.bytes, r->file.size);
    }
    if (!status) { // the chosen one stands first
        list.item[0] = *chosen;
        *out = list.item;
        *n_out = 1;
    } else {
        prt_free(list.item);
    }
    prt_free(item);
    return status;
}

static int parse(const struct prt_context *ctx, void *arg, struct prt_blob *out)
{
    const struct request *r = arg;
    struct prt_import *item;
    unsigned n;
    int status = r->all ? prt_material_import(ctx, r->path, r->file.bytes, r->file.size,
                                              r->mm_per_unit, &item, &n)
                        : read_one(ctx, r, &item, &n);
    if (!status) *out = (struct prt_blob){item, n * sizeof *item};
    return status;
}

// What a child sent is checked like a file.
static int accept(const struct prt_context *ctx, const struct request *r,
                  const struct prt_blob *blob)
{
    struct prt_import *item = blob->bytes;
    size_t n = blob->size / sizeof *item;
    bool good = n > 0 && n <= IMPORT_MAX_MEDIA && blob->size == n * sizeof *item;
    for (size_t i = 0; good && i < n; i++)
        good = memchr(item[i].name, 0, sizeof item->name) &&
               memchr(item[i].format, 0, sizeof item->format) &&
               memchr(item[i].why_not, 0, sizeof item->why_not) &&
               (!item[i].has_medium || !prt_material_check(ctx, &item[i].material));
    return good ? PRT_OK : prt_fail(ctx, PRT_FORMAT, "%s: cannot be read", r->path);
}

static int import_isolated(const struct prt_context *ctx, struct request *r,
                           struct prt_import **out, unsigned *n_out)
{
    struct prt_isolate_limits limits = {.memory_bytes = 256 << 20, .seconds = 20};
    struct prt_blob blob = {NULL, 0};
    int status = prt_isolate(ctx, r->path, &limits, parse, r, &blob);
    if (!status && (status = accept(ctx, r, &blob))) prt_free(blob.bytes);
    if (status) return status;
    *out = blob.bytes;
    *n_out = (unsigned)(blob.size / sizeof **out);
    return PRT_OK;
}

// FILE#NAME is split where there is no file of the whole name.
static bool split(const char *text, struct request *r)
{
    size_t n = strlen(text);
    const char *hash = access(text, F_OK) ? strrchr(text, '#') : NULL;
    if (hash) n = (size_t)(hash - text);
    if (n >= sizeof r->path) return false;
    memcpy(r->path, text, n);
    r->path[n] = 0;
    r->name = hash ? hash + 1 : NULL;
    return !access(r->path, F_OK);
}

int prt_material_import_file(const struct prt_context *ctx, const char *text,
                             double mm_per_unit, struct prt_import **out, unsigned *n_out)
{
    struct request r = {.mm_per_unit = mm_per_unit};
    if (!split(text, &r)) return prt_fail(ctx, PRT_IO, "%s: no such file", text);
    int status = prt_read_file(ctx, r.path, IMPORT_MAX_BYTES, &r.file);
    if (status) return status;
    r.all = !r.name;
    status = import_isolated(ctx, &r, out, n_out);
    prt_free(r.file.bytes);
    return status;
}

// Text of none of the known kinds is taken for prt's own JSON, whose reader names its faults.
static bool is_foreign(const char *text, size_t n)
{
    const char *at = text + strspn(text, " \t\r\n");
    if (!strncmp(text, "\xef\xbb\xbf", 3)) at = text + 3;
    if (*at == '<' || (n > 1 && (*at == '\xff' || *at == '\xfe'))) return true;
    if (*at != '{') return strstr(at, "MakeNamed") || strstr(at, "Material \"");
    cJSON *object = cJSON_ParseWithLength(text, n);
    bool found = !cJSON_HasObjectItem(object, "sigma_s_prime") &&
                 !cJSON_HasObjectItem(object, "profile") && prt_import_is_blender(object);
    cJSON_Delete(object);
    return found;
}

bool prt_material_is_foreign(const char *name_or_file)
{
    struct request r = {.all = false};
    struct prt_blob file;
    if (!split(name_or_file, &r)) return false;
    struct prt_context quiet;
    prt_context_init(&quiet);
    quiet.log = prt_log_none;
    if (r.name) return true;
    if (prt_read_file(&quiet, r.path, IMPORT_MAX_BYTES, &file)) return false;
    bool foreign = is_foreign(file.bytes, file.size);
    prt_free(file.bytes);
    return foreign;
}

// The one medium of r->file, which is freed.
static int load_one(const struct prt_context *ctx, struct request *r, struct prt_material *out)
{
    struct prt_import *item;
    unsigned n;
    int status = import_isolated(ctx, r, &item, &n);
    prt_free(r->file.bytes);
    if (status) return status;
    *out = item->material;
    prt_free(item);
    return PRT_OK;
}

int prt_material_load_foreign(const struct prt_context *ctx, const char *text,
                              struct prt_material *out)
{
    struct request r = {.all = false};
    if (!split(text, &r)) return prt_fail(ctx, PRT_IO, "%s: no such file", text);
    int status = prt_read_file(ctx, r.path, IMPORT_MAX_BYTES, &r.file);
    return status ? status : load_one(ctx, &r, out);
}

int prt_material_load_foreign_fd(const struct prt_context *ctx, const char *what, int fd,
                                 const char *name, struct prt_material *out)
{
    struct request r = {.name = name && *name ? name : NULL};
    snprintf(r.path, sizeof r.path, "%s", what);
    int status = prt_read_fd(ctx, what, fd, IMPORT_MAX_BYTES, &r.file);
    return status ? status : load_one(ctx, &r, out);
}
