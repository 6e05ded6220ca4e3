// SPDX-License-Identifier: MIT
// prt: the offline program. Picks the subcommand and turns its outcome into an exit status.
#include "tool.h"

#include <stdio.h>
#include <string.h>

static int (*const run[N_COMMAND])(struct tool *) = {
    [CMD_BAKE] = run_bake, [CMD_COLORS] = run_colors,   [CMD_IMAGE] = run_image,
    [CMD_INFO] = run_info, [CMD_COMPARE] = run_compare, [CMD_ENV] = run_env,
};

int main(int argc, char **argv)
{
    if (argc < 2) {
        fputs("error: no subcommand given; see prt --help\n", stderr);
        return EXIT_USAGE;
    }
    if (!strcmp(argv[1], "--help") || !strcmp(argv[1], "-h") || !strcmp(argv[1], "help")) {
        usage_print();
        return EXIT_DONE;
    }
    if (!strcmp(argv[1], "--version")) {
        puts("prt " PRT_VERSION);
        return EXIT_DONE;
    }
    int command = command_find(argv[1]);
    if (command < 0) {
        fprintf(stderr, "error: %s is not a subcommand of prt; see prt --help\n", argv[1]);
        return EXIT_USAGE;
    }
    struct tool tool;
    int status = options_parse((enum command)command, argc - 2, argv + 2, &tool.opt);
    if (status >= 0) return status;
    status = tool_begin(&tool);
    if (status >= 0) return status;
    status = run[command](&tool);
    tool_end(&tool);
    // An answer that could not be printed is a failure too.
    if (fflush(stdout) || ferror(stdout)) {
        fputs("error: standard output could not be written\n", stderr);
        if (status == EXIT_DONE) status = EXIT_FAILED;
    }
    return status;
}
