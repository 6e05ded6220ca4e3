// SPDX-License-Identifier: MIT
// A view of a model: its pictures follow the controls, into a file or onto the terminal.
#include "control.h"
#include "common/picture_ending.h"
#include "terminal.h"

#include <errno.h>
#include <math.h>
#include <pthread.h>
#include <stdlib.h>
#include <string.h>
#include <strings.h>
#include <time.h>
#include <unistd.h>

struct view {
    struct destination base; // first
    struct control *control;
    char env[MOST_LIGHTS][80];
    pthread_t frames;
    pthread_mutex_t lock; // all below
    struct relight_view *view;
    double value[N_VALUE];
    struct relight_light lights[MOST_LIGHTS];
    struct relight_view_request request;
};

// ---- the state

static void apply_values(struct view *v)
{
    const struct options *o = &v->control->options;
    struct relight_picture *p = &v->request.picture;
    float gain = (float)exp2(v->value[TARGET_LIGHT_GAIN]);
    for (uint32_t i = 0; i < o->n_env; i++) {
        bool turns = o->light < 0 || (uint32_t)o->light == i;
        float by = turns ? (float)v->value[TARGET_LIGHT_AZIMUTH] : 0;
        v->lights[i].env = v->env[i];
        v->lights[i].rotate_deg = o->rotate_deg + by;
        for (int k = 0; k < 3; k++) v->lights[i].gain[k] = turns ? gain : 1;
    }
    p->exposure_ev = o->picture.exposure_ev + (float)v->value[TARGET_EXPOSURE];
    p->camera.azimuth_deg =
        o->picture.camera.azimuth_deg + (float)v->value[TARGET_CAMERA_AZIMUTH];
    p->camera.elevation_deg =
        fmaxf(-90, fminf(90, o->picture.camera.elevation_deg +
                                 (float)v->value[TARGET_CAMERA_ELEVATION]));
    float zoom = o->picture.camera.zoom * (float)exp2(v->value[TARGET_CAMERA_ZOOM]);
    p->camera.zoom = fmaxf(.1f, fminf(100, zoom));
}

// Values end where the view's ends: the way back begins there.
static double limited(const struct view *v, int value, double x)
{
    static const double most[N_VALUE] = {[TARGET_LIGHT_GAIN] = 12, [TARGET_EXPOSURE] = 20};
    const struct relight_camera *begin = &v->control->options.picture.camera;
    switch (value) {
    case TARGET_CAMERA_ELEVATION:
        return fmax(-90 - begin->elevation_deg, fmin(90 - begin->elevation_deg, x));
    case TARGET_CAMERA_ZOOM:
        return fmax(log2(.1 / begin->zoom), fmin(log2(100 / begin->zoom), x));
    default:
        return most[value] > 0 ? fmax(-most[value], fmin(most[value], x)) : remainder(x, 360);
    }
}

// The values behind a change, and the names of the fields that differ.
static size_t change_values(struct view *v, const struct change *c, const char *fields[4])
{
    static const char *const names[N_VALUE] = {[TARGET_LIGHT_AZIMUTH] = "lights.rotate_deg",
                                               [TARGET_LIGHT_GAIN] = "lights.gain",
                                               [TARGET_EXPOSURE] = "picture.exposure_ev",
                                               [TARGET_CAMERA_AZIMUTH] = "picture.camera",
                                               [TARGET_CAMERA_ELEVATION] = "picture.camera",
                                               [TARGET_CAMERA_ZOOM] = "picture.camera"};
    size_t n = 0;
    for (int i = 0; i < N_VALUE; i++) {
        double x = c->reset ? 0 : v->value[i];
        if (c->has_position[i]) x = c->position[i];
        x = limited(v, i, x + c->delta[i]);
        bool same = x == v->value[i];
        v->value[i] = x;
        if (!same && (!n || strcmp(fields[n - 1], names[i]))) fields[n++] = names[i];
    }
    return n;
}

static bool send(void *user, const struct change *c)
{
    struct view *v = user;
    const char *fields[4];
    struct relight_error error;
    pthread_mutex_lock(&v->lock);
    size_t n = change_values(v, c, fields);
    apply_values(v);
    // While the connection is lost the values are kept, and the view is opened with them.
    bool sent =
        n && v->view && !relight_view_change(v->view, &v->request, n, fields, NULL, &error);
    pthread_mutex_unlock(&v->lock);
    return sent;
}

// ---- pictures

static bool write_file(const char *path, const void *bytes, size_t n)
{
    char temporary[4096];
    int size = snprintf(temporary, sizeof temporary, "%s.%d", path, (int)getpid());
    FILE *file = size < (int)sizeof temporary ? fopen(temporary, "we") : NULL;
    bool good = file && fwrite(bytes, 1, n, file) == n;
    if (file) good &= !fclose(file);
    good = good && !rename(temporary, path);
    if (!good) say("%s: %s", path, strerror(errno));
    if (!good && file) unlink(temporary);
    return good;
}

static bool show(const struct view *v, const struct relight_image *image)
{
    const char *path = v->control->options.output;
    struct prt_terminal terminal;
    if (strcmp(path, "-")) return write_file(path, image->data, image->n_byte);
    prt_terminal_detect(STDOUT_FILENO, &terminal);
    fputs("\033[H", stdout); // over the picture before
    bool good = !prt_terminal_draw(stdout, &terminal, image->width, image->height, image->data);
    return !fflush(stdout) && good;
}

// Opens the view with the values as they are.
static int open_again(struct view *v, struct relight_error *error)
{
    struct relight_view *view;
    pthread_mutex_lock(&v->lock);
    apply_values(v);
    int status = relight_view_open(v->control->client, &v->request, &view, error);
    if (!status) v->view = view;
    pthread_mutex_unlock(&v->lock);
    return status;
}

static int show_frames(struct view *v, struct relight_error *error)
{
    for (;;) {
        struct relight_frame_out frame;
        int status = relight_view_next(v->view, -1, &frame, error);
        if (status) return status;
        show_connected(v->control, true);
        bool good = !frame.has_image || show(v, &frame.image);
        relight_frame_out_finish(&frame);
        if (!good) exit(EXIT_FAILED);
    }
}

static bool is_lost(int status)
{
    return status == -RELIGHT_E_DISCONNECTED || status == -RELIGHT_E_SHUTTING_DOWN ||
           status == -RELIGHT_E_UNREACHABLE || status == -RELIGHT_E_CANCELLED;
}

static void *frames(void *user)
{
    struct view *v = user;
    for (;;) {
        struct relight_error error = {0};
        struct timespec pause = {0, 500000000};
        int status = v->view ? show_frames(v, &error) : open_again(v, &error);
        if (!status) continue;
        show_connected(v->control, false);
        // The daemon would refuse again: the model is gone, for instance.
        if (!is_lost(status)) exit(report(&error));
        pthread_mutex_lock(&v->lock);
        struct relight_view *view = v->view;
        v->view = NULL;
        pthread_mutex_unlock(&v->lock);
        if (view) report(&error);
        if (view) relight_view_close(view, NULL, NULL, NULL);
        nanosleep(&pause, NULL);
    }
    return NULL;
}

// ---- opening

static void fit(struct view *v)
{
    struct relight_picture *p = &v->request.picture;
    struct prt_terminal terminal;
    if (p->format != RELIGHT_IMAGE_RGB8 || p->width) return;
    prt_terminal_detect(STDOUT_FILENO, &terminal);
    p->width = 640;
    p->height = 480;
    prt_terminal_fit(&terminal, &p->width, &p->height);
    fputs("\033[2J", stdout);
}

static int prepare(struct view *v, struct relight_error *error)
{
    const struct options *o = &v->control->options;
    int status = 0;
    for (uint32_t i = 0; i < o->n_env && !status; i++)
        status =
            relight_env_resolve(v->control->client, o->env[i], NULL, NULL, v->env[i], error);
    v->request = (struct relight_view_request){.model = o->target,
                                               .n_light = o->n_env,
                                               .lights = v->lights,
                                               .picture = o->picture,
                                               .skip_equal = true,
                                               .max_fps = 60};
    if (!picture_ending(o->output, &v->request.picture.format)) {
        char list[128];
        *error = (struct relight_error){.code = RELIGHT_E_ARGUMENT};
        snprintf(error->text, sizeof error->text,
                 "%.100s: -o has to end in one of %s, or be - for the terminal", o->output,
                 picture_ending_list(list));
        return -RELIGHT_E_ARGUMENT;
    }
    fit(v);
    return status;
}

static void stop(struct destination *base)
{
    (void)base; // the view ends with the connection
}

struct destination *open_view(struct control *control, int *status)
{
    struct view *v = calloc(1, sizeof *v);
    struct relight_error error = {.code = RELIGHT_E_NO_MEMORY, .text = "not enough memory"};
    if (v) {
        v->base = (struct destination){send, stop};
        v->control = control;
        pthread_mutex_init(&v->lock, NULL);
        if (control->options.light >= (int)control->options.n_env) {
            error.code = RELIGHT_E_ARGUMENT;
            snprintf(error.text, sizeof error.text, "--light %d: there %s %u --env",
                     control->options.light + 1, control->options.n_env == 1 ? "is" : "are",
                     control->options.n_env);
        } else if (!prepare(v, &error) && !open_again(v, &error) &&
                   !pthread_create(&v->frames, NULL, frames, v)) {
            pthread_detach(v->frames);
            return &v->base;
        }
    }
    *status = report(&error);
    free(v);
    return NULL;
}
