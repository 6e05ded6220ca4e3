// SPDX-License-Identifier: MIT
// The relight program: a thin command line over librelight.
#include "cli.h"

#include <stdio.h>

int main(int argc, char **argv)
{
    struct options options;
    const struct command *command = options_parse(argc, argv, &options);
    struct relight_options how = {.name = "relight " RELIGHT_VERSION,
                                  .reconnect_s = options.follow ? 60 : 0,
                                  .token = options.token,
                                  .ca = options.ca,
                                  .timeout_s = options.timeout_s};
    struct relight_client *client;
    struct relight_error error;
    int status;
    if (relight_connect(options.server, &how, &client, &error)) {
        status = report_error(&options, &error);
    } else {
        status = options_materials(client, &options);
        if (!status) status = command->run(client, &options);
        relight_close(client);
    }
    progress_clear();
    options_finish(&options);
    if (fflush(stdout) && status == EXIT_DONE) {
        perror("relight: standard output");
        status = EXIT_FAILED;
    }
    return status;
}
