// SPDX-License-Identifier: MIT
// Tokens: their names, hashes, scopes and quotas, and the JSON text of DATA/tokens.json.
#include "core/token_store.h"

#include <cjson/cJSON.h>
#include <errno.h>
#include <fcntl.h>
#include <math.h>
#include <sodium.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>
#include <sys/stat.h>
#include <unistd.h>

static const struct {
    const char *word;
    unsigned scope;
} scope_words[] = {{"view", SCOPE_VIEW},
                   {"edit", SCOPE_EDIT},
                   {"upload", SCOPE_UPLOAD},
                   {"admin", SCOPE_ADMIN}};
enum { N_SCOPE = sizeof scope_words / sizeof *scope_words };

const struct token_quota token_quotas[] = {{"connections", LEDGER_CONNECTIONS},
                                           {"requests", LEDGER_REQUESTS},
                                           {"views", LEDGER_LONG_REQUESTS},
                                           {"memory", LEDGER_PAYLOAD},
                                           {"output", LEDGER_OUTPUT},
                                           {"bakes", LEDGER_JOBS},
                                           {"uploads", LEDGER_UPLOADS},
                                           {"models", LEDGER_MODELS},
                                           {"disk", LEDGER_DISK}};
const size_t n_token_quota = sizeof token_quotas / sizeof *token_quotas;

static const char prefix[] = "relight_";
static const double most_number = 9007199254740991; // a JSON number holds it exactly

bool scopes_parse(const char *text, unsigned *out)
{
    unsigned scopes = 0;
    for (const char *at = text + strspn(text, " ,"); *at; at += strspn(at, " ,")) {
        size_t n = strcspn(at, " ,");
        unsigned found = 0;
        for (size_t i = 0; i < N_SCOPE; i++)
            if (strlen(scope_words[i].word) == n && !strncmp(at, scope_words[i].word, n))
                found = scope_words[i].scope;
        if (!found) return false;
        scopes |= found;
        at += n;
    }
    *out = scopes;
    return true;
}

void scopes_print(unsigned scopes, char out[64])
{
    size_t n = 0;
    snprintf(out, 64, "none");
    for (size_t i = 0; i < N_SCOPE; i++)
        if (scopes & scope_words[i].scope)
            n += (size_t)snprintf(out + n, 64 - n, "%s%s", n ? "," : "", scope_words[i].word);
}

const char *token_name_fault(const char *name)
{
    static const char allowed[] = "abcdefghijklmnopqrstuvwxyzABCDEFGHIJKLMNOPQRSTUVWXYZ"
                                  "0123456789._-";
    size_t n = strlen(name);
    if (!n || n >= TOKEN_NAME || strspn(name, allowed) != n)
        return "a token's name has 1 to 63 letters, digits, dots, hyphens and underscores";
    return strcmp(name, "default") ? NULL : "the name \"default\" is that of --token-file";
}

void token_generate(char secret[TOKEN_SECRET])
{
    uint8_t bytes[32];
    size_t n = sizeof prefix - 1;
    randombytes_buf(bytes, sizeof bytes);
    memcpy(secret, prefix, n);
    sodium_bin2base64(secret + n, TOKEN_SECRET - n, bytes, sizeof bytes,
                      sodium_base64_VARIANT_URLSAFE_NO_PADDING);
    sodium_memzero(bytes, sizeof bytes);
}

void token_hash(const char *secret, uint8_t hash[TOKEN_HASH])
{
    crypto_generichash(hash, TOKEN_HASH, (const uint8_t *)secret, strlen(secret), NULL, 0);
}

struct token *token_add(struct token_store *store, const struct token *token, char fault[256])
{
    const char *why = token_name_fault(token->name);
    if (!why && token_find(store, token->name))
        why = "a token of this name exists: revoke it first, or choose another name";
    if (!why && !token->scopes) why = "a token needs at least one scope";
    if (!why && store->n == TOKENS_MAX) why = "there are 1000 tokens already: revoke some";
    if (!why && store->n == store->room) {
        size_t room = store->room ? 2 * store->room : 16;
        struct token *more = realloc(store->token, room * sizeof *more);
        if (more) store->token = more, store->room = room;
        else why = "not enough memory";
    }
    if (why) {
        snprintf(fault, 256, "token %.64s: %s", token->name, why);
        return NULL;
    }
    store->token[store->n] = *token;
    return &store->token[store->n++];
}

struct token *token_find(const struct token_store *store, const char *name)
{
    for (size_t i = 0; i < store->n; i++)
        if (!strcmp(store->token[i].name, name)) return &store->token[i];
    return NULL;
}

struct token *token_by_secret(const struct token_store *store, const char *secret)
{
    uint8_t hash[TOKEN_HASH];
    struct token *found = NULL;
    token_hash(secret, hash);
    for (size_t i = 0; i < store->n; i++)
        if (!sodium_memcmp(hash, store->token[i].hash, TOKEN_HASH)) found = &store->token[i];
    return found;
}

void token_remove(struct token_store *store, struct token *token)
{
    size_t at = (size_t)(token - store->token);
    memmove(token, token + 1, (--store->n - at) * sizeof *token);
}

void tokens_finish(struct token_store *store)
{
    free(store->token);
    *store = (struct token_store){0};
}

// ---- the file

static const char *text_of(const cJSON *json, const char *key)
{
    const cJSON *item = cJSON_GetObjectItemCaseSensitive(json, key);
    return cJSON_IsString(item) ? item->valuestring : "";
}

// A number in [0, most]; absent: 0.
static bool number_of(const cJSON *json, const char *key, double most, double *out)
{
    const cJSON *item = cJSON_GetObjectItemCaseSensitive(json, key);
    *out = item ? item->valuedouble : 0;
    return !item || (cJSON_IsNumber(item) && *out >= 0 && *out <= most);
}

static bool whole_of(const cJSON *json, const char *key, uint64_t *out)
{
    double x;
    if (!number_of(json, key, most_number, &x) || x != floor(x)) return false;
    *out = (uint64_t)x;
    return true;
}

// NULL, or the fault's text.
static const char *read_one(const cJSON *json, struct token *out)
{
    const char *hash = text_of(json, "hash"), *name = text_of(json, "name");
    const cJSON *quotas = cJSON_GetObjectItemCaseSensitive(json, "quotas");
    uint64_t created, expires;
    size_t n = 0;
    *out = (struct token){0};
    if (strlen(name) >= sizeof out->name) return "\"name\" is too long";
    snprintf(out->name, sizeof out->name, "%s", name);
    snprintf(out->by, sizeof out->by, "%s", text_of(json, "by"));
    if (strlen(hash) != 2 * TOKEN_HASH ||
        sodium_hex2bin(out->hash, TOKEN_HASH, hash, 2 * TOKEN_HASH, NULL, &n, NULL) ||
        n != TOKEN_HASH)
        return "\"hash\" is not 64 hexadecimal digits";
    if (!scopes_parse(text_of(json, "scopes"), &out->scopes)) return "\"scopes\" is unknown";
    if (!whole_of(json, "created", &created) || !whole_of(json, "expires", &expires))
        return "\"created\" and \"expires\" are seconds since 1970";
    out->created_s = (int64_t)created;
    out->expires_s = (int64_t)expires;
    if (quotas && !cJSON_IsObject(quotas)) return "\"quotas\" is not an object";
    if (!number_of(quotas, "rate", 1e9, &out->rate)) return "the quota \"rate\" is unreadable";
    for (size_t i = 0; i < n_token_quota; i++)
        if (!whole_of(quotas, token_quotas[i].word, &out->limit[token_quotas[i].resource]))
            return "a quota is no whole number";
    return NULL;
}

int tokens_parse(const char *text, size_t n, struct token_store *out, char fault[256])
{
    *out = (struct token_store){0};
    cJSON *json = cJSON_ParseWithLength(text, n);
    const cJSON *list = cJSON_GetObjectItemCaseSensitive(json, "tokens"), *item;
    const char *why = cJSON_IsArray(list) ? NULL : "it is not a list of tokens";
    char wrong[256];
    size_t number = 0;
    if (why) snprintf(fault, 256, "%s", why);
    cJSON_ArrayForEach(item, list)
    {
        struct token one;
        number++;
        if (!why && (why = read_one(item, &one)))
            snprintf(fault, 256, "entry %zu: %s", number, why);
        if (!why && !token_add(out, &one, wrong)) {
            why = wrong;
            snprintf(fault, 256, "entry %zu: %.200s", number, wrong);
        }
    }
    cJSON_Delete(json);
    if (why) tokens_finish(out);
    return why ? -1 : 0;
}

static cJSON *print_one(const struct token *t)
{
    char hash[2 * TOKEN_HASH + 1], scopes[64];
    cJSON *json = cJSON_CreateObject();
    sodium_bin2hex(hash, sizeof hash, t->hash, TOKEN_HASH);
    scopes_print(t->scopes, scopes);
    cJSON_AddStringToObject(json, "name", t->name);
    cJSON_AddStringToObject(json, "hash", hash);
    cJSON_AddStringToObject(json, "scopes", scopes);
    cJSON_AddNumberToObject(json, "created", (double)t->created_s);
    if (t->expires_s) cJSON_AddNumberToObject(json, "expires", (double)t->expires_s);
    cJSON_AddStringToObject(json, "by", t->by);
    cJSON *quotas = cJSON_AddObjectToObject(json, "quotas");
    if (t->rate > 0) cJSON_AddNumberToObject(quotas, "rate", t->rate);
    for (size_t i = 0; i < n_token_quota; i++)
        if (t->limit[token_quotas[i].resource])
            cJSON_AddNumberToObject(quotas, token_quotas[i].word,
                                    (double)t->limit[token_quotas[i].resource]);
    return json;
}

char *tokens_print(const struct token_store *store)
{
    cJSON *json = cJSON_CreateObject(), *list = cJSON_AddArrayToObject(json, "tokens");
    for (size_t i = 0; i < store->n; i++)
        cJSON_AddItemToArray(list, print_one(&store->token[i]));
    char *text = cJSON_Print(json);
    cJSON_Delete(json);
    return text;
}

// The error of fsync() in the folder of the file.
static int sync_folder(const char *path)
{
    char folder[4096];
    snprintf(folder, sizeof folder, "%s", path);
    *strrchr(folder, '/') = 0;
    int fd = open(folder, O_RDONLY | O_DIRECTORY | O_CLOEXEC), fault = 0;
    if (fd < 0 || fsync(fd)) fault = errno;
    if (fd >= 0) close(fd);
    return fault;
}

int tokens_write(const char *path, const char *text)
{
    char temporary[4200];
    snprintf(temporary, sizeof temporary, "%s.tmp", path);
    int fault = 0, fd = open(temporary, O_CREAT | O_TRUNC | O_WRONLY | O_CLOEXEC, 0600);
    size_t n = strlen(text), at = 0;
    while (fd >= 0 && at < n) {
        ssize_t done = write(fd, text + at, n - at);
        if (done < 0 && errno == EINTR) continue;
        if (done <= 0) break;
        at += (size_t)done;
    }
    if (fd < 0 || at < n || fchmod(fd, 0600) || fsync(fd)) fault = errno ? errno : EIO;
    if (fd >= 0 && close(fd) && !fault) fault = errno;
    if (!fault && rename(temporary, path)) fault = errno;
    if (!fault) return sync_folder(path);
    unlink(temporary);
    return fault;
}
