/* SPDX-License-Identifier: MIT */
/* token.h owns the shared secret of --token-file. */
#ifndef RELIGHTD_TOKEN_H
#define RELIGHTD_TOKEN_H

#include <stdbool.h>

enum { TOKEN_ROOM = 256 };

/* Reads the file's first line. 0, or -1 with the fault's words; token is unchanged then. */
int token_read(const char *path, char token[TOKEN_ROOM], char fault[256]);
/* Whether `said` is the token; true when the token is empty. Takes as long for a nearly right
 * one as for a wrong one. */
bool token_is_right(const char *token, const char *said);

#endif
