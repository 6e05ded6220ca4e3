// SPDX-License-Identifier: MIT
// The listing of the models folder: files beside folders NAME/VERSION, each of which has one
// model and perhaps a model.json with the settings of its LOAD.
#include "store/import_file.h"

#include <cjson/cJSON.h>
#include <ctype.h>
#include <dirent.h>
#include <errno.h>
#include <fcntl.h>
#include <limits.h>
#include <stdarg.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>
#include <strings.h>
#include <unistd.h>

enum { MAX_LISTED = 4096, MAX_FOLDERS = 4096, MAX_SETTINGS = 64 << 10, MAX_FOLDER_NAME = 60 };

static bool is_model_file(const char *name, bool *prt)
{
    static const char *const ends[] = {".prt", ".glb", ".gltf", ".obj", ".ply", ".stl"};
    const char *dot = strrchr(name, '.');
    for (size_t i = 0; dot && i < sizeof ends / sizeof *ends; i++)
        if (!strcasecmp(dot, ends[i])) {
            *prt = i == 0;
            return true;
        }
    return false;
}

// The folder's next free entry; NULL when there are too many, or no memory.
static struct import_entry *next_entry(struct import_list *list)
{
    return list->n < MAX_LISTED ? &list->entry[list->n] : NULL;
}

// A scan that lacks memory or descriptors says nothing of the folder.
static void note_lack(struct import_list *list, int err)
{
    if (err == EMFILE || err == ENFILE || err == ENOMEM) list->readable = false;
}

// Adds the file of this path; false where it is no regular file below the folder.
static bool add_file(struct import_list *list, int root, const char *path, char *version)
{
    struct import_entry *e = next_entry(list);
    int fd = e ? import_open_below(root, path, O_PATH, e->stamp, &e->bytes) : -EMLINK;
    if (fd < 0) note_lack(list, -fd);
    if (fd < 0) return false;
    close(fd);
    (void)is_model_file(path, &e->prt);
    e->version = version;
    if (!(e->name = strdup(path))) return false;
    list->n++;
    return true;
}

static void add_fault(struct import_list *list, char *version, const char *fmt, ...)
{
    struct import_entry *e = next_entry(list);
    va_list args;
    if (!e || !(e->name = strdup(""))) {
        free(version);
        return;
    }
    va_start(args, fmt);
    vsnprintf(e->fault, sizeof e->fault, fmt, args);
    va_end(args);
    e->version = version;
    list->n++;
}

static DIR *open_folder(struct import_list *list, int root, const char *path)
{
    int fd = import_open_any_below(root, path, O_RDONLY | O_DIRECTORY);
    DIR *dir = fd < 0 ? NULL : fdopendir(fd);
    if (!dir) note_lack(list, fd < 0 ? -fd : errno);
    if (fd >= 0 && !dir) close(fd);
    return dir;
}

// NULL where there is none; "" where it cannot be read.
static char *read_settings(struct import_list *list, int root, const char *folder)
{
    char path[300], stamp[IMPORT_STAMP];
    uint64_t bytes;
    snprintf(path, sizeof path, "%s/model.json", folder);
    int fd = import_open_below(root, path, O_RDONLY | O_NONBLOCK, stamp, &bytes);
    if (fd < 0) {
        note_lack(list, -fd);
        return NULL;
    }
    char *text = bytes <= MAX_SETTINGS ? calloc(1, MAX_SETTINGS + 1) : strdup("");
    ssize_t n = text && *text == 0 && bytes <= MAX_SETTINGS ? read(fd, text, MAX_SETTINGS) : 0;
    if (text && n >= 0) text[n] = 0;
    if (!text) note_lack(list, ENOMEM);
    close(fd);
    return text;
}

// The file that model.json names as "path"; "" for none.
static void named_file(const char *settings, char out[256])
{
    cJSON *json = settings ? cJSON_Parse(settings) : NULL;
    const char *path = cJSON_GetStringValue(cJSON_GetObjectItemCaseSensitive(json, "path"));
    snprintf(out, 256, "%.255s", path ? path : "");
    cJSON_Delete(json);
}

// The model file of a version's folder: the .prt, or else the only one. The number of those
// among which it would have to be chosen.
static unsigned only_file(DIR *dir, char out[256])
{
    unsigned n_prt = 0, n_other = 0;
    char other[256] = "";
    for (struct dirent *d; (d = readdir(dir));) {
        bool prt = false;
        if (d->d_name[0] == '.' || !is_model_file(d->d_name, &prt)) continue;
        snprintf(prt ? out : other, 256, "%s", d->d_name);
        *(prt ? &n_prt : &n_other) += 1;
    }
    if (!n_prt) snprintf(out, 256, "%s", other);
    return n_prt ? n_prt : n_other;
}

static void list_version(struct import_list *list, int root, const char *name,
                         const char *number)
{
    char folder[160], file[256] = "", path[300], shown[256], *version = NULL;
    snprintf(folder, sizeof folder, "%s/%s", name, number);
    DIR *dir = open_folder(list, root, folder);
    if (!dir) return;
    name_printable(folder, shown, sizeof shown);
    version = strdup(shown);
    char *settings = read_settings(list, root, folder);
    if (!settings) settings = read_settings(list, root, name);
    named_file(settings, file);
    unsigned n = file[0] ? 1 : only_file(dir, file);
    snprintf(path, sizeof path, "%s/%s", folder, file);
    closedir(dir);
    if (!version) {
        free(settings);
    } else if (settings && !settings[0]) {
        add_fault(list, version, "model.json is empty, or longer than %d bytes", MAX_SETTINGS);
        free(settings);
    } else if (n > 1) {
        add_fault(list, version,
                  "%u model files: name one in its model.json, as {\"path\": \"FILE\"}", n);
        free(settings);
    } else if (n == 1 && add_file(list, root, path, version)) {
        list->entry[list->n - 1].settings = settings;
    } else {
        if (file[0]) add_fault(list, version, "%.100s is not in its folder", file);
        else free(version); // nothing was put into the folder yet
        free(settings);
    }
}

static bool is_folder_name(const char *name)
{
    return name[0] != '.' && strlen(name) <= MAX_FOLDER_NAME;
}

// 3, 1.2, 2024-06-01 or v3: folders of other names are no versions.
static bool is_version(const char *name)
{
    return is_folder_name(name) && isdigit((unsigned char)(name[0] == 'v' ? name[1] : name[0]));
}

static void list_versions(struct import_list *list, int root, const char *name, unsigned *n)
{
    DIR *dir = open_folder(list, root, name);
    for (struct dirent *d; dir && *n < MAX_FOLDERS && (d = readdir(dir));) {
        if (d->d_type == DT_REG || !is_version(d->d_name)) continue;
        ++*n;
        list_version(list, root, name, d->d_name);
    }
    if (dir) closedir(dir);
}

static void look_again(struct import_list *list, int root)
{
    for (size_t i = 0; i < list->n_known; i++) {
        struct import_known *k = &list->known[i];
        uint64_t bytes;
        int fd = import_open_below(root, k->name, O_PATH, k->stamp, &bytes);
        if (fd < 0) note_lack(list, -fd);
        if (fd < 0) k->stamp[0] = 0;
        else close(fd);
    }
}

static void list_entry(struct import_list *list, int root, const struct dirent *d,
                       unsigned *n_folder)
{
    bool prt;
    if (is_model_file(d->d_name, &prt) && add_file(list, root, d->d_name, NULL)) return;
    if (d->d_type != DT_REG && is_folder_name(d->d_name))
        list_versions(list, root, d->d_name, n_folder);
}

void import_list(const char *folder, struct import_list *list)
{
    unsigned n_folder = 0;
    DIR *dir = opendir(folder);
    list->entry = dir ? calloc(MAX_LISTED, sizeof *list->entry) : NULL;
    list->readable = list->entry != NULL;
    while (list->readable) {
        errno = 0;
        const struct dirent *d = readdir(dir);
        if (!d) {
            list->readable = errno == 0;
            break;
        }
        list_entry(list, dirfd(dir), d, &n_folder);
    }
    if (list->readable) look_again(list, dirfd(dir));
    if (dir) closedir(dir);
}

void import_list_finish(struct import_list *list)
{
    for (size_t i = 0; i < list->n; i++) {
        free(list->entry[i].name);
        free(list->entry[i].version);
        free(list->entry[i].settings);
    }
    for (size_t i = 0; i < list->n_known; i++) free(list->known[i].name);
    free(list->entry);
    free(list->known);
    *list = (struct import_list){0};
}
