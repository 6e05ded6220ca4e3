// SPDX-License-Identifier: MIT
// The files of the page in memory, and the answer to a request for one of them.
#include "net/page_files.h"

#include "core/log.h"
#include "net/routes.h"

#include <ctype.h>
#include <dirent.h>
#include <errno.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>
#include <strings.h>
#include <sys/stat.h>
#include <unistd.h>

#define XXH_INLINE_ALL
#include <xxhash.h>

// A page of this project has about 20 files and 3 MB; a folder beyond these is another one.
enum { PAGE_FILES = 500, PAGE_BYTES = 64 << 20, PAGE_DEPTH = 4 };

static struct page_file *files;
static size_t n_file, n_bytes;

static const struct {
    const char *ending, *type;
} types[] = {
    {".html", "text/html; charset=utf-8"},
    {".js", "text/javascript; charset=utf-8"},
    {".mjs", "text/javascript; charset=utf-8"},
    {".css", "text/css; charset=utf-8"},
    {".json", "application/json"},
    {".map", "application/json"},
    {".txt", "text/plain; charset=utf-8"},
    {".svg", "image/svg+xml"},
    {".png", "image/png"},
    {".jpg", "image/jpeg"},
    {".webp", "image/webp"},
    {".woff2", "font/woff2"},
    {".wasm", "application/wasm"},
    {".glb", "model/gltf-binary"},
    {".webmanifest", "application/manifest+json"},
};

static bool ends_with(const char *text, const char *end)
{
    size_t n = strlen(text), m = strlen(end);
    return n >= m && !strcmp(text + n - m, end);
}

static const char *type_of(const char *path)
{
    for (size_t i = 0; i < sizeof types / sizeof *types; i++)
        if (ends_with(path, types[i].ending)) return types[i].type;
    return "application/octet-stream";
}

static int read_bytes(const char *path, size_t size, struct page_bytes *out)
{
    FILE *f = fopen(path, "rb");
    char *bytes = f ? malloc(size + 1) : NULL;
    bool whole = bytes && fread(bytes, 1, size, f) == size;
    if (f) fclose(f);
    if (!whole) {
        free(bytes);
        return -1;
    }
    *out = (struct page_bytes){bytes, size};
    return 0;
}

static struct page_file *file_at(const char *path, size_t n)
{
    for (size_t i = 0; i < n_file; i++)
        if (strlen(files[i].path) == n && !strncmp(files[i].path, path, n)) return &files[i];
    struct page_file *more = realloc(files, (n_file + 1) * sizeof *files);
    if (!more) return NULL;
    files = more;
    files[n_file] = (struct page_file){.path = strndup(path, n)};
    return files[n_file].path ? &files[n_file++] : NULL;
}

// One file of the folder: a form of the one whose name it has without .br or .gz.
static int add_file(const char *file, const char *path, size_t size)
{
    enum page_encoding form = ends_with(path, ".br")   ? PAGE_BROTLI
                              : ends_with(path, ".gz") ? PAGE_GZIP
                                                       : PAGE_PLAIN;
    struct page_file *f = file_at(path, strlen(path) - (form == PAGE_PLAIN ? 0 : 3));
    n_bytes += size;
    if (!f || n_file > PAGE_FILES || n_bytes > PAGE_BYTES) return -1;
    f->type = type_of(f->path);
    f->hashed = !strncmp(f->path, "/assets/", 8);
    return read_bytes(file, size, &f->form[form]);
}

static int add_folder(const char *root, const char *path, int depth)
{
    char name[4096], inner[512];
    struct dirent *entry;
    struct stat st;
    snprintf(name, sizeof name, "%s%s", root, path);
    DIR *folder = depth < PAGE_DEPTH ? opendir(name) : NULL;
    int failed = folder ? 0 : -1;
    while (!failed && (entry = readdir(folder))) {
        if (entry->d_name[0] == '.') continue;
        int n = snprintf(inner, sizeof inner, "%s/%s", path, entry->d_name);
        int m = snprintf(name, sizeof name, "%s%s", root, inner);
        if (n >= (int)sizeof inner || m >= (int)sizeof name || stat(name, &st)) failed = -1;
        else if (S_ISDIR(st.st_mode)) failed = add_folder(root, inner, depth + 1);
        else if (S_ISREG(st.st_mode)) failed = add_file(name, inner, (size_t)st.st_size);
    }
    if (folder) closedir(folder);
    return failed;
}

// The folder of --page, else share/relight/page beside the folder of this program.
static bool find_folder(const struct server *server, char out[4096])
{
    if (server->options.page[0]) return snprintf(out, 4096, "%s", server->options.page) < 4096;
    ssize_t n = readlink("/proc/self/exe", out, 4000);
    if (n <= 0) return false;
    out[n] = 0;
    for (int up = 0; up < 2; up++) {
        char *slash = strrchr(out, '/');
        if (!slash) return false;
        *slash = 0;
    }
    strcat(out, "/share/relight/page");
    return !access(out, F_OK);
}

void page_files_read(struct server *server)
{
    char folder[4096];
    if (!find_folder(server, folder)) return;
    errno = 0;
    if (!add_folder(folder, "", 0)) {
        log_line(LOG_EVENT, "page folder=%s files=%zu bytes=%zu", folder, n_file, n_bytes);
        return;
    }
    log_line(LOG_WARN,
             "page %s could not be read (%s), or has more than %d files or %d MiB; / says so",
             folder, errno ? strerror(errno) : "too large", PAGE_FILES, PAGE_BYTES >> 20);
    page_files_free();
}

void page_files_free(void)
{
    for (size_t i = 0; i < n_file; i++) {
        free(files[i].path);
        for (int k = 0; k < PAGE_N_ENCODING; k++) free(files[i].form[k].bytes);
    }
    free(files);
    files = NULL;
    n_file = n_bytes = 0;
}

bool page_files_any(void)
{
    return page_files_find("/") != NULL;
}

const struct page_file *page_files_find(const char *path)
{
    if (!strcmp(path, "/")) path = "/index.html";
    for (size_t i = 0; i < n_file; i++)
        if (!strcmp(files[i].path, path) && files[i].form[PAGE_PLAIN].bytes) return &files[i];
    return NULL;
}

// ---- answers

static const char no_page[] =
    "<!doctype html><html lang=\"en\"><meta charset=\"utf-8\"><title>relightd</title>"
    "<h1>relightd is running; its page is not installed</h1>"
    "<p>The page is built where Node.js (18 or newer) and npm are: "
    "<code>deploy/dependencies --page</code>, then <code>cmake -B build -DRELIGHT_PAGE=ON</code> "
    "and <code>cmake --build build</code>, or <code>deploy/demo --serve</code>. "
    "A folder with the page is named by <code>--page DIR</code>.</p>"
    "<p>The API is at <a href=\"/v1/openapi.json\">/v1/openapi.json</a>.</p>\n";

// Whether Accept-Encoding names the encoding, without q=0.
static bool accepts(const char *accepted, const char *word)
{
    size_t n = strlen(word);
    for (const char *at = accepted; at && *at; at = strchr(at, ',')) {
        at += strspn(at, " ,");
        if (strncasecmp(at, word, n) || !strchr(" ,;", at[n])) continue;
        const char *q = at + n + strspn(at + n, " ;");
        return strncasecmp(q, "q=0", 3) ||
               (q[3] == '.' && isdigit((unsigned char)q[4 + strspn(q + 4, "0")]));
    }
    return false;
}

static enum page_encoding choose(struct exchange *x, const struct page_file *file)
{
    char room[300];
    const char *said = http_header(x->wsi, WSI_TOKEN_HTTP_ACCEPT_ENCODING, room, sizeof room);
    if (file->form[PAGE_BROTLI].bytes && said && accepts(said, "br")) return PAGE_BROTLI;
    if (file->form[PAGE_GZIP].bytes && said && accepts(said, "gzip")) return PAGE_GZIP;
    return PAGE_PLAIN;
}

// A page of an allowed origin may import the modules; http_admitted has checked the origin.
static void add_origin(struct exchange *x)
{
    char room[300];
    const char *origin = http_header(x->wsi, WSI_TOKEN_ORIGIN, room, sizeof room);
    exchange_field(x, "vary:", "accept-encoding, origin");
    if (origin && *origin) exchange_field(x, "access-control-allow-origin:", "%s", origin);
}

static bool answer_no_page(struct exchange *x)
{
    struct payload whole = {(char *)(uintptr_t)no_page, sizeof no_page - 1, NULL, NULL};
    exchange_field(x, "cache-control:", "no-store");
    exchange_answer(x, 200, "text/html; charset=utf-8", NULL, 0, &whole);
    return true;
}

bool page_file(struct exchange *x, struct http_problem *problem)
{
    const struct page_file *file = page_files_find(x->head.path);
    if (!file) return answer_no_page(x);
    enum page_encoding form = choose(x, file);
    struct payload whole = {file->form[form].bytes, file->form[form].n, NULL, NULL};
    char tag[40];
    snprintf(tag, sizeof tag, "\"%016llx-%d\"",
             (unsigned long long)XXH3_64bits(whole.bytes, whole.size), form);
    exchange_field(x, "etag:", "%s", tag);
    exchange_field(x, "cache-control:", "%s",
                   file->hashed ? "public, max-age=31536000, immutable" : "public, no-cache");
    add_origin(x);
    if (strstr(x->head.none_match, tag)) {
        exchange_answer(x, 304, file->type, NULL, 0, NULL);
        return true;
    }
    if (form != PAGE_PLAIN)
        exchange_field(x, "content-encoding:", "%s", form == PAGE_BROTLI ? "br" : "gzip");
    exchange_answer(x, 200, file->type, NULL, 0, &whole);
    return true;
}
