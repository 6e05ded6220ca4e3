// SPDX-License-Identifier: MIT
// relight-preview: draws pictures of a daemon's model locally: stills, turntables, contact
// sheets.
#include "follow.h"

#include <stdio.h>
#include <stdlib.h>

int report(const struct relight_error *error)
{
    fprintf(stderr, "relight-preview: %s\n", error->text);
    if (*error->hint) fprintf(stderr, "relight-preview: %s\n", error->hint);
    return exit_status(error->code);
}

static void log_line(void *user, enum prt_log_level level, const char *line)
{
    if (level != PRT_LOG_NOTE) fprintf(stderr, "relight-preview: %s\n", line);
}

int main(int argc, char **argv)
{
    struct options options;
    struct relight_error error;
    options_parse(argc, argv, &options);
    struct scene scene = {.options = &options};
    prt_context_init(&scene.ctx);
    scene.ctx.log = log_line;
    struct relight_options how = {.name = "relight-preview " RELIGHT_VERSION,
                                  .token = getenv("RELIGHT_TOKEN"),
                                  .timeout_s = options.timeout_s};
    if (relight_connect(options.server, &how, &scene.client, &error)) return report(&error);
    if (options.follow) return follow_room(scene.client, &options);
    int status = EXIT_DONE;
    if (prt_pool_create(0, &scene.ctx.pool)) {
        fprintf(stderr, "relight-preview: threads could not be started\n");
        status = EXIT_FAILED;
    }
    if (!status) status = scene_fetch(&scene);
    if (!status) status = draw_all(&scene);
    scene_finish(&scene);
    prt_pool_destroy(scene.ctx.pool);
    relight_close(scene.client);
    return status;
}
