// SPDX-License-Identifier: MIT
// The text of tokens.json: it is taken, and printing it and reading it again gives the same
// list; or it is refused with its reason.
#include <assert.h>
#include <stdlib.h>
#include <string.h>

#include "core/token_store.h"

int LLVMFuzzerTestOneInput(const uint8_t *bytes, size_t n);

static void check(const struct token_store *store)
{
    struct token_store again;
    char fault[256], *text = tokens_print(store);
    assert(text && !tokens_parse(text, strlen(text), &again, fault));
    assert(again.n == store->n && store->n <= TOKENS_MAX);
    for (size_t i = 0; i < store->n; i++) {
        const struct token *a = &store->token[i], *b = &again.token[i];
        assert(!token_name_fault(a->name) && token_find(store, a->name) == a);
        assert(a->scopes && !(a->scopes & ~(unsigned)SCOPE_ALL));
        assert(!strcmp(a->name, b->name) && !memcmp(a->hash, b->hash, TOKEN_HASH));
        assert(a->scopes == b->scopes && a->expires_s == b->expires_s && a->expires_s >= 0);
        assert(!memcmp(a->limit, b->limit, sizeof a->limit) && a->rate >= 0);
    }
    tokens_finish(&again);
    free(text);
}

int LLVMFuzzerTestOneInput(const uint8_t *bytes, size_t n)
{
    struct token_store store;
    char fault[256] = "", *text = malloc(n + 1); // its end is where a read beyond it shows
    if (n) memcpy(text, bytes, n);
    int status = tokens_parse(text, n, &store, fault);
    assert(status == 0 || status == -1);
    assert(!status == !fault[0]);
    if (!status) check(&store);
    tokens_finish(&store);
    free(text);
    return 0;
}
