// SPDX-License-Identifier: MIT
// The file of the shared secret.
#include "core/token.h"

#include <errno.h>
#include <stdio.h>
#include <string.h>

int token_read(const char *path, char token[TOKEN_ROOM], char fault[256])
{
    char line[TOKEN_ROOM + 2] = "";
    FILE *file = fopen(path, "re");
    const char *why = file ? NULL : strerror(errno);
    if (file && !fgets(line, sizeof line, file)) line[0] = 0;
    if (file) fclose(file);
    line[strcspn(line, "\r\n")] = 0;
    if (!why && !line[0]) why = "the first line holds no token";
    if (!why && strlen(line) >= TOKEN_ROOM) why = "the token is longer than 255 bytes";
    if (why) {
        snprintf(fault, 256, "token file %s: %s", path, why);
        return -1;
    }
    strcpy(token, line);
    return 0;
}
