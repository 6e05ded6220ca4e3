// SPDX-License-Identifier: MIT
// Zip archives (PKWARE's APPNOTE, without 64-bit sizes and encryption).
#include "zip.h"

#include <stdio.h>
#include <stdlib.h>
#include <string.h>
#include <zlib.h>

enum {
    LOCAL = 0x04034b50,
    CENTRAL = 0x02014b50,
    END = 0x06054b50,
    N_LOCAL = 30,
    N_CENTRAL = 46,
    N_END = 22,
    STORED = 0,
    DEFLATED = 8,
    DAY = 0x21, /* 1980-01-01: equal rooms give equal files */
};

// ---- writing

static void append(uint8_t **to, size_t *n, size_t *room, const void *bytes, size_t size,
                   bool *failed)
{
    if (*failed) return;
    if (*n + size > *room) {
        size_t more = (*n + size) * 2;
        uint8_t *longer = more < UINT32_MAX ? realloc(*to, more) : NULL;
        if (!longer) {
            *failed = true;
            return;
        }
        *to = longer;
        *room = more;
    }
    if (size) memcpy(*to + *n, bytes, size);
    *n += size;
}

static void put16(uint8_t *at, unsigned x)
{
    at[0] = (uint8_t)x;
    at[1] = (uint8_t)(x >> 8);
}

static void put32(uint8_t *at, uint32_t x)
{
    put16(at, x & 0xffff);
    put16(at + 2, x >> 16);
}

// Raw deflate; NULL where it does not get smaller.
static uint8_t *deflated(const void *bytes, size_t n, size_t *out_n)
{
    z_stream z = {0};
    if (n < 64 || n > ZIP_MOST_BYTES ||
        deflateInit2(&z, 6, Z_DEFLATED, -MAX_WBITS, 8, Z_DEFAULT_STRATEGY) != Z_OK)
        return NULL;
    uint8_t *out = malloc(n);
    z.next_in = (Bytef *)(uintptr_t)bytes;
    z.avail_in = (uInt)n;
    z.next_out = out;
    z.avail_out = (uInt)n;
    bool fits = out && deflate(&z, Z_FINISH) == Z_STREAM_END;
    *out_n = n - z.avail_out;
    deflateEnd(&z);
    if (fits) return out;
    free(out);
    return NULL;
}

void zip_add(struct zip_writer *zip, const char *name, const void *bytes, size_t n)
{
    uint8_t local[N_LOCAL] = {0}, central[N_CENTRAL] = {0};
    size_t length = strlen(name), packed_n = n, at = zip->n;
    if (n > ZIP_MOST_BYTES || length > 255 || zip->n_file >= ZIP_MOST_FILES) zip->failed = true;
    if (zip->failed) return;
    uint8_t *packed = deflated(bytes, n, &packed_n);
    if (!packed) packed_n = n;
    put32(local, LOCAL);
    put16(local + 4, 20);    // version 2.0
    put16(local + 6, 0x800); // the name is UTF-8
    put16(local + 8, packed ? DEFLATED : STORED);
    put16(local + 12, DAY);
    put32(local + 14, (uint32_t)crc32(0, bytes, (uInt)n));
    put32(local + 18, (uint32_t)packed_n);
    put32(local + 22, (uint32_t)n);
    put16(local + 26, (unsigned)length);
    put32(central, CENTRAL);
    put16(central + 4, 20);
    memcpy(central + 6, local + 4, 26);
    put32(central + 42, (uint32_t)at);
    append(&zip->bytes, &zip->n, &zip->room, local, N_LOCAL, &zip->failed);
    append(&zip->bytes, &zip->n, &zip->room, name, length, &zip->failed);
    append(&zip->bytes, &zip->n, &zip->room, packed ? packed : bytes, packed_n, &zip->failed);
    append(&zip->directory, &zip->n_directory, &zip->directory_room, central, N_CENTRAL,
           &zip->failed);
    append(&zip->directory, &zip->n_directory, &zip->directory_room, name, length,
           &zip->failed);
    zip->n_file++;
    free(packed);
}

uint8_t *zip_finish(struct zip_writer *zip, size_t *n)
{
    uint8_t end[N_END] = {0}, *out;
    put32(end, END);
    put16(end + 8, (unsigned)zip->n_file);
    put16(end + 10, (unsigned)zip->n_file);
    put32(end + 12, (uint32_t)zip->n_directory);
    put32(end + 16, (uint32_t)zip->n);
    append(&zip->bytes, &zip->n, &zip->room, zip->directory, zip->n_directory, &zip->failed);
    append(&zip->bytes, &zip->n, &zip->room, end, N_END, &zip->failed);
    out = zip->failed ? NULL : zip->bytes;
    *n = zip->n;
    if (!out) free(zip->bytes);
    free(zip->directory);
    *zip = (struct zip_writer){0};
    return out;
}

// ---- reading

static unsigned get16(const uint8_t *at)
{
    return (unsigned)at[0] | (unsigned)at[1] << 8;
}

static uint32_t get32(const uint8_t *at)
{
    return (uint32_t)get16(at) | (uint32_t)get16(at + 2) << 16;
}

static const uint8_t *find_end(const uint8_t *bytes, size_t n)
{
    for (size_t back = N_END; back <= n && back <= N_END + 65535; back++)
        if (get32(bytes + n - back) == END) return bytes + n - back;
    return NULL;
}

static bool inflated(const uint8_t *from, size_t n, uint8_t *to, size_t size)
{
    z_stream z = {.next_in = (Bytef *)(uintptr_t)from, .avail_in = (uInt)n};
    if (inflateInit2(&z, -MAX_WBITS) != Z_OK) return false;
    z.next_out = to;
    z.avail_out = (uInt)size;
    int status = inflate(&z, Z_FINISH);
    bool whole = status == Z_STREAM_END && !z.avail_out;
    inflateEnd(&z);
    return whole;
}

// One entry of the directory. NULL, or the fault.
static const char *read_one(const uint8_t *bytes, size_t n, const uint8_t *central,
                            size_t *left, struct zip_file *out)
{
    unsigned flags = get16(central + 8), method = get16(central + 10),
             length = get16(central + 28);
    uint32_t packed = get32(central + 20), size = get32(central + 24), at = get32(central + 42);
    if (length >= sizeof out->name || !length) return "a name is too long";
    memcpy(out->name, central + N_CENTRAL, length);
    out->name[length] = 0;
    if (memchr(out->name, 0, length)) return "a name has a zero byte";
    if (flags & 1) return "it is encrypted";
    if (method != STORED && method != DEFLATED) return "a compression that is not supported";
    if (at > n || n - at < N_LOCAL || get32(bytes + at) != LOCAL)
        return "a file lies outside the archive";
    size_t begin = at + N_LOCAL + (size_t)get16(bytes + at + 26) + get16(bytes + at + 28);
    if (begin > n || packed > n - begin) return "a file lies outside the archive";
    if (size > *left) return "it unpacks to more than 256 MiB";
    *left -= size;
    if (!(out->bytes = malloc((size_t)size + 1))) return "not enough memory";
    out->n = size;
    out->bytes[size] = 0;
    bool right =
        method == STORED ? packed == size : inflated(bytes + begin, packed, out->bytes, size);
    if (right && method == STORED && size) memcpy(out->bytes, bytes + begin, size);
    if (!right || crc32(0, out->bytes, size) != get32(central + 16))
        return "a file in it is damaged";
    return NULL;
}

int zip_read(const uint8_t *bytes, size_t n, struct zip_file **files, size_t *n_file,
             char error[160])
{
    const uint8_t *end = n >= N_END ? find_end(bytes, n) : NULL;
    const char *fault = end ? NULL : "it is no zip archive";
    size_t count = end ? get16(end + 10) : 0, at = end ? get32(end + 16) : 0, done = 0;
    size_t left = ZIP_MOST_BYTES, last = end ? (size_t)(end - bytes) : 0;
    struct zip_file *list = calloc(count + 1, sizeof *list);
    if (!list) fault = "not enough memory";
    if (!fault && count > ZIP_MOST_FILES) fault = "it has too many files";
    for (; !fault && done < count; done++) {
        if (at > last || last - at < N_CENTRAL || get32(bytes + at) != CENTRAL) {
            fault = "its directory is damaged";
            break;
        }
        size_t length = N_CENTRAL + (size_t)get16(bytes + at + 28) + get16(bytes + at + 30) +
                        get16(bytes + at + 32);
        if (length > last - at) fault = "its directory is damaged";
        else fault = read_one(bytes, n, bytes + at, &left, &list[done]);
        at += length;
    }
    if (!fault) {
        *files = list;
        *n_file = count;
        return 0;
    }
    snprintf(error, 160, "%s", fault);
    zip_free(list, list ? count : 0);
    return -1;
}

void zip_free(struct zip_file *files, size_t n_file)
{
    for (size_t i = 0; i < n_file; i++) free(files[i].bytes);
    free(files);
}
