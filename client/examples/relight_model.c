/* SPDX-License-Identifier: MIT */
/* Uploads a model, has it baked, and writes a picture of it under a light.
 *   cc relight_model.c $(pkg-config --cflags --libs relight) -o relight_model
 *   ./relight_model bunny.glb 50 marble studio.exr bunny.png */
#include <relight/relight.h>
#include <stdio.h>
#include <stdlib.h>

static int show_progress(void *user, const struct relight_progress *p)
{
    (void)user;
    fprintf(stderr, "\r%s %3.0f %% ", p->stage, 100 * p->fraction);
    return 0; /* non-zero would stop waiting */
}

int main(int argc, char **argv)
{
    if (argc != 6) return fprintf(stderr, "MODEL SIZE_MM MATERIAL ENV OUT.png\n"), 2;
    struct relight_error error;
    struct relight_client *client = NULL;
    struct relight_loaded loaded = {0};
    struct relight_image image = {0};
    struct relight_load load = {.size_mm = strtof(argv[2], NULL), .material = argv[3]};
    struct relight_light light = {0};
    char env[80];
    FILE *file = NULL;
    int failed = relight_connect(NULL, NULL, &client, &error);
    if (!failed) failed = relight_env_resolve(client, argv[4], NULL, NULL, env, &error);
    if (!failed)
        failed = relight_load_file(client, argv[1], &load, NULL, NULL, &loaded, &error);
    if (!failed && loaded.job[0]) /* empty: it was baked before */
        failed = relight_watch(client, loaded.job, show_progress, NULL, &error);
    light.env = env;
    struct relight_image_request request = {
        .model = loaded.model, .n_light = 1, .lights = &light};
    request.picture.format = RELIGHT_IMAGE_PNG;
    if (!failed) failed = relight_image(client, &request, &image, &error);
    if (failed) fprintf(stderr, "error: %s\n%s\n", error.text, error.hint);
    else if (!(file = fopen(argv[5], "wb")) ||
             fwrite(image.data, 1, image.n_byte, file) != image.n_byte || fclose(file))
        failed = fprintf(stderr, "error: %s cannot be written\n", argv[5]);
    relight_image_finish(&image);
    relight_loaded_finish(&loaded);
    relight_close(client);
    return failed ? 1 : 0;
}
