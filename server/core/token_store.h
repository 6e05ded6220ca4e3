/* SPDX-License-Identifier: MIT */
/* token_store.h owns the list of tokens and its file format. A token is 256 random bits; the
 * list keeps its BLAKE2b hash. Pure but for the random source and the clock that callers pass;
 * one thread at a time for one list. */
#ifndef RELIGHTD_TOKEN_STORE_H
#define RELIGHTD_TOKEN_STORE_H

#include "core/ledger.h"

#include <stdbool.h>
#include <stddef.h>
#include <stdint.h>

enum access_scope {
    SCOPE_VIEW = 1,   /* look: lists, colours, pictures, views */
    SCOPE_EDIT = 2,   /* change what others see: vertices, unload, cancel */
    SCOPE_UPLOAD = 4, /* send files and load models */
    SCOPE_ADMIN = 8,  /* what belongs to others; tokens */
    SCOPE_ALL = 15,
};
/* Words, comma-separated, blanks ignored. False for an unknown word; "" gives 0. */
bool scopes_parse(const char *text, unsigned *out);
/* "view,edit"; "none" for 0. */
void scopes_print(unsigned scopes, char out[64]);

enum {
    TOKEN_NAME = 64,   /* bytes, with the end */
    TOKEN_SECRET = 64, /* "relight_" and 43 characters of base64url, with the end */
    TOKEN_HASH = 32,
    TOKENS_MAX = 1000,
};

struct token {
    char name[TOKEN_NAME];
    uint8_t hash[TOKEN_HASH];
    unsigned scopes;
    int64_t created_s, expires_s; /* since 1970; expires_s 0: never */
    char by[96];                  /* principal that created it */
    double rate;                  /* requests a second; 0: no limit of its own */
    uint64_t limit[LEDGER_N];     /* in place of the ledger's limit by client; 0: that one */
    bool pending;                 /* its file is being written: not valid yet */
    double allowance;             /* requests it may send now */
    uint64_t allowance_ns;        /* when that was counted; 0: never */
};

struct token_store {
    struct token *token;
    size_t n, room;
};

/* Letters, digits, '.', '_' and '-', 1 to 63 of them; "default" is --token-file's. NULL, or the
 * fault's text. */
const char *token_name_fault(const char *name);
/* A quota's word ("models", "bakes", …) and resource; N_QUOTA of them. */
struct token_quota {
    const char *word;
    enum ledger_resource resource;
};
extern const struct token_quota token_quotas[];
extern const size_t n_token_quota;

/* Random; the only time that the text exists. */
void token_generate(char secret[TOKEN_SECRET]);
void token_hash(const char *secret, uint8_t hash[TOKEN_HASH]);

/* Copies the token into the list. NULL with the fault's text: a bad or used name, too many. The
 * pointer is valid until the next change. */
struct token *token_add(struct token_store *store, const struct token *token, char fault[256]);
struct token *token_find(const struct token_store *store, const char *name); /* or NULL */
/* By secret; every entry is compared, each in constant time. NULL when there is none. */
struct token *token_by_secret(const struct token_store *store, const char *secret);
void token_remove(struct token_store *store, struct token *token);

/* Reads a file's text into an empty list. 0, or -1 with the fault's text; the list is empty
 * then. */
int tokens_parse(const char *text, size_t n, struct token_store *out, char fault[256]);
/* The file's text, malloc()ed; NULL without memory. */
char *tokens_print(const struct token_store *store);
/* Replaces the file, which its owner alone may read; it is on disk when this returns 0, else an
 * errno. Blocks; any thread, one at a time. */
int tokens_write(const char *path, const char *text);
void tokens_finish(struct token_store *store);

#endif
