// SPDX-License-Identifier: MIT
#include "video.h"

#include "preview.h"

#include <errno.h>
#include <fcntl.h>
#include <signal.h>
#include <spawn.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>
#include <strings.h>
#include <sys/wait.h>
#include <unistd.h>

extern char **environ;

struct video {
    FILE *frames;
    pid_t pid;
    size_t frame_bytes;
    const char *path;
};

static bool ends_in(const char *path, const char *ending)
{
    size_t n = strlen(path), k = strlen(ending);
    return n > k && !strcasecmp(path + n - k, ending);
}

bool video_is_name(const char *path)
{
    return ends_in(path, ".mp4") || ends_in(path, ".webm");
}

// ffmpeg with its standard input from `from`; its own messages only where it fails.
static int start(struct video *v, int from, uint32_t width, uint32_t height, double fps)
{
    char size[32], rate[32], file[4096];
    snprintf(size, sizeof size, "%ux%u", width, height);
    snprintf(rate, sizeof rate, "%g", fps);
    snprintf(file, sizeof file, "file:%s", v->path); // a name with a colon is no URL
    const char *mp4[] = {"-c:v", "libx264", "-crf", "18", "-movflags", "+faststart", NULL};
    const char *webm[] = {"-c:v", "libvpx-vp9", "-crf", "30", "-b:v", "0", NULL};
    const char *head[] = {"ffmpeg",   "-loglevel", "error", "-y", "-f", "rawvideo",
                          "-pix_fmt", "rgb24",     "-s",    size, "-r", rate,
                          "-i",       "-",         "-an",   NULL};
    const char **codec = ends_in(v->path, ".mp4") ? mp4 : webm;
    char *argv[40];
    int n = 0;
    for (int i = 0; head[i]; i++) argv[n++] = (char *)(uintptr_t)head[i];
    for (int i = 0; codec[i]; i++) argv[n++] = (char *)(uintptr_t)codec[i];
    argv[n++] = (char *)(uintptr_t) "-pix_fmt";
    argv[n++] = (char *)(uintptr_t) "yuv420p";
    argv[n++] = file;
    argv[n] = NULL;
    posix_spawn_file_actions_t actions;
    posix_spawn_file_actions_init(&actions);
    posix_spawn_file_actions_adddup2(&actions, from, STDIN_FILENO);
    // Ctrl-C goes to the terminal's group: ffmpeg would end before the last frames.
    posix_spawnattr_t own_group;
    posix_spawnattr_init(&own_group);
    posix_spawnattr_setflags(&own_group, POSIX_SPAWN_SETPGROUP);
    int err = posix_spawnp(&v->pid, "ffmpeg", &actions, &own_group, argv, environ);
    posix_spawnattr_destroy(&own_group);
    posix_spawn_file_actions_destroy(&actions);
    return err;
}

struct video *video_open(const char *path, uint32_t width, uint32_t height, double fps)
{
    int ends[2];
    if (width % 2 || height % 2) {
        fprintf(stderr, "relight-preview: %ux%u: sides of a film are even\n", width, height);
        return NULL;
    }
    struct video *v = calloc(1, sizeof *v);
    if (!v || pipe2(ends, O_CLOEXEC)) {
        free(v);
        return NULL;
    }
    signal(SIGPIPE, SIG_IGN); // video_add sees it
    *v = (struct video){.path = path, .frame_bytes = (size_t)3 * width * height};
    int err = start(v, ends[0], width, height, fps);
    close(ends[0]);
    v->frames = err ? NULL : fdopen(ends[1], "wb");
    if (v->frames) return v;
    close(ends[1]);
    if (err == ENOENT)
        fprintf(stderr,
                "relight-preview: %s: films need the program ffmpeg, which is not in PATH\n",
                path);
    else fprintf(stderr, "relight-preview: ffmpeg: %s\n", strerror(err ? err : errno));
    if (!err) waitpid(v->pid, NULL, 0);
    free(v);
    return NULL;
}

bool video_add(struct video *v, const uint8_t *rgb)
{
    return fwrite(rgb, v->frame_bytes, 1, v->frames) == 1;
}

int video_close(struct video *v)
{
    int status = 0;
    bool written = fclose(v->frames) == 0;
    while (waitpid(v->pid, &status, 0) < 0 && errno == EINTR) continue;
    bool good = written && WIFEXITED(status) && WEXITSTATUS(status) == 0;
    if (!good) fprintf(stderr, "relight-preview: ffmpeg could not write %s\n", v->path);
    free(v);
    return good ? EXIT_DONE : EXIT_FAILED;
}
