// SPDX-License-Identifier: MIT
// Who may do what: tokens, local users, addresses.
#include "core/access.h"

#include "core/address.h"
#include "core/guesses.h"
#include "core/loop.h"
#include "core/options.h"

#include <arpa/inet.h>
#include <errno.h>
#include <math.h>
#include <netinet/in.h>
#include <sodium.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>
#include <time.h>
#include <unistd.h>

enum { MOST_FILE = 1 << 20 };
static const char file_name[] = "tokens.json", token_prefix[] = "token:";

struct access {
    const struct options *options;
    char folder[4000];
    struct token_store store;
    struct token shared; // of --token-file; without a name: none
    bool existed;        // a token was created in this folder at some time
    struct guesses guesses;
    access_guest_fn guest_check;
    bool (*guest_current)(void *user, const char *principal);
    void *guests;
};

const char *caller_payer(const struct caller *caller)
{
    return caller->inviter[0] ? caller->inviter : caller->name;
}

const char *access_missing(unsigned has, unsigned wanted)
{
    static const struct {
        unsigned scope;
        const char *word;
    } words[] = {{SCOPE_VIEW, "view"},
                 {SCOPE_EDIT, "edit"},
                 {SCOPE_UPLOAD, "upload"},
                 {SCOPE_ADMIN, "admin"}};
    for (size_t i = 0; i < sizeof words / sizeof *words; i++)
        if (wanted & ~has & words[i].scope) return words[i].word;
    return NULL;
}

// ---- the file

void access_path(const struct access *access, char *path, unsigned n)
{
    snprintf(path, n, "%s/%s", access->folder, file_name);
}

static int read_file(struct access *access, char fault[256])
{
    char path[4096], why[256] = "";
    access_path(access, path, sizeof path);
    FILE *file = fopen(path, "re");
    if (!file && errno == ENOENT) return 0;
    char *text = file ? malloc(MOST_FILE + 1) : NULL;
    size_t n = text ? fread(text, 1, MOST_FILE + 1, file) : 0;
    int failed = -1;
    if (!file || !text || ferror(file)) snprintf(why, sizeof why, "%s", strerror(errno));
    else if (n > MOST_FILE) snprintf(why, sizeof why, "it is longer than 1 MiB");
    else failed = tokens_parse(text, n, &access->store, why);
    if (file) fclose(file);
    free(text);
    access->existed = true;
    if (failed)
        snprintf(fault, 256,
                 "tokens %.120s: %.75s: restore the file, or remove it to begin anew", path,
                 why);
    return failed;
}

int access_create(const struct options *options, const char *folder, struct access **out,
                  char fault[256])
{
    struct access *access = calloc(1, sizeof *access);
    if (!access || sodium_init() < 0) {
        snprintf(fault, 256, "tokens: %s", access ? "libsodium failed" : "not enough memory");
        free(access);
        return -1;
    }
    access->options = options;
    guesses_init(&access->guesses);
    snprintf(access->folder, sizeof access->folder, "%s", folder ? folder : "");
    if (folder && read_file(access, fault)) {
        access_destroy(access);
        return -1;
    }
    *out = access;
    return 0;
}

void access_destroy(struct access *access)
{
    if (!access) return;
    tokens_finish(&access->store);
    free(access);
}

struct token_store *access_store(struct access *access)
{
    return &access->store;
}

int access_replace(struct access *access, const char *text, size_t n, char fault[256])
{
    struct token_store fresh;
    if (tokens_parse(text, n, &fresh, fault)) return -1;
    for (size_t i = 0; i < fresh.n; i++) {
        const struct token *before = token_find(&access->store, fresh.token[i].name);
        if (!before || memcmp(before->hash, fresh.token[i].hash, TOKEN_HASH)) continue;
        fresh.token[i].allowance = before->allowance;
        fresh.token[i].allowance_ns = before->allowance_ns;
        fresh.token[i].pending = before->pending; // its answer is on its way
    }
    tokens_finish(&access->store);
    access->store = fresh;
    access->existed = true;
    return 0;
}

bool access_commit(struct access *access, struct token *token)
{
    bool before = access_required(access);
    token->pending = false;
    access->existed = true;
    return !before;
}

// ---- tokens

void access_set_default(struct access *access, const char *secret)
{
    access->shared = (struct token){.scopes = SCOPE_ALL};
    if (!*secret) return;
    strcpy(access->shared.name, "default");
    token_hash(secret, access->shared.hash);
}

bool access_has_default(const struct access *access)
{
    return access->shared.name[0];
}

bool access_is_default(const struct access *access, const char *secret)
{
    uint8_t hash[TOKEN_HASH];
    token_hash(secret, hash);
    return access->shared.name[0] && !sodium_memcmp(hash, access->shared.hash, TOKEN_HASH);
}

bool access_required(const struct access *access)
{
    return access_has_default(access) || access->existed;
}

bool access_configured(const struct options *options)
{
    char path[4096];
    if (options->token_file[0]) return true;
    if (!options->data[0]) return false;
    snprintf(path, sizeof path, "%s/%s", options->data, file_name);
    return !access(path, F_OK);
}

static struct token *token_of(const struct access *access, const char *principal)
{
    size_t n = sizeof token_prefix - 1;
    if (strncmp(principal, token_prefix, n)) return NULL;
    if (access->shared.name[0] && !strcmp(principal + n, access->shared.name))
        return (struct token *)&access->shared;
    return token_find(&access->store, principal + n);
}

static bool expired(const struct token *token)
{
    struct timespec now; // time() lags behind it by milliseconds
    clock_gettime(CLOCK_REALTIME, &now);
    return token->expires_s && now.tv_sec >= token->expires_s;
}

bool is_guest(const char *principal)
{
    return !strncmp(principal, "guest:", 6);
}

void access_set_guests(struct access *access, access_guest_fn check,
                       bool (*current)(void *user, const char *principal), void *user)
{
    access->guest_check = check;
    access->guest_current = current;
    access->guests = user;
}

bool access_is_current(const struct access *access, const struct caller *caller)
{
    if (is_guest(caller->name))
        return access->guest_current && access->guest_current(access->guests, caller->name);
    if (strncmp(caller->name, token_prefix, sizeof token_prefix - 1)) return true;
    const struct token *token = token_of(access, caller->name);
    return token && !token->pending && !expired(token) &&
           (sodium_is_zero(caller->token, TOKEN_HASH) ||
            !sodium_memcmp(caller->token, token->hash, TOKEN_HASH));
}

static void sign(const struct token *token, const char *text, char out[44])
{
    uint8_t mac[crypto_auth_hmacsha256_BYTES];
    _Static_assert((int)crypto_auth_hmacsha256_KEYBYTES == (int)TOKEN_HASH, "the key");
    crypto_auth_hmacsha256(mac, (const uint8_t *)text, strlen(text), token->hash);
    sodium_bin2base64(out, 44, mac, sizeof mac, sodium_base64_VARIANT_URLSAFE_NO_PADDING);
}

bool access_sign(const struct access *access, const struct caller *caller, const char *text,
                 char out[44])
{
    const struct token *token = token_of(access, caller->name);
    if (!token || token->pending) return false;
    sign(token, text, out);
    return true;
}

bool access_signature_is(const struct access *access, const char *name, const char *text,
                         const char *signature, struct caller *out)
{
    char principal[96], right[44];
    if (strlen(name) >= TOKEN_NAME || strlen(signature) != sizeof right - 1) return false;
    snprintf(principal, sizeof principal, "%s%s", token_prefix, name);
    const struct token *token = token_of(access, principal);
    if (!token || token->pending || expired(token)) return false;
    sign(token, text, right);
    if (sodium_memcmp(right, signature, sizeof right - 1)) return false;
    *out = (struct caller){.scopes = token->scopes & SCOPE_VIEW, .expires_s = token->expires_s};
    memcpy(out->token, token->hash, TOKEN_HASH);
    snprintf(out->name, sizeof out->name, "%s", principal);
    return true;
}

bool access_take_request(struct access *access, const struct caller *caller, uint32_t *retry_ms)
{
    struct token *t = token_of(access, caller_payer(caller));
    if (!t || !(t->rate > 0)) return true;
    uint64_t now = loop_now_ns();
    double most = fmax(ACCESS_BURST, t->rate);
    double more = (double)(now - t->allowance_ns) * 1e-9 * t->rate;
    t->allowance = t->allowance_ns ? fmin(most, t->allowance + more) : most;
    t->allowance_ns = now;
    if (t->allowance >= 1) {
        t->allowance--;
        return true;
    }
    double wait_ms = ceil((1 - t->allowance) / t->rate * 1e3);
    *retry_ms = wait_ms < 4e9 ? (uint32_t)fmax(1, wait_ms) : UINT32_MAX;
    return false;
}

void access_quotas(void *access, const char *principal, uint64_t limit[LEDGER_N])
{
    const struct token *t = token_of(access, principal);
    for (int i = 0; i < LEDGER_N; i++) limit[i] = t ? t->limit[i] : 0;
}

// ---- identity

static bool is_loopback(const char *host)
{
    struct sockaddr_in four = {.sin_family = AF_INET};
    struct sockaddr_in6 six = {.sin6_family = AF_INET6};
    if (inet_pton(AF_INET, host, &four.sin_addr) == 1)
        return address_is_loopback((struct sockaddr *)&four);
    return inet_pton(AF_INET6, host, &six.sin6_addr) == 1 &&
           address_is_loopback((struct sockaddr *)&six);
}

static enum access_verdict without_token(const struct access *access, const char *who,
                                         struct caller *out, char error[256])
{
    char uid[32], root[] = "uid:0";
    snprintf(out->name, sizeof out->name, "%s", who);
    snprintf(uid, sizeof uid, "uid:%u", (unsigned)geteuid());
    out->expires_s = 0;
    out->scopes = 0;
    if (!strcmp(who, uid) || !strcmp(who, root)) out->scopes = SCOPE_ALL;
    else if (!strncmp(who, "uid:", 4))
        scopes_parse(access->options->local_scopes, &out->scopes);
    else if (!access_required(access))
        out->scopes = !strncmp(who, "addr:", 5) && is_loopback(who + 5)
                          ? SCOPE_ALL
                          : SCOPE_ALL & ~SCOPE_ADMIN;
    if (out->scopes) return ACCESS_GRANTED;
    snprintf(error, 256, "the token is missing: this daemon requires one");
    return ACCESS_NO_TOKEN;
}

static enum access_verdict with_token(struct access *access, const char *secret,
                                      struct caller *out, char error[256])
{
    const struct token *t = token_by_secret(&access->store, secret);
    if (access_is_default(access, secret)) t = &access->shared;
    if (!t || t->pending) {
        snprintf(error, 256, "the token is wrong, or it was revoked");
        return ACCESS_WRONG;
    }
    if (expired(t)) {
        char day[32];
        struct tm when;
        strftime(day, sizeof day, "%Y-%m-%d %H:%M UTC", gmtime_r(&t->expires_s, &when));
        snprintf(error, 256, "the token %s expired on %s: an administrator can create another",
                 t->name, day);
        return ACCESS_EXPIRED;
    }
    snprintf(out->name, sizeof out->name, "%s%s", token_prefix, t->name);
    out->scopes = t->scopes;
    out->expires_s = t->expires_s;
    memcpy(out->token, t->hash, TOKEN_HASH);
    return ACCESS_GRANTED;
}

enum access_verdict access_check(struct access *access, const char *who, const char *secret,
                                 struct caller *out, char error[256], uint32_t *retry_ms)
{
    enum access_verdict verdict = ACCESS_NO_TOKEN;
    *retry_ms = 0;
    *out = (struct caller){0};
    bool later = *secret && guesses_wait_ms(&access->guesses, who, loop_now_ns());
    if (*secret && !later && access->guest_check)
        verdict = access->guest_check(access->guests, secret, out, error);
    if (verdict == ACCESS_WRONG) guesses_count(&access->guesses, who, secret, loop_now_ns());
    if (verdict != ACCESS_NO_TOKEN) return verdict;
    // A client may have a token for another daemon in its environment.
    if (!*secret || !access_required(access)) return without_token(access, who, out, error);
    if ((*retry_ms = guesses_wait_ms(&access->guesses, who, loop_now_ns()))) {
        snprintf(error, 256, "too many wrong tokens came from your address: wait %u s",
                 (*retry_ms + 999) / 1000);
        return ACCESS_LATER;
    }
    verdict = with_token(access, secret, out, error);
    if (verdict == ACCESS_WRONG) guesses_count(&access->guesses, who, secret, loop_now_ns());
    return verdict;
}
