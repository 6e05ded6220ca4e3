/* SPDX-License-Identifier: MIT */
/* token.h owns reading the shared secret of --token-file. */
#ifndef RELIGHTD_TOKEN_H
#define RELIGHTD_TOKEN_H

enum { TOKEN_ROOM = 256 };

/* Reads the file's first line. 0, or -1 with the error's text in fault; token is unchanged
 * then. */
int token_read(const char *path, char token[TOKEN_ROOM], char fault[256]);
#endif
