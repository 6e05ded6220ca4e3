// SPDX-License-Identifier: MIT
// Files: written whole or not at all, through a temporary file; vertices in the formats of
// vertex_file.h.
#include "cli.h"
#include "terminal.h"

#include <errno.h>
#include <fcntl.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>
#include <sys/stat.h>
#include <unistd.h>

static int file_error(const struct options *options, const char *path, const char *text)
{
    struct relight_error error = {.code = RELIGHT_E_FILE};
    snprintf(error.text, sizeof error.text, "%s: %s", path, text);
    return report_error(options, &error);
}

static int write_all(int fd, const char *bytes, size_t n)
{
    while (n) {
        ssize_t put = write(fd, bytes, n < (1u << 30) ? n : (1u << 30));
        if (put < 0 && errno == EINTR) continue;
        if (put <= 0) return -1;
        bytes += put;
        n -= (size_t)put;
    }
    return 0;
}

int write_file(const struct options *options, const char *path, const void *bytes, size_t n)
{
    char temp[4096];
    struct stat st;
    // Devices and pipes (/dev/stdout) are written in place: there is nothing to rename.
    bool special = stat(path, &st) == 0 && !S_ISREG(st.st_mode);
    if (snprintf(temp, sizeof temp, "%s.tmp-%ld", path, (long)getpid()) >= (int)sizeof temp)
        return file_error(options, path, "the path is too long");
    int fd = special ? open(path, O_WRONLY | O_CLOEXEC)
                     : open(temp, O_WRONLY | O_CREAT | O_TRUNC | O_CLOEXEC, 0666);
    if (fd < 0) return file_error(options, path, strerror(errno));
    bool bad = write_all(fd, bytes, n) || (!special && fsync(fd));
    int fault = errno;
    if (close(fd) && !bad) {
        bad = true;
        fault = errno;
    }
    if (!bad && !special && rename(temp, path)) {
        bad = true;
        fault = errno;
    }
    if (bad && !special) unlink(temp);
    return bad ? file_error(options, path, strerror(fault)) : EXIT_DONE;
}

bool is_terminal_path(const char *path)
{
    return path && !strcmp(path, "-");
}

void fit_terminal(struct options *options)
{
    struct relight_picture *p = &options->picture;
    struct prt_terminal terminal;
    if (p->width || !is_terminal_path(options->output)) return;
    prt_terminal_detect(STDOUT_FILENO, &terminal);
    p->width = 800;
    p->height = 600;
    prt_terminal_fit(&terminal, &p->width, &p->height);
}

int draw_in_terminal(const struct options *options, const struct relight_image *image)
{
    struct prt_terminal terminal;
    prt_terminal_detect(STDOUT_FILENO, &terminal);
    return prt_terminal_draw(stdout, &terminal, image->width, image->height, image->data)
               ? file_error(options, "standard output", "the picture could not be written")
               : EXIT_DONE;
}

int picture_usage(const struct options *options, const char *others)
{
    char list[128];
    return report_usage(options, "-o FILE has to end in one of %s%s, or be - for the terminal",
                        others, picture_ending_list(list));
}

static struct prt_vertex_block *copy_blocks(const struct relight_geometry *g)
{
    struct prt_vertex_block *block = calloc(g->n_block + 1, sizeof *block);
    for (size_t i = 0; i < g->n_block && block; i++)
        block[i] = (struct prt_vertex_block){.object = g->block[i].object,
                                             .vertex_begin = g->block[i].vertex_begin,
                                             .n_vertex = g->block[i].n_vertex,
                                             .triangle_begin = g->block[i].triangle_begin,
                                             .n_triangle = g->block[i].n_triangle};
    return block;
}

int write_vertices(const struct options *options, const char *path, uint32_t n,
                   const float *rgb, const struct relight_geometry *g)
{
    char *bytes = NULL;
    size_t size = 0;
    struct prt_vertex_block *block = copy_blocks(g);
    FILE *f = block ? open_memstream(&bytes, &size) : NULL;
    struct prt_vertex_data data = {.n_vertex = n,
                                   .n_triangle = g->n_triangle,
                                   .position = g->position,
                                   .normal = g->normal,
                                   .color = (const float(*)[3])rgb,
                                   .triangle = g->triangle,
                                   .block = block,
                                   .n_block = (uint32_t)g->n_block,
                                   .generator = "relight " RELIGHT_VERSION};
    int result =
        f ? prt_vertex_file_write(f, prt_vertex_format_of(path), &data) : PRT_VERTEX_NO_MEMORY;
    bool bad = result || ferror(f);
    if (f) bad |= fclose(f) != 0;
    int status = result == PRT_VERTEX_TOO_LARGE
                     ? file_error(options, path, "a GLB holds less than 4 GiB; write .ply")
                 : bad ? file_error(options, path, "not enough memory")
                       : write_file(options, path, bytes, size);
    free(bytes);
    free(block);
    return status;
}

// The bytes of a regular file or pipe, malloc()ed; NULL with errno set.
static char *read_all(const char *path, size_t *n)
{
    char *bytes = NULL, part[1 << 16];
    FILE *in = fopen(path, "rbe"), *out = in ? open_memstream(&bytes, n) : NULL;
    size_t got;
    while (out && (got = fread(part, 1, sizeof part, in)) > 0)
        if (fwrite(part, 1, got, out) != got) break;
    bool bad = !out || ferror(in) || ferror(out);
    int fault = errno;
    if (out) bad |= fclose(out) != 0;
    if (in) fclose(in);
    if (!bad) return bytes;
    free(bytes);
    errno = fault ? fault : ENOMEM;
    return NULL;
}

int read_npy(const struct options *options, const char *path, uint32_t *n, float **out)
{
    size_t size = 0;
    struct prt_npy npy;
    char *bytes = read_all(path, &size);
    if (!bytes) return file_error(options, path, strerror(errno));
    const char *reason = prt_npy_parse(bytes, size, &npy);
    if (!reason && npy.n > UINT32_MAX) reason = "has more than 4294967295 rows";
    *out = reason ? NULL : malloc(((size_t)npy.n + 1) * 12);
    if (*out) {
        *n = (uint32_t)npy.n;
        prt_npy_rows(&npy, (float(*)[3]) * out);
    }
    free(bytes);
    return *out ? EXIT_DONE : file_error(options, path, reason ? reason : "not enough memory");
}
