/* SPDX-License-Identifier: MIT */
/* token.h owns the shared secret of --token-file. */
#ifndef RELIGHTD_TOKEN_H
#define RELIGHTD_TOKEN_H

#include <stdbool.h>

enum { TOKEN_ROOM = 256 };

/* Reads the file's first line. 0, or -1 with the error's text in fault; token is unchanged
 * then. */
int token_read(const char *path, char token[TOKEN_ROOM], char fault[256]);
/* Whether `said` is the token; true when the token is empty. The time does not depend on how
 * much of it is right. */
bool token_is_right(const char *token, const char *said);

#endif
