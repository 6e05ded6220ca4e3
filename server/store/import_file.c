// SPDX-License-Identifier: MIT
// Reading the models folder: openat2 keeps every path below it, FICLONE shares a copy's blocks.
#include "store/import_file.h"

#include "frame.h"
#include "prt/transport.h"
#include "relight.pb-c.h"

#include <ctype.h>
#include <errno.h>
#include <fcntl.h>
#include <limits.h>
#include <linux/fs.h>
#include <linux/openat2.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>
#include <strings.h>
#include <sys/ioctl.h>
#include <sys/stat.h>
#include <sys/syscall.h>
#include <unistd.h>

enum { PIECE = 1 << 20, MAX_NAMES = 63 };

// Without openat2 (old kernels, some containers) no link is followed at all.
static int open_without_links(int dir, const char *path, int flags)
{
    char part[NAME_MAX + 1];
    int at = dup(dir);
    while (at >= 0) {
        size_t n = strcspn(path, "/");
        bool last = !path[n];
        if (!n || n > NAME_MAX || (path[0] == '.' && (n == 1 || (n == 2 && path[1] == '.')))) {
            close(at);
            errno = EXDEV;
            return -1;
        }
        snprintf(part, sizeof part, "%.*s", (int)n, path);
        int next = openat(at, part, O_NOFOLLOW | O_CLOEXEC | (last ? flags : O_PATH));
        int err = errno;
        close(at);
        errno = err;
        at = next;
        if (last) return at;
        path += n + 1;
    }
    return -1;
}

static void print_stamp(const struct stat *st, char stamp[IMPORT_STAMP])
{
    snprintf(stamp, IMPORT_STAMP, "%llx:%llu:%lld:%lld.%09ld:%lld.%09ld",
             (unsigned long long)st->st_dev, (unsigned long long)st->st_ino,
             (long long)st->st_size, (long long)st->st_mtim.tv_sec, st->st_mtim.tv_nsec,
             (long long)st->st_ctim.tv_sec, st->st_ctim.tv_nsec);
}

// A file or folder below `dir`, or -errno.
int import_open_any_below(int dir, const char *path, int flags)
{
    struct open_how how = {.flags = (uint64_t)(flags | O_CLOEXEC),
                           .resolve = RESOLVE_BENEATH | RESOLVE_NO_MAGICLINKS};
    int fd = (int)syscall(SYS_openat2, dir, path, &how, sizeof how);
    if (fd < 0 && (errno == ENOSYS || errno == EPERM))
        fd = open_without_links(dir, path, flags);
    return fd < 0 ? -errno : fd;
}

int import_open_below(int dir, const char *path, int flags, char stamp[IMPORT_STAMP],
                      uint64_t *bytes)
{
    struct stat st;
    int fd = import_open_any_below(dir, path, flags);
    if (fd < 0) return fd;
    if (fstat(fd, &st) || !S_ISREG(st.st_mode)) {
        close(fd);
        return -EINVAL;
    }
    print_stamp(&st, stamp);
    *bytes = (uint64_t)st.st_size;
    return fd;
}

int import_open(const char *folder, const char *path, int flags, char stamp[IMPORT_STAMP],
                uint64_t *bytes)
{
    int dir = open(folder, O_PATH | O_DIRECTORY | O_CLOEXEC);
    if (dir < 0) return -errno;
    int fd = import_open_below(dir, path, flags, stamp, bytes);
    close(dir);
    return fd;
}

// Adds all of `from` to the hash and, where `to` is a descriptor, writes it there. 0 or -errno.
static int hash_and_write(int from, int to, const atomic_bool *stop, char hash[65])
{
    struct relight_sha256 sha;
    char *piece = malloc(PIECE);
    int err = piece ? 0 : -ENOMEM;
    relight_sha256_init(&sha);
    while (!err) {
        ssize_t n = read(from, piece, PIECE);
        if (n < 0 && errno == EINTR) continue;
        if (n < 0) err = -errno;
        if (n <= 0) break;
        relight_sha256_add(&sha, piece, (size_t)n);
        for (ssize_t put = 0, k; to >= 0 && !err && put < n; put += k)
            if ((k = write(to, piece + put, (size_t)(n - put))) < 0) {
                if (errno != EINTR) err = -errno;
                k = 0;
            }
        if (atomic_load(stop)) err = -ECANCELED;
    }
    free(piece);
    relight_sha256_hex(&sha, hash);
    return err;
}

// Both ways the hash is that of the copy, whatever happens to the original meanwhile.
static int copy_bytes(int from, int to, const atomic_bool *stop, char hash[65])
{
    int err = ioctl(to, FICLONE, from) ? hash_and_write(from, to, stop, hash)
                                       : hash_and_write(to, -1, stop, hash);
    return !err && fsync(to) ? -errno : err;
}

static void fail(struct import_file *out, int code, const char *path, const char *text)
{
    out->code = code;
    snprintf(out->error, sizeof out->error, "%.100s: %.180s", path, text);
}

static void fail_errno(struct import_file *out, const char *path, int err)
{
    char text[200];
    bool full = err == ENOSPC || err == EDQUOT || err == EFBIG;
    snprintf(text, sizeof text, "the file cannot be copied into the data folder: %s",
             strerror(err));
    fail(out,
         full ? RELIGHT__ERROR_CODE__ERROR_LIMIT
              : (err == ECANCELED ? RELIGHT__ERROR_CODE__ERROR_CANCELLED
                                  : RELIGHT__ERROR_CODE__ERROR_INTERNAL),
         path, text);
}

static int hex_digit(char c)
{
    return isdigit((unsigned char)c) ? c - '0' : (c | 32) - 'a' + 10;
}

// The file names in a .gltf, read as text: "uri": "NAME" with JSON's escapes of printable
// characters and per cent signs resolved. Data URIs and paths out of the folder are left out.
static bool read_uri(const char *at, const char *end, char *name, size_t n)
{
    size_t k = 0;
    for (; at < end && k + 1 < n; at++) {
        char c = *at;
        if (c == '\\' && at + 1 < end && (at[1] == '/' || at[1] == '"')) c = *++at;
        else if (c == '\\') return false;
        else if (c == '%' && end - at > 2 && isxdigit((unsigned char)at[1]) &&
                 isxdigit((unsigned char)at[2])) {
            c = (char)(hex_digit(at[1]) << 4 | hex_digit(at[2]));
            at += 2;
        }
        name[k++] = c;
    }
    name[k] = 0;
    return at == end && k && strlen(name) == k && name[0] != '/' && !strchr(name, ':') &&
           !strstr(name, "..");
}

static void read_names(struct import_file *out, const char *copy, const char *path)
{
    struct prt_blob text;
    const char *dot = strrchr(path, '.');
    if (!dot || strcasecmp(dot, ".gltf") || prt_read_file(NULL, copy, 64 << 20, &text)) return;
    out->name = calloc(MAX_NAMES, sizeof *out->name);
    const char *at = text.bytes, *end = at + text.size;
    for (; out->name && (at = memmem(at, (size_t)(end - at), "\"uri\"", 5)); at += 5) {
        const char *open = memchr(at + 5, '"', (size_t)(end - at - 5));
        const char *close = open ? memchr(open + 1, '"', (size_t)(end - open - 1)) : NULL;
        char name[600];
        bool known = false;
        if (!close) break;
        if (!read_uri(open + 1, close, name, sizeof name)) continue;
        for (size_t i = 0; i < out->n_name; i++) known |= !strcmp(out->name[i], name);
        if (known) continue;
        if (out->n_name == MAX_NAMES) {
            fail(out, RELIGHT__ERROR_CODE__ERROR_LIMIT, path, "it refers to too many files");
            break;
        }
        if ((out->name[out->n_name] = strdup(name))) out->n_name++;
    }
    prt_free(text.bytes);
}

// NULL, or why the copy is not to be used.
static const char *check_copy(int fd, const char *copy, struct import_file *out)
{
    struct stat st;
    char after[IMPORT_STAMP];
    struct prt_context ctx;
    struct prt_file *file = NULL;
    if (!fstat(fd, &st)) print_stamp(&st, after);
    else after[0] = 0;
    out->code = RELIGHT__ERROR_CODE__ERROR_BUSY;
    if (strcmp(after, out->stamp)) return "the file was written to while it was copied";
    prt_context_init(&ctx);
    ctx.log = prt_log_none;
    int status =
        prt_file_probe(copy) ? prt_file_open(&ctx, copy, PRT_FILE_CHECK_HEADERS, &file) : 0;
    prt_file_close(file);
    out->lasts = status && status != PRT_NOMEM && status != PRT_IO;
    out->code = RELIGHT__ERROR_CODE__ERROR_FORMAT;
    if (out->lasts) return "the .prt is damaged or of another version; prt info FILE says more";
    out->code = RELIGHT__ERROR_CODE__ERROR_BUSY;
    if (status) return "its copy cannot be opened now";
    out->code = 0;
    return NULL;
}

static void make_copy(int fd, const char *path, const char *to, const atomic_bool *stop,
                      struct import_file *out)
{
    static atomic_uint number;
    char temporary[PATH_MAX], final[PATH_MAX];
    const char *wrong = NULL;
    snprintf(temporary, sizeof temporary, "%s/.tmp-%u", to, atomic_fetch_add(&number, 1));
    int copy = open(temporary, O_CREAT | O_TRUNC | O_RDWR | O_CLOEXEC, 0600);
    int err = copy < 0 ? -errno : copy_bytes(fd, copy, stop, out->hash);
    if (copy >= 0) close(copy);
    if (!err && snprintf(final, sizeof final, "%s/%s", to, out->hash) >= PATH_MAX)
        err = -ENAMETOOLONG;
    if (!err) wrong = check_copy(fd, temporary, out);
    if (wrong) fail(out, out->code, path, wrong);
    else if (!err && rename(temporary, final)) err = -errno;
    if (err) fail_errno(out, path, -err);
    if (err || wrong) unlink(temporary);
    else out->copied = true;
}

void import_copy_file(const char *folder, const char *path, const char *to, const char *known,
                      const char *known_stamp, uint64_t most, const atomic_bool *stop,
                      struct import_file *out)
{
    char copy[PATH_MAX];
    *out = (struct import_file){0};
    int fd = import_open(folder, path, O_RDONLY | O_NONBLOCK, out->stamp, &out->bytes);
    if (fd < 0) {
        // The same text whether the file exists or not: clients learn nothing of paths outside.
        fail(out, RELIGHT__ERROR_CODE__ERROR_FORBIDDEN, path,
             "no such file inside the models folder (links that lead out of it are not "
             "followed)");
        return;
    }
    if (known[0] && !strcmp(known_stamp, out->stamp))
        snprintf(out->hash, sizeof out->hash, "%s", known);
    else if ((out->lasts = out->bytes > most))
        fail(out, RELIGHT__ERROR_CODE__ERROR_LIMIT, path,
             "the file is larger than the disk budget (--disk)");
    else make_copy(fd, path, to, stop, out);
    close(fd);
    if (out->code) return;
    snprintf(copy, sizeof copy, "%s/%s", to, out->hash);
    out->prt = prt_file_probe(copy);
    read_names(out, copy, path);
}

void import_file_finish(struct import_file *file)
{
    for (size_t i = 0; i < file->n_name; i++) free(file->name[i]);
    free(file->name);
    file->name = NULL;
    file->n_name = 0;
}

// Bytes of the UTF-8 character at s, whose end is a NUL; 0 when it is none or a control.
static size_t utf8_length(const unsigned char *s)
{
    if (s[0] < 0x80) return s[0] >= 32 && s[0] != 127;
    size_t m = s[0] >= 0xf0 ? 4 : s[0] >= 0xe0 ? 3 : 2;
    if (s[0] < 0xc2 || s[0] > 0xf4) return 0;
    for (size_t i = 1; i < m; i++)
        if ((s[i] & 0xc0) != 0x80) return 0;
    bool overlong = (s[0] == 0xe0 && s[1] < 0xa0) || (s[0] == 0xf0 && s[1] < 0x90);
    bool surrogate = s[0] == 0xed && s[1] > 0x9f, beyond = s[0] == 0xf4 && s[1] > 0x8f;
    bool control = s[0] == 0xc2 && s[1] < 0xa0;
    return overlong || surrogate || beyond || control ? 0 : m;
}

void name_printable(const char *text, char *out, size_t n)
{
    const unsigned char *s = (const unsigned char *)text;
    size_t at = 0;
    while (*s && at + 5 < n) {
        size_t m = utf8_length(s);
        if (m) memcpy(out + at, s, m);
        else snprintf(out + at, n - at, "\\x%02x", *s);
        at += m ? m : 4;
        s += m ? m : 1;
    }
    out[at] = 0;
}
