// SPDX-License-Identifier: MIT
// prt, the offline program: runs the subcommand and returns its exit status.
#include "tool.h"

#include <stdio.h>

static int (*const run[N_COMMAND])(struct tool *) = {
    [CMD_BAKE] = run_bake,         [CMD_COLORS] = run_colors,   [CMD_IMAGE] = run_image,
    [CMD_INFO] = run_info,         [CMD_COMPARE] = run_compare, [CMD_ENV] = run_env,
    [CMD_MATERIAL] = run_material,
};

int main(int argc, char **argv)
{
    struct tool tool;
    int status = options_parse(argc, argv, &tool.opt);
    if (status >= 0) return status;
    status = tool_begin(&tool);
    if (status >= 0) return status;
    status = run[tool.opt.command](&tool);
    tool_end(&tool);
    // Output is buffered: an error such as a full disk may appear only here.
    if (fflush(stdout) || ferror(stdout)) {
        fputs("error: standard output could not be written\n", stderr);
        if (status == EXIT_DONE) status = EXIT_FAILED;
    }
    return status;
}
