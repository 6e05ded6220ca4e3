// SPDX-License-Identifier: MIT
// Other programs' materials: which reader takes a text, the list it fills, the choice by name.
#include "import.h"

#include <ctype.h>
#include <stdarg.h>
#include <strings.h>

// Names come from files and go to terminals.
static void copy_name(char *to, size_t size, const char *from)
{
    size_t n = 0;
    for (; from[n] && n + 1 < size; n++)
        to[n] = (unsigned char)from[n] < 32 || from[n] == 127 ? '?' : from[n];
    while (n && ((unsigned char)from[n] & 0xc0) == 0x80) n--; // no cut UTF-8 character
    to[n] = 0;
}

struct prt_import *prt_import_add(struct import_list *list, const char *name)
{
    if (list->n == IMPORT_MAX_MEDIA) {
        (void)prt_fail(list->ctx, PRT_LIMIT, "%s: has more than %d materials", list->what,
                       IMPORT_MAX_MEDIA);
        return NULL;
    }
    if (list->n == list->capacity) {
        unsigned room = list->capacity ? 2 * list->capacity : 4;
        struct prt_import *grown = prt_alloc(room, sizeof *grown);
        if (!grown) {
            (void)prt_fail(list->ctx, PRT_NOMEM, "%s: no memory", list->what);
            return NULL;
        }
        if (list->n) memcpy(grown, list->item, list->n * sizeof *grown);
        prt_free(list->item);
        list->item = grown;
        list->capacity = room;
    }
    struct prt_import *item = &list->item[list->n++];
    *item = (struct prt_import){.material = {.eta = 1.5f, .roughness = 0.3f}};
    copy_name(item->name, sizeof item->name, name[0] ? name : "material");
    copy_name(item->material.name, sizeof item->material.name, item->name);
    return item;
}

void prt_import_warn(const struct import_list *list, const struct prt_import *item,
                     const char *fmt, ...)
{
    char text[700];
    va_list args;
    if (list->only && strcmp(list->only, item->name)) return;
    va_start(args, fmt);
    vsnprintf(text, sizeof text, fmt, args);
    va_end(args);
    prt_log(list->ctx, PRT_LOG_WARNING, "%s: %s: %s", list->what, item->name, text);
}

void prt_import_none(struct prt_import *item, const char *fmt, ...)
{
    va_list args;
    va_start(args, fmt);
    vsnprintf(item->why_not, sizeof item->why_not, fmt, args);
    va_end(args);
}

static int read_json(struct import_list *list, const char *text, size_t n)
{
    cJSON *object = cJSON_ParseWithLength(text, n);
    int status =
        !object ? prt_fail(list->ctx, PRT_FORMAT, "%s: not valid JSON", list->what)
        : prt_import_is_blender(object)
            ? prt_import_blender(list, object)
            : prt_fail(list->ctx, PRT_FORMAT,
                       "%s: JSON without a Principled shader's inputs (\"Base Color\", "
                       "\"Subsurface Weight\", …)",
                       list->what);
    cJSON_Delete(object);
    return status;
}

int prt_import_text(struct import_list *list, const char *text, size_t n)
{
    const char *at = text + strspn(text, " \t\r\n");
    bool utf16 = n > 1 && ((text[0] == '\xff' && text[1] == '\xfe') ||
                           (text[0] == '\xfe' && text[1] == '\xff'));
    if (!strncmp(text, "\xef\xbb\xbf", 3)) at = text + 3;
    if (n > IMPORT_MAX_BYTES)
        return prt_fail(list->ctx, PRT_LIMIT, "%s: has %zu bytes, at most %d are read",
                        list->what, n, IMPORT_MAX_BYTES);
    if (*at == '<' || utf16) return prt_import_mtlx(list, text, n);
    if (*at == '{') return read_json(list, text, n);
    if (*at == '#' || isalpha((unsigned char)*at)) return prt_import_pbrt(list, text);
    return prt_fail(list->ctx, PRT_FORMAT,
                    "%s: neither MaterialX, a material's JSON nor a pbrt scene", list->what);
}

int prt_material_import(const struct prt_context *ctx, const char *what, const char *text,
                        size_t n, double mm_per_unit, struct prt_import **out, unsigned *n_out)
{
    struct import_list list = {.ctx = ctx, .what = what, .mm_per_unit = mm_per_unit};
    int status = prt_import_text(&list, text, n);
    for (unsigned i = 0; i < list.n && !status; i++)
        if (list.item[i].has_medium) status = prt_material_check(ctx, &list.item[i].material);
    if (status) {
        prt_free(list.item);
        return status;
    }
    *out = list.item;
    *n_out = list.n;
    return PRT_OK;
}

static int name_error(const struct prt_context *ctx, const char *what,
                      const struct prt_import *item, unsigned n, const char *text,
                      const char *remedy)
{
    char list[256] = "";
    size_t used = 0;
    for (unsigned i = 0; i < n && used < sizeof list; i++)
        if (item[i].has_medium)
            used += (size_t)snprintf(list + used, sizeof list - used, "%s%s", used ? ", " : "",
                                     item[i].name);
    return prt_fail(ctx, PRT_ARG, "%s: %s%s%s; its media: %s", what, text,
                    remedy[0] ? ": " : "", remedy, list[0] ? list : "none");
}

int prt_import_choose(const struct prt_context *ctx, const char *what,
                      const struct prt_import *item, unsigned n, const char *name,
                      const struct prt_import **out)
{
    const char *names[IMPORT_MAX_MEDIA];
    char remedy[400] = "";
    unsigned media = 0;
    int found = -1;
    for (unsigned i = 0; i < n && i < IMPORT_MAX_MEDIA; i++) {
        names[i] = item[i].name;
        if (item[i].has_medium && !media++ && !name) found = (int)i;
    }
    if (name && (found = prt_name_choose(name, names, n, remedy, sizeof remedy)) < 0)
        return name_error(ctx, what, item, n, "has no such material", remedy);
    if (!name && media > 1)
        return name_error(ctx, what, item, n, "has several media, choose one as FILE#NAME", "");
    if (!name && !media && n == 1) found = 0;
    if (found < 0) return name_error(ctx, what, item, n, "no material in it has a medium", "");
    if (!item[found].has_medium)
        return prt_fail(ctx, PRT_ARG, "%s: %s gives no medium: %s", what, item[found].name,
                        item[found].why_not);
    *out = &item[found];
    return PRT_OK;
}
